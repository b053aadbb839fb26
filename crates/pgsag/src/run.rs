//! A run folder: what is finished, what is not, and how to finish it. Knows no stage by name.
//!
//! Every job works in a folder of its own, `.NN-stage.job.partial.<host>-<pid>-<n>`, and is published by a rename, so
//! that a published folder is always whole. A job runs exactly when what decides its answer has changed.

use std::fs::{self, File, TryLockError};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};

pub mod artifact;
pub mod execute;
pub mod machine;
pub mod manifest;
pub mod plan;
pub mod progress;
pub mod settings;
mod slots;
pub mod stage;
pub mod status;

use crate::error::UserError;
use manifest::{Manifest, StageManifest};
use settings::Settings;
use stage::{Per, Stage};

/// A run folder with the table of its stages and the settings in force.
pub struct Run {
    /// `RUN`.
    pub folder: PathBuf,
    /// The rows, in order.
    pub table: &'static [Stage],
    /// Every setting.
    pub settings: Settings,
    /// The seed of everything random.
    pub seed: u64,
    /// Device and SIMD level in words.
    pub backend: String,
    /// Backends with whose checkpoints a job of this one may go on.
    pub kindred: Vec<String>,
    /// Devices that are handed to the jobs of stages on a backend, one each; none: jobs choose for themselves.
    pub devices: Vec<String>,
}

impl Run {
    /// The folder of a finished stage, `RUN/NN-name`.
    ///
    /// # Panics
    /// Where the table has no such stage: a mistake of ours.
    #[must_use]
    pub fn stage_folder(&self, stage: &str) -> PathBuf {
        self.folder.join(self.numbered(stage))
    }

    fn numbered(&self, stage: &str) -> String {
        let row = self.table.iter().position(|row| row.name == stage).expect("a stage of the table");
        format!("{:02}-{stage}", row + 1)
    }

    /// The row of this name.
    #[must_use]
    pub fn stage(&self, name: &str) -> Option<&'static Stage> {
        self.table.iter().find(|row| row.name == name)
    }

    /// Where a job is published.
    #[must_use]
    pub fn job_folder(&self, stage: &Stage, job: &str) -> PathBuf {
        match stage.per {
            Per::Whole => self.stage_folder(stage.name),
            _ => self.stage_folder(stage.name).join(job),
        }
    }

    /// `RUN/log/<stage>.<job>.jsonl`.
    #[must_use]
    pub fn log_path(&self, stage: &str, job: &str) -> PathBuf {
        self.folder.join("log").join(format!("{stage}.{job}.jsonl"))
    }

    /// Where the last words of a failed job are kept until it is tried again.
    #[must_use]
    pub fn failure_path(&self, stage: &str, job: &str) -> PathBuf {
        self.folder.join("log").join(format!("{stage}.{job}.failed"))
    }

    fn attempt_prefix(&self, stage: &str, job: &str) -> String {
        format!(".{}.{job}.partial.", self.numbered(stage))
    }

    /// The folders of all unpublished attempts at a job, sorted.
    #[must_use]
    pub fn attempts(&self, stage: &str, job: &str) -> Vec<PathBuf> {
        self.folders_beginning(&self.attempt_prefix(stage, job))
    }

    fn folders_beginning(&self, prefix: &str) -> Vec<PathBuf> {
        let Ok(entries) = fs::read_dir(&self.folder) else { return Vec::new() };
        let mut found: Vec<PathBuf> = entries
            .filter_map(|entry| entry.ok().map(|entry| entry.path()))
            .filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(prefix)))
            .collect();
        found.sort();
        found
    }

    /// Makes the folder of a new attempt.
    fn new_attempt(&self, stage: &str, job: &str) -> Result<PathBuf> {
        let (host, pid) = (machine::host(), std::process::id());
        for number in 0.. {
            let name = format!("{}{host}-{pid}-{number}", self.attempt_prefix(stage, job));
            let path = self.folder.join(name);
            match fs::create_dir(&path) {
                Ok(()) => return Ok(path),
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error).with_context(|| format!("{}: cannot be made", path.display())),
            }
        }
        unreachable!("an attempt number is always free")
    }

    /// The fingerprint of a finished upstream artifact or of a part of it.
    ///
    /// # Errors
    /// Where it is not finished.
    pub fn fingerprint(&self, stage: &str, part: Option<&str>) -> Result<String> {
        let row = self.stage(stage).with_context(|| format!("no stage is called {stage}"))?;
        let folder = self.stage_folder(stage);
        match (row.per, part) {
            (Per::Whole, part) => Ok(Manifest::read(&folder)?.part(part)),
            (_, None) => Ok(StageManifest::read(&folder)?.output()),
            (_, Some(job)) => Ok(Manifest::read(&folder.join(job))?.output),
        }
    }

    /// The names of the finished jobs of a stage, sorted.
    ///
    /// # Errors
    /// Where the stage is not finished.
    pub fn finished_jobs(&self, stage: &str) -> Result<Vec<String>> {
        Ok(StageManifest::read(&self.stage_folder(stage))?.jobs.into_keys().collect())
    }

    /// Takes the run for this process, until the guard is dropped or the process dies.
    ///
    /// # Errors
    /// Where another process has it.
    pub fn lock(&self) -> Result<File> {
        lock(&self.folder)
    }
}

/// See [`Run::lock`].
///
/// # Errors
/// Where another process has the run.
pub fn lock(folder: &Path) -> Result<File> {
    let path = folder.join("lock");
    let mut file = File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .read(true)
        .open(&path)
        .with_context(|| format!("{}: cannot be written", path.display()))?;
    match file.try_lock() {
        Ok(()) => {
            file.set_len(0)?;
            write!(file, "{} {}", machine::host(), std::process::id())?;
            Ok(file)
        }
        Err(TryLockError::WouldBlock) => {
            let holder = fs::read_to_string(&path).unwrap_or_default();
            Err(UserError::at(
                folder,
                format!("another pgsag works on it (host and process: {holder})"),
                "wait for it, stop it, or give another -o",
            )
            .into())
        }
        Err(TryLockError::Error(error)) => Err(error).with_context(|| format!("{}: cannot be locked", path.display())),
    }
}

#[cfg(test)]
mod tests;
