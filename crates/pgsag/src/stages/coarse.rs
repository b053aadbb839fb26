//! `coarse`: points on everything, before anything is known of buildings: oriented, dense, from stereo, or the sparse points where stereo is switched off or finds little.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use pgsag_scene::{Scene, SparsePoint, View};
use pgsag_splat::stereo::{CheckOptions, StereoOptions};
use pgsag_splat::train::InitialPoint;
use serde::{Deserialize, Serialize};

use super::import::{Imported, decode_points, encode_points};
use super::{config, read, write};
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan};

mod dense;

pub(crate) use dense::stereo_camera;

/// Points to begin from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Coarse {
    /// Where they lie and who saw them.
    pub points: Vec<SparsePoint>,
    /// `[points]` unit normals, world frame, zero where one is not known; or empty where none is.
    pub normals: Vec<[f32; 3]>,
}

impl Artifact for Coarse {
    const FORMAT: &'static str = "pgsag-coarse";
    const VERSION: u32 = 1;

    fn read(folder: &Path) -> Result<Self> {
        let (file, bytes) = read(&folder.join("points.bin"))?;
        let points =
            decode_points(&bytes, usize::MAX).with_context(|| format!("{file}: damaged; delete its folder"))?;
        let (file, bytes) = read(&folder.join("normals.bin"))?;
        ensure!(bytes.len() % 12 == 0, "{file}: damaged; delete its folder");
        let word = |bytes: &[u8], at: usize| f32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
        let normals: Vec<_> = bytes.chunks_exact(12).map(|row| [word(row, 0), word(row, 4), word(row, 8)]).collect();
        ensure!(normals.is_empty() || normals.len() == points.len(), "{file}: damaged; delete its folder");
        Ok(Self { points, normals })
    }

    fn write(&self, folder: &Path) -> Result<()> {
        write(&folder.join("points.bin"), &encode_points(&self.points))?;
        let normals: Vec<u8> = self.normals.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
        write(&folder.join("normals.bin"), &normals)
    }
}

impl Coarse {
    /// A point as training begins from it.
    #[must_use]
    pub fn initial_point(&self, index: usize) -> InitialPoint {
        let point = &self.points[index];
        InitialPoint {
            position_world: point.position_world.to_array(),
            color: point.color,
            normal: self.normals.get(index).map(|normal| normal.map(f64::from)),
        }
    }

    /// Whether a view has measured a point itself; so where nobody knows who did.
    #[must_use]
    pub fn is_measured_by(&self, index: usize, view: usize) -> bool {
        let track = &self.points[index].track;
        track.is_empty() || track.iter().any(|seen| seen.view_index as usize == view)
    }

    /// These points, and those of `sparse` that are alone: none of these lies in their cell of width `reach` (scene
    /// units) or in one beside it. What only two views or a large error vouch for is left out.
    fn with_lonely(mut self, sparse: &[SparsePoint], reach: f64) -> Self {
        let cell = |point: &SparsePoint| (point.position_world / reach).floor().as_i64vec3().to_array();
        let taken: BTreeSet<[i64; 3]> = self.points.iter().map(cell).collect();
        let is_lonely = |point: &SparsePoint| {
            let [x, y, z] = cell(point);
            let near = (0..27).map(|i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1]);
            point.track.len() >= 3 && point.error_px <= MAX_ERROR_PX && !near.into_iter().any(|at| taken.contains(&at))
        };
        self.points.extend(sparse.iter().filter(|point| is_lonely(point)).cloned());
        self.normals.resize(self.points.len(), [0.0; 3]);
        self
    }

    /// The scene with these points in place of the sparse ones.
    #[must_use]
    pub fn scene(self, imported: Imported) -> Scene {
        Scene { points: self.points, ..imported.scene }
    }
}

/// What the coarse surface is made of.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CoarseOptions {
    /// Dense oriented points by stereo; false: the sparse points are handed on as they are.
    pub stereo: bool,
    /// Size of the images in stereo over their size in training.
    pub scale: f64,
    /// Images are not made smaller than this for stereo, longest side in pixels.
    pub smallest_px: u32,
    /// Nor larger than this.
    pub largest_px: u32,
    /// Neighbours that each view is matched with.
    pub neighbor_count: u32,
    /// Side of the cells that keep one point each, in ground sampling distances of training.
    pub cell_gsd: f64,
    /// Search for depth.
    pub matching: StereoOptions,
    /// Agreement between views.
    pub check: CheckOptions,
}

impl Default for CoarseOptions {
    fn default() -> Self {
        Self {
            stereo: true,
            scale: 1.0,
            smallest_px: 200,
            largest_px: 1600,
            neighbor_count: 4,
            cell_gsd: 4.0,
            matching: StereoOptions::default(),
            check: CheckOptions::default(),
        }
    }
}

/// Sparse points are alone where stereo found nothing within so many of its cells.
const LONELY_CELLS: f64 = 4.0;
/// Sparse points with a larger mean reprojection error are not believed without stereo.
const MAX_ERROR_PX: f32 = 2.0;
/// Processor seconds of stereo per pixel, with four neighbours.
const STEREO_SECS_PER_PIXEL: f64 = 15e-6;

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let config = config(run)?;
    let imported = Imported::read(&run.stage_folder("import"))?;
    let pixels = |view: &View| stereo_camera(&view.camera, &config).pixel_count() as u64;
    let stereo = if config.coarse.stereo { imported.scene.views.iter().map(pixels).sum::<u64>() } else { 0 };
    let largest = imported.scene.views.iter().map(|view| view.camera.pixel_count() as u64).max().unwrap_or(0);
    let points = imported.scene.points.len() as u64 + stereo / 20;
    let cost = Cost {
        memory_bytes: (128 << 20) + 400 * points + 16 * largest + dense::HELD_BYTES,
        disk_bytes: 64 * points + 8 * stereo,
        cpu_secs: 1.0 + stereo as f64 * STEREO_SECS_PER_PIXEL,
    };
    Ok(JobPlan::whole(&["import"], cost))
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let config = config(job.run)?;
    let imported: Imported = job.read("import")?;
    if config.coarse.stereo {
        let dense = dense::surface(job, &imported, &config)?;
        if dense.points.len() > imported.scene.points.len() {
            let found = dense.points.len();
            let reach = LONELY_CELLS * dense::cell(&imported.scene, &config).unwrap_or(0.0);
            let whole = if reach > 0.0 { dense.with_lonely(&imported.scene.points, reach) } else { dense };
            let alone = whole.points.len() - found;
            job.say(&format!(
                "{found} points on surfaces, found by stereo; {alone} sparse ones where it found nothing"
            ));
            return job.write(&whole);
        }
        job.warn("stereo found fewer points than there are sparse ones; these are used instead");
    }
    job.write(&Coarse { points: imported.scene.points, normals: Vec::new() })
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use pgsag_scene::points::TrackElement;

    use super::*;

    #[test]
    fn sparse_points_fill_what_stereo_left_open() {
        let point = |x: f64, seen: u32, error_px: f32| SparsePoint {
            position_world: DVec3::new(x, 0.5, 0.5),
            color: [0; 3],
            error_px,
            track: (0..seen).map(|view_index| TrackElement { view_index, xy_px: [0.0; 2] }).collect(),
        };
        let dense = Coarse { points: vec![point(0.5, 2, 0.0)], normals: vec![[0.0, 0.0, 1.0]] };
        let sparse = [point(1.5, 4, 0.5), point(5.5, 4, 0.5), point(9.5, 2, 0.5), point(13.5, 4, 2.5)];
        let whole = dense.with_lonely(&sparse, 1.0);
        assert_eq!(whole.points.iter().map(|point| point.position_world.x).collect::<Vec<_>>(), [0.5, 5.5]);
        assert_eq!(whole.normals, [[0.0, 0.0, 1.0], [0.0; 3]]);
    }
}
