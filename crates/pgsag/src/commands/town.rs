//! `pgsag town`: a synthetic town as an ordinary scene.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result};
use pgsag_scene::synthetic::{Town, TownOptions};
use serde_json::json;

use super::{print, progress};
use crate::cli::TownCommand;
use crate::error::UserError;
use crate::run::progress::Progress;
use crate::town_folder::{FolderOptions, write_town_with};

/// Writes the town.
pub(super) fn run(args: &TownCommand, json: bool) -> Result<()> {
    if std::fs::read_dir(&args.output).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(UserError::at(&args.output, "is there already and not empty", "give another -o").into());
    }
    let options = args.town.town_options();
    write(&options, &args.town.folder_options(), &args.output, &progress(json))?;
    if json {
        return print(&json!({"event": "finished", "scene": args.output, "views": options.view_count}).to_string());
    }
    print(&format!(
        "scene: {} ({} images; the truth is in {})",
        args.output.display(),
        options.view_count,
        args.output.join("truth").display()
    ))
}

/// Builds a town and writes it, telling how far it is.
pub(super) fn write(
    options: &TownOptions,
    folder_options: &FolderOptions,
    folder: &Path,
    progress: &Arc<dyn Progress>,
) -> Result<()> {
    let started = Instant::now();
    progress.started("town", "all", "a synthetic town");
    let town = Town::generate(options);
    let written = write_town_with(&town, folder_options, folder, &mut |done, total| {
        progress.advance("town", "all", done as u64, total as u64, "images");
    });
    let outcome = if written.is_ok() { "done" } else { "failed" };
    progress.finished("town", "all", outcome, started.elapsed().as_secs_f64());
    written.context("town")
}
