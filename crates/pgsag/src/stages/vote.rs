//! `vote`: what the views say of every coarse point, and what it therefore lies on. Paper Eq. 6-7.

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::{Result, ensure};
use glam::DVec3;
use pgsag_group::label::labels;
use pgsag_group::surface::Surface;
use pgsag_group::{Label, Vote};

use super::coarse::Coarse;
use super::import::Imported;
use super::masks::{MaskState, mask_of, states};
use super::{config, read, write};
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan};

/// The votes of all points and what follows from them; empty where no view has a mask.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Votes {
    /// What the views say.
    pub votes: Vec<Vote>,
    /// What the points lie on.
    pub labels: Vec<Label>,
}

impl Artifact for Votes {
    const FORMAT: &'static str = "pgsag-votes";
    const VERSION: u32 = 2;

    fn read(folder: &Path) -> Result<Self> {
        let (file, bytes) = read(&folder.join("votes.bin"))?;
        ensure!(bytes.len() % 9 == 0, "{file}: damaged; delete its folder");
        let word = |bytes: &[u8], at: usize| u32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
        let vote = |row: &[u8]| Vote { inside: word(row, 0), outside: word(row, 4) };
        let label = |row: &[u8]| match row[8] {
            1 => Label::Background,
            2 => Label::Building,
            _ => Label::Unknown,
        };
        Ok(Self {
            votes: bytes.chunks_exact(9).map(vote).collect(),
            labels: bytes.chunks_exact(9).map(label).collect(),
        })
    }

    fn write(&self, folder: &Path) -> Result<()> {
        let mut bytes = Vec::with_capacity(9 * self.votes.len());
        for (vote, label) in self.votes.iter().zip(&self.labels) {
            bytes.extend(vote.inside.to_le_bytes());
            bytes.extend(vote.outside.to_le_bytes());
            bytes.push(*label as u8);
        }
        write(&folder.join("votes.bin"), &bytes)
    }
}

/// Spacings of the points that their surroundings reach when labels are settled.
const REACH_SPACINGS: f64 = 3.0;

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let imported = Imported::read(&run.stage_folder("import"))?;
    let pixels = imported.scene.views.iter().map(|view| view.camera.pixel_count() as u64).max().unwrap_or(0);
    let points = imported.scene.points.len() as u64;
    let cost = Cost {
        memory_bytes: (64 << 20) + 8 * 24 * pixels + 600 * points,
        disk_bytes: 9 * points,
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
    let done = AtomicU64::new(0);
    let mask = |view: usize| -> Result<_> {
        job.check()?;
        job.advance(done.fetch_add(1, Ordering::Relaxed) + 1, total, "views");
        mask_of(&masks, view, states[view])
    };
    let positions: Vec<DVec3> = scene.points.iter().map(|point| point.position_world).collect();
    let surface = Surface::new(positions.clone());
    let votes = pgsag_group::vote::vote(&scene, &surface, mask, &options)?;
    let labels = labels(&positions, &votes, &options, REACH_SPACINGS * surface.spacing);
    let count = |wanted: &dyn Fn(&Vote) -> bool| votes.iter().filter(|vote| wanted(vote)).count();
    let (potential, reliable) = (count(&Vote::is_potential), count(&|vote| vote.is_reliable(&options)));
    let building = labels.iter().filter(|label| **label == Label::Building).count();
    job.say(&format!(
        "{potential} of {} points may lie on buildings, {reliable} do so reliably, {building} with their surroundings",
        votes.len()
    ));
    job.write(&Votes { votes, labels })
}
