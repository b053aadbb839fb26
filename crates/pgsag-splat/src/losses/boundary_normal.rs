//! L_ban (Eq. 8): the normal that is blended agrees with the normal of the depth map, less so at boundaries.
//!
//! The depth's normal comes from central differences, n_d = normalize((P_right − P_left) × (P_above − P_below)), which
//! faces the camera. It is multiplied by the opacity, detached, to compare with a blended normal that is not normalised.
//! Bands of rows run in parallel; within a band the gradients of the differences pass through a ring of three rows.

use rayon::prelude::*;

use super::spare::Spare;
use super::total::{clear_rows, ray};
use super::view::LossView;
use crate::backend::{LossWeights, Reading};
use crate::equations::algebra::{Vec3, cross, dot, each, normalized_grad, scale, sub};
use crate::equations::number::{Kernel, Pixels};
use crate::equations::projection::Lens;
use crate::equations::{Number, Scalar};

/// Difference of normals below which the absolute value turns into a parabola (Huber), so that rounding does not flip
/// the gradient of a perfect plane; 0.06 degrees.
const SOFTENING: f64 = 1e-3;
/// Cross product of differences below which there is no normal, relative to squared depth.
const DEGENERATE: f64 = 1e-12;
/// Rows of a band.
const BAND: usize = 32;

/// The maps that the term compares, `[H * W]` each.
#[derive(Clone, Copy, Debug)]
pub struct NormalMaps<'a, T> {
    /// Blended normal N, camera frame: x, y, z.
    pub normal: [&'a [T]; 3],
    /// Sum of blending weights.
    pub opacity: &'a [T],
    /// Unbiased depth, 0 where undefined and at inactive pixels.
    pub depth: &'a [T],
}

/// Where gradients go, `[H * W]` each.
#[derive(Debug)]
pub struct NormalGradients<'a, T> {
    /// Of the blended normal.
    pub normal: [&'a mut [T]; 3],
    /// Of the depth.
    pub depth: &'a mut [T],
    /// Of the blended distance; for `carry` alone.
    pub distance: &'a mut [T],
}

/// L_ban. Its gradients times `d_loss` are written for the normal and added for the depth; then `carry(y, d_depth, d_normal,
/// d_distance)` is called for every row y, while it is at hand.
///     L = mean_i w_i ‖n_d α − N‖₁   (code)   or   mean_i w_i ‖n_d α − N‖²   (paper)
/// w is `normal_boundary` on boundary pixels and inner edges, 1 elsewhere, times (1 − g)² where asked. Pixels with an
/// inactive or empty pixel in the stencil do not count, but the mean runs over all active pixels (or the frame). `rooms` is
/// memory to work in.
pub fn boundary_normal<T: Scalar>(
    view: &LossView,
    maps: NormalMaps<'_, T>,
    weights: &LossWeights,
    d_loss: f64,
    gradients: NormalGradients<'_, T>,
    carry: impl Fn(usize, &[T], [&mut [T]; 3], &mut [T]) + Sync,
    rooms: &Spare<Vec<T>>,
) -> f64 {
    let share = 1.0 / view.mean_count(weights.mean_over_mask) as f64;
    let width = view.width.max(1);
    let [x, y, z] = gradients.normal.map(|map| map.chunks_mut(BAND * width));
    let depths = gradients.depth.chunks_mut(BAND * width).zip(gradients.distance.chunks_mut(BAND * width));
    let bands: Vec<_> = x.zip(y).zip(z).zip(depths).enumerate().collect();
    let sums: Vec<f64> = bands
        .into_par_iter()
        .with_max_len(1)
        .map(|(band, (((x, y), z), (d_depth, d_distance)))| {
            let (d_scale, first) = (share * d_loss, band * BAND);
            let d_normal = [&mut *x, &mut *y, &mut *z];
            let d_band = &mut *d_depth;
            let sum = rooms.lend(|sides| {
                T::widest(Band { view, maps, weights, d_scale, first, d_normal, d_depth: d_band, sides })
            });
            let rows = x.chunks_mut(width).zip(y.chunks_mut(width)).zip(z.chunks_mut(width));
            let depths = d_depth.chunks(width).zip(d_distance.chunks_mut(width));
            for (row, (((x, y), z), (d_depth, d_distance))) in rows.zip(depths).enumerate() {
                carry(first + row, d_depth, [x, y, z], d_distance);
            }
            sum
        })
        .collect();
    sums.into_iter().sum::<f64>() * share
}

/// A band of rows.
struct Band<'a, T> {
    view: &'a LossView,
    maps: NormalMaps<'a, T>,
    weights: &'a LossWeights,
    /// Gradient of the sum.
    d_scale: f64,
    /// First row.
    first: usize,
    d_normal: [&'a mut [T]; 3],
    d_depth: &'a mut [T],
    /// Ring of three rows by six planes: gradients of the two differences.
    sides: &'a mut Vec<T>,
}

/// Columns beside a row of the ring, zero, so that neighbours can be read at the border.
const MARGIN: usize = 16;

impl<T: Scalar> Kernel<T> for Band<'_, T> {
    type Output = f64;

    #[inline(always)]
    fn run<P: Pixels<T>>(mut self) -> f64 {
        for map in &mut self.d_normal {
            clear_rows(self.view, self.first, map);
        }
        let stride = self.view.width.next_multiple_of(MARGIN) + 2 * MARGIN;
        self.sides.clear();
        self.sides.resize(3 * 6 * stride, T::zero());
        let lens = Lens::<P>::new(&self.view.camera);
        let rows = self.d_depth.len() / self.view.width;
        let mut loss = 0.0;
        // Ring rows: image row `first + turn - 1` is at `turn % 3`.
        for turn in 0..rows + 2 {
            let own = (1..=rows).contains(&turn);
            let row = self.first + turn;
            if row > 0 && row <= self.view.height {
                let sum = self.differentiate::<P>(&lens, row - 1, own, (turn % 3) * 6 * stride, stride);
                loss += if own { sum } else { 0.0 };
            } else {
                self.sides[(turn % 3) * 6 * stride..][..6 * stride].fill(T::zero());
            }
            if turn >= 2 {
                self.gather::<P>(&lens, turn, stride);
            }
        }
        loss
    }
}

/// Normal of the depth map with what its gradient needs.
struct Stencil<P: Number> {
    across: Vec3<P>,
    upward: Vec3<P>,
    normal: Vec3<P>,
    length: P,
    /// Whether there is one.
    counts: P::Truth,
}

impl<T: Scalar> Band<'_, T> {
    /// Compares one row: the gradients of its differences go to the ring at `ring`, those of its normals, where the row
    /// is the band's own, to `d_normal`. Returns the row's sum.
    #[inline(always)]
    fn differentiate<P: Pixels<T>>(&mut self, lens: &Lens<P>, y: usize, own: bool, ring: usize, stride: usize) -> f64 {
        let (view, width) = (self.view, self.view.width);
        let sides = &mut self.sides[ring..][..6 * stride];
        sides.fill(T::zero());
        let span = view.spans[y].start.max(1)..view.spans[y].end.min(width - 1);
        if span.is_empty() || y == 0 || y + 1 >= view.height {
            return 0.0;
        }
        let d_scale = P::from_f64(self.d_scale);
        let mut loss = P::zero();
        for x in span.clone().step_by(P::LEN) {
            let index = y * width + x;
            let stencil = stencil(view, self.maps.depth, lens, x, y);
            if !P::any(stencil.counts) {
                continue;
            }
            let zero = P::zero();
            // Lanes past the span do not count.
            let weight = weight::<T, P>(view, self.weights, index, y * width + span.end);
            let weight = P::select(stencil.counts, weight, zero);
            let opacity = P::load(&self.maps.opacity[index..]);
            let normal: Vec3<P> = each(|k| P::load(&self.maps.normal[k][index..]));
            let (value, d) = norm(sub(scale(stencil.normal, opacity), normal), self.weights.reading);
            loss += weight * value;
            let d_difference = scale(d, weight * d_scale);
            let d_cross = normalized_grad(stencil.normal, stencil.length, scale(d_difference, opacity));
            let d_sides = [cross(stencil.upward, d_cross), cross(d_cross, stencil.across)];
            for side in 0..2 {
                for k in 0..3 {
                    d_sides[side][k].store(&mut sides[(3 * side + k) * stride + MARGIN + x..][..P::LEN]);
                }
            }
            if own {
                let at = index - self.first * width;
                for k in 0..3 {
                    (-d_difference[k]).store(&mut self.d_normal[k][at..(y - self.first) * width + span.end]);
                }
            }
        }
        loss.total()
    }

    /// Carries the gradients of the differences to the four depths each was made of, for the row in the middle of the
    /// ring whose newest row was written at `turn`.
    #[inline(always)]
    fn gather<P: Pixels<T>>(&mut self, lens: &Lens<P>, turn: usize, stride: usize) {
        let row = turn - 2;
        let (y, width) = (self.first + row, self.view.width);
        let [above, middle, below] =
            [turn + 1, turn + 2, turn].map(|turn| &self.sides[turn % 3 * 6 * stride..][..6 * stride]);
        let span = self.view.spans[y].clone();
        for x in span.clone().step_by(P::LEN) {
            let (rows, x_wide) = ([above, middle, below], MARGIN + x);
            let d_point: Vec3<P> = [
                gathered(rows, 0, stride, x_wide),
                gathered(rows, 1, stride, x_wide),
                gathered(rows, 2, stride, x_wide),
            ];
            let out = &mut self.d_depth[row * width..][x..span.end];
            (P::load(out) + dot(d_point, ray(lens, x, y))).store(out);
        }
    }
}

/// One coordinate of the gradient of the point at `x` of the middle row of three: what its four neighbours' differences
/// leave to it.
#[inline(always)]
fn gathered<T: Scalar, P: Pixels<T>>([above, middle, below]: [&[T]; 3], k: usize, stride: usize, x: usize) -> P {
    let at = |sides: &[T], at: usize| P::load(&sides[at..][..P::LEN]);
    let across = at(middle, k * stride + x - 1) - at(middle, k * stride + x + 1);
    across + (at(below, (3 + k) * stride + x) - at(above, (3 + k) * stride + x))
}

#[inline(always)]
fn stencil<T: Scalar, P: Pixels<T>>(view: &LossView, depth: &[T], lens: &Lens<P>, x: usize, y: usize) -> Stencil<P> {
    let (index, width) = (y * view.width + x, view.width);
    let zero = P::zero();
    let read = |index: usize| P::load(&depth[index..]);
    let (middle, left, right) = (read(index), read(index - 1), read(index + 1));
    let (above, below) = (read(index - width), read(index + width));
    // Depth is 0 at inactive pixels.
    let least = middle.min(left).min(right).min(above).min(below);
    let point = |depth: P, ray: Vec3<P>| scale(ray, depth);
    let across = sub(point(right, ray(lens, x + 1, y)), point(left, ray(lens, x - 1, y)));
    let upward = sub(point(above, ray(lens, x, y - 1)), point(below, ray(lens, x, y + 1)));
    let normal = cross(across, upward);
    let length = dot(normal, normal).sqrt();
    let counts = zero.less(least) & (P::from_f64(DEGENERATE) * middle * middle).less(length);
    let length = P::select(counts, length, P::one());
    Stencil { across, upward, normal: scale(normal, P::one() / length), length, counts }
}

/// w from `index` on, 0 from `end` on.
#[inline(always)]
fn weight<T: Scalar, P: Pixels<T>>(view: &LossView, weights: &LossWeights, index: usize, end: usize) -> P {
    let one = P::one();
    let active = P::from_bytes(bytemuck::cast_slice(&view.active[index..end]));
    let edge = P::from_bytes(bytemuck::cast_slice(&view.edge[index..end]));
    let boundary = one - edge * P::from_f64(1.0 - f64::from(weights.normal_boundary));
    if !weights.normal_image_gradient {
        return active * boundary;
    }
    let gradient = &view.gradient;
    let printed = P::from_singles(&gradient.printed[index..end]);
    let smooth = one - (printed * P::from_f64(1.0 / f64::from(gradient.full))).min(one);
    active * boundary * smooth * smooth
}

/// The norm of a difference and its gradient: softened L1, or squared L2.
#[inline(always)]
fn norm<P: Number>(difference: Vec3<P>, reading: Reading) -> (P, Vec3<P>) {
    match reading {
        Reading::Paper => (dot(difference, difference), each(|k| difference[k] + difference[k])),
        Reading::Code => {
            let (soft, hard) = (P::from_f64(SOFTENING), P::from_f64(1.0 / SOFTENING));
            let half = P::from_f64(0.5);
            let part: Vec3<P> = each(|k| {
                let size = difference[k].abs();
                P::select(size.less(soft), half * size * size * hard, size - half * soft)
            });
            let slope = each(|k| (difference[k] * hard).clamp(-P::one(), P::one()));
            (part[0] + part[1] + part[2], slope)
        }
    }
}

#[cfg(test)]
mod tests;
