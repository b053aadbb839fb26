//! L_ban (Eq. 8): the normal that is blended agrees with the normal of the depth map, less so at boundaries.
//!
//! The depth's normal comes from central differences, n_d = normalize((P_right − P_left) × (P_above − P_below)), which
//! faces the camera. It is multiplied by the opacity, detached, to compare with a blended normal that is not normalised.

use super::rows::{map_rows, sum_rows};
use super::view::LossView;
use crate::backend::{LossWeights, Reading};
use crate::equations::Scalar;
use crate::equations::algebra::{Vec3, cross, dot, normalized_grad, scale, sub};
use crate::equations::projection::Lens;

/// Difference of normals below which the absolute value turns into a parabola (Huber), so that rounding does not flip
/// the gradient of a perfect plane; 0.06 degrees.
const SOFTENING: f64 = 1e-3;
/// Cross product of differences below which there is no normal, relative to squared depth.
const DEGENERATE: f64 = 1e-12;

/// The maps that the term compares, `[H * W]`.
#[derive(Clone, Copy, Debug)]
pub struct NormalMaps<'a, T> {
    /// Blended normal N, camera frame.
    pub normal: &'a [Vec3<T>],
    /// Sum of blending weights.
    pub opacity: &'a [T],
    /// Unbiased depth, 0 where undefined.
    pub depth: &'a [T],
}

/// Normal of the depth map at one pixel with what its gradient needs.
struct Stencil<T> {
    across: Vec3<T>,
    upward: Vec3<T>,
    normal: Vec3<T>,
    length: T,
}

/// L_ban, with its gradients times `d_loss` added to `d_normal` and `d_depth`.
///     L = mean_i w_i ‖n_d α − N‖₁   (code)   or   mean_i w_i ‖n_d α − N‖²   (paper)
/// w is `normal_boundary` on boundary pixels and inner edges, 1 elsewhere, times (1 − g)² where asked. Pixels with an
/// inactive or empty pixel in the stencil do not count, but the mean runs over all active pixels (or the frame).
pub fn boundary_normal<T: Scalar>(
    view: &LossView,
    maps: NormalMaps<'_, T>,
    weights: &LossWeights,
    d_loss: f64,
    d_normal: &mut [Vec3<T>],
    d_depth: &mut [T],
) -> f64 {
    let lens = Lens::<T>::new(&view.camera);
    let share = 1.0 / view.mean_count(weights.mean_over_mask) as f64;
    // Gradients of the two differences, kept per pixel and gathered afterwards, so that rows stay independent.
    let mut d_sides = vec![[[T::zero(); 3]; 2]; view.width * view.height];
    let rows = map_rows(&mut d_sides, view.width, |y, d_sides| {
        let mut loss = 0.0;
        let mut d_row = Vec::new();
        for x in view.spans[y].clone() {
            let index = y * view.width + x;
            let Some(stencil) = stencil(view, &lens, maps.depth, x, y) else { continue };
            let weight = weight(view, weights, index);
            let opacity = maps.opacity[index];
            let (value, d_difference) = norm(sub(scale(stencil.normal, opacity), maps.normal[index]), weights.reading);
            loss += weight * share * value.to_f64();
            let d_difference = scale(d_difference, T::from_f64(weight * share * d_loss));
            d_row.push((index, d_difference));
            let d_cross = normalized_grad(stencil.normal, stencil.length, scale(d_difference, opacity));
            d_sides[x] = [cross(stencil.upward, d_cross), cross(d_cross, stencil.across)];
        }
        (loss, d_row)
    });
    let mut loss = 0.0;
    for (row, d_row) in rows {
        loss += row;
        d_row.into_iter().for_each(|(index, d)| d_normal[index] = sub(d_normal[index], d));
    }
    gather(view, &lens, &d_sides, d_depth);
    loss
}

/// Carries the gradients of the differences to the four depths each was made of.
fn gather<T: Scalar>(view: &LossView, lens: &Lens<T>, d_sides: &[[Vec3<T>; 2]], d_depth: &mut [T]) {
    let (width, height) = (view.width, view.height);
    sum_rows(d_depth, width, |y, d_depth| {
        for x in 0..width {
            let index = y * width + x;
            if !view.is_active(index) {
                continue;
            }
            let mut d_point = [T::zero(); 3];
            if x > 0 {
                d_point = add_if(d_point, d_sides[index - 1][0], T::one());
            }
            if x + 1 < width {
                d_point = add_if(d_point, d_sides[index + 1][0], -T::one());
            }
            if y + 1 < height {
                d_point = add_if(d_point, d_sides[index + width][1], T::one());
            }
            if y > 0 {
                d_point = add_if(d_point, d_sides[index - width][1], -T::one());
            }
            d_depth[x] += dot(d_point, ray(lens, x, y));
        }
        0.0
    });
}

#[inline(always)]
fn add_if<T: Scalar>(sum: Vec3<T>, value: Vec3<T>, sign: T) -> Vec3<T> {
    [sum[0] + sign * value[0], sum[1] + sign * value[1], sum[2] + sign * value[2]]
}

#[inline(always)]
fn ray<T: Scalar>(lens: &Lens<T>, x: usize, y: usize) -> Vec3<T> {
    lens.ray(T::from_f64(x as f64), T::from_f64(y as f64))
}

#[inline(always)]
fn stencil<T: Scalar>(view: &LossView, lens: &Lens<T>, depth: &[T], x: usize, y: usize) -> Option<Stencil<T>> {
    let index = y * view.width + x;
    if x == 0 || y == 0 || x + 1 >= view.width || y + 1 >= view.height || !view.is_active(index) {
        return None;
    }
    let point = |index: usize, x: usize, y: usize| {
        let usable = view.is_active(index) && depth[index] > T::zero();
        usable.then(|| scale(ray(lens, x, y), depth[index]))
    };
    if depth[index] <= T::zero() {
        return None;
    }
    let across = sub(point(index + 1, x + 1, y)?, point(index - 1, x - 1, y)?);
    let upward = sub(point(index - view.width, x, y - 1)?, point(index + view.width, x, y + 1)?);
    let normal = cross(across, upward);
    let length = dot(normal, normal).sqrt();
    (length > T::from_f64(DEGENERATE) * depth[index] * depth[index]).then(|| Stencil {
        across,
        upward,
        normal: scale(normal, T::one() / length),
        length,
    })
}

fn weight(view: &LossView, weights: &LossWeights, index: usize) -> f64 {
    let boundary = if view.edge[index] { f64::from(weights.normal_boundary) } else { 1.0 };
    let smooth = 1.0 - f64::from(view.gradient.normalized(index));
    if weights.normal_image_gradient { boundary * smooth * smooth } else { boundary }
}

/// The norm of a difference and its gradient: softened L1, or squared L2.
#[inline(always)]
fn norm<T: Scalar>(difference: Vec3<T>, reading: Reading) -> (T, Vec3<T>) {
    match reading {
        Reading::Paper => (dot(difference, difference), difference.map(|value| value + value)),
        Reading::Code => {
            let soft = T::from_f64(SOFTENING);
            let half = T::from_f64(0.5);
            let part = difference.map(|value| {
                let size = value.abs();
                T::select(size.less(soft), half * value * value / soft, size - half * soft)
            });
            let slope = difference.map(|value| (value / soft).clamp(-T::one(), T::one()));
            (part[0] + part[1] + part[2], slope)
        }
    }
}

#[cfg(test)]
mod tests;
