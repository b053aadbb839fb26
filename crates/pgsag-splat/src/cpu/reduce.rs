//! From the pairs of a render to sums per Gaussian, and the density statistics.
//!
//! The pairs of a Gaussian are added in their fixed order, so the result does not depend on threads.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use fearless_simd::Level;
use rayon::prelude::*;

use super::{
    backward::sum,
    bins::{Bins, Entry},
    cloud::CpuCloud,
    gradient::{Return, TaskSums},
    lanes::{LANES, Line, at_level},
    project::{Ellipses, GROUPS, Lanes},
    wide::{Carried, Wide},
};
use crate::equations::{
    Number,
    number::Pixels,
    projection::{self, Lens},
};

/// Sums of pairs that are fetched at a time.
const FETCHED: usize = 512;

/// The sums of the pairs of a task, in order. They lie anywhere: some are copied at a time, all latencies overlapping.
struct Ahead<'a> {
    places: &'a [AtomicU32],
    fetched: [Line; FETCHED],
    at: usize,
}

impl Ahead<'_> {
    /// The next place, and its sums.
    #[inline(always)]
    fn next(&mut self, pairs: &[Line]) -> (usize, &Line) {
        let at = self.at;
        self.at += 1;
        if at.is_multiple_of(FETCHED) {
            for (to, place) in self.fetched.iter_mut().zip(&self.places[at..]) {
                *to = pairs[place.load(Relaxed) as usize];
            }
        }
        (self.places[at].load(Relaxed) as usize, &self.fetched[at % FETCHED])
    }
}

/// What the blending of one render left behind.
#[derive(Clone, Copy)]
pub(crate) struct Sums<'a> {
    /// Entries, and places of pairs.
    pub(crate) bins: &'a Bins,
    /// By place: the sums of a pair.
    pub(crate) pairs: &'a [Line],
    /// By place: blocks in which a pair covers a pixel; 0: it has no sums.
    pub(crate) blocks: &'a [u16],
    /// By place: Σ v dx, Σ v dy without the load, where they differ; else empty.
    pub(crate) plain: &'a [[f32; 2]],
    /// Where statistics are asked for: pixels over which the photometric term averages.
    pub(crate) averaged_pixels: Option<f32>,
}

/// Adds up the pairs of one render and leaves their sums in the cloud, instead of those of earlier renders or, with
/// `accumulate`, beside them.
pub(crate) fn reduce(level: Level, cloud: &mut CpuCloud, sums: &Sums<'_>, back: Return, accumulate: bool) {
    let planes = cloud.planes;
    let chunk = GROUPS * LANES;
    let owned = by_task(&sums.bins.entries, chunk, cloud.touched.len().div_ceil(GROUPS));
    let statistics = &mut cloud.statistics;
    let parts = statistics
        .gradient
        .par_chunks_mut(chunk)
        .zip(statistics.absolute_gradient.par_chunks_mut(chunk))
        .zip(statistics.visible_count.par_chunks_mut(chunk))
        .zip(statistics.radius_px.par_chunks_mut(chunk));
    cloud
        .pending
        .begin(back, accumulate, cloud.touched.len().div_ceil(GROUPS))
        .par_iter_mut()
        .zip(cloud.values.par_chunks(GROUPS * planes))
        .zip(cloud.touched.par_chunks_mut(GROUPS))
        .zip(parts)
        .zip(owned)
        .with_max_len(1)
        .enumerate()
        .for_each(|(task, ((((out, values), touched), (((gradient, absolute), visible), radius)), owned))| {
            let first = task * chunk;
            let statistics = Statistics { gradient, absolute, visible, radius };
            let mut task = Task { sums, back: &back, accumulate, planes, first, statistics };
            at_level!(level, simd => task.run(simd, owned, values, out, touched));
        });
}

/// Cuts entries into those of `tasks` times `chunk` Gaussians.
fn by_task(mut entries: &[Entry], chunk: usize, tasks: usize) -> Vec<&[Entry]> {
    let mut owned = Vec::with_capacity(tasks);
    for task in 1..=tasks {
        let (own, rest) = entries.split_at(entries.partition_point(|entry| (entry.gaussian as usize) < task * chunk));
        owned.push(own);
        entries = rest;
    }
    owned
}

struct Statistics<'a> {
    gradient: &'a mut [f32],
    absolute: &'a mut [f32],
    visible: &'a mut [u32],
    radius: &'a mut [f32],
}

struct Task<'a> {
    sums: &'a Sums<'a>,
    back: &'a Return,
    accumulate: bool,
    planes: usize,
    /// First Gaussian of the task.
    first: usize,
    statistics: Statistics<'a>,
}

/// Sums of a group's Gaussians, Gaussian by Gaussian.
struct GroupRows {
    rows: [Line; LANES],
    /// Without the load, x and y, by lane; 0 where they do not differ.
    plain: [Line; 2],
    /// One bit for each lane with sums.
    visible: u16,
}

impl Task<'_> {
    #[inline(always)]
    fn run<S: Carried>(
        &mut self,
        simd: S,
        mut entries: &[Entry],
        values: &[Line],
        out: &mut TaskSums,
        touched: &mut [u16],
    ) {
        simd.carry();
        let lens = Lens::<Wide<S>>::new(&self.back.camera);
        let places = entries.first().map_or(&[][..], |entry| &self.sums.bins.places[entry.first as usize..]);
        let count: usize = entries.iter().map(|entry| entry.count as usize).sum();
        let mut ahead = Ahead { places: &places[..count], fetched: [Line::ZERO; FETCHED], at: 0 };
        for (group, touched) in touched.iter_mut().enumerate() {
            if !self.accumulate {
                *touched = 0;
            }
            let first = self.first + group * LANES;
            let split =
                entries.iter().take(LANES).take_while(|entry| (entry.gaussian as usize) < first + LANES).count();
            let (own, rest) = entries.split_at(split);
            entries = rest;
            let Some(sums) = self.group_rows(first, own, &mut ahead) else { continue };
            *touched |= sums.visible;
            let totals = transposed(&sums.rows);
            if let Some(pixels) = self.sums.averaged_pixels {
                let values = &values[group * self.planes..][..self.planes];
                for at in (0..LANES).step_by(Wide::<S>::LEN) {
                    let ellipses = Ellipses::<Wide<S>>::new(&lens, Lanes { values, at });
                    self.count(group * LANES, at, &totals, &sums.plain, &ellipses, pixels);
                }
            }
            out.push(group, &totals, sums.visible);
        }
    }

    /// Adds up the pairs of a group's Gaussians; `None` where none covers a pixel.
    #[inline(always)]
    fn group_rows(&self, first: usize, entries: &[Entry], ahead: &mut Ahead<'_>) -> Option<GroupRows> {
        if entries.is_empty() {
            return None;
        }
        let mut group = GroupRows { rows: [Line::ZERO; LANES], plain: [Line::ZERO; 2], visible: 0 };
        for entry in entries {
            let lane = (entry.gaussian as usize - first) % LANES;
            let mut total = Line::ZERO;
            for _ in 0..entry.count {
                let (place, pair) = ahead.next(self.sums.pairs);
                if self.sums.blocks[place] == 0 {
                    continue;
                }
                group.visible |= 1 << lane;
                for (to, from) in total.0.iter_mut().zip(pair.0) {
                    *to += from;
                }
                if !self.sums.plain.is_empty() {
                    for (sum, value) in group.plain.iter_mut().zip(self.sums.plain[place]) {
                        sum.0[lane] += value;
                    }
                }
            }
            group.rows[lane] = total;
        }
        (group.visible != 0).then_some(group)
    }

    /// Adds the lanes of one group from `at` on to the statistics.
    #[inline(always)]
    fn count<S: Carried>(
        &mut self,
        first: usize,
        at: usize,
        totals: &[Line; LANES],
        plain: &[Line; 2],
        ellipses: &Ellipses<Wide<S>>,
        pixels: f32,
    ) {
        let total = |k: usize| Wide::<S>::load(&totals[k], at);
        let zero = Wide::<S>::zero();
        let covered = total(sum::COVERED);
        let counts = zero.less(covered);
        let [a, b, c] = ellipses.conic;
        let [vx, vy] = match self.sums.plain {
            [] => [total(sum::VX), total(sum::VY)],
            _ => [Wide::load(&plain[0], at), Wide::load(&plain[1], at)],
        };
        let length = |x: Wide<S>, y: Wide<S>| (x * x + y * y).sqrt();
        let pixels = Wide::from_f64(f64::from(pixels));
        let ln_2 = Wide::from_f64(std::f64::consts::LN_2);
        // The last group may be short.
        let within = |lane: usize| (first + lane).min(self.statistics.visible.len());
        let lanes = within(at)..within(at + Wide::<S>::LEN);
        let per_covered = |length: Wide<S>| length * pixels / covered;
        let statistics = &mut self.statistics;
        let mean = per_covered(length(a * vx + b * vy, b * vx + c * vy));
        add_where(counts, &mut statistics.gradient[lanes.clone()], mean);
        let (au, av) = (total(sum::ABSOLUTE_U) * ln_2, total(sum::ABSOLUTE_V) * ln_2);
        add_where(counts, &mut statistics.absolute[lanes.clone()], per_covered(length(au, av)));
        let radius = Wide::select(counts, projection::radius(ellipses.screen_covariance), zero);
        let largest = &mut statistics.radius[lanes.clone()];
        Pixels::store(radius.max(Pixels::load(largest)), largest);
        for (count, covered) in statistics.visible[lanes].iter_mut().zip(&totals[sum::COVERED].0[at..]) {
            *count += u32::from(*covered > 0.0);
        }
    }
}

/// Adds to the lanes that count.
#[inline(always)]
fn add_where<S: Carried>(counts: S::mask32s, to: &mut [f32], value: Wide<S>) {
    let before = <Wide<S> as Pixels<f32>>::load(to);
    Pixels::store(Wide::select(counts, before + value, before), to);
}

/// Sums by what is summed, of sums by lane.
#[inline(always)]
fn transposed(rows: &[Line; LANES]) -> [Line; LANES] {
    let mut lines = [Line::ZERO; LANES];
    for (lane, row) in rows.iter().enumerate() {
        for (line, value) in lines.iter_mut().zip(row.0) {
            line.0[lane] = value;
        }
    }
    lines
}
