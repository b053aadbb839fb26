//! `masks`: which pixels show buildings, one raster per image at the size of training. From a folder, or nothing.

use std::path::{Path, PathBuf};

use anyhow::Result;
use pgsag_scene::Map;
use pgsag_scene::files::folder::{SceneFolder, open_scene};
use pgsag_scene::files::raster::{decode_mask, encode_mask_png};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::import::Imported;
use super::{
    batch_file, batch_views, batches, config, read, read_json, source_fingerprint, view_file, write, write_json,
};
use crate::config::Config;
use crate::photographs::{training_camera, training_mask};
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

pub(crate) fn sources(run: &Run) -> Result<Vec<(String, String)>> {
    let config = config(run)?;
    let folders = match config.masks.as_str() {
        "none" => Vec::new(),
        "auto" => ["masks", "mask"].iter().map(|name| PathBuf::from(&config.scene).join(name)).collect(),
        folder => vec![PathBuf::from(folder)],
    };
    folders
        .into_iter()
        .map(|folder| {
            Ok((folder.file_name().unwrap_or_default().to_string_lossy().into_owned(), source_fingerprint(&folder)?))
        })
        .collect()
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let imported = Imported::read(&run.stage_folder("import"))?;
    let pixels = imported.scene.views.iter().map(|view| view.camera.pixel_count() as u64).max().unwrap_or(0);
    let threads = rayon::current_num_threads() as u64;
    Ok(batches(imported.scene.views.len(), &["import"], |count| Cost {
        memory_bytes: (64 << 20) + 8 * pixels * threads,
        disk_bytes: count as u64 * pixels / 50,
        cpu_secs: count as f64 * pixels as f64 * 60e-9,
    }))
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let config = config(job.run)?;
    let imported: Imported = job.read("import")?;
    let folder = with_masks(&imported, &config)?;
    let views = batch_views(job, imported.scene.views.len());
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

fn with_masks(imported: &Imported, config: &Config) -> Result<SceneFolder> {
    let scene = Path::new(&config.scene);
    match config.masks.as_str() {
        "none" => Ok(imported.folder(scene)),
        "auto" => {
            let opened = open_scene(scene)?;
            Ok(SceneFolder { scene: imported.scene.clone(), ..opened })
        }
        masks => {
            let mut folder = imported.folder(scene);
            folder.attach_masks(Path::new(masks))?;
            Ok(folder)
        }
    }
}

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
