//! The report: one offline page.

use anyhow::Result;

use crate::run::stage::Job;

/// The page as text.
///
/// # Errors
/// Where an artifact cannot be read.
pub fn page(job: &Job<'_>) -> Result<String> {
    Ok(format!("<!doctype html><title>pgsag</title><p>{}</p>", job.run.backend))
}
