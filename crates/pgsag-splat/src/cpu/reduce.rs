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
    lanes::{LANES, Line, SharedLine, at_level},
    project::{Ellipses, GROUPS, Lanes},
    wide::{Carried, Wide},
};
use crate::equations::projection::{self, Lens};

/// What the blending of one render left behind.
#[derive(Clone, Copy)]
pub(crate) struct Sums<'a> {
    /// Entries, and places of pairs.
    pub(crate) bins: &'a Bins,
    /// By place: blocks in which a pair covers a pixel; 0: it has no sums.
    pub(crate) blocks: &'a [u16],
    /// By place: Σ v dx, Σ v dy without the load, where they differ; else empty.
    pub(crate) plain: &'a [[f32; 2]],
    /// Where statistics are asked for: pixels over which the photometric term averages.
    pub(crate) averaged_pixels: Option<f32>,
}

/// Adds up `pairs` (`[pairs]`) of one render and leaves their sums in the cloud, instead of those of earlier renders or, with
/// `accumulate`, beside them.
pub(crate) fn reduce(
    level: Level,
    cloud: &mut CpuCloud,
    sums: &Sums<'_>,
    pairs: &mut [SharedLine],
    back: Return,
    accumulate: bool,
) {
    let planes = cloud.planes;
    let chunk = GROUPS * LANES;
    let owned = by_task(&sums.bins.entries, pairs, chunk, cloud.touched.len().div_ceil(GROUPS));
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

/// Entries of some Gaussians, and the sums of their pairs, both in order of Gaussians.
type Owned<'a> = (&'a [Entry], &'a mut [SharedLine]);

/// Cuts entries and pairs into those of `tasks` times `chunk` Gaussians.
fn by_task<'a>(
    mut entries: &'a [Entry],
    mut pairs: &'a mut [SharedLine],
    chunk: usize,
    tasks: usize,
) -> Vec<Owned<'a>> {
    let mut owned = Vec::with_capacity(tasks);
    for task in 1..=tasks {
        let (own, rest) = entries.split_at(entries.partition_point(|entry| (entry.gaussian as usize) < task * chunk));
        let count = own.iter().map(|entry| entry.count as usize).sum();
        let (own_pairs, rest_pairs) = pairs.split_at_mut(count);
        owned.push((own, own_pairs));
        (entries, pairs) = (rest, rest_pairs);
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
        (mut entries, mut pairs): Owned<'_>,
        values: &[Line],
        out: &mut TaskSums,
        touched: &mut [u16],
    ) {
        simd.carry();
        let lens = Lens::<Wide<S>>::new(&self.back.camera);
        for (group, touched) in touched.iter_mut().enumerate() {
            if !self.accumulate {
                *touched = 0;
            }
            let first = self.first + group * LANES;
            let split =
                entries.iter().take(LANES).take_while(|entry| (entry.gaussian as usize) < first + LANES).count();
            let (own, rest) = entries.split_at(split);
            entries = rest;
            let Some(sums) = self.group_rows(first, own, &mut pairs) else { continue };
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

    /// Adds up the pairs of a group's Gaussians, which are the first of `pairs`, and takes them off; `None` where none
    /// covers a pixel.
    #[inline(always)]
    fn group_rows(&self, first: usize, entries: &[Entry], pairs: &mut &mut [SharedLine]) -> Option<GroupRows> {
        if entries.is_empty() {
            return None;
        }
        let mut group = GroupRows { rows: [Line::ZERO; LANES], plain: [Line::ZERO; 2], visible: 0 };
        for entry in entries {
            let lane = (entry.gaussian as usize - first) % LANES;
            let (own, rest) = std::mem::take(pairs).split_at_mut(entry.count as usize);
            *pairs = rest;
            let mut total = Line::ZERO;
            let places = &self.sums.bins.places[entry.first as usize..][..entry.count as usize];
            for (pair, place) in own.iter_mut().zip(places) {
                let place = place.load(Relaxed) as usize;
                if self.sums.blocks[place] == 0 {
                    continue;
                }
                group.visible |= 1 << lane;
                for (to, from) in total.0.iter_mut().zip(pair.get().0) {
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
