//! What the runner knows of a stage, and what a stage knows of its job.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context as _, Result};
use serde_json::Value;

use super::Run;
use super::artifact::{Artifact, Checkpoint};
use super::manifest::Measured;
use super::progress::Progress;
use crate::error::Interrupted;

/// One job per what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Per {
    /// One job, whose folder is the stage's.
    Whole,
    /// One per batch of images.
    Image,
    /// One per building group or background block.
    Group,
    /// One per cube of the city.
    Tile,
}

/// One row of the pipeline.
#[derive(Clone, Copy)]
pub struct Stage {
    /// Its name; its folder is `NN-name`.
    pub name: &'static str,
    /// The stages whose artifacts it reads, all above it.
    pub reads: &'static [&'static str],
    /// How it is divided.
    pub per: Per,
    /// The configuration keys (or tables) that its answer depends on.
    pub slice: &'static [&'static str],
    /// Whether its answer depends on device and SIMD level.
    pub on_backend: bool,
    /// Format and version of its artifact.
    pub format: (&'static str, u32),
    /// Raised when the same input gives another answer than before.
    pub code: u32,
    /// A folder of the run that mirrors this stage's artifact once it is finished.
    pub publishes: Option<&'static str>,
    /// Files outside the run that the stage reads, with their fingerprints.
    pub sources: fn(&Run) -> Result<Vec<(String, String)>>,
    /// Its jobs, once everything it reads is finished.
    pub jobs: fn(&Run) -> Result<Vec<JobPlan>>,
    /// Reads, calls a library function, writes.
    pub run: fn(&Job<'_>) -> Result<()>,
}

/// What a job is expected to need.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// Memory held at once, bytes.
    pub memory_bytes: u64,
    /// Bytes of its artifact.
    pub disk_bytes: u64,
    /// Processor seconds.
    pub cpu_secs: f64,
}

/// A job before it runs.
#[derive(Clone, Debug, PartialEq)]
pub struct JobPlan {
    /// `g012`, `t003`; `all` for a whole stage.
    pub name: String,
    /// What of the upstream stages it reads: a stage and, if not all of it, one job or sub-folder.
    pub inputs: Vec<(&'static str, Option<String>)>,
    /// Estimate.
    pub cost: Cost,
}

/// The name of the only job of a whole stage.
pub const WHOLE: &str = "all";

impl JobPlan {
    /// The one job of a whole stage that reads everything its stage reads.
    #[must_use]
    pub fn whole(reads: &[&'static str], cost: Cost) -> Vec<Self> {
        vec![Self { name: WHOLE.into(), inputs: reads.iter().map(|stage| (*stage, None)).collect(), cost }]
    }
}

/// Says when to stop: 0 = go on, otherwise the exit code to stop with.
#[derive(Clone, Debug, Default)]
pub struct Cancel(Arc<AtomicU8>);

impl Cancel {
    /// Asks everyone to save and stop; the first exit code stays.
    pub fn request(&self, exit_code: u8) {
        // A lost race means that someone else asked first, which is as good.
        let _ = self.0.compare_exchange(0, exit_code, Ordering::SeqCst, Ordering::SeqCst);
    }

    /// Whether someone asked.
    #[must_use]
    pub fn is_requested(&self) -> bool {
        self.0.load(Ordering::SeqCst) != 0
    }

    /// An error once someone asked.
    ///
    /// # Errors
    /// [`Interrupted`] with the exit code that was asked for.
    pub fn check(&self) -> Result<(), Interrupted> {
        match self.0.load(Ordering::SeqCst) {
            0 => Ok(()),
            exit_code => Err(Interrupted { exit_code }),
        }
    }
}

/// What a running stage sees: its inputs, its attempt's folder, and whom to tell.
pub struct Job<'a> {
    /// The run.
    pub run: &'a Run,
    /// The row.
    pub stage: &'static Stage,
    /// `g012`; `all` for a whole stage.
    pub name: String,
    /// Memory that it may hold, bytes.
    pub memory_bytes: u64,
    /// The device that it was handed; empty: it chooses.
    pub(super) device: String,
    pub(super) key: String,
    /// Of the same work on other backends.
    pub(super) kindred: Vec<String>,
    pub(super) attempt: PathBuf,
    pub(super) attempts: Vec<PathBuf>,
    pub(super) cancel: Cancel,
    pub(super) progress: Arc<dyn Progress>,
    pub(super) warnings: Mutex<Vec<String>>,
    pub(super) measured: Mutex<Measured>,
}

impl Job<'_> {
    /// The folder to write into; it becomes the artifact when the job is finished.
    #[must_use]
    pub fn output(&self) -> &Path {
        &self.attempt
    }

    /// The folder of a finished upstream stage.
    #[must_use]
    pub fn input(&self, stage: &str) -> PathBuf {
        self.run.stage_folder(stage)
    }

    /// Reads the artifact of a whole upstream stage.
    ///
    /// # Errors
    /// Where it is damaged.
    pub fn read<A: Artifact>(&self, stage: &str) -> Result<A> {
        A::read(&self.input(stage)).with_context(|| format!("{} of {stage}", A::FORMAT))
    }

    /// Reads the artifact of one job of an upstream stage.
    ///
    /// # Errors
    /// Where it is damaged.
    pub fn read_job<A: Artifact>(&self, stage: &str, job: &str) -> Result<A> {
        A::read(&self.input(stage).join(job)).with_context(|| format!("{} of {stage} {job}", A::FORMAT))
    }

    /// Writes this job's artifact.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn write<A: Artifact>(&self, artifact: &A) -> Result<()> {
        artifact.write(&self.attempt)
    }

    /// The job's own random stream: the run's seed with the hash of stage and job.
    #[must_use]
    pub fn seed(&self) -> u64 {
        let hash = super::artifact::fingerprint_words([self.stage.name, self.name.as_str()]);
        self.run.seed ^ u64::from_str_radix(&hash[..16], 16).unwrap_or(0)
    }

    /// Tells how far the job is.
    pub fn advance(&self, done: u64, total: u64, unit: &str) {
        self.progress.advance(self.stage.name, &self.name, done, total, unit);
    }

    /// Says something to the person who waits.
    pub fn say(&self, text: &str) {
        self.progress.note(self.stage.name, &self.name, text);
    }

    /// Says something that a reader of the result should know; kept in the manifest.
    pub fn warn(&self, text: impl Into<String>) {
        let text = text.into();
        self.progress.warning(self.stage.name, &self.name, &text);
        self.warnings.lock().unwrap_or_else(PoisonError::into_inner).push(text);
    }

    /// Keeps a number that differs from run to run (`measured`).
    pub fn measure(&self, name: &str, value: impl Into<Value>) {
        let mut measured = self.measured.lock().unwrap_or_else(PoisonError::into_inner);
        measured.more.insert(name.to_owned(), value.into());
    }

    /// Whether the job should save and stop.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.cancel.is_requested()
    }

    /// An error once the job should stop.
    ///
    /// # Errors
    /// [`Interrupted`].
    pub fn check(&self) -> Result<()> {
        Ok(self.cancel.check()?)
    }

    /// The device that this job was handed, or else the one that was typed.
    #[must_use]
    pub fn device<'d>(&'d self, typed: &'d str) -> &'d str {
        if self.device.is_empty() { typed } else { &self.device }
    }

    /// The furthest valid state of any attempt at this work, on this backend or a kindred one.
    #[must_use]
    pub fn checkpoint(&self) -> Option<Checkpoint> {
        // Of equals the last is taken: what this backend itself made.
        let keys = self.kindred.iter().chain([&self.key]);
        let found = keys.filter_map(|key| Checkpoint::newest(&self.attempts, key));
        found.max_by_key(|checkpoint| checkpoint.step)
    }

    /// Saves a state in this attempt.
    ///
    /// # Errors
    /// Where the folder cannot be written.
    pub fn save(&self, step: u64, state: &[u8]) -> Result<()> {
        Checkpoint::save(&self.attempt, &self.key, step, state)
    }

    /// The live log of this job, holding only the lines up to `step` of an earlier attempt (none for 0).
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn log(&self, step: u64) -> Result<LiveLog> {
        LiveLog::open(self.run.log_path(self.stage.name, &self.name), step)
    }
}

/// `RUN/log/<stage>.<job>.jsonl`.
pub struct LiveLog {
    path: PathBuf,
    file: File,
}

impl LiveLog {
    fn open(path: PathBuf, step: u64) -> Result<Self> {
        let kept: String = std::fs::read_to_string(&path)
            .unwrap_or_default()
            .lines()
            .filter(|line| {
                let value: Value = serde_json::from_str(line).unwrap_or_default();
                value.get("iteration").and_then(Value::as_u64).is_some_and(|iteration| iteration <= step)
            })
            .map(|line| format!("{line}\n"))
            .collect();
        super::artifact::write_whole(&path, kept.as_bytes())?;
        let file = OpenOptions::new().append(true).open(&path).with_context(|| format!("{}", path.display()))?;
        Ok(Self { path, file })
    }

    /// Appends one line.
    ///
    /// # Errors
    /// Where the disk is full.
    pub fn line(&mut self, value: &Value) -> Result<()> {
        writeln!(self.file, "{value}").with_context(|| format!("{}", self.path.display()))
    }
}
