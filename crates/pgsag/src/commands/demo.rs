//! `pgsag demo`: a synthetic town, reconstructed and scored on this machine in a few minutes.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use pgsag_scene::synthetic::TownOptions;
use pgsag_splat::train::TrainOptions;
use serde_json::json;

use super::{print, progress, reconstruct, score, town};
use crate::cli::DemoArgs;
use crate::config::{Config, Preset};
use crate::run::artifact::Artifact as _;
use crate::run::progress::Progress;
use crate::stages::read_json;
use crate::stages::score::Scored;
use crate::town_folder::FolderOptions;

/// The threshold whose F1 the demo prints, metres.
const HEADLINE_M: f64 = 0.2;

/// Steps of training: stereo has put the Gaussians on the surface, and a first look shall take minutes.
const ITERATIONS: u32 = 800;

/// Makes the town, reconstructs it, scores it.
pub(super) fn run(args: &DemoArgs, json: bool) -> Result<()> {
    let progress = progress(json);
    let options = TownOptions { seed: args.seed, ..TownOptions::default() };
    std::fs::create_dir_all(&args.output).map_err(|error| {
        crate::error::UserError::at(&args.output, format!("cannot be made ({error})"), "give another -o")
    })?;
    let folder = args.output.canonicalize().context("the run folder")?;
    let scene = folder.join("scene");
    make_town(&options, &scene, &progress)?;
    let preset = Config::preset(Preset::Fast);
    let config = Config {
        train: TrainOptions { iterations: ITERATIONS, ..preset.train },
        scene: scene.to_string_lossy().into_owned(),
        truth: scene.join("truth").to_string_lossy().into_owned(),
        threads: args.threads,
        seed: args.seed,
        ..preset
    };
    progress.note("demo", "all", "the town comes with its exact masks, so that its buildings are known");
    reconstruct::execute(&folder, config, false, progress)?;
    let result = folder.join("result");
    let report = result.join("report.html");
    let Some(found) = Scored::read(&result)?.0 else { return print("the demo was not scored") };
    let f1 = found.scores.iter().find(|row| (row.threshold_m - HEADLINE_M).abs() < 1e-9).map_or(0.0, |row| row.f1);
    if json {
        return print(&json!({"event": "finished", "f1": f1, "threshold_m": HEADLINE_M, "report": report}).to_string());
    }
    for line in score::table(&found) {
        print(&line)?;
    }
    print(&format!("F1 at {HEADLINE_M} m: {f1:.3}"))?;
    print(&format!("report: {}", report.display()))
}

/// Writes the town, unless it is there from an earlier start with the same knobs.
fn make_town(options: &TownOptions, scene: &Path, progress: &Arc<dyn Progress>) -> Result<()> {
    let stored: Option<TownOptions> = read_json(&scene.join("truth/town.json")).ok();
    if stored.as_ref() == Some(options) {
        return Ok(());
    }
    if scene.exists() {
        std::fs::remove_dir_all(scene).with_context(|| format!("{}", scene.display()))?;
    }
    let folder_options = FolderOptions { masks: true, depth: false, ..FolderOptions::default() };
    town::write(options, &folder_options, scene, progress)
}
