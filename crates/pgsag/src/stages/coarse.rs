//! `coarse`: points on everything, before anything is known of buildings.

use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use pgsag_scene::{Scene, SparsePoint};
use pgsag_splat::train::InitialPoint;

use super::import::{Imported, decode_points, encode_points};
use super::{read, write};
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan};

/// Points to begin from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Coarse {
    /// Where they lie and who saw them.
    pub points: Vec<SparsePoint>,
    /// `[points]` unit normals, world frame, or empty where none are known.
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

    /// The scene with these points in place of the sparse ones.
    #[must_use]
    pub fn scene(self, imported: Imported) -> Scene {
        Scene { points: self.points, ..imported.scene }
    }
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let imported = Imported::read(&run.stage_folder("import"))?;
    let bytes = 64 * imported.scene.points.len() as u64;
    Ok(JobPlan::whole(&["import"], Cost { memory_bytes: (64 << 20) + 4 * bytes, disk_bytes: bytes, cpu_secs: 1.0 }))
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let imported: Imported = job.read("import")?;
    job.say("the sparse points are handed on as they are");
    job.write(&Coarse { points: imported.scene.points, normals: Vec::new() })
}
