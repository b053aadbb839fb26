//! From the sums over pixels back to the stored parameters, 16 Gaussians at a time, and the density statistics.
//!
//! The pairs of a Gaussian are added in their fixed order, so the result does not depend on threads.

use std::sync::atomic::Ordering::Relaxed;

use fearless_simd::Level;
use rayon::prelude::*;

use super::{
    backward::sum,
    bins::{Bins, Entry},
    cloud::{CpuCloud, plane},
    lanes::{LANES, Line, at_level},
    project::{Ellipses, GROUPS, Lanes, coefficients},
    wide::{Carried, Wide},
};
use crate::backend::ViewCamera;
use crate::equations::{
    Number, activation,
    algebra::{Mat3, Vec3, add, mat_vec, sub, transpose_vec},
    covariance, harmonics,
    plane::{distance_grad, normal, normal_axis, normal_grad},
    projection::{self, Lens},
};

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
}

/// How to go back.
#[derive(Clone, Copy)]
pub(crate) struct Return<'a> {
    /// The camera.
    pub(crate) camera: &'a ViewCamera,
    /// Degree of harmonics in use.
    pub(crate) sh_degree: u8,
    /// Whether normals and distances were drawn.
    pub(crate) planes: bool,
    /// Add to the gradients at hand instead of replacing them.
    pub(crate) accumulate: bool,
    /// Gradient of the smallest scale of every visible Gaussian, per scene unit.
    pub(crate) d_smallest_scale: f32,
    /// Where statistics are asked for: pixels over which the photometric term averages.
    pub(crate) averaged_pixels: Option<f32>,
}

/// Gradients of all parameters.
pub(crate) fn gradients(level: Level, cloud: &mut CpuCloud, sums: &Sums<'_>, back: &Return<'_>) {
    let (planes, count) = (cloud.planes, cloud.count);
    let used = plane::HARMONICS + 3 * harmonics::basis_count(back.sh_degree);
    cloud.gradient_planes = if back.accumulate { cloud.gradient_planes.max(used) } else { used };
    let used = cloud.gradient_planes;
    let statistics = &mut cloud.statistics;
    let chunk = GROUPS * LANES;
    let parts = statistics
        .gradient
        .par_chunks_mut(chunk)
        .zip(statistics.absolute_gradient.par_chunks_mut(chunk))
        .zip(statistics.visible_count.par_chunks_mut(chunk))
        .zip(statistics.radius_px.par_chunks_mut(chunk));
    cloud
        .gradients
        .par_chunks_mut(GROUPS * planes)
        .zip(cloud.values.par_chunks(GROUPS * planes))
        .zip(cloud.touched.par_chunks_mut(GROUPS))
        .zip(parts)
        .enumerate()
        .for_each(|(task, (((gradients, values), touched), (((gradient, absolute), visible), radius)))| {
            let first = task * chunk;
            let from = sums.bins.entries.partition_point(|entry| (entry.gaussian as usize) < first);
            let statistics = Statistics { gradient, absolute, visible, radius };
            let mut task = Task { sums, back, planes, used, first, statistics };
            let entries = &sums.bins.entries[from..];
            debug_assert!(count > first);
            at_level!(level, simd => task.run(simd, entries, values, gradients, touched));
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
    back: &'a Return<'a>,
    planes: usize,
    /// Planes with gradients.
    used: usize,
    /// First Gaussian of the task.
    first: usize,
    statistics: Statistics<'a>,
}

/// Sums over a group, by what is summed, then by lane.
struct GroupSums {
    totals: [Line; 16],
    plain: [Line; 2],
    /// 1 for lanes with sums.
    visible: Line,
}

impl Task<'_> {
    #[inline(always)]
    fn run<S: Carried>(
        &mut self,
        simd: S,
        mut entries: &[Entry],
        values: &[Line],
        gradients: &mut [Line],
        touched: &mut [bool],
    ) {
        simd.carry();
        let lens = Lens::<Wide<S>>::new(self.back.camera);
        for (group, touched) in touched.iter_mut().enumerate() {
            let first = self.first + group * LANES;
            let split =
                entries.iter().take(LANES).take_while(|entry| (entry.gaussian as usize) < first + LANES).count();
            let (own, rest) = entries.split_at(split);
            entries = rest;
            let lines = &mut gradients[group * self.planes..][..self.used];
            let Some(sums) = self.group_sums(first, own) else {
                *touched &= self.back.accumulate;
                continue;
            };
            let fresh = !*touched || !self.back.accumulate;
            *touched = true;
            if fresh {
                lines[plane::HARMONICS + 3 * harmonics::basis_count(self.back.sh_degree)..].fill(Line::ZERO);
            }
            let values = &values[group * self.planes..][..self.planes];
            let mut measures = [Line::ZERO; 4];
            for at in (0..LANES).step_by(Wide::<S>::LEN) {
                let mut out = Out { lines, at, visible: Wide::<S>::zero().less(Wide::load(&sums.visible, at)), fresh };
                group_gradients(&lens, self.back, values, &sums, &mut out, &mut measures);
            }
            if self.back.averaged_pixels.is_some() {
                self.count(group * LANES, &sums, &measures);
            }
        }
    }

    /// Adds up the pairs of a group's Gaussians; `None` where none covers a pixel.
    #[inline(always)]
    fn group_sums(&self, first: usize, entries: &[Entry]) -> Option<GroupSums> {
        let mut group = GroupSums { totals: [Line::ZERO; 16], plain: [Line::ZERO; 2], visible: Line::ZERO };
        let mut any = false;
        for entry in entries {
            let (mut total, mut plain, mut visible) = (Line::ZERO, [0.0f32; 2], false);
            for pair in entry.first..entry.first + entry.count {
                let place = self.sums.bins.places[pair as usize].load(Relaxed) as usize;
                if self.sums.blocks[place] != 0 {
                    visible = true;
                    for (to, from) in total.0.iter_mut().zip(&self.sums.pairs[place].0) {
                        *to += from;
                    }
                    if let Some(own) = self.sums.plain.get(place) {
                        plain = [plain[0] + own[0], plain[1] + own[1]];
                    }
                }
            }
            if visible {
                any = true;
                let lane = entry.gaussian as usize - first;
                for (line, value) in group.totals.iter_mut().zip(total.0) {
                    line.0[lane] = value;
                }
                if self.sums.plain.is_empty() {
                    plain = [total.0[sum::VX], total.0[sum::VY]];
                }
                group.plain[0].0[lane] = plain[0];
                group.plain[1].0[lane] = plain[1];
                group.visible.0[lane] = 1.0;
            }
        }
        any.then_some(group)
    }

    /// Adds one group to the statistics. `measures`: A, B, C of the conic, radius.
    fn count(&mut self, first: usize, sums: &GroupSums, measures: &[Line; 4]) {
        let pixels = self.back.averaged_pixels.unwrap_or(0.0);
        for lane in 0..LANES {
            let covered = sums.totals[sum::COVERED].0[lane];
            if covered == 0.0 {
                continue;
            }
            let i = first + lane;
            let [a, b, c, radius] = measures.map(|line| line.0[lane]);
            let [vx, vy] = [sums.plain[0].0[lane], sums.plain[1].0[lane]];
            let (du, dv) = (a * vx + b * vy, b * vx + c * vy);
            let [au, av] = [sum::ABSOLUTE_U, sum::ABSOLUTE_V].map(|k| sums.totals[k].0[lane] * std::f32::consts::LN_2);
            self.statistics.gradient[i] += (du * du + dv * dv).sqrt() * pixels / covered;
            self.statistics.absolute[i] += (au * au + av * av).sqrt() * pixels / covered;
            self.statistics.visible[i] += 1;
            self.statistics.radius[i] = self.statistics.radius[i].max(radius);
        }
    }
}

/// Where gradients of some lanes go.
struct Out<'a, S: Carried> {
    lines: &'a mut [Line],
    at: usize,
    /// Lanes that have gradients; in others they may be anything.
    visible: S::mask32s,
    /// Whether nothing was there.
    fresh: bool,
}

impl<S: Carried> Out<'_, S> {
    #[inline(always)]
    fn add(&mut self, plane: usize, value: Wide<S>) {
        let value = Wide::select(self.visible, value, Wide::zero());
        let sum = if self.fresh { value } else { Wide::<S>::load(&self.lines[plane], self.at) + value };
        sum.store(&mut self.lines[plane], self.at);
    }
}

/// Gradients of the lanes of `out`, added there.
#[inline(always)]
fn group_gradients<S: Carried>(
    lens: &Lens<Wide<S>>,
    back: &Return<'_>,
    values: &[Line],
    sums: &GroupSums,
    out: &mut Out<'_, S>,
    measures: &mut [Line; 4],
) {
    let at = out.at;
    let lanes = Lanes { values, at };
    let totals = Lanes { values: &sums.totals, at };
    let ellipses = Ellipses::new(lens, lanes);
    let half = Wide::<S>::from_f64(-0.5);
    let [a, b, c] = ellipses.conic;
    for (line, value) in measures.iter_mut().zip([a, b, c, projection::radius(ellipses.screen_covariance)]) {
        value.store(line, at);
    }

    let (vx, vy) = (totals.one(sum::VX), totals.one(sum::VY));
    let d_conic = [half * totals.one(sum::VXX), -totals.one(sum::VXY), half * totals.one(sum::VYY)];
    let d_screen_covariance = projection::conic_grad(ellipses.conic, d_conic);
    let (mut d_point, d_covariance) =
        projection::screen_covariance_grad(lens, ellipses.point, &ellipses.covariance, d_screen_covariance);
    d_point = add(d_point, projection::screen_grad(lens, ellipses.point, [a * vx + b * vy, b * vx + c * vy]));
    let (mut d_rotation, d_scales) = covariance::covariance_grad(&ellipses.rotation, ellipses.scales, &d_covariance);

    let mean: Vec3<Wide<S>> = lanes.three(plane::MEAN);
    let (direction, reach) = harmonics::direction(mean, lens.eye);
    let held = coefficients(back.sh_degree, lanes);
    let rgb = harmonics::color(&held, direction, back.sh_degree);
    let d_rgb = totals.three(sum::FEATURES);
    let (d_held, d_direction) = harmonics::color_grad(&held, direction, back.sh_degree, rgb, d_rgb);
    let mut d_mean = harmonics::direction_grad(direction, reach, d_direction);
    for l in 0..harmonics::basis_count(back.sh_degree) {
        for channel in 0..3 {
            out.add(plane::HARMONICS + 3 * l + channel, d_held[l][channel]);
        }
    }
    if back.planes {
        let [nx, ny, nz] = totals.three(sum::FEATURES + 3);
        let d_planes = [nx, ny, nz, totals.one(sum::FEATURES + 6)];
        d_point = add(d_point, plane_gradients(lens, &ellipses, sub(lens.eye, mean), d_planes, &mut d_rotation));
    }
    d_mean = add(d_mean, projection::to_camera_grad(lens, d_point));
    let d_log_scales = activation::scales_grad(ellipses.scales, d_scales);
    let smallest = smallest_scale(ellipses.scales, back.d_smallest_scale);
    let (unit, norm) = ellipses.quaternion;
    let d_quaternion = activation::unit_quaternion_grad(unit, norm, covariance::rotation_grad(unit, &d_rotation));
    for axis in 0..3 {
        out.add(plane::MEAN + axis, d_mean[axis]);
        out.add(plane::LOG_SCALE + axis, d_log_scales[axis] + smallest[axis]);
    }
    for k in 0..4 {
        out.add(plane::ROTATION + k, d_quaternion[k]);
    }
    out.add(plane::OPACITY, totals.one(sum::V) * (Wide::one() - ellipses.opacity));
}

/// Gradients of normal and distance (four): returns that of the mean in the camera frame, adds that of the rotation.
#[inline(always)]
fn plane_gradients<T: Number>(
    lens: &Lens<T>,
    ellipses: &Ellipses<T>,
    to_eye: Vec3<T>,
    [nx, ny, nz, d_distance]: [T; 4],
    d_rotation: &mut Mat3<T>,
) -> Vec3<T> {
    let axis = normal_axis(&ellipses.rotation, ellipses.scales, to_eye);
    let facing = mat_vec(&lens.rotation, normal(&ellipses.rotation, axis));
    let (d_facing, d_point) = distance_grad(facing, ellipses.point, d_distance);
    let d_axes = normal_grad(axis, transpose_vec(&lens.rotation, add(d_facing, [nx, ny, nz])));
    for row in 0..3 {
        d_rotation[row] = add(d_rotation[row], d_axes[row]);
    }
    d_point
}

/// Gradient of the logarithms of the scales where the smallest (the first of equals) has this gradient.
#[inline(always)]
fn smallest_scale<T: Number>(scales: [T; 3], d_smallest: f32) -> [T; 3] {
    let d = T::from_f64(f64::from(d_smallest));
    let (zero, one) = (T::zero(), T::one());
    let second = T::select(scales[1].less(scales[0]), one, zero);
    let third = T::select(scales[2].less(scales[0].min(scales[1])), one, zero);
    [d * (one - second) * (one - third) * scales[0], d * second * (one - third) * scales[1], d * third * scales[2]]
}
