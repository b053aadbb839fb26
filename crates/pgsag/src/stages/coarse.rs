//! `coarse`: points on everything, before anything is known of buildings: oriented, dense, from stereo, or the sparse points where stereo is switched off or finds little.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use pgsag_mesh::evidence::points::{WithheldOptions, withheld};
use pgsag_scene::{Scene, SparsePoint, View};
use pgsag_splat::stereo::{CheckOptions, StereoOptions};
use pgsag_splat::train::InitialPoint;
use serde::{Deserialize, Serialize};

use super::import::{Imported, decode_points, encode_points};
use super::{config, read, write};
use crate::config::Config;
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan};

mod dense;

pub(crate) use dense::{ground_sampling, stereo_camera};

/// Points to begin from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Coarse {
    /// Where they lie and who saw them.
    pub points: Vec<SparsePoint>,
    /// `[points]` unit normals, world frame, zero where one is not known; or empty where none is.
    pub normals: Vec<[f32; 3]>,
    /// Sparse points (indices into those of `import`) that nothing above was made of, in rising order: witnesses.
    pub withheld: Vec<u32>,
}

impl Artifact for Coarse {
    const FORMAT: &'static str = "pgsag-coarse";
    const VERSION: u32 = 2;

    fn read(folder: &Path) -> Result<Self> {
        let (file, bytes) = read(&folder.join("points.bin"))?;
        let points =
            decode_points(&bytes, usize::MAX).with_context(|| format!("{file}: damaged; delete its folder"))?;
        let (file, bytes) = read(&folder.join("normals.bin"))?;
        ensure!(bytes.len() % 12 == 0, "{file}: damaged; delete its folder");
        let word = |bytes: &[u8], at: usize| f32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
        let normals: Vec<_> = bytes.chunks_exact(12).map(|row| [word(row, 0), word(row, 4), word(row, 8)]).collect();
        ensure!(normals.is_empty() || normals.len() == points.len(), "{file}: damaged; delete its folder");
        let (file, bytes) = read(&folder.join("withheld.bin"))?;
        ensure!(bytes.len() % 4 == 0, "{file}: damaged; delete its folder");
        let withheld = bytes.as_chunks::<4>().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
        Ok(Self { points, normals, withheld })
    }

    fn write(&self, folder: &Path) -> Result<()> {
        write(&folder.join("points.bin"), &encode_points(&self.points))?;
        let normals: Vec<u8> = self.normals.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
        write(&folder.join("normals.bin"), &normals)?;
        let withheld: Vec<u8> = self.withheld.iter().flat_map(|index| index.to_le_bytes()).collect();
        write(&folder.join("withheld.bin"), &withheld)
    }
}

/// Who measured what.
pub struct Witnesses<'a> {
    points: &'a [SparsePoint],
    /// Views that measured any point; one that was kept out of the coarse model measured none.
    measuring: BTreeSet<u32>,
}

impl Witnesses<'_> {
    /// Whether a view has measured a point itself; so where nobody knows who did, and for views that measured nothing at
    /// all, which can but believe the others.
    #[must_use]
    pub fn include(&self, index: usize, view: usize) -> bool {
        let track = &self.points[index].track;
        track.is_empty()
            || track.iter().any(|seen| seen.view_index as usize == view)
            || !self.measuring.contains(&(view as u32))
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

    /// Which points each view bears witness to; views that were kept out have measured none, though they may be in the
    /// tracks of sparse points.
    #[must_use]
    pub fn witnesses(&self, config: &Config) -> Witnesses<'_> {
        let seen = self.points.iter().flat_map(|point| &point.track).map(|seen| seen.view_index);
        Witnesses { points: &self.points, measuring: seen.filter(|view| !config.is_held_out(*view as usize)).collect() }
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
    /// Sparse points that stereo does not begin from and that fill no hole, so that they can judge the surface. None where
    /// stereo is off: the sparse points are then all there is.
    pub withheld: WithheldOptions,
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
            withheld: WithheldOptions::default(),
        }
    }
}

/// Sparse points are alone where stereo found nothing within so many of its cells.
const LONELY_CELLS: f64 = 4.0;
/// Sparse points with a larger mean reprojection error are not believed without stereo.
const MAX_ERROR_PX: f32 = 2.0;
/// Of fewer sparse points than this all are used: a tenth of them would tell nothing.
const MIN_POINTS_TO_SPARE: usize = 300;
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
    let mut imported: Imported = job.read("import")?;
    if !config.coarse.stereo {
        return job.write(&Coarse { points: imported.scene.points, ..Coarse::default() });
    }
    let withheld = keep_back(&mut imported.scene, &config);
    let dense = dense::surface(job, &imported, &config)?;
    if dense.points.len() > imported.scene.points.len() {
        let found = dense.points.len();
        let reach = LONELY_CELLS * dense::cell(&imported.scene, &config).unwrap_or(0.0);
        let whole = if reach > 0.0 { dense.with_lonely(&imported.scene.points, reach) } else { dense };
        let alone = whole.points.len() - found;
        job.say(&format!("{found} points on surfaces, found by stereo; {alone} sparse ones where it found nothing"));
        return job.write(&Coarse { withheld, ..whole });
    }
    job.warn("stereo found fewer points than there are sparse ones; these are used instead");
    job.write(&Coarse { points: imported.scene.points, withheld, ..Coarse::default() })
}

/// Takes the points that are to judge the surface out of the scene.
fn keep_back(scene: &mut Scene, config: &Config) -> Vec<u32> {
    let options = &config.coarse.withheld;
    if scene.points.len() < MIN_POINTS_TO_SPARE {
        return Vec::new();
    }
    let block = options.block_gsd * ground_sampling(scene, config).unwrap_or(0.0);
    let kept_back = withheld(&scene.points, block, options);
    let mut is_out = kept_back.iter();
    scene.points.retain(|_| !is_out.next().copied().unwrap_or(false));
    (0..kept_back.len()).filter(|at| kept_back[*at]).map(|at| at as u32).collect()
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
        let normals = vec![[0.0, 0.0, 1.0]];
        let dense = Coarse { points: vec![point(0.5, 2, 0.0)], normals, withheld: Vec::new() };
        let sparse = [point(1.5, 4, 0.5), point(5.5, 4, 0.5), point(9.5, 2, 0.5), point(13.5, 4, 2.5)];
        let whole = dense.with_lonely(&sparse, 1.0);
        assert_eq!(whole.points.iter().map(|point| point.position_world.x).collect::<Vec<_>>(), [0.5, 5.5]);
        assert_eq!(whole.normals, [[0.0, 0.0, 1.0], [0.0; 3]]);
    }

    #[test]
    fn a_view_that_measured_nothing_believes_the_others() {
        let point = SparsePoint {
            position_world: DVec3::ZERO,
            color: [0; 3],
            error_px: 0.0,
            track: vec![
                TrackElement { view_index: 1, xy_px: [0.0; 2] },
                TrackElement { view_index: 2, xy_px: [0.0; 2] },
            ],
        };
        let other = SparsePoint { track: vec![TrackElement { view_index: 3, xy_px: [0.0; 2] }], ..point.clone() };
        let coarse = Coarse { points: vec![point, other], ..Coarse::default() };
        let witnesses = coarse.witnesses(&Config::default());
        let of_first: Vec<bool> = (0..4).map(|view| witnesses.include(0, view)).collect();
        assert_eq!(of_first, [true, true, true, false]);
        let kept_out = Config { holdout: 3, ..Config::default() };
        assert!(coarse.witnesses(&kept_out).include(0, 3));
    }

    #[test]
    fn points_that_are_to_judge_leave_the_scene() {
        use pgsag_scene::synthetic::{Town, TownOptions};
        let options = TownOptions { view_count: 8, point_count: 600, ..TownOptions::default() };
        let full = Town::generate(&options).scene;
        let mut scene = full.clone();
        let withheld = keep_back(&mut scene, &Config::default());
        assert!(!withheld.is_empty() && withheld.len() * 4 < full.points.len(), "{}", withheld.len());
        assert_eq!(scene.points.len() + withheld.len(), full.points.len());
        assert!(withheld.iter().all(|at| !scene.points.contains(&full.points[*at as usize])));
        let folder = tempfile::tempdir().expect("temporary folder");
        let coarse = Coarse { points: scene.points.clone(), withheld, ..Coarse::default() };
        coarse.write(folder.path()).expect("written");
        assert_eq!(Coarse::read(folder.path()).expect("ours"), coarse);
        scene.points.truncate(MIN_POINTS_TO_SPARE - 1);
        assert_eq!(keep_back(&mut scene, &Config::default()), Vec::<u32>::new());
    }
}
