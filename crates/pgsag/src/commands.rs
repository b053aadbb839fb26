//! One file per command: from what was typed to what is printed.

use std::io::{IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, Result};

use crate::cli::{Cli, Command};
use crate::config::{self, Config};
use crate::error::UserError;
use crate::pipeline::PIPELINE;
use crate::run::execute::Limits;
use crate::run::progress::{Bars, JsonLines, Lines, Progress};
use crate::run::settings::Settings;
use crate::run::stage::Cancel;
use crate::run::{Run, machine};
use crate::{engine, run};

mod config_table;
mod demo;
mod doctor;
mod job;
mod mask;
mod models;
mod plan;
mod reconstruct;
mod score;
mod status;
mod town;

/// Name of the file that makes a folder a run.
const RUN_FILE: &str = "run.toml";
/// Share of the available memory that is used unless told otherwise.
const MEMORY_SHARE: f64 = 0.8;

/// Does what was typed.
///
/// # Errors
/// What the command failed with; `error` says with which exit code to end.
pub fn dispatch(cli: Cli) -> Result<()> {
    let filter = tracing_subscriber::EnvFilter::try_new(&cli.log).map_err(|_| {
        UserError::new("--log", format!("{:?} is no filter", cli.log), "use error, warn, info or debug")
    })?;
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    match cli.command {
        Command::Demo(args) => demo::run(&args, cli.json),
        Command::Reconstruct(args) => reconstruct::run(&args, cli.json),
        Command::Doctor(args) => doctor::run(&args, cli.json),
        Command::Mask(args) => mask::run(&args, cli.json),
        Command::Models(args) => models::run(&args, cli.json),
        Command::Plan(args) => plan::run(&args, cli.json),
        Command::Status(args) => status::run(&args, cli.json),
        Command::Job(args) => job::run(&args, cli.json),
        Command::Score(args) => score::run(&args, cli.json),
        Command::Town(args) => town::run(&args, cli.json),
        Command::Config(args) => config_table::run(&args, cli.json),
    }
}

/// Prints one line of a command's answer.
fn print(line: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{line}").and_then(|()| out.flush()) {
        // The reader has seen enough, as in `pgsag status RUN | head`.
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => other.context("standard output"),
    }
}

/// Whom jobs tell.
fn progress(json: bool) -> Arc<dyn Progress> {
    if json {
        Arc::new(JsonLines::default())
    } else if std::io::stderr().is_terminal() {
        Arc::new(Bars::default())
    } else {
        Arc::new(Lines::default())
    }
}

/// A cancellation that Ctrl-C (130) and a termination request (75) ask for; a second signal ends at once.
fn cancel_on_signals() -> Result<Cancel> {
    let cancel = Cancel::default();
    let mut signals = signal_hook::iterator::Signals::new([signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM])?;
    let asked = cancel.clone();
    std::thread::spawn(move || {
        for signal in signals.forever() {
            let exit_code = if signal == signal_hook::consts::SIGINT { 130 } else { 75 };
            if asked.is_requested() {
                std::process::exit(exit_code.into());
            }
            asked.request(exit_code);
        }
    });
    Ok(cancel)
}

/// What the machine may be asked for under this configuration; also sizes the pool of threads.
fn limits(config: &Config) -> Result<Limits> {
    let threads = if config.threads == 0 { machine::thread_count() } else { config.threads as usize };
    let jobs = if config.jobs == 0 { (threads / 4).max(1) } else { config.jobs as usize };
    let memory_bytes = if config.memory_limit.is_empty() {
        let available =
            machine::available_memory_bytes().context("the available memory is unknown: give --memory-limit")?;
        (available as f64 * MEMORY_SHARE) as u64
    } else {
        config::parse_size(&config.memory_limit)?
    };
    // A pool that exists already keeps its size; results do not depend on it.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    Ok(Limits { jobs, memory_bytes, threads, device_jobs: config.jobs as usize, device: None })
}

/// The run of these settings in this folder; `device` where another was typed than the settings say.
fn open_run(folder: &Path, settings: Settings, device: Option<&str>) -> Result<Run> {
    let config = Config::from_settings(&settings)?;
    let (backend, kindred) = engine::describe(device.unwrap_or(&config.device), &config.simd)?;
    let folder = folder.to_owned();
    Ok(Run { folder, table: PIPELINE, settings, seed: config.seed, backend, kindred, devices: Vec::new() })
}

/// The settings that a run was last started with.
fn stored_settings(folder: &Path) -> Result<Settings> {
    let path = folder.join(RUN_FILE);
    let text = std::fs::read_to_string(&path).map_err(|_| {
        UserError::at(
            folder,
            format!("is no run folder (it has no {RUN_FILE})"),
            "give the -o of a reconstruct command",
        )
    })?;
    let nested: serde_json::Value = toml::from_str(&text).map_err(|error| {
        UserError::at(&path, error.message().replace('\n', " "), "run the reconstruct command again")
    })?;
    // One spelling per value, and a clear word about keys of another version.
    let config = Config::from_settings(&Settings::flatten(&nested)).map_err(|error| {
        UserError::at(&path, error.root_cause().to_string(), "run the reconstruct command again with this version")
    })?;
    Ok(config.settings())
}

/// Writes every setting in force.
fn store_settings(folder: &Path, settings: &Settings) -> Result<()> {
    let text = toml::to_string(&settings.nest()).context(RUN_FILE)?;
    let text = format!("# Every setting of this run, written by pgsag {}.\n{text}", env!("CARGO_PKG_VERSION"));
    run::artifact::write_whole(&folder.join(RUN_FILE), text.as_bytes())
}

/// An absolute spelling of a path that must exist.
fn existing(path: &Path, what: &str) -> Result<PathBuf> {
    std::fs::canonicalize(path)
        .map_err(|_| UserError::at(path, format!("{what} is not there"), "check the path").into())
}

/// Settings with absolute paths and checked words.
fn checked(mut config: Config) -> Result<Config> {
    match config.masks.as_str() {
        "auto" | "none" | "geometry" => {}
        "language" => {
            let models = crate::networks::models_folder(&config.language.models)?;
            crate::networks::bundles(&config.language)?;
            config.language.models = existing(&models, "the folder of models")?.to_string_lossy().into_owned();
        }
        folder => config.masks = existing(Path::new(folder), "the folder of masks")?.to_string_lossy().into_owned(),
    }
    if !matches!(config.instances.as_str(), "auto" | "none") {
        config.instances =
            existing(Path::new(&config.instances), "the folder of instances")?.to_string_lossy().into_owned();
    }
    for (path, what) in [(&mut config.truth, "the truth"), (&mut config.aoi, "the area of interest")] {
        if !path.is_empty() {
            *path = existing(Path::new(path.as_str()), what)?.to_string_lossy().into_owned();
        }
    }
    if config.engine != "local" {
        return Err(UserError::new(format!("--engine {}", config.engine), "is unknown", "use local").into());
    }
    if !config.until.is_empty() && !PIPELINE.iter().any(|stage| stage.name == config.until) {
        let names: Vec<&str> = PIPELINE.iter().map(|stage| stage.name).collect();
        return Err(UserError::new(
            format!("--until {}", config.until),
            "there is no such stage",
            format!("use one of {}", names.join(" ")),
        )
        .into());
    }
    if config.holdout == 1 {
        return Err(UserError::new("--holdout 1", "would keep every image out", "use 0 or a number from 2").into());
    }
    Ok(config)
}
