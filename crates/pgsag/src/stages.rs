//! One file per row of the pipeline: read typed artifacts, call a library function, write.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use pgsag_scene::files::map::{FloatSample, decode_map, encode_map};
use pgsag_scene::{Map, Mask, PixelClass, View};
use pgsag_splat::backend::ViewCamera;

use crate::config::Config;
use crate::run::stage::{Cost, Job, JobPlan};
use crate::run::{Run, artifact};

pub mod aoi;
pub mod cloud;
pub mod coarse;
pub mod depth;
pub mod forecast;
pub mod fuse;
pub mod group;
pub mod import;
pub mod masks;
pub mod merge;
pub mod mesh;
pub mod refine;
pub mod report;
pub mod score;
pub mod train;
pub mod vote;

/// Images in one job of a stage that is divided by images.
pub const BATCH: usize = 200;

/// The configuration of a run.
///
/// # Errors
/// Where it is of another version.
pub fn config(run: &Run) -> Result<Config> {
    Config::from_settings(&run.settings)
}

/// Reads a JSON file of ours.
pub(crate) fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    let text = std::fs::read_to_string(path).with_context(|| format!("{}", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{}", path.display()))
}

/// Writes a JSON file of ours.
pub(crate) fn write_json<T: serde::Serialize>(path: &Path, value: &T) -> Result<()> {
    let text = serde_json::to_string_pretty(value).with_context(|| format!("{}", path.display()))?;
    write(path, format!("{text}\n").as_bytes())
}

/// Writes a file into an attempt's folder, which is published as a whole later.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    std::fs::write(path, bytes).with_context(|| format!("{}: cannot be written", path.display()))
}

/// Reads a file with its name for messages.
pub(crate) fn read(path: &Path) -> Result<(String, Vec<u8>)> {
    let bytes = std::fs::read(path).with_context(|| format!("{}", path.display()))?;
    Ok((path.display().to_string(), bytes))
}

/// Writes a map of floats.
pub(crate) fn write_map<T: FloatSample>(path: &Path, map: &Map<T>) -> Result<()> {
    write(path, &encode_map(map))
}

/// Reads a map of floats.
pub(crate) fn read_map<T: FloatSample>(path: &Path) -> Result<Map<T>> {
    let (file, bytes) = read(path)?;
    Ok(decode_map(&file, &bytes)?)
}

/// Name of a view's file in an artifact.
pub(crate) fn view_file(view_index: usize, kind: &str) -> String {
    format!("{view_index:05}.{kind}")
}

/// The batch of images that a view belongs to.
pub(crate) fn batch_name(view_index: usize) -> String {
    format!("i{:03}", view_index / BATCH)
}

/// Where a stage that is divided by images keeps a view's file.
pub(crate) fn batch_file(stage_folder: &Path, view_index: usize, kind: &str) -> PathBuf {
    stage_folder.join(batch_name(view_index)).join(view_file(view_index, kind))
}

/// The views of a job of such a stage.
pub(crate) fn batch_views(job: &Job<'_>, view_count: usize) -> Vec<usize> {
    (0..view_count).filter(|view| batch_name(*view) == job.name).collect()
}

/// One job per batch of images that reads everything its stage reads.
pub(crate) fn batches(view_count: usize, reads: &[&'static str], cost: impl Fn(usize) -> Cost) -> Vec<JobPlan> {
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for view in 0..view_count {
        *counts.entry(batch_name(view)).or_default() += 1;
    }
    counts
        .into_iter()
        .map(|(name, count)| JobPlan {
            name,
            inputs: reads.iter().map(|stage| (*stage, None)).collect(),
            cost: cost(count),
        })
        .collect()
}

/// A view's camera about a group's origin, cut to a window of the training image.
pub(crate) fn view_camera(
    view: &View,
    camera: &pgsag_scene::Pinhole,
    window_px: [u32; 4],
    origin: [f64; 3],
) -> ViewCamera {
    let [x0, y0, width, height] = window_px;
    let camera_from_group = view.camera_from_world.with_origin(origin.into());
    let rotation = camera_from_group.rotation_matrix();
    ViewCamera {
        pinhole: camera.cropped(x0, y0, width, height),
        rotation: std::array::from_fn(|row| rotation.row(row).to_array()),
        translation: camera_from_group.translation.to_array(),
        near: 0.0,
    }
}

/// Pixel classes as a grey PNG of the class numbers.
pub(crate) fn encode_classes(mask: &Mask) -> Vec<u8> {
    let values = mask.classes.iter().map(|class| *class as u16).collect();
    pgsag_scene::files::raster::encode_instances_png(&Map { width: mask.width, height: mask.height, values })
}

/// Reads what [`encode_classes`] wrote.
pub(crate) fn read_classes(path: &Path) -> Result<Mask> {
    let (file, bytes) = read(path)?;
    let map = pgsag_scene::files::raster::decode_instances(&file, &bytes)?;
    let classes = map.values.iter().map(|value| match value {
        0 => PixelClass::Free,
        1 => PixelClass::Occluded,
        2 => PixelClass::Boundary,
        _ => PixelClass::Inside,
    });
    Ok(Mask { width: map.width, height: map.height, classes: classes.collect() })
}

/// No files outside the run.
pub(crate) fn no_sources(_: &Run) -> Result<Vec<(String, String)>> {
    Ok(Vec::new())
}

/// Fingerprints of everything below a file or folder outside the run, as one word; `absent` where it is not there.
pub(crate) fn source_fingerprint(path: &Path) -> Result<String> {
    if path.is_file() {
        return artifact::fingerprint_source(path);
    }
    if !path.is_dir() {
        return Ok("absent".into());
    }
    use rayon::prelude::*;
    let files = artifact::files_below(path)?;
    let prints: Vec<String> =
        files.par_iter().map(|file| artifact::fingerprint_source(&path.join(file))).collect::<Result<_>>()?;
    Ok(artifact::fingerprint_words(files.iter().zip(&prints).flat_map(|(file, print)| [file.as_str(), print.as_str()])))
}
