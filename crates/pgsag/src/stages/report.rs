//! `report`: what a person opens, gathered in one folder that is published whole as `RUN/result`.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result};
use serde_json::json;

use super::group::group_names;
use super::import::Imported;
use super::{write, write_json};
use crate::report;
use crate::run::Run;
use crate::run::artifact::{Artifact, files_below};
use crate::run::stage::{Cost, Job, JobPlan};

/// The folder; its content is for people and other programs, nothing of ours reads it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Published;

impl Artifact for Published {
    const FORMAT: &'static str = "pgsag-result";
    const VERSION: u32 = 1;

    fn read(_: &Path) -> Result<Self> {
        Ok(Self)
    }

    fn write(&self, _: &Path) -> Result<()> {
        Ok(())
    }
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let bytes = fs::metadata(run.stage_folder("merge").join("city.ply")).map_or(0, |found| found.len());
    let reads = run.stage("report").map_or(&[][..], |stage| stage.reads);
    let cost = Cost { memory_bytes: (256 << 20) + 8 * bytes, disk_bytes: 2 * bytes, cpu_secs: 10.0 };
    Ok(JobPlan::whole(reads, cost))
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let imported: Imported = job.read("import")?;
    let merge = job.input("merge");
    for file in files_below(&merge)?.iter().filter(|file| file.ends_with(".ply")) {
        link(&merge.join(file), &job.output().join(file))?;
    }
    for name in &group_names(&job.input("group"))? {
        let to = job.output().join("gaussians").join(format!("{name}.ply"));
        link(&job.input("train").join(name).join("cloud.ply"), &to)?;
    }
    let score = job.input("score").join("score.json");
    if score.exists() {
        link(&score, &job.output().join("score.json"))?;
    }
    let frame = &imported.scene.frame;
    let georef = json!({
        "offset": frame.offset.to_array(), "epsg": frame.epsg, "vertical_datum": frame.vertical_datum,
        "origin_lla": frame.origin_lla, "metres_per_unit": frame.metres_per_unit,
        "up": frame.up_world.to_array(), "source": frame.source,
    });
    write_json(&job.output().join("georef.json"), &georef)?;
    let page = report::page(job)?;
    write(&job.output().join("report.html"), page.as_bytes())
}

/// The same file under a second name, where the disk can do that.
fn link(from: &Path, to: &Path) -> Result<()> {
    if let Some(parent) = to.parent() {
        fs::create_dir_all(parent)?;
    }
    if fs::hard_link(from, to).is_err() {
        fs::copy(from, to).with_context(|| format!("{}", to.display()))?;
    }
    Ok(())
}
