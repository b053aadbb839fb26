//! From sums per Gaussian back to the stored parameters, 16 Gaussians at a time.
//!
//! Gradients are made where they are used, a group at a time (by `adam`, or to be read): they are never stored whole.

use fearless_simd::Level;
use rayon::prelude::*;

use super::{
    backward::sum,
    cloud::{CpuCloud, plane},
    lanes::{LANES, Line, at_level},
    project::{Ellipses, GROUPS, Lanes, at_degree, coefficients},
    wide::{Carried, Wide},
};
use crate::backend::ViewCamera;
use crate::equations::{
    Number, activation,
    algebra::{Mat3, Vec3, add, each, mat_vec, sub, transpose_vec},
    covariance, harmonics,
    plane::{distance_grad, normal, normal_axis, normal_grad},
    projection::{self, Lens},
};

/// How to go back through one render.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Return {
    /// The camera.
    pub(crate) camera: ViewCamera,
    /// Degree of harmonics in use.
    pub(crate) sh_degree: u8,
    /// Whether normals and distances were drawn.
    pub(crate) planes: bool,
    /// Whether colours were drawn.
    pub(crate) color: bool,
    /// Gradient of the smallest scale of every visible Gaussian, per scene unit.
    pub(crate) d_smallest_scale: f32,
}

impl Return {
    /// Planes that get a gradient.
    fn used_planes(&self) -> usize {
        plane::HARMONICS + if self.color { 3 * harmonics::basis_count(self.sh_degree) } else { 0 }
    }
}

/// Sums of the groups of one task that have any.
#[derive(Debug, Default)]
pub(crate) struct TaskSums {
    groups: Vec<u8>,
    /// `[groups][TOTALS]` by what is summed, and last 1 for lanes with sums.
    lines: Vec<Line>,
}

/// Lines of a group's sums.
const TOTALS: usize = sum::ABSOLUTE_U + 1;

impl TaskSums {
    /// Adds a group, by what is summed; 0 but for lanes with a bit in `visible`. Groups come in ascending order.
    #[inline(always)]
    pub(crate) fn push(&mut self, group: usize, sums: &[Line; LANES], visible: u16) {
        self.groups.push(group as u8);
        self.lines.extend_from_slice(&sums[..sum::ABSOLUTE_U]);
        self.lines.push(lanes_of(visible));
    }
}

/// 1 for lanes with a bit.
#[inline(always)]
fn lanes_of(bits: u16) -> Line {
    Line(each(|lane| f32::from(bits >> lane & 1)))
}

/// Sums of the renders of one step, by render, then by task of [`GROUPS`] groups. Buffers are kept between steps.
#[derive(Debug, Default)]
pub(crate) struct Pending {
    renders: [Option<Return>; 2],
    tasks: [Vec<TaskSums>; 2],
}

impl Pending {
    /// Makes room for a render, in place of all others or beside the first.
    pub(crate) fn begin(&mut self, back: Return, beside: bool, tasks: usize) -> &mut [TaskSums] {
        if !beside {
            self.renders = [None; 2];
        }
        let at = usize::from(beside);
        self.renders[at] = Some(back);
        self.tasks[at].resize_with(tasks, TaskSums::default);
        for task in &mut self.tasks[at] {
            task.groups.clear();
            task.lines.clear();
        }
        &mut self.tasks[at]
    }

    /// Forgets everything.
    pub(crate) fn clear(&mut self) {
        self.renders = [None; 2];
    }

    /// Planes that get a gradient.
    pub(crate) fn used_planes(&self) -> usize {
        self.renders.iter().flatten().map(Return::used_planes).max().unwrap_or(plane::HARMONICS)
    }

    /// The gradients of one task's groups, one after another.
    #[inline(always)]
    pub(crate) fn walk<S: Carried>(&self, task: usize) -> Walk<'_, S> {
        let side = |at: usize| {
            let back = self.renders[at].as_ref()?;
            Some(Side { back, sums: &self.tasks[at][task], at: 0, lens: Lens::new(&back.camera) })
        };
        Walk { sides: [side(0), side(1)], used: self.used_planes() }
    }
}

/// Where a walk is in one render.
struct Side<'a, S: Carried> {
    back: &'a Return,
    sums: &'a TaskSums,
    at: usize,
    lens: Lens<Wide<S>>,
}

/// Goes through the groups of a task.
pub(crate) struct Walk<'a, S: Carried> {
    sides: [Option<Side<'a, S>>; 2],
    /// Planes that get a gradient.
    used: usize,
}

impl<S: Carried> Walk<'_, S> {
    /// Writes the gradient of `group` to the first planes of `lines`; whether it has one. Groups in ascending order.
    #[inline(always)]
    pub(crate) fn next(&mut self, group: usize, values: &[Line], lines: &mut [Line]) -> bool {
        let lines = &mut lines[..self.used];
        let mut fresh = true;
        for side in self.sides.iter_mut().flatten() {
            if side.sums.groups.get(side.at) != Some(&(group as u8)) {
                continue;
            }
            let sums = &side.sums.lines[side.at * TOTALS..][..TOTALS];
            side.at += 1;
            if fresh {
                lines[side.back.used_planes()..].fill(Line::ZERO);
            }
            for at in (0..LANES).step_by(Wide::<S>::LEN) {
                let visible = Wide::<S>::zero().less(Wide::load(&sums[sum::ABSOLUTE_U], at));
                let mut out = Out { lines: &mut *lines, at, visible, fresh };
                group_gradients(&side.lens, side.back, values, sums, &mut out);
            }
            fresh = false;
        }
        !fresh
    }
}

/// The gradients of everything, laid out as the parameters.
pub(crate) fn all(level: Level, cloud: &CpuCloud) -> Vec<Line> {
    let mut out = vec![Line::ZERO; cloud.values.len()];
    let chunk = GROUPS * cloud.planes;
    out.par_chunks_mut(chunk).zip(cloud.values.par_chunks(chunk)).enumerate().for_each(|(task, (out, values))| {
        at_level!(level, simd => all_of_task(simd, &cloud.pending, task, (values, out), cloud.planes));
    });
    out
}

#[inline(always)]
fn all_of_task<S: Carried>(
    simd: S,
    pending: &Pending,
    task: usize,
    (values, out): (&[Line], &mut [Line]),
    planes: usize,
) {
    simd.carry();
    let mut walk = pending.walk::<S>(task);
    for (group, (values, out)) in values.chunks_exact(planes).zip(out.chunks_exact_mut(planes)).enumerate() {
        walk.next(group, values, out);
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
    back: &Return,
    values: &[Line],
    sums: &[Line],
    out: &mut Out<'_, S>,
) {
    let at = out.at;
    let lanes = Lanes { values, at };
    let totals = Lanes { values: sums, at };
    let ellipses = Ellipses::new(lens, lanes);
    let half = Wide::<S>::from_f64(-0.5);
    let [a, b, c] = ellipses.conic;

    let (vx, vy) = (totals.one(sum::VX), totals.one(sum::VY));
    let d_conic = [half * totals.one(sum::VXX), -totals.one(sum::VXY), half * totals.one(sum::VYY)];
    let d_screen_covariance = projection::conic_grad(ellipses.conic, d_conic);
    let (mut d_point, d_covariance) =
        projection::screen_covariance_grad(lens, ellipses.point, &ellipses.covariance, d_screen_covariance);
    d_point = add(d_point, projection::screen_grad(lens, ellipses.point, [a * vx + b * vy, b * vx + c * vy]));
    let (mut d_rotation, d_scales) = covariance::covariance_grad(&ellipses.rotation, ellipses.scales, &d_covariance);

    let mean: Vec3<Wide<S>> = lanes.three(plane::MEAN);
    let mut d_mean = [Wide::zero(); 3];
    if back.color {
        let (direction, reach) = harmonics::direction(mean, lens.eye);
        let d_rgb = totals.three(sum::FEATURES);
        let d_direction = at_degree!(back.sh_degree, color_gradients::<S>(lanes, direction, d_rgb, out));
        d_mean = harmonics::direction_grad(direction, reach, d_direction);
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

/// Gradient of the colours: adds those of the coefficients, returns that of the direction.
#[inline(always)]
fn color_gradients<S: Carried, const DEGREE: u8>(
    lanes: Lanes<'_>,
    direction: Vec3<Wide<S>>,
    d_rgb: Vec3<Wide<S>>,
    out: &mut Out<'_, S>,
) -> Vec3<Wide<S>> {
    let held = coefficients(DEGREE, lanes);
    let rgb = harmonics::color(&held, direction, DEGREE);
    let (d_held, d_direction) = harmonics::color_grad(&held, direction, DEGREE, rgb, d_rgb);
    for l in 0..harmonics::basis_count(DEGREE) {
        for channel in 0..3 {
            out.add(plane::HARMONICS + 3 * l + channel, d_held[l][channel]);
        }
    }
    d_direction
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
