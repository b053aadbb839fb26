//! Downloads what a manifest pins, with the system's `curl`: nothing without a revision, a size and a hash.

use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result};
use pgsag_models::Bundle;
use pgsag_models::bundle::{BundleFile, MANIFEST, Manifest, sha256_of};

use super::super::{existing, print};
use super::{KNOWN, how_to_get, is_plain, publish};
use crate::error::UserError;

/// Whence, unless `HF_ENDPOINT` says otherwise.
const ENDPOINT: &str = "https://huggingface.co";

pub(super) fn run(models: &Path, what: &str, accept_license: bool) -> Result<()> {
    if let Some((name, _, source)) = KNOWN.iter().find(|(name, ..)| *name == what) {
        let cause = "is not pinned yet: nobody here has seen its revision and hashes";
        return Err(UserError::new(*name, cause, how_to_get(name, source)).into());
    }
    let path = existing(Path::new(what), "a manifest or a known name")?;
    let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    let cure = "give a manifest.toml with revision, files, sizes and hashes";
    let manifest: Manifest = toml::from_str(&text).map_err(|cause| UserError::at(&path, cause.to_string(), cure))?;
    if !is_plain(&manifest.name) {
        return Err(UserError::at(&path, format!("{:?} cannot be a folder's name", manifest.name), cure).into());
    }
    let is_hex = |text: &str, length| text.len() == length && text.bytes().all(|byte| byte.is_ascii_hexdigit());
    let Some(revision) = manifest.revision.as_deref().filter(|revision| is_hex(revision, 40)) else {
        return Err(UserError::at(&path, "is not pinned: no revision of 40 digits", cure).into());
    };
    if let Some(file) = manifest.files.iter().find(|file| !is_hex(&file.sha256, 64)) {
        return Err(UserError::at(&path, format!("{} is not pinned: no SHA-256", file.name), cure).into());
    }
    if !accept_license {
        let cause = format!("the weights stand under {}", manifest.licence);
        return Err(UserError::at(&path, cause, "read it, then add --accept-license").into());
    }
    let part = models.join(format!(".{}.part", manifest.name));
    std::fs::create_dir_all(&part).with_context(|| part.display().to_string())?;
    std::fs::write(part.join(MANIFEST), &text).with_context(|| part.display().to_string())?;
    let bundle = Bundle::open(&part)?;
    let endpoint = std::env::var("HF_ENDPOINT").unwrap_or_else(|_| ENDPOINT.into());
    for file in &manifest.files {
        let url = format!("{}/{}/resolve/{revision}/{}", endpoint.trim_end_matches('/'), manifest.source, file.name);
        print(&format!("{url}  {} bytes  sha256 {}", file.bytes, file.sha256))?;
        download(&url, &part.join(&file.name), file)?;
    }
    bundle.check_files(true)?;
    publish(&part, &models.join(&manifest.name))?;
    print(&format!("{} is there; `pgsag models verify {}` tries it", manifest.name, manifest.name))
}

/// Goes on where an earlier attempt stopped; a token travels by standard input, where no list of processes shows it.
fn download(url: &str, target: &Path, file: &BundleFile) -> Result<()> {
    if std::fs::metadata(target).is_ok_and(|found| found.len() >= file.bytes) {
        if sha256_of(target)?.eq_ignore_ascii_case(&file.sha256) {
            return Ok(());
        }
        // Something else came last time: nothing to go on with.
        std::fs::remove_file(target).with_context(|| target.display().to_string())?;
    }
    let cure = "copy the files by hand (docs/models.md), or set HF_ENDPOINT to a mirror";
    let mut curl = Command::new("curl")
        .args([
            "--fail",
            "--location",
            "--progress-bar",
            "--show-error",
            "--continue-at",
            "-",
            "--config",
            "-",
            "--output",
        ])
        .arg(target)
        .arg(url)
        .stdin(Stdio::piped())
        .spawn()
        .map_err(|cause| UserError::new("curl", format!("cannot be started ({cause})"), cure))?;
    let token = std::env::var("HF_TOKEN").ok().filter(|token| !token.contains(['"', '\n', '\\']));
    if let Some(mut input) = curl.stdin.take()
        && let Some(token) = token
    {
        writeln!(input, "header = \"Authorization: Bearer {token}\"").context("curl")?;
    }
    let status = curl.wait().context("curl")?;
    if status.success() {
        return Ok(());
    }
    Err(UserError::new(url, format!("could not be downloaded ({status})"), cure).into())
}
