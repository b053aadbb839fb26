//! From the pairs of a render to sums per Gaussian, and the density statistics.
//!
//! The pairs of a Gaussian are added in their fixed order, so the result does not depend on threads.

use std::sync::atomic::Ordering::Relaxed;

use fearless_simd::Level;
use rayon::prelude::*;

use super::{
    backward::sum,
    bins::{Bins, Entry},
    cloud::CpuCloud,
    gradient::{Return, TaskSums, Totals},
    lanes::{LANES, Line, at_level},
    project::{Ellipses, GROUPS, Lanes},
    wide::{Carried, Wide},
};
use crate::equations::projection::{self, Lens};

/// What the blending of one render left behind.
#[derive(Clone, Copy)]
pub(crate) struct Sums<'a> {
    /// Entries, and places of pairs.
    pub(crate) bins: &'a Bins,
    /// `[pairs]` blocks in which a pair covers a pixel; 0: it has no sums.
    pub(crate) blocks: &'a [u16],
    /// `[pairs]`
    pub(crate) pairs: &'a [Line],
    /// `[pairs]` Σ v dx, Σ v dy without the load, where they differ; else empty.
    pub(crate) plain: &'a [[f32; 2]],
    /// Where statistics are asked for: pixels over which the photometric term averages.
    pub(crate) averaged_pixels: Option<f32>,
}

/// Adds up one render and leaves its sums in the cloud, instead of those of earlier renders or, with `accumulate`,
/// beside them.
pub(crate) fn reduce(level: Level, cloud: &mut CpuCloud, sums: &Sums<'_>, back: Return, accumulate: bool) {
    let planes = cloud.planes;
    let chunk = GROUPS * LANES;
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
        .enumerate()
        .for_each(|(task, (((out, values), touched), (((gradient, absolute), visible), radius)))| {
            let first = task * chunk;
            let from = sums.bins.entries.partition_point(|entry| (entry.gaussian as usize) < first);
            let statistics = Statistics { gradient, absolute, visible, radius };
            let mut task = Task { sums, back: &back, accumulate, planes, first, statistics };
            let entries = &sums.bins.entries[from..];
            at_level!(level, simd => task.run(simd, entries, values, out, touched));
        });
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

/// Records that are fetched at a time.
const FETCHED: usize = 64;

/// Sums of some pairs, and whose they are.
struct Fetched {
    sums: [Line; FETCHED],
    lanes: [u8; FETCHED],
    count: usize,
}

/// Sums of a group's Gaussians, Gaussian by Gaussian.
struct GroupRows {
    rows: [Line; LANES],
    /// Without the load, x and y, by lane; 0 where they do not differ.
    plain: [Line; 2],
    /// One bit for each lane with sums.
    visible: u16,
}

impl Fetched {
    /// Adds them to the sums of their lanes, in order, and forgets them.
    #[inline(always)]
    fn add(&mut self, group: &mut GroupRows) {
        for (sums, &lane) in self.sums.iter().zip(&self.lanes).take(self.count) {
            let lane = usize::from(lane) % LANES;
            for (to, from) in group.rows[lane].0.iter_mut().zip(&sums.0) {
                *to += from;
            }
            group.visible |= 1 << lane;
        }
        self.count = 0;
    }
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
        let mut fetched = Fetched { sums: [Line::ZERO; FETCHED], lanes: [0; FETCHED], count: 0 };
        for (group, touched) in touched.iter_mut().enumerate() {
            if !self.accumulate {
                *touched = 0;
            }
            let first = self.first + group * LANES;
            let split =
                entries.iter().take(LANES).take_while(|entry| (entry.gaussian as usize) < first + LANES).count();
            let (own, rest) = entries.split_at(split);
            entries = rest;
            let Some(sums) = self.group_rows(first, own, &mut fetched) else { continue };
            *touched |= sums.visible;
            let totals = Totals::of(&sums.rows, sums.visible);
            if let Some(pixels) = self.sums.averaged_pixels {
                let values = &values[group * self.planes..][..self.planes];
                let mut measures = [Line::ZERO; 4];
                for at in (0..LANES).step_by(Wide::<S>::LEN) {
                    measure(&lens, Lanes { values, at }, &mut measures);
                }
                self.count(group * LANES, &sums, &measures, pixels);
            }
            out.push(group, totals);
        }
    }

    /// Adds up the pairs of a group's Gaussians; `None` where none covers a pixel. Records are copied some at a time
    /// before they are added: they lie anywhere, and so their latencies overlap.
    #[inline(always)]
    fn group_rows(&self, first: usize, entries: &[Entry], fetched: &mut Fetched) -> Option<GroupRows> {
        if entries.is_empty() {
            return None;
        }
        let mut group = GroupRows { rows: [Line::ZERO; LANES], plain: [Line::ZERO; 2], visible: 0 };
        for entry in entries {
            let lane = entry.gaussian as usize - first;
            for place in &self.sums.bins.places[entry.first as usize..(entry.first + entry.count) as usize] {
                let place = place.load(Relaxed) as usize;
                fetched.sums[fetched.count] = self.sums.pairs[place];
                fetched.lanes[fetched.count] = lane as u8;
                fetched.count += usize::from(self.sums.blocks[place] != 0);
                if fetched.count == FETCHED {
                    fetched.add(&mut group);
                }
                if !self.sums.plain.is_empty() && self.sums.blocks[place] != 0 {
                    for (sum, value) in group.plain.iter_mut().zip(self.sums.plain[place]) {
                        sum.0[lane] += value;
                    }
                }
            }
        }
        fetched.add(&mut group);
        (group.visible != 0).then_some(group)
    }

    /// Adds one group to the statistics. `measures`: A, B, C of the conic, radius.
    fn count(&mut self, first: usize, sums: &GroupRows, measures: &[Line; 4], pixels: f32) {
        for lane in (0..LANES).filter(|lane| sums.visible >> lane & 1 != 0) {
            let row = &sums.rows[lane].0;
            let covered = row[sum::COVERED];
            if covered == 0.0 {
                continue;
            }
            let i = first + lane;
            let [a, b, c, radius] = measures.map(|line| line.0[lane]);
            let [vx, vy] = match self.sums.plain {
                [] => [row[sum::VX], row[sum::VY]],
                _ => sums.plain.map(|line| line.0[lane]),
            };
            let (du, dv) = (a * vx + b * vy, b * vx + c * vy);
            let [au, av] = [sum::ABSOLUTE_U, sum::ABSOLUTE_V].map(|k| row[k] * std::f32::consts::LN_2);
            self.statistics.gradient[i] += (du * du + dv * dv).sqrt() * pixels / covered;
            self.statistics.absolute[i] += (au * au + av * av).sqrt() * pixels / covered;
            self.statistics.visible[i] += 1;
            self.statistics.radius[i] = self.statistics.radius[i].max(radius);
        }
    }
}

/// A, B, C of the conic and the radius.
#[inline(always)]
fn measure<S: Carried>(lens: &Lens<Wide<S>>, lanes: Lanes<'_>, measures: &mut [Line; 4]) {
    let ellipses = Ellipses::<Wide<S>>::new(lens, lanes);
    let [a, b, c] = ellipses.conic;
    for (line, value) in measures.iter_mut().zip([a, b, c, projection::radius(ellipses.screen_covariance)]) {
        value.store(line, lanes.at);
    }
}
