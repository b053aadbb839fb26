//! The cost of a plane: bilaterally weighted NCC between a patch and its image under the plane's homography.

use fearless_simd::{Level, Simd, f32x4, prelude::*, u32x4};
use pgsag_scene::Map;

use super::{StereoOptions, StereoView, dot};
use crate::lanes::at_level;

/// Samples that are worked together.
const LANES: usize = 4;
/// At most 11 x 11 samples, in whole vectors.
const MAX_SAMPLES: usize = 124;

/// The reference patch of one pixel: offsets, weights and weighted, centred values; made once per pixel and half-step.
pub(super) struct Patch {
    /// In whole vectors: what fills the last one weighs nothing.
    count: usize,
    across: [f32; MAX_SAMPLES],
    down: [f32; MAX_SAMPLES],
    weight: [f32; MAX_SAMPLES],
    /// weight · (value − mean)
    centered: [f32; MAX_SAMPLES],
    variance: f32,
    /// Farthest offset along an axis, pixels.
    reach: f32,
}

/// Variance of luma below which a patch says nothing (an 8-bit step is 0.004).
const MIN_VARIANCE: f32 = 1.5e-5;

impl Patch {
    pub(super) fn new(gray: &Map<f32>, index: usize, options: &StereoOptions) -> Self {
        let (width, height) = (gray.width as i32, gray.height as i32);
        let (x, y) = (index as i32 % width, index as i32 / width);
        let radius = options.patch_radius.min(5) as i32;
        let step = options.patch_step_px.max(1) as i32;
        let center = gray.values[index];
        let mut patch = Self {
            count: 0,
            across: [0.0; MAX_SAMPLES],
            down: [0.0; MAX_SAMPLES],
            weight: [0.0; MAX_SAMPLES],
            centered: [0.0; MAX_SAMPLES],
            variance: 0.0,
            reach: (radius * step) as f32,
        };
        let (mut total, mut mean) = (0.0, 0.0);
        for (dy, dx) in (-radius..=radius).flat_map(|dy| (-radius..=radius).map(move |dx| (dy * step, dx * step))) {
            let (u, v) = (x + dx, y + dy);
            if u < 0 || v < 0 || u >= width || v >= height {
                continue;
            }
            let value = gray.values[(v * width + u) as usize];
            // A rational bell instead of an exponential: as good a weight, and the same on every machine.
            let ratio = (value - center) / options.color_sigma;
            let weight = 1.0 / (1.0 + ratio * ratio);
            (patch.across[patch.count], patch.down[patch.count]) = (dx as f32, dy as f32);
            patch.weight[patch.count] = weight;
            patch.centered[patch.count] = value;
            patch.count += 1;
            total += weight;
            mean += weight * value;
        }
        mean /= total;
        for k in 0..patch.count {
            let weight = patch.weight[k] / total;
            let value = patch.centered[k] - mean;
            patch.weight[k] = weight;
            patch.centered[k] = weight * value;
            patch.variance += weight * value * value;
        }
        patch.count = patch.count.next_multiple_of(LANES);
        patch
    }
}

/// A grey image in which bilinear interpolation is one load: per pixel p, and its slopes across, down and both.
#[derive(Debug)]
pub(super) struct Bilinear {
    size: [f32; 2],
    cells: Vec<[f32; LANES]>,
}

impl Bilinear {
    pub(super) fn new(gray: &Map<f32>) -> Self {
        let (width, height) = (gray.width as usize, gray.height as usize);
        let at = |x: usize, y: usize| gray.values[y.min(height - 1) * width + x.min(width - 1)];
        let cell = |i: usize| {
            let (x, y) = (i % width, i / width);
            let (p, right, below) = (at(x, y), at(x + 1, y), at(x, y + 1));
            [p, right - p, below - p, at(x + 1, y + 1) - right - below + p]
        };
        Self { size: [width as f32, height as f32], cells: (0..width * height).map(cell).collect() }
    }
}

/// What carries a reference pixel into one neighbour.
pub(super) struct Matcher<'a> {
    level: Level,
    image: &'a Bilinear,
    /// K_n · R · K_r⁻¹ and K_n · t, row-major, in f32.
    rotation: [[f32; 3]; 3],
    translation: [f32; 3],
    /// K_r⁻¹ as (1/fx, 1/fy, −cx/fx, −cy/fy).
    inverse: [f32; 4],
}

impl<'a> Matcher<'a> {
    pub(super) fn new(level: Level, reference: &StereoView, neighbor: &StereoView, image: &'a Bilinear) -> Self {
        let neighbor_from_reference = neighbor.camera_from_world * reference.camera_from_world.inverse();
        let k = glam::DMat3::from_cols(
            glam::DVec3::new(neighbor.camera.fx, 0.0, 0.0),
            glam::DVec3::new(0.0, neighbor.camera.fy, 0.0),
            glam::DVec3::new(neighbor.camera.cx, neighbor.camera.cy, 1.0),
        );
        let camera = &reference.camera;
        let rotation = (k * neighbor_from_reference.rotation_matrix()).transpose();
        Self {
            level,
            image,
            rotation: [rotation.x_axis, rotation.y_axis, rotation.z_axis].map(|row| row.as_vec3().to_array()),
            translation: (k * neighbor_from_reference.translation).as_vec3().to_array(),
            inverse: [
                (1.0 / camera.fx) as f32,
                (1.0 / camera.fy) as f32,
                (-camera.cx / camera.fx) as f32,
                (-camera.cy / camera.fy) as f32,
            ],
        }
    }

    /// 1 − NCC in `[0, 2]`; 2 where the patch leaves the neighbour or is flat.
    ///
    /// The plane n · X = −d carries the ray r to K_n (R r − t (n · r) / d); over a patch that map is replaced by its
    /// first-order expansion about the centre.
    pub(super) fn cost(&self, patch: &Patch, center: [f32; 2], ray: [f32; 3], depth: f32, normal: [f32; 3]) -> f32 {
        const WORST: f32 = 2.0;
        if patch.variance < MIN_VARIANCE {
            return WORST;
        }
        let distance = -depth * dot(normal, ray);
        if distance <= 0.0 {
            return WORST;
        }
        let Some((at, jacobian)) = self.linear_map(center, normal, distance) else { return WORST };
        let span =
            patch.reach * (jacobian[0][0].abs() + jacobian[0][1].abs() + jacobian[1][0].abs() + jacobian[1][1].abs());
        let [width, height] = self.image.size;
        let inside = at[0] > span && at[1] > span && at[0] < width - span && at[1] < height - span;
        if !inside && !self.box_fits(patch.reach, at, jacobian) {
            return WORST;
        }
        self.correlate(patch, at, jacobian)
    }

    /// Where the centre lands (relative to pixel centres) and how offsets map; `None` behind the neighbour.
    fn linear_map(&self, center: [f32; 2], normal: [f32; 3], distance: f32) -> Option<([f32; 2], [[f32; 2]; 2])> {
        let k = normal.map(|n| n / distance);
        let column =
            |c: usize| -> [f32; 3] { std::array::from_fn(|row| self.rotation[row][c] - self.translation[row] * k[c]) };
        let (a, b, c) = (column(0), column(1), column(2));
        let [ifx, ify, icx, icy] = self.inverse;
        let (rx, ry) = (center[0] * ifx + icx, center[1] * ify + icy);
        let h: [f32; 3] = std::array::from_fn(|row| a[row] * rx + b[row] * ry + c[row]);
        if h[2] <= 1e-6 {
            return None;
        }
        let (u, v) = (h[0] / h[2], h[1] / h[2]);
        let jacobian = [
            [(a[0] - u * a[2]) * ifx / h[2], (b[0] - u * b[2]) * ify / h[2]],
            [(a[1] - v * a[2]) * ifx / h[2], (b[1] - v * b[2]) * ify / h[2]],
        ];
        Some(([u - 0.5, v - 0.5], jacobian))
    }

    fn box_fits(&self, reach: f32, at: [f32; 2], jacobian: [[f32; 2]; 2]) -> bool {
        let half: [f32; 2] = std::array::from_fn(|i| reach * (jacobian[i][0].abs() + jacobian[i][1].abs()));
        let limit = self.image.size.map(|side| side - 1.0);
        (0..2).all(|i| at[i] - half[i] >= 0.0 && at[i] + half[i] < limit[i])
    }

    fn correlate(&self, patch: &Patch, at: [f32; 2], jacobian: [[f32; 2]; 2]) -> f32 {
        let [mean, square, cross] = at_level!(self.level, simd => self.moments(simd, patch, at, jacobian));
        let variance = square - mean * mean;
        if variance < MIN_VARIANCE {
            return 2.0;
        }
        1.0 - cross / (variance * patch.variance).sqrt()
    }

    /// Weighted mean and mean square of the patch's image, and its product with the reference patch.
    #[inline(always)]
    fn moments<S: Simd>(&self, simd: S, patch: &Patch, at: [f32; 2], jacobian: [[f32; 2]; 2]) -> [f32; 3] {
        let vector = |value: f32| f32x4::splat(simd, value);
        let (zero, width) = (vector(0.0), u32x4::splat(simd, self.image.size[0] as u32));
        let [[xx, xy], [yx, yy]] = jacobian.map(|row| row.map(vector));
        let (x, y) = (vector(at[0]), vector(at[1]));
        let last = self.image.cells.len() - 1;
        let [mut mean, mut square, mut cross] = [zero; 3];
        for start in (0..patch.count).step_by(LANES) {
            let load = |of: &[f32; MAX_SAMPLES]| f32x4::from_slice(simd, &of[start..start + LANES]);
            let (across, down) = (load(&patch.across), load(&patch.down));
            let u = xx.mul_add(across, xy.mul_add(down, x)).max(zero);
            let v = yx.mul_add(across, yy.mul_add(down, y)).max(zero);
            let (left, top) = (u.trunc(), v.trunc());
            let (fu, fv) = (u - left, v - top);
            let mut index = [0; LANES];
            (width * top.to_int::<u32x4<S>>() + left.to_int::<u32x4<S>>()).store_slice(&mut index);
            let cell = |lane: usize| f32x4::from_slice(simd, &self.image.cells[(index[lane] as usize).min(last)]);
            let (a, b) = cell(0).interleave(cell(2));
            let (c, d) = cell(1).interleave(cell(3));
            let ((p, right), (below, both)) = (a.interleave(c), b.interleave(d));
            let value = fv.mul_add(fu.mul_add(both, below), fu.mul_add(right, p));
            let weighted = load(&patch.weight) * value;
            mean += weighted;
            square = weighted.mul_add(value, square);
            cross = load(&patch.centered).mul_add(value, cross);
        }
        [simd.reduce_sum_f32x4(mean), simd.reduce_sum_f32x4(square), simd.reduce_sum_f32x4(cross)]
    }
}
