//! `pgsag reconstruct`: the main job.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use serde_json::json;

use super::{cancel_on_signals, checked, existing, limits, open_run, print, progress, store_settings, stored_settings};
use crate::cli::{ReconstructArgs, YesNo};
use crate::config::Config;
use crate::engine;
use crate::error::UserError;
use crate::run;
use crate::run::execute::{Children, InProcess, Summary};
use crate::run::progress::Progress;

/// Reconstructs a scene, or goes on where an earlier run stopped.
pub(super) fn run(args: &ReconstructArgs, json: bool) -> Result<()> {
    let mut config = checked(args.settings.resolve()?.config)?;
    config.scene = existing(&args.scene, "the scene")?.to_string_lossy().into_owned();
    let started = Instant::now();
    let until = config.until.clone();
    let summary = execute(&args.output, config, args.resume == YesNo::No, progress(json))?;
    let result = args.output.join("result");
    if json {
        return print(
            &json!({"event": "finished", "ran": summary.ran, "kept": summary.kept, "lost": summary.lost, "result": result,
                "measured": {"seconds": started.elapsed().as_secs_f64()}})
            .to_string(),
        );
    }
    if !summary.lost.is_empty() {
        bail!("{}; everything else is in {}", summary.lost.join("; "), result.display());
    }
    if summary.ran == 0 {
        print("everything was finished already")?;
    }
    if until.is_empty() {
        print(&format!("result: {}", result.display()))?;
        print(&format!("report: {}", result.join("report.html").display()))?;
    } else {
        print(&format!("finished up to {until}: {}", args.output.display()))?;
    }
    Ok(())
}

/// Runs what has to run in `folder`.
///
/// # Errors
/// Of the run; bad settings before anything is written.
pub(super) fn execute(folder: &Path, config: Config, afresh: bool, progress: Arc<dyn Progress>) -> Result<Summary> {
    prepare(folder, &config)?;
    let _guard = run::lock(folder)?;
    if afresh {
        forget(folder)?;
    }
    let limits = limits(&config)?;
    let until = (!config.until.is_empty()).then(|| config.until.clone());
    let settings = config.settings();
    let mut run = open_run(folder, settings, None)?;
    run.devices = engine::devices(&config.device)?;
    store_settings(folder, &run.settings)?;
    let cancel = cancel_on_signals()?;
    let here = InProcess { cancel: cancel.clone(), progress: Arc::clone(&progress) };
    let program = std::env::current_exe().context("this program's own path")?;
    let launcher = Children { program, here };
    run.execute(until.as_deref(), limits, &launcher, &cancel, &progress)
}

/// Makes the folder, or makes sure that it is a run of this scene.
fn prepare(folder: &Path, config: &Config) -> Result<()> {
    if Path::new(&config.scene) == folder.canonicalize().unwrap_or_default() {
        return Err(UserError::at(folder, "is the scene itself, which is never written to", "give another -o").into());
    }
    if folder.join(super::RUN_FILE).exists() {
        let stored = stored_settings(folder)?;
        let scene = stored.get("scene").and_then(|scene| scene.as_str()).unwrap_or_default();
        if scene != config.scene {
            return Err(UserError::at(
                folder,
                format!("is a run of another scene, {scene}"),
                "give another -o, or delete this folder",
            )
            .into());
        }
        return Ok(());
    }
    let is_used =
        fs::read_dir(folder).is_ok_and(|mut entries| entries.any(|entry| entry.is_ok_and(|entry| !is_ours(&entry))));
    if is_used {
        return Err(UserError::at(folder, "holds other files and is no run folder", "give another -o").into());
    }
    fs::create_dir_all(folder.join("log"))
        .map_err(|error| UserError::at(folder, format!("cannot be made ({error})"), "give another -o").into())
}

/// What a start that was killed before `run.toml` leaves, and the demo's own town.
fn is_ours(entry: &fs::DirEntry) -> bool {
    let name = entry.file_name().to_string_lossy().into_owned();
    matches!(name.as_str(), "log" | "lock" | "scene" | "truth") || name.ends_with(".partial")
}

/// Removes everything that earlier commands left in a run folder, but its scene.
fn forget(folder: &Path) -> Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let is_stage =
            name.len() > 3 && name.as_bytes()[..2].iter().all(u8::is_ascii_digit) && name.as_bytes()[2] == b'-';
        if is_stage || name.starts_with('.') || matches!(name.as_str(), "log" | "cache" | "result") {
            fs::remove_dir_all(&path).with_context(|| format!("{}", path.display()))?;
        }
    }
    Ok(())
}
