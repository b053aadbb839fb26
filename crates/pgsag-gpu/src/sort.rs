//! Prefix sums and a stable radix sort, of as many values as the card itself has counted.
//!
//! Exact: the lists of tiles are those of the CPU, in the same order. Nothing waits for another workgroup within a launch.

use std::sync::Arc;

use pgsag_splat::backend::Result;

use crate::device::Device;
use crate::memory::Buffer;
use crate::record::{Groups, Kernel, Recorder};

/// Values per thread, in every kernel here.
const EACH: u64 = 8;
const DIGITS: u64 = 256;
const DIGIT_BITS: u32 = 8;

const SCAN_SUMS: Kernel = Kernel {
    name: "scan sums",
    parts: &[
        include_str!("../shaders/scan_group.wgsl"),
        include_str!("../shaders/scan_source.wgsl"),
        include_str!("../shaders/scan_sums.wgsl"),
    ],
    adds: &[],
};
const SCAN_SPINE: Kernel = Kernel {
    name: "scan spine",
    parts: &[
        include_str!("../shaders/frame.wgsl"),
        include_str!("../shaders/scan_group.wgsl"),
        include_str!("../shaders/scan_spine.wgsl"),
    ],
    adds: &[],
};
const SCAN_APPLY: Kernel = Kernel {
    name: "scan apply",
    parts: &[
        include_str!("../shaders/scan_group.wgsl"),
        include_str!("../shaders/scan_source.wgsl"),
        include_str!("../shaders/scan_apply.wgsl"),
    ],
    adds: &[],
};
const SORT_COUNT: Kernel = Kernel {
    name: "sort count",
    parts: &[include_str!("../shaders/sort_common.wgsl"), include_str!("../shaders/sort_count.wgsl")],
    adds: &[],
};
const SORT_SPINE: Kernel = Kernel {
    name: "sort spine",
    parts: &[
        include_str!("../shaders/scan_group.wgsl"),
        include_str!("../shaders/sort_common.wgsl"),
        include_str!("../shaders/sort_spine.wgsl"),
    ],
    adds: &[],
};
const SORT_SCATTER: Kernel = Kernel {
    name: "sort scatter",
    parts: &[
        include_str!("../shaders/scan_group.wgsl"),
        include_str!("../shaders/sort_common.wgsl"),
        include_str!("../shaders/sort_scatter.wgsl"),
    ],
    adds: &[],
};

/// Kernels of this room.
#[cfg(test)]
pub(crate) const KERNELS: &[&Kernel] = &[&SCAN_SUMS, &SCAN_SPINE, &SCAN_APPLY, &SORT_COUNT, &SORT_SPINE, &SORT_SCATTER];

/// What counts, on the card.
pub(crate) struct Counters {
    /// Numbers: Gaussians, Gaussians drawn, pairs, pairs wanted where there was no room (else 0), sum of thicknesses (f32),
    /// visible Gaussians, tiles, chunks.
    pub(crate) sizes: Buffer,
    /// Workgroups to visit all: drawn Gaussians by 256 threads and by blocks, then pairs likewise; chunks, one each; three
    /// numbers per launch.
    pub(crate) launches: Buffer,
}

/// What is counted: its place in `sizes`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Counted {
    /// Gaussians that touch a drawn tile.
    Drawn = 1,
    /// Pairs of Gaussian and tile.
    Pairs = 2,
    /// Chunks of the lists, as many pairs as a subgroup has lanes.
    Chunks = 3,
}

impl Counters {
    pub(crate) fn new(device: &Device) -> Result<Self> {
        Ok(Self { sizes: device.buffer("counters", 32)?, launches: device.buffer("counters", 60)? })
    }

    /// One thread each, 256 a workgroup.
    pub(crate) fn threads(&self, counted: Counted) -> Groups<'_> {
        Groups::Indirect(&self.launches, 24 * (counted as u64 - 1))
    }

    /// One workgroup for each chunk.
    pub(crate) fn chunks(&self) -> Groups<'_> {
        Groups::Indirect(&self.launches, 48)
    }

    fn blocks(&self, counted: Counted) -> Groups<'_> {
        Groups::Indirect(&self.launches, 24 * (counted as u64 - 1) + 12)
    }
}

/// Sums before each value: of flags "not 0" of `count` values (`Drawn`), of values in an order (`Pairs`), or of the chunks
/// of `count` lists (`Chunks`; the number of lists stands in the counters). Sets the total
/// and its launches. Returns the prefix sums, `[count]`.
pub(crate) fn scan(
    device: &Device,
    record: &mut Recorder<'_>,
    counters: &Counters,
    frame: &Buffer,
    (counted, count): (Counted, u64),
    [values, order]: [&Buffer; 2],
) -> Result<Arc<Buffer>> {
    let mode = [("MODE", counted as u32 - 1)];
    let blocks = count.div_ceil(u64::from(device.group()) * EACH).max(1);
    let sums = record.scratch("prefix sums", 4 * blocks)?;
    let prefixes = record.scratch("prefix sums", 4 * count)?;
    // Of values that were counted by the card, only so many blocks as there are.
    let groups = match counted {
        Counted::Drawn | Counted::Chunks => Groups::Count(blocks),
        Counted::Pairs => counters.blocks(Counted::Drawn),
    };
    let sizes = &counters.sizes;
    record.run_with(&SCAN_SUMS, &mode, &[sizes, values, order, &sums], groups);
    record.run_with(&SCAN_SPINE, &mode, &[frame, sizes, &sums, &counters.launches], Groups::Count(1));
    record.run_with(&SCAN_APPLY, &mode, &[sizes, values, order, &sums, &prefixes], groups);
    Ok(prefixes)
}

/// Sorts keys of so many bits, stably. Values are their positions before. Returns sorted keys and values; there is room
/// for `room` of them.
pub(crate) fn sort(
    device: &Device,
    record: &mut Recorder<'_>,
    counters: &Counters,
    (counted, room): (Counted, u64),
    keys: &Arc<Buffer>,
    bits: u32,
) -> Result<[Arc<Buffer>; 2]> {
    let blocks = room.div_ceil(u64::from(device.group()) * EACH).max(1);
    let counts = record.scratch("digit counts", 4 * DIGITS * blocks)?;
    let totals = record.scratch("digit counts", 4 * DIGITS)?;
    let mut from = [Arc::clone(keys), record.scratch("sorted values", 4 * room)?];
    let mut into = [record.scratch("sorted keys", 4 * room)?, record.scratch("sorted values", 4 * room)?];
    let sizes = &counters.sizes;
    for pass in 0..bits.div_ceil(DIGIT_BITS).max(1) {
        let constants = [("SHIFT", pass * DIGIT_BITS), ("COUNT", counted as u32), ("FIRST", u32::from(pass == 0))];
        let groups = counters.blocks(counted);
        record.run_with(&SORT_COUNT, &constants, &[sizes, &from[0], &counts], groups);
        record.run_with(&SORT_SPINE, &constants, &[sizes, &counts, &totals], Groups::Count(DIGITS));
        let buffers = [sizes, &*from[0], &*from[1], &*counts, &*totals, &*into[0], &*into[1]];
        record.run_with(&SORT_SCATTER, &constants, &buffers, groups);
        std::mem::swap(&mut from, &mut into);
    }
    Ok(from)
}

#[cfg(test)]
mod tests;
