//! Typed artifacts, fingerprints, files that appear whole, and checkpoints that know whose they are.

use std::fs::{self, File};
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};

/// What a stage hands to the stages below it: one type per folder.
pub trait Artifact: Sized {
    /// Name of the format, as the manifest says it.
    const FORMAT: &'static str;
    /// Raised when older readers would misread it.
    const VERSION: u32;

    /// Reads it from its folder.
    ///
    /// # Errors
    /// Where a file is missing or damaged; the message names it.
    fn read(folder: &Path) -> Result<Self>;

    /// Writes it into an empty folder.
    ///
    /// # Errors
    /// Where a file cannot be written.
    fn write(&self, folder: &Path) -> Result<()>;
}

/// BLAKE3 of a file's bytes, in hexadecimal.
///
/// # Errors
/// Where the file cannot be read.
pub fn fingerprint_file(path: &Path) -> Result<String> {
    let mut hasher = blake3::Hasher::new();
    let mut file = File::open(path).with_context(|| format!("{}", path.display()))?;
    let mut buffer = vec![0; 1 << 16];
    loop {
        let count = file.read(&mut buffer).with_context(|| format!("{}", path.display()))?;
        if count == 0 {
            return Ok(short(&hasher.finalize()));
        }
        hasher.update(&buffer[..count]);
    }
}

/// A quick fingerprint of a large source file: its length and its first, middle and last 64 KiB. Enough to notice a
/// photograph that was edited or replaced without reading hundreds of gigabytes at every start.
///
/// # Errors
/// Where the file cannot be read.
pub fn fingerprint_source(path: &Path) -> Result<String> {
    use std::io::{Seek as _, SeekFrom};
    const WINDOW: u64 = 1 << 16;
    let mut file = File::open(path).with_context(|| format!("{}", path.display()))?;
    let length = file.metadata()?.len();
    if length <= 3 * WINDOW {
        return fingerprint_file(path);
    }
    let mut hasher = blake3::Hasher::new();
    hasher.update(&length.to_le_bytes());
    let mut window = vec![0; WINDOW as usize];
    for start in [0, length / 2, length - WINDOW] {
        file.seek(SeekFrom::Start(start))?;
        file.read_exact(&mut window).with_context(|| format!("{}", path.display()))?;
        hasher.update(&window);
    }
    Ok(short(&hasher.finalize()))
}

/// Fingerprint of a list of words, each told apart from its neighbours.
#[must_use]
pub fn fingerprint_words<'a>(words: impl IntoIterator<Item = &'a str>) -> String {
    let mut hasher = blake3::Hasher::new();
    for word in words {
        hasher.update(&(word.len() as u64).to_le_bytes());
        hasher.update(word.as_bytes());
    }
    short(&hasher.finalize())
}

/// 128 bits are plenty against accidents and keep manifests readable.
fn short(hash: &blake3::Hash) -> String {
    hash.to_hex()[..32].to_owned()
}

/// Writes a file so that it is there whole or not at all.
///
/// # Errors
/// Where the folder cannot be written.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let partial = path.with_file_name(format!(".{name}.{}.partial", std::process::id()));
    let write = || -> std::io::Result<()> {
        let mut file = File::create(&partial)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&partial, path)
    };
    write().with_context(|| format!("{}: cannot be written", path.display()))
}

/// Every file below a folder, as sorted paths relative to it with `/`.
///
/// # Errors
/// Where a folder cannot be listed.
pub fn files_below(folder: &Path) -> Result<Vec<String>> {
    fn visit(folder: &Path, prefix: &str, found: &mut Vec<String>) -> std::io::Result<()> {
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            if fs::metadata(entry.path())?.is_dir() {
                visit(&entry.path(), &format!("{name}/"), found)?;
            } else {
                found.push(name);
            }
        }
        Ok(())
    }
    let mut found = Vec::new();
    visit(folder, "", &mut found).with_context(|| format!("{}", folder.display()))?;
    found.sort();
    Ok(found)
}

const CHECKPOINT_MAGIC: &[u8; 8] = b"PGSAGCK1";
const CHECKPOINT_HEADER: usize = 8 + 32 + 8 + 8;
const CHECKPOINT_PREFIX: &str = "checkpoint.";

/// A saved state: which job it belongs to is part of it, so that a changed setting never resumes an old state.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Checkpoint {
    /// How far it is, in the stage's own steps.
    pub step: u64,
    /// The stage's own bytes.
    pub state: Vec<u8>,
}

impl Checkpoint {
    /// Saves into an attempt's folder, then removes that attempt's older ones but one.
    ///
    /// # Errors
    /// Where the folder cannot be written.
    pub fn save(attempt: &Path, key: &str, step: u64, state: &[u8]) -> Result<()> {
        let mut bytes = Vec::with_capacity(CHECKPOINT_HEADER + state.len() + 32);
        bytes.extend_from_slice(CHECKPOINT_MAGIC);
        bytes.extend_from_slice(&padded(key));
        bytes.extend_from_slice(&step.to_le_bytes());
        bytes.extend_from_slice(&(state.len() as u64).to_le_bytes());
        bytes.extend_from_slice(state);
        let hash = blake3::hash(&bytes);
        bytes.extend_from_slice(hash.as_bytes());
        write_whole(&attempt.join(format!("{CHECKPOINT_PREFIX}{step:010}")), &bytes)?;
        let mut old = Self::list(attempt);
        old.pop();
        old.pop();
        for path in old {
            fs::remove_file(&path).with_context(|| format!("{}", path.display()))?;
        }
        Ok(())
    }

    /// The newest valid one of `key` in any of `attempts`; damaged ones fall back to the one before.
    #[must_use]
    pub fn newest(attempts: &[PathBuf], key: &str) -> Option<Self> {
        let mut candidates: Vec<PathBuf> = attempts.iter().flat_map(|attempt| Self::list(attempt)).collect();
        candidates.sort_by(|a, b| b.file_name().cmp(&a.file_name()).then_with(|| a.cmp(b)));
        candidates.iter().find_map(|path| Self::read(path, key).ok())
    }

    /// Removes the checkpoints of an attempt that is about to be published.
    ///
    /// # Errors
    /// Where a file cannot be removed.
    pub fn remove_all(attempt: &Path) -> Result<()> {
        for path in Self::list(attempt) {
            fs::remove_file(&path).with_context(|| format!("{}", path.display()))?;
        }
        Ok(())
    }

    fn list(attempt: &Path) -> Vec<PathBuf> {
        let Ok(entries) = fs::read_dir(attempt) else { return Vec::new() };
        let mut found: Vec<PathBuf> = entries
            .filter_map(|entry| entry.ok().map(|entry| entry.path()))
            .filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(CHECKPOINT_PREFIX)))
            .collect();
        found.sort();
        found
    }

    fn read(path: &Path, key: &str) -> Result<Self> {
        let bytes = fs::read(path)?;
        let Some((body, hash)) = bytes.split_last_chunk::<32>() else { bail!("too short") };
        if blake3::hash(body).as_bytes() != hash || body.len() < CHECKPOINT_HEADER {
            bail!("damaged");
        }
        if &body[..8] != CHECKPOINT_MAGIC || body[8..40] != padded(key) {
            bail!("of another job");
        }
        let step = u64::from_le_bytes(body[40..48].try_into()?);
        Ok(Self { step, state: body[CHECKPOINT_HEADER..].to_vec() })
    }
}

fn padded(key: &str) -> [u8; 32] {
    let mut padded = [b' '; 32];
    for (to, from) in padded.iter_mut().zip(key.bytes()) {
        *to = from;
    }
    padded
}

#[cfg(test)]
mod tests;
