//! What each kernel takes on the card: two timestamps about every launch, for benchmarks.

use std::collections::BTreeMap;
use std::sync::PoisonError;

use pgsag_splat::backend::{BackendError, Result};
use wgpu::{BufferUsages, Features, QUERY_SET_MAX_QUERIES};

use crate::device::Device;

/// All launches of one kernel while a profile was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelTime {
    /// The kernel.
    pub name: &'static str,
    /// Launches.
    pub launches: u32,
    /// Sum over the launches, milliseconds.
    pub milliseconds: f64,
}

/// A profile that is being taken.
#[derive(Debug)]
pub(crate) struct Profile {
    pub(crate) queries: wgpu::QuerySet,
    /// Kernel of each pair of queries.
    names: Vec<&'static str>,
}

impl Profile {
    /// Two timestamps for one more launch; `None` when there are no more.
    pub(crate) fn next(&mut self, name: &'static str) -> Option<u32> {
        let at = 2 * self.names.len() as u32;
        (at + 2 <= QUERY_SET_MAX_QUERIES).then(|| {
            self.names.push(name);
            at
        })
    }
}

impl Device {
    /// From now on every launch is timed, up to two thousand.
    pub(crate) fn begin_profile(&self) -> Result<()> {
        if !self.wgpu.features().contains(Features::TIMESTAMP_QUERY) {
            return Err(BackendError::Device(format!("{} has no timestamps", self.adapter.name)));
        }
        let queries = self.wgpu.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("profile"),
            ty: wgpu::QueryType::Timestamp,
            count: QUERY_SET_MAX_QUERIES,
        });
        let profile = Profile { queries, names: Vec::new() };
        *self.profile.lock().unwrap_or_else(PoisonError::into_inner) = Some(profile);
        Ok(())
    }

    /// Sums by kernel, in order of names.
    pub(crate) fn end_profile(&self) -> Result<Vec<KernelTime>> {
        let taken = self.profile.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(Profile { queries, names }) = taken.filter(|profile| !profile.names.is_empty()) else {
            return Ok(Vec::new());
        };
        let count = 2 * names.len();
        let resolved = self.wgpu.create_buffer(&wgpu::BufferDescriptor {
            label: Some("profile"),
            size: 8 * count as u64,
            usage: BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let mut encoder = self.wgpu.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.resolve_query_set(&queries, 0..count as u32, &resolved, 0);
        self.queue.submit([encoder.finish()]);
        let ticks: Vec<u64> = self.read(&resolved, 0, count)?;
        let period = f64::from(self.queue.get_timestamp_period()) * 1e-6;
        let mut sums: BTreeMap<&'static str, (u32, f64)> = BTreeMap::new();
        for (name, pair) in names.into_iter().zip(ticks.chunks_exact(2)) {
            let sum = sums.entry(name).or_default();
            *sum = (sum.0 + 1, sum.1 + pair[1].saturating_sub(pair[0]) as f64 * period);
        }
        let time = |(name, (launches, milliseconds))| KernelTime { name, launches, milliseconds };
        Ok(sums.into_iter().map(time).collect())
    }
}
