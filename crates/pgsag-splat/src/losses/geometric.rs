//! L_mvgeo: the depth of a neighbour agrees. PGSR, section 3.3; there "multi-view geometric consistency".
//!
//! A reference pixel is lifted by its depth, seen by the neighbour, lifted again by the neighbour's depth there and seen
//! by the reference: it should come back to where it started. The gradient flows into both depth maps.

use rayon::prelude::*;

use super::view::LossView;
use crate::equations::algebra::{Mat3, Vec3, add, dot, each, mat_mul, mat_vec, scale, sub, transpose, transpose_vec};
use crate::equations::number::{Kernel, Pixels};
use crate::equations::projection::{Lens, screen, screen_grad};
use crate::equations::{Number, Scalar};

/// Error below which the distance turns into a parabola (Huber), pixels: less than depth maps resolve.
const SOFTENING_PX: f64 = 1e-2;
/// Rows that a thread takes at a time, at least.
const ROWS_AT_ONCE: usize = 8;
/// Most pixels of a vector.
const LANES: usize = 16;

/// neighbor_from_reference: X = A P + b, camera frames.
#[derive(Clone, Copy, Debug)]
pub struct Between<T> {
    /// A = W_n W_rᵀ.
    pub rotation: Mat3<T>,
    /// b = t_n − A t_r, scene units.
    pub translation: Vec3<T>,
}

impl<T: Number> Between<T> {
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
#[derive(Clone, Copy, Debug, Default)]
pub struct Geometric {
    /// Mean over valid pixels of w φ, pixels; 0 of none.
    pub value: f64,
    /// Pixels that pass the gate.
    pub valid_count: usize,
}

/// What one pixel gives to the neighbour's depths.
#[derive(Clone, Copy, Debug)]
struct Link<T> {
    /// Upper left of the four depths that were read.
    tap: u32,
    /// Where between them.
    fraction: [T; 2],
    d_neighbor: T,
}

/// L_mvgeo, with its gradients times `d_loss` written to the reference's `d_depth` and added to the neighbour's; neither
/// where `d_loss` is 0.
///     φ = ‖π_r(Aᵀ(z m − b)) − p‖,   m = X / X_z,   z = depth_n(π_n(X)),   X = A depth_r r + b
///     L = 1/|V| Σ_V w φ,   w = e^{−φ / gate}, detached,   V: φ < gate, in both masks, all depths there
/// With a gate of one pixel w is PGSR's; a wider gate widens w with it, so that far pixels still pull.
/// `weights` `[H * W]` receives w of the reference's pixels, 0 where invalid; NCC draws from these.
pub fn geometric<T: Scalar>(
    reference: DepthView<'_, T>,
    neighbor: DepthView<'_, T>,
    gate_px: f64,
    d_loss: f64,
    weights: &mut [T],
    d_depth: [&mut [T]; 2],
) -> Geometric {
    let width = reference.view.width.max(1);
    let [d_reference, d_neighbor] = d_depth;
    let mut slopes: Vec<&mut [T]> = if d_loss == 0.0 { Vec::new() } else { d_reference.chunks_mut(width).collect() };
    slopes.resize_with(reference.view.height, Default::default);
    let rows: Vec<(f64, usize, Vec<Link<T>>)> = weights
        .par_chunks_mut(width)
        .zip(slopes.par_iter_mut())
        .with_min_len(ROWS_AT_ONCE)
        .enumerate()
        .map(|(y, (weights, d_depth))| T::widest(Trip { reference, neighbor, gate_px, y, weights, d_depth }))
        .collect();
    let valid_count = rows.iter().map(|row| row.1).sum::<usize>();
    let share = 1.0 / valid_count.max(1) as f64;
    if d_loss != 0.0 {
        let factor = T::from_f64(d_loss * share);
        slopes.par_iter_mut().with_min_len(ROWS_AT_ONCE).enumerate().for_each(|(y, row)| {
            row[reference.view.reach(y)].iter_mut().for_each(|d| *d = *d * factor);
        });
        scatter(&rows, factor, d_neighbor, neighbor.view.width);
    }
    Geometric { value: rows.iter().map(|row| row.0).sum::<f64>() * share, valid_count }
}

/// Adds what the links give to the neighbour's depths. Each thread takes a band of rows and looks at all links, so that
/// every pixel's sum has one order, whatever the number of threads.
fn scatter<T: Scalar>(rows: &[(f64, usize, Vec<Link<T>>)], factor: T, d_neighbor: &mut [T], width: usize) {
    let band = (d_neighbor.len() / width.max(1)).div_ceil(rayon::current_num_threads()).max(1) * width.max(1);
    d_neighbor.par_chunks_mut(band).enumerate().for_each(|(index, out)| {
        let start = index * band;
        for link in rows.iter().flat_map(|row| &row.2) {
            // Wraps where the pixel lies before the band, and is past its end then.
            let above = (link.tap as usize).wrapping_sub(start);
            let below = above.wrapping_add(width);
            let shares = bilinear_shares(link.fraction);
            let d = factor * link.d_neighbor;
            for (at, shares) in [(above, [shares[0], shares[1]]), (below, [shares[2], shares[3]])] {
                if at < out.len() {
                    out[at] += d * shares[0];
                    out[at + 1] += d * shares[1];
                }
            }
        }
    });
}

/// Weights of upper left, upper right, lower left, lower right.
#[inline(always)]
fn bilinear_shares<T: Scalar>([fx, fy]: [T; 2]) -> [T; 4] {
    let (gx, gy) = (T::one() - fx, T::one() - fy);
    [gx * gy, fx * gy, gx * fy, fx * fy]
}

/// Interpolated value and its slope along x and y. `corners`: upper left, upper right, lower left, lower right.
#[inline(always)]
pub(super) fn bilinear<T: Number>(corners: [T; 4], fraction: [T; 2]) -> (T, [T; 2]) {
    let [a, b, c, d] = corners;
    let [fx, fy] = fraction;
    let (top, bottom) = (a + fx * (b - a), c + fx * (d - c));
    (top + fy * (bottom - top), [(b - a) + fy * ((d - c) - (b - a)), bottom - top])
}

/// There and back, of the pixels of one row.
struct Trip<'a, T> {
    reference: DepthView<'a, T>,
    neighbor: DepthView<'a, T>,
    gate_px: f64,
    y: usize,
    weights: &'a mut [T],
    /// Empty where no gradient is asked for.
    d_depth: &'a mut [T],
}

/// The lenses of both views and the way between them.
struct Pair<P> {
    lenses: [Lens<P>; 2],
    between: Between<P>,
    gate_px: P,
    nears: [P; 2],
}

impl<P: Number> Pair<P> {
    #[inline(always)]
    fn new(reference: &LossView, neighbor: &LossView, gate_px: f64) -> Self {
        Self {
            lenses: [Lens::new(&reference.camera), Lens::new(&neighbor.camera)],
            between: Between::new(reference, neighbor),
            gate_px: P::from_f64(gate_px),
            nears: [P::from_f64(reference.camera.near), P::from_f64(neighbor.camera.near)],
        }
    }
}

/// What was read in the neighbour.
struct Reading<T, P> {
    corners: [P; 4],
    fraction: [P; 2],
    taps: [u32; LANES],
    fractions: [[T; LANES]; 2],
    /// 1, or 0 where nothing could be read.
    found: P,
}

/// A vector's worth of trips, with unnormalised gradients.
struct Links<P: Number> {
    counts: P::Truth,
    weight: P,
    error: P,
    d_depth: P,
    d_neighbor: P,
}

impl<T: Scalar> Kernel<T> for Trip<'_, T> {
    /// Σ w φ, valid pixels, and what they give to the neighbour where gradients are asked for.
    type Output = (f64, usize, Vec<Link<T>>);

    #[inline(always)]
    fn run<P: Pixels<T>>(self) -> Self::Output {
        let view = self.reference.view;
        let pair = Pair::<P>::new(view, self.neighbor.view, self.gate_px);
        let span = view.spans[self.y].clone();
        let (mut sum, mut count) = (P::zero(), P::zero());
        let mut links = Vec::with_capacity(if self.d_depth.is_empty() { 0 } else { span.len() });
        self.weights[view.reach(self.y)].fill(T::zero());
        if !self.d_depth.is_empty() {
            self.d_depth[view.reach(self.y)].fill(T::zero());
        }
        for x in span.clone().step_by(P::LEN) {
            let row = self.y * view.width;
            let active = P::from_bytes(bytemuck::cast_slice(&view.active[row + x..row + span.end]));
            let depth = active * P::load(&self.reference.depth[row + x..row + span.end]);
            let pixel = [P::count_from(x), P::from_f64(self.y as f64)];
            let ray = pair.lenses[0].ray(pixel[0], pixel[1]);
            let there = add(mat_vec(&pair.between.rotation, scale(ray, depth)), pair.between.translation);
            let Some(read) = read(&self.neighbor, &pair, there, depth) else { continue };
            let found = trip(&pair, pixel, ray, there, &read);
            if !P::any(found.counts) {
                continue;
            }
            let kept = |value: P| P::select(found.counts, value, P::zero());
            let weight = kept(found.weight);
            weight.store(&mut self.weights[x..span.end]);
            sum += weight * kept(found.error);
            count += kept(P::one());
            if !self.d_depth.is_empty() {
                kept(found.d_depth).store(&mut self.d_depth[x..span.end]);
                let (mut kept, mut d) = ([T::zero(); LANES], [T::zero(); LANES]);
                weight.store(&mut kept[..P::LEN]);
                found.d_neighbor.store(&mut d[..P::LEN]);
                for lane in (0..P::LEN).filter(|&lane| kept[lane] > T::zero()) {
                    let fraction = [read.fractions[0][lane], read.fractions[1][lane]];
                    links.push(Link { tap: read.taps[lane], fraction, d_neighbor: d[lane] });
                }
            }
        }
        (sum.total(), count.total() as usize, links)
    }
}

/// Reads the neighbour's depths about the points `there`, of pixels with a depth; `None` where no pixel finds any.
#[inline(always)]
fn read<T: Scalar, P: Pixels<T>>(
    neighbor: &DepthView<'_, T>,
    pair: &Pair<P>,
    there: Vec3<P>,
    depth: P,
) -> Option<Reading<T, P>> {
    let (zero, one, half) = (P::zero(), P::one(), P::from_f64(0.5));
    let view = neighbor.view;
    let goes = zero.less(depth) & pair.nears[1].less(there[2]);
    let forward = P::select(goes, there[2], one);
    let [u, v] = screen(&pair.lenses[1], [there[0], there[1], forward]);
    let (x, y) = (u - half, v - half);
    // Between four pixel centres; not a number is nowhere.
    let last = |pixels: usize| P::from_f64(pixels as f64 - 1.0);
    let beside = P::from_f64(-1e-37);
    let goes = goes & beside.less(x) & beside.less(y) & x.less(last(view.width)) & y.less(last(view.height));
    if !P::any(goes) {
        return None;
    }
    let ((left, columns), (top, rows)) = (x.whole(), y.whole());
    let mut lanes = [[T::zero(); LANES]; 3];
    for (value, lanes) in [P::select(goes, one, zero), x - left, y - top].into_iter().zip(&mut lanes) {
        value.store(&mut lanes[..P::LEN]);
    }
    let [goes, fractions @ ..] = lanes;
    let mut corners = [[T::zero(); LANES]; 4];
    let (mut taps, mut found) = ([0; LANES], [T::zero(); LANES]);
    let mut any = false;
    for lane in (0..P::LEN).filter(|&lane| goes[lane] > T::zero()) {
        let tap = rows[lane] as usize * view.width + columns[lane] as usize;
        if !view.quad_fits[tap] {
            continue;
        }
        let (above, below) = (&neighbor.depth[tap..tap + 2], &neighbor.depth[tap + view.width..][..2]);
        let four = [above[0], above[1], below[0], below[1]];
        if four.iter().all(|&depth| depth > T::zero()) {
            for k in 0..4 {
                corners[k][lane] = four[k];
            }
            taps[lane] = tap as u32;
            found[lane] = T::one();
            any = true;
        }
    }
    any.then(|| Reading {
        corners: each(|k| P::load(&corners[k][..P::LEN])),
        fraction: each(|k| P::load(&fractions[k][..P::LEN])),
        taps,
        fractions,
        found: P::load(&found[..P::LEN]),
    })
}

/// The way back, and the gradients along the whole trip.
#[inline(always)]
fn trip<T: Scalar, P: Pixels<T>>(
    pair: &Pair<P>,
    pixel: [P; 2],
    ray: Vec3<P>,
    there: Vec3<P>,
    read: &Reading<T, P>,
) -> Links<P> {
    let [own, other] = &pair.lenses;
    let (zero, one, half) = (P::zero(), P::one(), P::from_f64(0.5));
    let reads = zero.less(read.found);
    let there = [there[0], there[1], P::select(reads, there[2], one)];
    let (found, slope) = bilinear(read.corners, read.fraction);
    let direction = scale(there, one / there[2]);
    let back = transpose_vec(&pair.between.rotation, sub(scale(direction, found), pair.between.translation));
    let returns = reads & pair.nears[0].less(back[2]);
    let back = [back[0], back[1], P::select(returns, back[2], one)];
    let end = screen(own, back);
    let miss: [P; 2] = each(|k| end[k] - (pixel[k] + half));
    let distance = (miss[0] * miss[0] + miss[1] * miss[1]).sqrt();
    let counts = returns & distance.less(pair.gate_px);
    let weight = (-distance.min(pair.gate_px) / pair.gate_px).exp();
    let (error, d_miss) = softened(miss, distance, weight);
    // Back along the trip: screen of the reference, the neighbour's depth, the screen of the neighbour.
    let d_end = mat_vec(&pair.between.rotation, screen_grad(own, back, d_miss));
    let d_neighbor = dot(d_end, direction);
    let d_direction = scale(d_end, found);
    let mut d_there = screen_grad(other, there, each(|k| slope[k] * d_neighbor));
    let along = d_direction[0] * direction[0] + d_direction[1] * direction[1];
    d_there = add(d_there, scale([d_direction[0], d_direction[1], -along], one / there[2]));
    let d_depth = dot(transpose_vec(&pair.between.rotation, d_there), ray);
    Links { counts, weight, error, d_depth, d_neighbor }
}

/// Huber's distance and its gradient times the weight.
#[inline(always)]
fn softened<P: Number>(miss: [P; 2], distance: P, weight: P) -> (P, [P; 2]) {
    let soft = P::from_f64(SOFTENING_PX);
    let half = P::from_f64(0.5);
    let error = P::select(distance.less(soft), half * distance * distance / soft, distance - half * soft);
    let slope = weight / distance.max(soft);
    (error, [miss[0] * slope, miss[1] * slope])
}

#[cfg(test)]
mod tests;
