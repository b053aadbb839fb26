//! L_mvgeo: the depth of a neighbour agrees. PGSR, section 3.3; there "multi-view geometric consistency".
//!
//! A reference pixel is lifted by its depth, seen by the neighbour, lifted again by the neighbour's depth there and seen
//! by the reference: it should come back to where it started. The gradient flows into both depth maps.

use rayon::prelude::*;

use super::view::LossView;
use crate::equations::Scalar;
use crate::equations::algebra::{Mat3, Vec3, add, mat_mul, mat_vec, scale, sub, transpose, transpose_vec};
use crate::equations::projection::{Lens, screen, screen_grad};

/// Error below which the distance turns into a parabola (Huber), pixels: less than depth maps resolve.
const SOFTENING_PX: f64 = 1e-2;
/// Pixels a thread takes at a time, at least.
const PIXELS_AT_ONCE: usize = 4096;

/// neighbor_from_reference: X = A P + b, camera frames.
#[derive(Clone, Copy, Debug)]
pub struct Between<T> {
    /// A = W_n W_rᵀ.
    pub rotation: Mat3<T>,
    /// b = t_n − A t_r, scene units.
    pub translation: Vec3<T>,
}

impl<T: Scalar> Between<T> {
    /// Between two prepared views; composed in f64.
    #[must_use]
    pub fn new(reference: &LossView, neighbor: &LossView) -> Self {
        let (r, n) = (&reference.camera, &neighbor.camera);
        let rotation = mat_mul(&n.rotation, &transpose(&r.rotation));
        let translation = sub(n.translation, mat_vec(&rotation, r.translation));
        Self { rotation: rotation.map(|row| row.map(T::from_f64)), translation: translation.map(T::from_f64) }
    }
}

/// A view with its depth map.
#[derive(Clone, Copy, Debug)]
pub struct DepthView<'a, T> {
    /// The view.
    pub view: &'a LossView,
    /// `[H * W]` unbiased depth, scene units, 0 where undefined.
    pub depth: &'a [T],
}

/// Outcome of the term.
#[derive(Clone, Debug)]
pub struct Geometric<T> {
    /// Mean over valid pixels of w φ, pixels; 0 of none.
    pub value: f64,
    /// Pixels that pass the gate.
    pub valid_count: usize,
    /// `[H * W]` w of the reference's pixels, 0 where invalid; NCC draws from these.
    pub weights: Vec<T>,
}

/// What one pixel found.
#[derive(Clone, Copy, Default)]
struct Link<T> {
    weight: T,
    error: T,
    d_depth: T,
    d_neighbor: T,
    /// Upper left of the four depths that were read, and where between them.
    tap: u32,
    fraction: [T; 2],
}

/// L_mvgeo, with its gradients times `d_loss` added to both `d_depth` (reference, neighbour); none where `d_loss` is 0.
///     φ = ‖π_r(Aᵀ(z m − b)) − p‖,   m = X / X_z,   z = depth_n(π_n(X)),   X = A depth_r r + b
///     L = 1/|V| Σ_V w φ,   w = e^{−φ / gate}, detached,   V: φ < gate, in both masks, all depths there
/// With a gate of one pixel w is PGSR's; a wider gate widens w with it, so that far pixels still pull.
pub fn geometric<T: Scalar>(
    reference: DepthView<'_, T>,
    neighbor: DepthView<'_, T>,
    gate_px: f64,
    d_loss: f64,
    d_depth: [&mut [T]; 2],
) -> Geometric<T> {
    let trip = Trip::new(reference, neighbor, gate_px);
    let links: Vec<Link<T>> = (0..reference.depth.len())
        .into_par_iter()
        .with_min_len(PIXELS_AT_ONCE)
        .map(|index| trip.link(index).unwrap_or_default())
        .collect();
    let (mut sum, mut valid_count) = (0.0, 0usize);
    for link in links.iter().filter(|link| link.weight > T::zero()) {
        sum += (link.weight * link.error).to_f64();
        valid_count += 1;
    }
    let share = 1.0 / valid_count.max(1) as f64;
    if d_loss != 0.0 {
        let [d_reference, d_neighbor] = d_depth;
        let factor = T::from_f64(d_loss * share);
        for (link, d_reference) in links.iter().zip(d_reference).filter(|(link, _)| link.weight > T::zero()) {
            *d_reference += factor * link.d_depth;
            let tap = link.tap as usize;
            let [row, next] = [tap, tap + neighbor.view.width];
            let shares = bilinear_shares(link.fraction);
            for (at, share) in [row, row + 1, next, next + 1].into_iter().zip(shares) {
                d_neighbor[at] += factor * link.d_neighbor * share;
            }
        }
    }
    Geometric { value: sum * share, valid_count, weights: links.into_iter().map(|link| link.weight).collect() }
}

/// Where a screen position falls between pixel centres: the upper left pixel and the fractions towards the right and
/// below; `None` where one of the four pixels is inactive or off the image.
#[inline(always)]
pub(super) fn footing<T: Scalar>(view: &LossView, at: [T; 2]) -> Option<(usize, [T; 2])> {
    let half = T::from_f64(0.5);
    let (x, y) = (at[0] - half, at[1] - half);
    // Not a number fails both comparisons.
    let inside = x >= T::zero() && y >= T::zero();
    let (column, row) = (x.to_f64() as usize, y.to_f64() as usize);
    if !inside || column + 1 >= view.width || row + 1 >= view.height {
        return None;
    }
    let tap = row * view.width + column;
    view.quad_fits[tap].then(|| (tap, [x - T::from_f64(column as f64), y - T::from_f64(row as f64)]))
}

/// Weights of upper left, upper right, lower left, lower right.
#[inline(always)]
fn bilinear_shares<T: Scalar>([fx, fy]: [T; 2]) -> [T; 4] {
    let (gx, gy) = (T::one() - fx, T::one() - fy);
    [gx * gy, fx * gy, gx * fy, fx * fy]
}

/// Interpolated value and its slope along x and y. `corners`: upper left, upper right, lower left, lower right.
#[inline(always)]
pub(super) fn bilinear<T: Scalar>(corners: [T; 4], fraction: [T; 2]) -> (T, [T; 2]) {
    let [a, b, c, d] = corners;
    let [fx, fy] = fraction;
    let (top, bottom) = (a + fx * (b - a), c + fx * (d - c));
    (top + fy * (bottom - top), [(b - a) + fy * ((d - c) - (b - a)), bottom - top])
}

/// There and back.
struct Trip<'a, T> {
    reference: DepthView<'a, T>,
    neighbor: DepthView<'a, T>,
    lenses: [Lens<T>; 2],
    between: Between<T>,
    gate_px: T,
}

impl<'a, T: Scalar> Trip<'a, T> {
    fn new(reference: DepthView<'a, T>, neighbor: DepthView<'a, T>, gate_px: f64) -> Self {
        let lenses = [Lens::new(&reference.view.camera), Lens::new(&neighbor.view.camera)];
        let between = Between::new(reference.view, neighbor.view);
        Self { reference, neighbor, lenses, between, gate_px: T::from_f64(gate_px) }
    }

    /// The trip of one pixel and its unnormalised gradients; `None` where it leads nowhere.
    #[inline(always)]
    fn link(&self, index: usize) -> Option<Link<T>> {
        let (view, depth) = (self.reference.view, self.reference.depth[index]);
        if depth <= T::zero() || !view.is_active(index) {
            return None;
        }
        let [own, other] = &self.lenses;
        let pixel = [T::from_f64((index % view.width) as f64), T::from_f64((index / view.width) as f64)];
        let ray = own.ray(pixel[0], pixel[1]);
        let there = add(mat_vec(&self.between.rotation, scale(ray, depth)), self.between.translation);
        if there[2] <= T::from_f64(self.neighbor.view.camera.near) {
            return None;
        }
        let (tap, fraction) = footing(self.neighbor.view, screen(other, there))?;
        let corners = self.corners(tap)?;
        let (found, slope) = bilinear(corners, fraction);
        let direction = scale(there, T::one() / there[2]);
        let back = transpose_vec(&self.between.rotation, sub(scale(direction, found), self.between.translation));
        if back[2] <= T::from_f64(view.camera.near) {
            return None;
        }
        let half = T::from_f64(0.5);
        let end = screen(own, back);
        let miss = [end[0] - (pixel[0] + half), end[1] - (pixel[1] + half)];
        let distance = (miss[0] * miss[0] + miss[1] * miss[1]).sqrt();
        if !distance.less(self.gate_px) {
            return None;
        }
        let weight = (-distance / self.gate_px).exp();
        let (error, d_miss) = softened(miss, distance, weight);
        // Back along the trip: screen of the reference, the neighbour's depth, the screen of the neighbour.
        let d_end = mat_vec(&self.between.rotation, screen_grad(own, back, d_miss));
        let d_found = d_end[0] * direction[0] + d_end[1] * direction[1] + d_end[2] * direction[2];
        let d_direction = scale(d_end, found);
        let mut d_there = screen_grad(other, there, slope.map(|value| value * d_found));
        let along = d_direction[0] * direction[0] + d_direction[1] * direction[1];
        d_there = add(d_there, scale([d_direction[0], d_direction[1], -along], T::one() / there[2]));
        let d_start = transpose_vec(&self.between.rotation, d_there);
        let d_depth = d_start[0] * ray[0] + d_start[1] * ray[1] + d_start[2] * ray[2];
        Some(Link { weight, error, d_depth, d_neighbor: d_found, tap: tap as u32, fraction })
    }

    /// The four depths; `None` where one is undefined.
    #[inline(always)]
    fn corners(&self, tap: usize) -> Option<[T; 4]> {
        let (depth, width) = (self.neighbor.depth, self.neighbor.view.width);
        let corners = [depth[tap], depth[tap + 1], depth[tap + width], depth[tap + width + 1]];
        corners.iter().all(|&depth| depth > T::zero()).then_some(corners)
    }
}

/// Huber's distance and its gradient times the weight.
#[inline(always)]
fn softened<T: Scalar>(miss: [T; 2], distance: T, weight: T) -> (T, [T; 2]) {
    let soft = T::from_f64(SOFTENING_PX);
    let half = T::from_f64(0.5);
    let error = T::select(distance.less(soft), half * distance * distance / soft, distance - half * soft);
    let slope = weight / distance.max(soft);
    (error, [miss[0] * slope, miss[1] * slope])
}

#[cfg(test)]
mod tests;
