//! `refine`: masks, set right by the voted points, to the pixel classes that training works with, per kind of group.

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::Result;
use pgsag_group::edges::inner_edges;
use pgsag_group::refine::{
    Drawing, RefineOptions, background_classes, building_classes, corrected, drawn_labels, fill_segments,
};
use pgsag_group::surface::{Seen, Surface};
use pgsag_group::{GroupKind, Label, Segmenter};
use pgsag_scene::files::raster::{decode_mask, encode_mask_png};
use pgsag_scene::{Map, Mask};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::coarse::{Coarse, Witnesses};
use super::import::Imported;
use super::masks::{instances_of, mask_of, measured_fringe, states};
use super::vote::Votes;
use super::{
    batch_file, batch_views, batches, config, encode_classes, read, read_classes, read_json, view_file, write,
    write_json,
};
use crate::photographs::Photographs;
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan};

mod ask;

use ask::Asker;

/// Which views of a batch have classes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Classes {
    /// Indices of the views.
    pub views: Vec<usize>,
}

impl Artifact for Classes {
    const FORMAT: &'static str = "pgsag-classes";
    const VERSION: u32 = 2;

    fn read(folder: &Path) -> Result<Self> {
        read_json(&folder.join("classes.json"))
    }

    fn write(&self, folder: &Path) -> Result<()> {
        write_json(&folder.join("classes.json"), self)
    }
}

/// The end of the name of a raster of inner edges.
const EDGES: &str = "edges.png";

/// The end of a class raster's name.
fn kind_name(kind: GroupKind) -> &'static str {
    match kind {
        GroupKind::Building => "building.png",
        GroupKind::Background => "background.png",
    }
}

/// The classes of a view for a kind of group; `None` where its mask is unknown.
///
/// # Errors
/// Where the raster is damaged.
pub fn classes_of(stage_folder: &Path, view_index: usize, kind: GroupKind) -> Result<Option<Mask>> {
    let path = batch_file(stage_folder, view_index, kind_name(kind));
    if path.exists() { read_classes(&path).map(Some) } else { Ok(None) }
}

/// Where buildings part inside of a view's mask; `None` where nothing is known.
///
/// # Errors
/// Where the raster is damaged.
pub fn edges_of(stage_folder: &Path, view_index: usize) -> Result<Option<Map<bool>>> {
    let path = batch_file(stage_folder, view_index, EDGES);
    if !path.exists() {
        return Ok(None);
    }
    let (file, bytes) = read(&path)?;
    Ok(Some(decode_mask(&file, &bytes)?))
}

/// The building mask of a view after refinement; `None` where its mask is unknown.
///
/// # Errors
/// Where the raster is damaged.
pub fn building_of(stage_folder: &Path, view_index: usize) -> Result<Option<Map<bool>>> {
    let active = |mask: Mask| Map {
        width: mask.width,
        height: mask.height,
        values: mask.classes.iter().map(|class| class.is_active()).collect(),
    };
    Ok(classes_of(stage_folder, view_index, GroupKind::Building)?.map(active))
}

/// Small masks of all that a model sees in an image: three for each of a thousand clicks.
const SEGMENTS_BYTES: u64 = 800 << 20;

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let imported = Imported::read(&run.stage_folder("import"))?;
    let pixels = imported.scene.views.iter().map(|view| view.camera.pixel_count() as u64).max().unwrap_or(0);
    let points = std::fs::metadata(run.stage_folder("vote").join("votes.bin")).map_or(0, |found| found.len() / 9);
    let threads = rayon::current_num_threads() as u64;
    let config = config(run)?;
    let segments = if config.refine.everything { SEGMENTS_BYTES } else { 0 };
    let models = if config.masks == "language" { crate::networks::memory_bytes(&config.language) } else { 0 };
    Ok(batches(imported.scene.views.len(), &["import", "coarse", "masks", "vote"], |count| Cost {
        memory_bytes: (64 << 20) + 64 * pixels * threads + 400 * points + models + segments,
        disk_bytes: count as u64 * pixels / 16,
        cpu_secs: count as f64 * (pixels as f64 * 600e-9 + points as f64 * 50e-9),
    }))
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let wing = super::masks::model(&config(job.run)?)?;
    make(job, wing.as_ref().map(|wing| wing as &dyn Segmenter))
}

/// The stage, with a model to ask for every building where there is one.
///
/// # Errors
/// Where a file or the model cannot be read or asked.
pub fn make(job: &Job<'_>, segmenter: Option<&dyn Segmenter>) -> Result<()> {
    let config = config(job.run)?;
    let imported: Imported = job.read("import")?;
    let view_count = imported.scene.views.len();
    let states = states(job, view_count)?;
    let Votes { labels, .. } = job.read("vote")?;
    let photographs = Photographs::new(&imported, &config, job, 0);
    let is_used = config.refine.correct && !labels.is_empty();
    let coarse = if is_used { job.read("coarse")? } else { Coarse::default() };
    let surface = Surface::new(coarse.points.iter().map(|point| point.position_world).collect());
    let witnesses = coarse.witnesses(&config);
    let mut pencil = Pencil { witnesses, surface, labels, photographs, imported: &imported, fringe_px: 0.0 };
    let views = batch_views(job, view_count);
    if !pencil.surface.is_empty() {
        let seen = |view| pencil.seen(view);
        pencil.fringe_px = measured_fringe(job, &views, &pencil.photographs, &pencil.labels, seen)?;
    }
    let asker = segmenter.filter(|_| is_used).map(|segmenter| Asker::new(job, &config, &pencil, segmenter));
    let all = segmenter.filter(|_| is_used && config.refine.everything);
    let (masks, turn) = (job.input("masks"), Mutex::new(()));
    let done = AtomicU64::new(0);
    let refined = |&view: &usize| -> Result<Option<(usize, u64, u64)>> {
        job.check()?;
        let Some(given) = mask_of(&masks, view, states[view])? else { return Ok(None) };
        let asked = asker.as_ref().map(|asker| asker.mended(view, &given)).transpose()?;
        let segments = match all {
            Some(segmenter) => {
                // One view after another: a thousand masks are held at once.
                let _turn = turn.lock().map_err(|_| anyhow::anyhow!("a thread broke"))?;
                segmenter.everything(pencil.photographs.whole(view)?.as_ref())?
            }
            None => None,
        };
        let mask = pencil.corrected(view, asked.as_ref().unwrap_or(&given), segments.as_ref(), &config.refine)?;
        write_classes(job, view, &mask, &config.refine)?;
        if let Some(edges) = pencil.inner_edges(view, &mask, instances_of(&masks, view)?.as_ref(), &config.refine) {
            write(&job.output().join(view_file(view, EDGES)), &encode_mask_png(&edges))?;
        }
        write_named(job, &imported.scene.views[view].name, &mask)?;
        job.advance(done.fetch_add(1, Ordering::Relaxed) + 1, views.len() as u64, "masks");
        let changed = given.values.iter().zip(&mask.values).filter(|(before, now)| before != now).count();
        Ok(Some((view, changed as u64, mask.values.len() as u64)))
    };
    let found = views.par_iter().map(refined).collect::<Result<Vec<_>>>()?;
    let found: Vec<_> = found.into_iter().flatten().collect();
    let (changed, all) = found.iter().fold((0, 0), |sum, (_, changed, all)| (sum.0 + changed, sum.1 + all));
    if let Some(asker) = asker {
        job.say(&asker.told());
    }
    if all > 0 {
        job.say(&format!("the points corrected {:.2} % of the masks' pixels", 100.0 * changed as f64 / all as f64));
    }
    job.write(&Classes { views: found.into_iter().map(|(view, ..)| view).collect() })
}

/// Share of a superpixel's points that must agree to overrule a mask as one.
const SURE_AGREEMENT: f32 = 0.8;

/// Draws the voted points into images.
struct Pencil<'a> {
    witnesses: Witnesses<'a>,
    surface: Surface,
    labels: Vec<Label>,
    photographs: Photographs,
    imported: &'a Imported,
    /// How far buildings are drawn past their edges.
    fringe_px: f32,
}

impl Pencil<'_> {
    /// What a view sees of the coarse points.
    fn seen(&self, view: usize) -> Seen {
        let (camera, pose) = (self.photographs.camera(view), &self.imported.scene.views[view].camera_from_world);
        self.surface.render(&self.surface.buffer_camera(&camera, pose), pose, |_| true)
    }

    /// Where buildings part inside of a mask; `None` where there is no edge.
    fn inner_edges(
        &self,
        view: usize,
        mask: &Map<bool>,
        instances: Option<&Map<u16>>,
        options: &RefineOptions,
    ) -> Option<Map<bool>> {
        if !mask.values.contains(&true) {
            return None;
        }
        let edges = inner_edges(mask, &self.seen(view), self.surface.spacing, instances, options.band_px);
        edges.values.contains(&true).then_some(edges)
    }

    /// A given mask, set right where the points contradict it.
    fn corrected(
        &self,
        view: usize,
        given: &Map<bool>,
        segments: Option<&Map<u32>>,
        options: &RefineOptions,
    ) -> Result<Map<bool>> {
        if self.surface.is_empty() {
            return Ok(given.clone());
        }
        let (camera, seen) = (self.photographs.camera(view), self.seen(view));
        let is_witnessed = |point: u32| self.witnesses.include(point as usize, view);
        let drawing = Drawing {
            seen: &seen,
            labels: &self.labels,
            is_witnessed: &is_witnessed,
            agreement: SURE_AGREEMENT,
            fringe_px: self.fringe_px,
        };
        let mut drawn = drawn_labels(&drawing, self.photographs.whole(view)?.as_ref(), options);
        if let Some(segments) = segments {
            fill_segments(&mut drawn, segments, SURE_AGREEMENT);
        }
        let reach_px = f64::from(options.min_change_px).max(self.surface.spacing_px(&camera, &seen));
        Ok(corrected(given, &drawn, reach_px as f32))
    }
}

fn write_classes(job: &Job<'_>, view: usize, mask: &Map<bool>, options: &RefineOptions) -> Result<()> {
    for kind in [GroupKind::Building, GroupKind::Background] {
        let classes = match kind {
            GroupKind::Building => building_classes(mask, options),
            GroupKind::Background => background_classes(mask, options),
        };
        write(&job.output().join(view_file(view, kind_name(kind))), &encode_classes(&classes))?;
    }
    Ok(())
}

/// The refined mask under COLMAP's name for it: the photograph's path with `.png` behind it.
fn write_named(job: &Job<'_>, name: &str, mask: &Map<bool>) -> Result<()> {
    let path = job.output().join("masks").join(format!("{name}.png"));
    if Path::new(name).components().any(|part| !matches!(part, std::path::Component::Normal(_))) {
        return Ok(()); // a name that leads out of the folder
    }
    std::fs::create_dir_all(path.parent().unwrap_or(job.output()))?;
    write(&path, &encode_mask_png(mask))
}
