//! What made a published folder: the record by which a job is known to be finished, and what it cost.
//!
//! Two runs of the same work agree in everything outside `measured`.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::artifact;
use super::settings::Settings;

/// The file's name in every job's folder.
pub const MANIFEST: &str = "manifest.json";

/// Everything that decides a job's answer. Equal identities give equal bytes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    /// Which row of the pipeline.
    pub stage: String,
    /// Which of its jobs.
    pub job: String,
    /// Format of the artifact.
    pub format: String,
    /// Its version.
    pub version: u32,
    /// Version of the code that makes it.
    pub code: String,
    /// The slice of the configuration that the stage reads.
    pub settings: Settings,
    /// Upstream artifact (`stage` or `stage/part`) -> fingerprint.
    pub inputs: BTreeMap<String, String>,
    /// File outside the run -> fingerprint.
    pub sources: BTreeMap<String, String>,
    /// The run's seed.
    pub seed: u64,
    /// Device and SIMD level, `none` where the stage's answer does not depend on them.
    pub backend: String,
}

impl Identity {
    /// One word for all of it.
    ///
    /// # Panics
    /// Never: an identity is plain data.
    #[must_use]
    pub fn key(&self) -> String {
        let text = serde_json::to_string(self).expect("plain data becomes JSON");
        artifact::fingerprint_words([text.as_str()])
    }
}

/// One file of an artifact.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Output {
    /// Bytes.
    pub bytes: u64,
    /// BLAKE3.
    pub fingerprint: String,
}

/// What a job cost and where it ran. Differs from run to run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Name of the machine.
    pub host: String,
    /// Seconds from start to publication, of the attempt that finished.
    pub wall_secs: f64,
    /// Processor seconds of the attempt that finished, all threads; 0 where the system does not tell.
    pub cpu_secs: f64,
    /// Most memory held at once; 0 where the system does not tell. In-process jobs of one stage share it.
    pub peak_memory_bytes: u64,
    /// What the stage itself measured.
    #[serde(flatten)]
    pub more: BTreeMap<String, Value>,
}

/// The record of a finished job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// What decided the answer.
    #[serde(flatten)]
    pub identity: Identity,
    /// Relative path -> file.
    pub outputs: BTreeMap<String, Output>,
    /// One fingerprint of all outputs.
    pub output: String,
    /// What a reader of the result should know.
    pub warnings: Vec<String>,
    /// What it cost.
    pub measured: Measured,
}

impl Manifest {
    /// Fingerprints the files of `folder` and makes its record; every file is flushed to the disk.
    ///
    /// # Errors
    /// Where a file cannot be read.
    pub fn of(identity: Identity, folder: &Path, warnings: Vec<String>, measured: Measured) -> Result<Self> {
        let mut outputs = BTreeMap::new();
        for name in artifact::files_below(folder)? {
            if name == MANIFEST {
                continue;
            }
            let path = folder.join(&name);
            let file = fs::File::open(&path).with_context(|| format!("{}", path.display()))?;
            file.sync_all().with_context(|| format!("{}", path.display()))?;
            let fingerprint = artifact::fingerprint_file(&path)?;
            outputs.insert(name, Output { bytes: file.metadata()?.len(), fingerprint });
        }
        let output = fingerprint_of(outputs.iter());
        Ok(Self { identity, outputs, output, warnings, measured })
    }

    /// Writes it, last of all files of its folder.
    ///
    /// # Errors
    /// Where the folder cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).context("manifest")?;
        artifact::write_whole(&folder.join(MANIFEST), format!("{text}\n").as_bytes())
    }

    /// Reads the record of a folder.
    ///
    /// # Errors
    /// Where there is none or it is damaged.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(MANIFEST);
        let text = fs::read_to_string(&path).with_context(|| format!("{}", path.display()))?;
        serde_json::from_str(&text).with_context(|| format!("{}", path.display()))
    }

    /// The first file that is missing or has another length than recorded.
    #[must_use]
    pub fn first_damage(&self, folder: &Path) -> Option<String> {
        self.outputs.iter().find_map(|(name, output)| match fs::metadata(folder.join(name)) {
            Ok(found) if found.len() == output.bytes => None,
            Ok(_) => Some(format!("{name} has another length than recorded")),
            Err(_) => Some(format!("{name} is missing")),
        })
    }

    /// Fingerprint of everything, or of the files below `part/`.
    #[must_use]
    pub fn part(&self, part: Option<&str>) -> String {
        match part {
            None => self.output.clone(),
            Some(part) => {
                let prefix = format!("{part}/");
                fingerprint_of(self.outputs.iter().filter(|(name, _)| name.starts_with(&prefix)))
            }
        }
    }
}

fn fingerprint_of<'a>(outputs: impl Iterator<Item = (&'a String, &'a Output)>) -> String {
    artifact::fingerprint_words(outputs.flat_map(|(name, output)| [name.as_str(), output.fingerprint.as_str()]))
}

/// The record of a stage whose jobs are all finished.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StageManifest {
    /// Which row.
    pub stage: String,
    /// Job -> fingerprint of its output.
    pub jobs: BTreeMap<String, String>,
}

impl StageManifest {
    /// Reads the record of a stage's folder.
    ///
    /// # Errors
    /// Where there is none or it is damaged.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(MANIFEST);
        let text = fs::read_to_string(&path).with_context(|| format!("{}", path.display()))?;
        serde_json::from_str(&text).with_context(|| format!("{}", path.display()))
    }

    /// Writes it.
    ///
    /// # Errors
    /// Where the folder cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).context("manifest")?;
        artifact::write_whole(&folder.join(MANIFEST), format!("{text}\n").as_bytes())
    }

    /// One fingerprint of all jobs.
    #[must_use]
    pub fn output(&self) -> String {
        artifact::fingerprint_words(self.jobs.iter().flat_map(|(job, output)| [job.as_str(), output.as_str()]))
    }
}
