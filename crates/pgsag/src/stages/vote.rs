//! `vote`: what the views say of every sparse point. Paper Eq. 6-7.

use std::path::Path;

use anyhow::{Result, ensure};
use pgsag_group::Vote;

use super::coarse::Coarse;
use super::import::Imported;
use super::masks::{MaskState, mask_of, states};
use super::{config, read, write};
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan};

/// The votes of all points; empty where no view has a mask.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Votes(pub Vec<Vote>);

impl Artifact for Votes {
    const FORMAT: &'static str = "pgsag-votes";
    const VERSION: u32 = 1;

    fn read(folder: &Path) -> Result<Self> {
        let (file, bytes) = read(&folder.join("votes.bin"))?;
        ensure!(bytes.len() % 8 == 0, "{file}: damaged; delete its folder");
        let word = |bytes: &[u8], at: usize| u32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
        Ok(Self(bytes.chunks_exact(8).map(|pair| Vote { inside: word(pair, 0), outside: word(pair, 4) }).collect()))
    }

    fn write(&self, folder: &Path) -> Result<()> {
        let bytes: Vec<u8> =
            self.0.iter().flat_map(|vote| [vote.inside, vote.outside]).flat_map(u32::to_le_bytes).collect();
        write(&folder.join("votes.bin"), &bytes)
    }
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let imported = Imported::read(&run.stage_folder("import"))?;
    let pixels = imported.scene.views.iter().map(|view| view.camera.pixel_count() as u64).max().unwrap_or(0);
    let points = imported.scene.points.len() as u64;
    let cost = Cost {
        memory_bytes: (64 << 20) + 32 * pixels + 400 * points,
        disk_bytes: 8 * points,
        cpu_secs: imported.scene.views.len() as f64 * pixels as f64 * 40e-9,
    };
    Ok(JobPlan::whole(&["import", "coarse", "masks"], cost))
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let scene = job.read::<Coarse>("coarse")?.scene(job.read("import")?);
    let states = states(job, scene.views.len())?;
    if states.iter().all(|state| *state == MaskState::Unknown) {
        job.say("no masks, no votes");
        return job.write(&Votes::default());
    }
    let options = config(job.run)?.vote;
    let masks = job.input("masks");
    let total = states.len() as u64;
    let mask = |view: usize| -> Result<_> {
        job.check()?;
        job.advance(view as u64 + 1, total, "views");
        mask_of(&masks, view, states[view])
    };
    let votes = pgsag_group::vote::vote(&scene, mask, &options)?;
    let reliable = votes.iter().filter(|vote| vote.is_reliable(&options)).count();
    job.say(&format!("{reliable} of {} points lie on buildings", votes.len()));
    job.write(&Votes(votes))
}
