//! `import`: cameras, points, frame and where the photographs lie.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use glam::DVec3;
use pgsag_scene::files::folder::{SceneFolder, open_scene};
use pgsag_scene::points::TrackElement;
use pgsag_scene::{Frame, Scene, SparsePoint, View};
use serde::{Deserialize, Serialize};

use super::{config, read, read_json, source_fingerprint, write, write_json};
use crate::error::UserError;
use crate::run::Run;
use crate::run::artifact::{Artifact, fingerprint_source};
use crate::run::stage::{Cost, Job, JobPlan};

/// A photograph of the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Photo {
    /// Below the scene's folder where it lies there.
    pub path: PathBuf,
    /// Of its bytes, so that what depends on pixels notices another photograph.
    pub fingerprint: String,
}

/// The scene as the rest of the run knows it.
#[derive(Clone, Debug, PartialEq)]
pub struct Imported {
    /// Views sorted by name, points, frame.
    pub scene: Scene,
    /// One per view.
    pub photos: Vec<Photo>,
}

#[derive(Serialize, Deserialize)]
struct Header {
    frame: Frame,
    views: Vec<View>,
    photos: Vec<Photo>,
}

impl Artifact for Imported {
    const FORMAT: &'static str = "pgsag-scene";
    const VERSION: u32 = 1;

    fn read(folder: &Path) -> Result<Self> {
        let Header { frame, views, photos } = read_json(&folder.join("scene.json"))?;
        let (file, bytes) = read(&folder.join("points.bin"))?;
        let points =
            decode_points(&bytes, views.len()).with_context(|| format!("{file}: damaged; delete its folder"))?;
        Ok(Self { scene: Scene { views, points, frame }, photos })
    }

    fn write(&self, folder: &Path) -> Result<()> {
        let Scene { views, points, frame } = &self.scene;
        let header = Header { frame: frame.clone(), views: views.clone(), photos: self.photos.clone() };
        write_json(&folder.join("scene.json"), &header)?;
        write(&folder.join("points.bin"), &encode_points(points))
    }
}

impl Imported {
    /// The scene with its pixels, without masks.
    #[must_use]
    pub fn folder(&self, scene: &Path) -> SceneFolder {
        SceneFolder {
            scene: self.scene.clone(),
            image_paths: self.photos.iter().map(|photo| scene.join(&photo.path)).collect(),
            headers: Vec::new(),
            mask_paths: vec![None; self.photos.len()],
            mask_convention: None,
            notes: Vec::new(),
        }
    }
}

const MAGIC: &[u8; 8] = b"PGSAGPT1";

/// Little-endian: magic, u64 count, then per point 3 f64, 3 u8, f32 error, u32 track length; then all tracks, u32 view
/// and 2 f32 each.
pub(crate) fn encode_points(points: &[SparsePoint]) -> Vec<u8> {
    let mut out = MAGIC.to_vec();
    out.extend((points.len() as u64).to_le_bytes());
    for point in points {
        point.position_world.to_array().iter().for_each(|value| out.extend(value.to_le_bytes()));
        out.extend(point.color);
        out.extend(point.error_px.to_le_bytes());
        out.extend((point.track.len() as u32).to_le_bytes());
    }
    for seen in points.iter().flat_map(|point| &point.track) {
        out.extend(seen.view_index.to_le_bytes());
        seen.xy_px.iter().for_each(|value| out.extend(value.to_le_bytes()));
    }
    out
}

pub(crate) fn decode_points(bytes: &[u8], view_count: usize) -> Result<Vec<SparsePoint>> {
    const POINT: usize = 24 + 3 + 4 + 4;
    const SEEN: usize = 12;
    let Some((header, body)) = bytes.split_at_checked(16) else { bail!("too short") };
    let count = u64::from_le_bytes(header[8..].try_into()?) as usize;
    if &header[..8] != MAGIC || count > body.len() / POINT {
        bail!("no file of points");
    }
    let (heads, mut tracks) = body.split_at(count * POINT);
    let mut points = Vec::with_capacity(count);
    for head in heads.chunks_exact(POINT) {
        let number = |at: usize| f64::from_le_bytes(std::array::from_fn(|i| head[8 * at + i]));
        let word = |at: usize| -> [u8; 4] { std::array::from_fn(|i| head[at + i]) };
        let length = u32::from_le_bytes(word(31)) as usize;
        let Some((own, rest)) = tracks.split_at_checked(length.saturating_mul(SEEN)) else { bail!("tracks end early") };
        tracks = rest;
        let mut track = Vec::with_capacity(length);
        for seen in own.chunks_exact(SEEN) {
            let word = |at: usize| -> [u8; 4] { std::array::from_fn(|i| seen[at + i]) };
            let view_index = u32::from_le_bytes(word(0));
            if view_index as usize >= view_count {
                bail!("view {view_index} does not exist");
            }
            track.push(TrackElement { view_index, xy_px: [f32::from_le_bytes(word(4)), f32::from_le_bytes(word(8))] });
        }
        points.push(SparsePoint {
            position_world: DVec3::new(number(0), number(1), number(2)),
            color: [head[24], head[25], head[26]],
            error_px: f32::from_le_bytes(word(27)),
            track,
        });
    }
    Ok(points)
}

/// Everything in the scene's folder but masks, truth and runs.
pub(crate) fn sources(run: &Run) -> Result<Vec<(String, String)>> {
    let scene = PathBuf::from(config(run)?.scene);
    let mut names: Vec<String> = std::fs::read_dir(&scene)
        .map_err(|_| UserError::at(&scene, "the scene is not there", "check the path"))?
        .filter_map(|entry| entry.ok().map(|entry| entry.file_name().to_string_lossy().into_owned()))
        .filter(|name| !name.starts_with('.') && !matches!(name.as_str(), "mask" | "masks" | "truth"))
        .filter(|name| !scene.join(name).join("run.toml").exists())
        .collect();
    names.sort();
    names.into_iter().map(|name| Ok((name.clone(), source_fingerprint(&scene.join(name))?))).collect()
}

pub(crate) fn jobs(_: &Run) -> Result<Vec<JobPlan>> {
    Ok(JobPlan::whole(&[], Cost { memory_bytes: 256 << 20, disk_bytes: 16 << 20, cpu_secs: 5.0 }))
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let config = config(job.run)?;
    let scene_folder = PathBuf::from(&config.scene);
    let mut opened = open_scene(&scene_folder)?;
    let given = config.metres_per_unit;
    if !given.is_finite() || given < 0.0 {
        let cause = format!("{given} is not a scale");
        return Err(UserError::new("metres_per_unit", cause, "give a positive number, or 0 where files tell it").into());
    }
    if given > 0.0 {
        opened.scene.frame.metres_per_unit = Some(given);
        opened.notes.retain(|note| note.code != "scale-unknown");
    }
    for note in &opened.notes {
        job.warn(format!("{} ({})", note.text, note.code));
    }
    if opened.scene.frame.metres_per_unit.is_none() {
        job.warn("the scale is unknown: lengths are in the scene's own units");
    }
    use rayon::prelude::*;
    let photo = |path: &PathBuf| -> Result<Photo> {
        let relative = path.strip_prefix(&scene_folder).unwrap_or(path).to_owned();
        Ok(Photo { path: relative, fingerprint: fingerprint_source(path)? })
    };
    let photos = opened.image_paths.par_iter().map(photo).collect::<Result<Vec<_>>>()?;
    if photos.len() < 2 {
        return Err(UserError::at(&scene_folder, "has fewer than two images with cameras", "give more images").into());
    }
    job.say(&format!("{} images, {} points", photos.len(), opened.scene.points.len()));
    job.write(&Imported { scene: opened.scene, photos })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_survive_their_file_and_damage_is_refused() {
        let points: Vec<SparsePoint> = (0..5_u32)
            .map(|i| SparsePoint {
                position_world: DVec3::new(f64::from(i), 1e6 + 0.25, -3.5),
                color: [i as u8, 2, 3],
                error_px: 0.5 * i as f32,
                track: (0..i).map(|view_index| TrackElement { view_index, xy_px: [1.5, i as f32] }).collect(),
            })
            .collect();
        let bytes = encode_points(&points);
        assert_eq!(decode_points(&bytes, 5).expect("ours"), points);
        assert!(decode_points(&bytes, 2).is_err(), "a view that does not exist");
        for length in 0..bytes.len() {
            assert!(decode_points(&bytes[..length], 5).is_err(), "cut at {length}");
        }
    }
}
