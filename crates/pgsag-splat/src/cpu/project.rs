//! From the cloud to records: 16 Gaussians at a time through the equations, in vector lanes.
//!
//! First the ellipses, and which drawn tiles each touches; colours and planes only of groups that touch any.

use fearless_simd::Level;
use rayon::prelude::*;

use super::{
    bins::{Bins, Boxes, Entry, place},
    bounds::{self, Sight},
    cloud::{CpuCloud, plane},
    lanes::{LANES, Line, at_level},
    layout::Layout,
    wide::{Carried, Wide},
};
use crate::backend::ViewCamera;
use crate::equations::{
    Number, activation,
    algebra::{Mat3, Vec3, mat_vec, sub},
    covariance, harmonics,
    plane::{distance, normal, normal_axis},
    projection::{self, Lens},
};

/// Groups that a task takes at a time.
pub(crate) const GROUPS: usize = 4 * LANES;

/// What to project, and how.
#[derive(Clone, Copy)]
pub(crate) struct Projection<'a> {
    /// The camera.
    pub(crate) camera: &'a ViewCamera,
    /// What is drawn.
    pub(crate) layout: &'a Layout,
    /// Degree of harmonics in use.
    pub(crate) sh_degree: u8,
    /// Whether normals and distances are drawn.
    pub(crate) planes: bool,
    /// Whether colours are drawn.
    pub(crate) color: bool,
    /// log2 of the alpha cut.
    pub(crate) cut: f32,
}

/// What a task found: Gaussians that touch drawn tiles, and those tiles.
#[derive(Debug, Default)]
pub(crate) struct Found {
    entries: Vec<Entry>,
    tiles: Vec<u32>,
}

/// A group of Gaussians up to its ellipses on the screen.
pub(crate) struct Ellipses<T> {
    /// Unit quaternion and the stored one's norm.
    pub(crate) quaternion: ([T; 4], T),
    /// Columns: axes, group frame.
    pub(crate) rotation: Mat3<T>,
    /// Standard deviations.
    pub(crate) scales: [T; 3],
    /// Σ, group frame.
    pub(crate) covariance: Mat3<T>,
    /// Mean, camera frame.
    pub(crate) point: Vec3<T>,
    /// (a, b, c) on the screen.
    pub(crate) screen_covariance: [T; 3],
    /// Its inverse.
    pub(crate) conic: [T; 3],
    /// In (0, 1).
    pub(crate) opacity: T,
}

/// Lanes of a group: the planes of 16, 8 or 4 Gaussians.
#[derive(Clone, Copy)]
pub(crate) struct Lanes<'a> {
    /// The group's lines.
    pub(crate) values: &'a [Line],
    /// First lane.
    pub(crate) at: usize,
}

impl Lanes<'_> {
    /// One plane.
    #[inline(always)]
    pub(crate) fn one<S: Carried>(self, plane: usize) -> Wide<S> {
        Wide::load(&self.values[plane], self.at)
    }

    /// Three planes from `plane` on.
    #[inline(always)]
    pub(crate) fn three<S: Carried>(self, plane: usize) -> Vec3<Wide<S>> {
        [self.one(plane), self.one(plane + 1), self.one(plane + 2)]
    }

    /// The quaternion, as stored.
    #[inline(always)]
    pub(crate) fn quaternion<S: Carried>(self) -> [Wide<S>; 4] {
        let [w, x, y] = self.three(plane::ROTATION);
        [w, x, y, self.one(plane::ROTATION + 3)]
    }
}

impl<S: Carried> Ellipses<Wide<S>> {
    /// Of stored parameters.
    #[inline(always)]
    pub(crate) fn new(lens: &Lens<Wide<S>>, lanes: Lanes<'_>) -> Self {
        let quaternion = activation::unit_quaternion(lanes.quaternion());
        let rotation = covariance::rotation(quaternion.0);
        let scales = activation::scales(lanes.three(plane::LOG_SCALE));
        let covariance = covariance::covariance(&rotation, scales);
        let point = projection::to_camera(lens, lanes.three(plane::MEAN));
        let screen_covariance = projection::screen_covariance(lens, point, &covariance);
        let conic = projection::conic(screen_covariance);
        let opacity = activation::opacity(lanes.one(plane::OPACITY));
        Self { quaternion, rotation, scales, covariance, point, screen_covariance, conic, opacity }
    }
}

/// The coefficients of a group, of a degree.
#[inline(always)]
pub(crate) fn coefficients<S: Carried>(degree: u8, lanes: Lanes<'_>) -> [Vec3<Wide<S>>; harmonics::BASIS_MAX] {
    let mut out = [[Wide::zero(); 3]; harmonics::BASIS_MAX];
    for l in 0..harmonics::basis_count(degree) {
        out[l] = lanes.three(plane::HARMONICS + 3 * l);
    }
    out
}

/// Calls a function of harmonics with the degree as a constant, so that what it holds of each stays in registers.
macro_rules! at_degree {
    ($degree:expr, $function:ident::<S>($($argument:expr),*)) => {
        match $degree {
            0 => $function::<S, 0>($($argument),*),
            1 => $function::<S, 1>($($argument),*),
            2 => $function::<S, 2>($($argument),*),
            _ => $function::<S, 3>($($argument),*),
        }
    };
}
pub(crate) use at_degree;

/// Projects what the drawn tiles may see of the cloud: writes `records` (by Gaussian; only of those that touch a drawn tile), and the lists of tiles.
pub(crate) fn project(
    level: Level,
    cloud: &CpuCloud,
    projection: &Projection<'_>,
    records: &mut Vec<Line>,
    found: &mut Vec<Found>,
    bins: &mut Bins,
) {
    records.resize(cloud.touched.len() * LANES, Line::ZERO);
    found.resize_with(cloud.touched.len().div_ceil(GROUPS), Found::default);
    let tasks = records
        .par_chunks_mut(GROUPS * LANES)
        .zip(cloud.values.par_chunks(GROUPS * cloud.planes))
        .zip(cloud.boxes.par_chunks(GROUPS / LANES * bounds::PLANES))
        .zip(found.par_iter_mut())
        .with_max_len(1);
    tasks.enumerate().for_each(|(task, (((records, values), boxes), found))| {
        found.entries.clear();
        found.tiles.clear();
        let mut task =
            Task { projection, first: task * GROUPS * LANES, count: cloud.count, planes: cloud.planes, found };
        at_level!(level, simd => task.run(simd, records, values, boxes));
    });
    let found: Vec<_> = found.iter().map(|found| (&found.entries[..], &found.tiles[..])).collect();
    bins.gather(&found);
}

struct Task<'a> {
    projection: &'a Projection<'a>,
    /// Of the task's Gaussians.
    first: usize,
    /// Of the cloud.
    count: usize,
    planes: usize,
    found: &'a mut Found,
}

impl Task<'_> {
    #[inline(always)]
    fn run<S: Carried>(&mut self, simd: S, records: &mut [Line], values: &[Line], boxes: &[Line]) {
        simd.carry();
        let Projection { camera, layout, cut, .. } = *self.projection;
        let lens = Lens::<Wide<S>>::new(camera);
        let sight = Sight::new(layout, &lens, camera.near, cut);
        let near = Wide::<S>::from_f64(camera.near);
        let mut seen = 0;
        for (group, (records, values)) in
            records.chunks_exact_mut(LANES).zip(values.chunks_exact(self.planes)).enumerate()
        {
            if group % LANES == 0 {
                seen = sight.seen(&boxes[group / LANES * bounds::PLANES..][..bounds::PLANES]);
            }
            if seen >> (group % LANES) & 1 == 0 {
                continue;
            }
            let (mut fields, mut depths, mut tiles) = ([Line::ZERO; 16], Line::ZERO, Boxes::NONE);
            for at in (0..LANES).step_by(Wide::<S>::LEN) {
                let depth = ellipse_fields(&lens, values, at, &mut fields);
                depth.store(&mut depths, at);
                tiles.set::<S>(layout, &fields, at, cut, near.less(depth));
            }
            let touching = self.bin(self.first + group * LANES, &fields, &depths, &tiles);
            if touching != 0 {
                for at in (0..LANES).step_by(Wide::<S>::LEN) {
                    feature_fields(&lens, values, at, self.projection, &mut fields);
                }
                for (lane, record) in records.iter_mut().enumerate().filter(|(lane, _)| touching >> lane & 1 != 0) {
                    for (to, from) in record.0.iter_mut().zip(&fields) {
                        *to = from.0[lane];
                    }
                }
            }
        }
    }

    /// Finds the tiles of each Gaussian of a group; one bit for each that touches any.
    #[inline(always)]
    fn bin(&mut self, first: usize, fields: &[Line; 16], depths: &Line, boxes: &Boxes) -> u16 {
        let Projection { layout, cut, .. } = *self.projection;
        let mut touching = 0;
        for lane in 0..LANES.min(self.count - first) {
            let start = self.found.tiles.len();
            boxes.touched(layout, fields, lane, cut, &mut self.found.tiles);
            let count = self.found.tiles.len() - start;
            if count > 0 {
                self.found.entries.push(Entry {
                    gaussian: (first + lane) as u32,
                    depth: depths.0[lane].to_bits(),
                    first: start as u32,
                    count: count as u32,
                    thickness: fields[place::THICKNESS].0[lane],
                });
                touching |= 1 << lane;
            }
        }
        touching
    }
}

/// Centre and exponent of the lanes from `at` on; returns their depth.
#[inline(always)]
fn ellipse_fields<S: Carried>(lens: &Lens<Wide<S>>, values: &[Line], at: usize, fields: &mut [Line; 16]) -> Wide<S> {
    let ellipses = Ellipses::new(lens, Lanes { values, at });
    let [u, v] = projection::screen(lens, ellipses.point);
    let [a, b, c] = ellipses.conic;
    let log2_e = Wide::from_f64(std::f64::consts::LOG2_E);
    let half = Wide::from_f64(-0.5 * std::f64::consts::LOG2_E);
    let [x, y, z] = ellipses.scales;
    x.min(y).min(z).store(&mut fields[place::THICKNESS], at);
    let (xx, xy, yy) = (a * half, -b * log2_e, c * half);
    for (k, value) in [u, v, xx, xy, yy, ellipses.opacity.log2()].into_iter().enumerate() {
        value.store(&mut fields[k], at);
    }
    let half_xy = Wide::from_f64(-0.5) * xy;
    (half_xy / yy).store(&mut fields[place::SLOPE_Y], at);
    (half_xy / xx).store(&mut fields[place::SLOPE_X], at);
    ellipses.point[2]
}

/// R G B as seen along a direction.
#[inline(always)]
fn color<S: Carried, const DEGREE: u8>(lanes: Lanes<'_>, direction: Vec3<Wide<S>>) -> Vec3<Wide<S>> {
    harmonics::color(&coefficients(DEGREE, lanes), direction, DEGREE)
}

/// Colours, and where asked normals and distances, of the lanes from `at` on.
#[inline(always)]
fn feature_fields<S: Carried>(
    lens: &Lens<Wide<S>>,
    values: &[Line],
    at: usize,
    projection: &Projection<'_>,
    fields: &mut [Line; 16],
) {
    let lanes = Lanes { values, at };
    let mean: Vec3<Wide<S>> = lanes.three(plane::MEAN);
    if projection.color {
        let (direction, _) = harmonics::direction(mean, lens.eye);
        let rgb = at_degree!(projection.sh_degree, color::<S>(lanes, direction));
        for k in 0..3 {
            rgb[k].store(&mut fields[place::FEATURES + k], at);
        }
    }
    if projection.planes {
        let (unit, _) = activation::unit_quaternion(lanes.quaternion());
        let rotation = covariance::rotation(unit);
        let scales = activation::scales(lanes.three(plane::LOG_SCALE));
        let axis = normal_axis(&rotation, scales, sub(lens.eye, mean));
        let facing = mat_vec(&lens.rotation, normal(&rotation, axis));
        for k in 0..3 {
            facing[k].store(&mut fields[place::FEATURES + 3 + k], at);
        }
        distance(facing, projection::to_camera(lens, mean)).store(&mut fields[place::FEATURES + 6], at);
    }
}
