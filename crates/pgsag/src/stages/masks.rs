//! `masks`: which pixels show buildings, one raster per image at the size of training. From a folder, from the shape of
//! the coarse surface (`geometry`), from a model that is asked by words (Eq. 5), or nothing.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use glam::DVec3;
use pgsag_group::fringe::{fringe_px, some_of};
use pgsag_group::geometry::{self, Points};
use pgsag_group::plan::PlanFrame;
use pgsag_group::refine::{Drawing, drawn_labels, mask_of_labels, raw_labels};
use pgsag_group::segment::named;
use pgsag_group::surface::{Seen, Surface};
use pgsag_group::{Label, Segmenter};
use pgsag_scene::Map;
use pgsag_scene::files::folder::{SceneFolder, open_scene};
use pgsag_scene::files::raster::{decode_instances, decode_mask, encode_instances_png, encode_mask_png};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::coarse::Coarse;
use super::import::Imported;
use super::{
    batch_file, batch_views, batches, config, read, read_json, source_fingerprint, view_file, write, write_json,
};
use crate::config::Config;
use crate::lengths::Lengths;
use crate::photographs::{Photographs, training_camera, training_mask};
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan};

/// What is known of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MaskState {
    /// Buildings are marked.
    Buildings,
    /// A mask says that there is none.
    Empty,
    /// There is no mask.
    Unknown,
}

/// One batch of images.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MaskList {
    /// View index and what is known of it.
    pub views: Vec<(usize, MaskState)>,
}

impl Artifact for MaskList {
    const FORMAT: &'static str = "pgsag-masks";
    const VERSION: u32 = 1;

    fn read(folder: &Path) -> Result<Self> {
        read_json(&folder.join("masks.json"))
    }

    fn write(&self, folder: &Path) -> Result<()> {
        write_json(&folder.join("masks.json"), self)
    }
}

/// What is known of every view.
///
/// # Errors
/// Where a batch is damaged.
pub fn states(job: &Job<'_>, view_count: usize) -> Result<Vec<MaskState>> {
    let mut states = vec![MaskState::Unknown; view_count];
    for batch in job.run.finished_jobs("masks")? {
        for (view, state) in job.read_job::<MaskList>("masks", &batch)?.views {
            if let Some(slot) = states.get_mut(view) {
                *slot = state;
            }
        }
    }
    Ok(states)
}

/// The mask of a view at the size of training; `None` where it is unknown.
///
/// # Errors
/// Where it is damaged.
pub fn mask_of(stage_folder: &Path, view_index: usize, state: MaskState) -> Result<Option<Map<bool>>> {
    if state == MaskState::Unknown {
        return Ok(None);
    }
    let (file, bytes) = read(&batch_file(stage_folder, view_index, "mask.png"))?;
    Ok(Some(decode_mask(&file, &bytes)?))
}

/// Where masks come from.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Origin {
    Nothing,
    /// `SCENE/masks` or `SCENE/mask`.
    Scene,
    Folder(PathBuf),
    Geometry,
    /// Where instances are.
    Instances,
    /// A model.
    Language,
}

fn origin(config: &Config) -> Origin {
    match config.masks.as_str() {
        "none" => Origin::Nothing,
        "geometry" => Origin::Geometry,
        "language" => Origin::Language,
        "auto" if MASK_FOLDERS.iter().any(|name| Path::new(&config.scene).join(name).is_dir()) => Origin::Scene,
        "auto" if instance_folder(config).is_some() => Origin::Instances,
        "auto" => Origin::Geometry,
        folder => Origin::Folder(folder.into()),
    }
}

/// Where the building numbers of images are, if anywhere.
fn instance_folder(config: &Config) -> Option<PathBuf> {
    match config.instances.as_str() {
        "none" => None,
        "auto" => Some(Path::new(&config.scene).join(INSTANCE_FOLDER)).filter(|folder| folder.is_dir()),
        folder => Some(folder.into()),
    }
}

/// Where a scene keeps building numbers.
const INSTANCE_FOLDER: &str = "instances";
/// Where a scene keeps masks.
const MASK_FOLDERS: [&str; 2] = ["masks", "mask"];

pub(crate) fn sources(run: &Run) -> Result<Vec<(String, String)>> {
    let config = config(run)?;
    let mut folders = match config.masks.as_str() {
        "none" | "geometry" | "language" => Vec::new(),
        "auto" => MASK_FOLDERS.iter().map(|name| PathBuf::from(&config.scene).join(name)).collect(),
        folder => vec![PathBuf::from(folder)],
    };
    folders.extend(instance_folder(&config));
    let fingerprint = |folder: PathBuf| -> Result<(String, String)> {
        Ok((folder.file_name().unwrap_or_default().to_string_lossy().into_owned(), source_fingerprint(&folder)?))
    };
    let mut sources = folders.into_iter().map(fingerprint).collect::<Result<Vec<_>>>()?;
    sources.extend(models(run)?);
    Ok(sources)
}

/// Which networks answer, where any are asked.
pub(crate) fn models(run: &Run) -> Result<Vec<(String, String)>> {
    let config = config(run)?;
    if config.masks == "language" { crate::networks::sources(&config.language) } else { Ok(Vec::new()) }
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let imported = Imported::read(&run.stage_folder("import"))?;
    let pixels = imported.scene.views.iter().map(|view| view.camera.pixel_count() as u64).max().unwrap_or(0);
    let threads = rayon::current_num_threads() as u64;
    if origin(&config(run)?) == Origin::Geometry {
        let points =
            std::fs::metadata(run.stage_folder("coarse").join("points.bin")).map_or(0, |found| found.len() / 50);
        return Ok(batches(imported.scene.views.len(), &["import", "coarse"], |count| Cost {
            memory_bytes: (64 << 20) + 48 * pixels * threads + 600 * points,
            disk_bytes: count as u64 * pixels / 50,
            cpu_secs: count as f64 * (pixels as f64 * 500e-9 + points as f64 * 50e-9),
        }));
    }
    let models = match origin(&config(run)?) {
        Origin::Language => crate::networks::memory_bytes(&config(run)?.language),
        _ => 0,
    };
    Ok(batches(imported.scene.views.len(), &["import"], |count| Cost {
        memory_bytes: (64 << 20) + 8 * pixels * threads + models,
        disk_bytes: count as u64 * pixels / 50,
        cpu_secs: count as f64 * (pixels as f64 * 60e-9 + models as f64 * 8e-9),
    }))
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let wing = model(&config(job.run)?)?;
    make(job, wing.as_ref().map(|wing| wing as &dyn Segmenter))
}

/// The networks where masks by language are asked for.
pub(super) fn model(config: &Config) -> Result<Option<pgsag_models::Wing>> {
    let is_asked = origin(config) == Origin::Language;
    is_asked.then(|| crate::networks::wing(&config.language, rayon::current_num_threads())).transpose()
}

/// The stage, with a model to ask where there is one.
///
/// # Errors
/// Where a file or the model cannot be read or asked.
pub fn make(job: &Job<'_>, segmenter: Option<&dyn Segmenter>) -> Result<()> {
    let config = config(job.run)?;
    let imported: Imported = job.read("import")?;
    let origin = origin(&config);
    let views = batch_views(job, imported.scene.views.len());
    let instances = write_instances(job, &imported, &config, &views)?;
    if origin == Origin::Instances {
        return job.write(&MaskList { views: by_instances(job, &views, &instances)? });
    }
    if origin == Origin::Geometry {
        let states = by_geometry(job, &imported, &config, &views)?;
        return job.write(&MaskList { views: states });
    }
    if origin == Origin::Language {
        let segmenter = segmenter.context("masks by language without a model")?;
        return job.write(&MaskList { views: by_language(job, &imported, &config, &views, segmenter)? });
    }
    let folder = with_masks(&imported, &config, origin)?;
    let done = std::sync::atomic::AtomicU64::new(0);
    let total = views.len() as u64;
    let states = views
        .par_iter()
        .map(|&view| {
            job.check()?;
            let state = write_mask(job, &folder, &config, view)?;
            job.advance(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1, total, "masks");
            Ok((view, state))
        })
        .collect::<Result<Vec<_>>>()?;
    tell(job, &folder, &states);
    job.write(&MaskList { views: states })
}

fn with_masks(imported: &Imported, config: &Config, origin: Origin) -> Result<SceneFolder> {
    let scene = Path::new(&config.scene);
    match origin {
        Origin::Nothing | Origin::Geometry | Origin::Instances | Origin::Language => Ok(imported.folder(scene)),
        Origin::Scene => {
            let opened = open_scene(scene)?;
            Ok(SceneFolder { scene: imported.scene.clone(), ..opened })
        }
        Origin::Folder(masks) => {
            let mut folder = imported.folder(scene);
            folder.attach_masks(&masks)?;
            Ok(folder)
        }
    }
}

/// The building numbers of a view at the size of training; `None` where nobody gave any.
///
/// # Errors
/// Where the raster is damaged.
pub fn instances_of(stage_folder: &Path, view_index: usize) -> Result<Option<Map<u16>>> {
    let path = batch_file(stage_folder, view_index, INSTANCES);
    if !path.exists() {
        return Ok(None);
    }
    let (file, bytes) = read(&path)?;
    Ok(Some(decode_instances(&file, &bytes)?))
}

/// The end of the name of a raster of building numbers.
const INSTANCES: &str = "instances.png";

/// Brings given building numbers to the size of training; the views that have some.
fn write_instances(job: &Job<'_>, imported: &Imported, config: &Config, views: &[usize]) -> Result<BTreeSet<usize>> {
    let Some(folder) = instance_folder(config) else { return Ok(BTreeSet::new()) };
    let mut scene = imported.folder(Path::new(&config.scene));
    scene.attach_masks(&folder)?;
    let write_one = |&view: &usize| -> Result<Option<usize>> {
        job.check()?;
        let Some(found) = scene.read_undistorted_instances(view)? else { return Ok(None) };
        let camera = training_camera(&imported.scene.views[view].camera, config.image_width);
        let sized = found.resized_nearest(camera.width, camera.height);
        write(&job.output().join(view_file(view, INSTANCES)), &encode_instances_png(&sized))?;
        Ok(Some(view))
    };
    let found: BTreeSet<usize> =
        views.par_iter().map(write_one).collect::<Result<Vec<_>>>()?.into_iter().flatten().collect();
    job.say(&format!("{} of {} images tell buildings apart", found.len(), views.len()));
    Ok(found)
}

/// Masks where numbers are given and nothing else is.
fn by_instances(job: &Job<'_>, views: &[usize], with: &BTreeSet<usize>) -> Result<Vec<(usize, MaskState)>> {
    let mask = |&view: &usize| -> Result<(usize, MaskState)> {
        if !with.contains(&view) {
            return Ok((view, MaskState::Unknown));
        }
        let (file, bytes) = read(&job.output().join(view_file(view, INSTANCES)))?;
        let found = decode_instances(&file, &bytes)?;
        let values: Vec<bool> = found.values.iter().map(|number| *number > 0).collect();
        let state = if values.contains(&true) { MaskState::Buildings } else { MaskState::Empty };
        let mask = Map { width: found.width, height: found.height, values };
        write(&job.output().join(view_file(view, "mask.png")), &encode_mask_png(&mask))?;
        Ok((view, state))
    };
    views.iter().map(mask).collect()
}

/// Masks from a model that is asked for buildings in every image, at the size of training.
fn by_language(
    job: &Job<'_>,
    imported: &Imported,
    config: &Config,
    views: &[usize],
    segmenter: &dyn Segmenter,
) -> Result<Vec<(usize, MaskState)>> {
    let photographs = Photographs::new(imported, config, job, 0);
    let words = &config.language.words;
    job.say(&format!("a model is asked for \"{words}\""));
    let (mut states, mut shares) = (Vec::with_capacity(views.len()), Vec::with_capacity(views.len()));
    // One image after another: a model takes all threads for itself.
    for (done, &view) in views.iter().enumerate() {
        job.check()?;
        let name = || imported.scene.views[view].name.clone();
        let mask = named(segmenter, photographs.whole(view)?.as_ref(), words).with_context(name)?;
        write(&job.output().join(view_file(view, "mask.png")), &encode_mask_png(&mask))?;
        let marked = mask.values.iter().filter(|inside| **inside).count();
        shares.push(marked as f64 / mask.values.len().max(1) as f64);
        states.push((view, if marked > 0 { MaskState::Buildings } else { MaskState::Empty }));
        job.advance(done as u64 + 1, views.len() as u64, "masks");
    }
    shares.sort_by(f64::total_cmp);
    let median = shares.get(shares.len() / 2).copied().unwrap_or(0.0);
    if !PLAUSIBLE.contains(&median) {
        let text = "the middle one of the masks by language marks";
        job.warn(format!("{text} {:.2} % of its image: implausible, look at 03-masks", 100.0 * median));
    }
    Ok(states)
}

/// Share of an image that buildings cover in aerial photographs of towns.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 0.01..=0.85;

/// Masks from the shape of the coarse surface: its points are told apart and drawn into every image.
fn by_geometry(
    job: &Job<'_>,
    imported: &Imported,
    config: &Config,
    views: &[usize],
) -> Result<Vec<(usize, MaskState)>> {
    let coarse: Coarse = job.read("coarse")?;
    let positions: Vec<DVec3> = coarse.points.iter().map(|point| point.position_world).collect();
    let colors: Vec<[u8; 3]> = coarse.points.iter().map(|point| point.color).collect();
    let surface = Surface::new(positions.clone());
    let lengths = Lengths::of(&imported.scene);
    let points = Points { positions: &positions, colors: &colors, normals: &coarse.normals, spacing: surface.spacing };
    let frame = PlanFrame::new(imported.scene.frame.up_world);
    let found = geometry::find(&points, &frame, &config.geometry, lengths.units(1.0));
    let Some(found) = found.filter(|found| found.buildings > 0) else {
        job.warn("nothing here has the shape of a building: buildings are not separated from their surroundings");
        return Ok(views.iter().map(|view| (*view, MaskState::Unknown)).collect());
    };
    job.say(&format!(
        "{} pieces have the shape of buildings, {} others rise above the ground",
        found.buildings, found.others
    ));
    let photographs = Photographs::new(imported, config, job, 0);
    let witnesses = coarse.witnesses(config);
    let done = std::sync::atomic::AtomicU64::new(0);
    let seen = |view: usize| {
        let (camera, pose) = (photographs.camera(view), &imported.scene.views[view].camera_from_world);
        surface.render(&surface.buffer_camera(&camera, pose), pose, |_| true)
    };
    let labels = &found.labels;
    let fringe_px = measured_fringe(job, views, &photographs, labels, seen)?;
    let draw = |&view: &usize| {
        job.check()?;
        let is_witnessed = |point: u32| witnesses.include(point as usize, view);
        let seen = seen(view);
        let drawing = Drawing { seen: &seen, labels, is_witnessed: &is_witnessed, agreement: AGREEMENT, fringe_px };
        let drawn = drawn_labels(&drawing, photographs.whole(view)?.as_ref(), &config.refine);
        let side = config.refine.superpixel_px;
        let mask = mask_of_labels(&drawn, (SPECK_SUPERPIXELS * side.pow(2)) as usize, GAP_SUPERPIXELS * side);
        write(&job.output().join(view_file(view, "mask.png")), &encode_mask_png(&mask))?;
        job.advance(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1, views.len() as u64, "masks");
        Ok((view, if mask.values.contains(&true) { MaskState::Buildings } else { MaskState::Empty }))
    };
    views.par_iter().map(draw).collect()
}

/// How far the points draw buildings past their edges, pixels, said aloud; `seen` is what a view sees of them.
pub(super) fn measured_fringe(
    job: &Job<'_>,
    views: &[usize],
    photographs: &Photographs,
    labels: &[Label],
    seen: impl Fn(usize) -> Seen + Sync,
) -> Result<f32> {
    let some = some_of(views);
    let done = std::sync::atomic::AtomicU64::new(0);
    let fringe = fringe_px(&some, |view| -> Result<_> {
        job.check()?;
        let image = photographs.whole(view)?;
        let drawn = raw_labels(&seen(view), labels, image.width, image.height);
        job.advance(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1, some.len() as u64, "edges");
        Ok((drawn, image))
    })?;
    job.say(&format!("points draw buildings {fringe:.1} pixels past their edges; that is cut off"));
    Ok(fringe as f32)
}

/// Share of a superpixel's points that must agree for it to follow them as one.
const AGREEMENT: f32 = 0.6;
/// Gaps between points are filled as far as so many superpixels.
const GAP_SUPERPIXELS: u32 = 4;
/// Patches of a mask smaller than this many superpixels are specks.
const SPECK_SUPERPIXELS: u32 = 2;

fn write_mask(job: &Job<'_>, folder: &SceneFolder, config: &Config, view: usize) -> Result<MaskState> {
    let Some(mask) = folder.read_undistorted_mask(view)? else { return Ok(MaskState::Unknown) };
    let camera = training_camera(&folder.scene.views[view].camera, config.image_width);
    let mask = training_mask(&mask, &camera);
    write(&job.output().join(view_file(view, "mask.png")), &encode_mask_png(&mask))?;
    Ok(if mask.values.contains(&true) { MaskState::Buildings } else { MaskState::Empty })
}

fn tell(job: &Job<'_>, folder: &SceneFolder, states: &[(usize, MaskState)]) {
    let count = |wanted: MaskState| states.iter().filter(|(_, state)| *state == wanted).count();
    let (buildings, empty, unknown) = (count(MaskState::Buildings), count(MaskState::Empty), count(MaskState::Unknown));
    if buildings + empty == 0 {
        job.warn("no masks: buildings are not separated from their surroundings");
        return;
    }
    if let Some(convention) = folder.mask_convention {
        job.say(&format!("masks are named like {convention}"));
    }
    job.say(&format!("{buildings} masks show buildings, {empty} say that there is none"));
    if unknown > 0 {
        job.warn(format!("{unknown} images have no mask: they are used for the background only"));
    }
}
