//! The only place that chooses what computes.

use anyhow::Result;
use pgsag_splat::backend::Backend;
use pgsag_splat::cpu::{Cpu, CpuOptions, SimdLevel};

use crate::error::UserError;

/// Work that any device can do.
pub trait Work {
    /// What it gives.
    type Output;

    /// Does it.
    ///
    /// # Errors
    /// The work's own.
    fn on<B: Backend>(self, backend: &B) -> Result<Self::Output>;
}

/// Does `work` on the device of these settings.
///
/// # Errors
/// An unknown device or level, or the work's own.
pub fn run<W: Work>(device: &str, simd: &str, work: W) -> Result<W::Output> {
    work.on(&cpu(device, simd)?)
}

/// Device and SIMD level in words: what decides results beside the seed.
///
/// # Errors
/// An unknown device or level.
pub fn describe(device: &str, simd: &str) -> Result<String> {
    cpu(device, simd)?;
    Ok(format!("cpu {}", name(level(simd)?)))
}

/// The SIMD levels of this machine, best first.
#[must_use]
pub fn levels() -> Vec<String> {
    SimdLevel::available().into_iter().map(name).collect()
}

fn name(level: SimdLevel) -> String {
    format!("{level:?}").to_ascii_lowercase()
}

fn level(simd: &str) -> Result<SimdLevel> {
    let found = match simd {
        "auto" => SimdLevel::available().first().copied(),
        typed => SimdLevel::available().into_iter().find(|level| name(*level) == typed),
    };
    found.ok_or_else(|| {
        let cure = format!("use auto or one of {}", levels().join(", "));
        UserError::new(format!("--simd {simd}"), "this machine has no such level", cure).into()
    })
}

fn cpu(device: &str, simd: &str) -> Result<Cpu> {
    if !matches!(device, "auto" | "cpu") {
        return Err(
            UserError::new(format!("--device {device}"), "there is no such device here", "use auto or cpu").into()
        );
    }
    Ok(Cpu::new(CpuOptions { simd: level(simd)?, ..CpuOptions::default() })?)
}
