//! L_mvrgb: what the plane under a pixel shows looks the same to a neighbour. PGSR, section 3.3.
//!
//! A 7 x 7 patch of grey about a reference pixel is carried to the neighbour by the homography of the blended plane at
//! its centre, and compared by squared normalised cross-correlation. The gradient goes to N and D of the centre alone.

use pgsag_scene::numbers::SplitMix64;
use rayon::prelude::*;

use super::geometric::{Between, bilinear, footing};
use super::view::{LossView, PATCH_HALF};
use crate::equations::Scalar;
use crate::equations::algebra::{Vec3, add, dot, mat_vec, scale, sub};
use crate::equations::projection::{Lens, screen, screen_grad};

/// Pixels along a side of a patch.
const SIDE: usize = 2 * PATCH_HALF + 1;
/// Samples of a patch.
const SAMPLES: usize = SIDE * SIDE;
/// Mean squared deviation of grey below which a patch is flat and says nothing: (a hundredth of full scale)².
const FLAT: f64 = 1e-4;
/// Loss beyond which a patch does not show the same thing. PGSR.
const KEEP_BELOW: f64 = 0.9;
/// Added to the product of variances. PGSR.
const EPSILON: f64 = 1e-8;
/// Patches a thread takes at a time, at least.
const PATCHES_AT_ONCE: usize = 64;

/// What the term looks at.
#[derive(Clone, Copy, Debug)]
pub struct NccInputs<'a, T> {
    /// The reference view.
    pub view: &'a LossView,
    /// The neighbour.
    pub neighbor: &'a LossView,
    /// Blended N of the reference, camera frame: x, y, z, `[H * W]` each.
    pub normal: [&'a [T]; 3],
    /// Blended D of the reference, scene units, `[H * W]`.
    pub distance: &'a [T],
    /// Weights of the geometric term, `[H * W]`; patches are centred where they are positive.
    pub weights: &'a [T],
    /// At most so many patches.
    pub patch_limit: usize,
    /// Decides which.
    pub seed: u64,
}

/// One compared patch.
#[derive(Clone, Copy)]
struct Patch<T> {
    index: usize,
    loss: T,
    d_normal: Vec3<T>,
    d_distance: T,
}

/// L_mvrgb and the patches kept, with its gradients times `d_loss` added to `d_normal` and `d_distance`.
///     e = 1 − (Σ r̃ x̃)² / (Σ r̃² Σ x̃² + ε),   L = mean over kept patches of w e,   w detached
/// r̃, x̃: grey less its mean. A patch counts where it lies in both masks, is not flat, correlates positively (the square
/// is blind to inverted contrast) and has e < 0.9.
pub fn ncc<T: Scalar>(
    inputs: &NccInputs<'_, T>,
    d_loss: f64,
    d_normal: [&mut [T]; 3],
    d_distance: &mut [T],
) -> (f64, usize) {
    let centers = draw(inputs);
    let warp = Warp::new(inputs);
    let patches: Vec<Patch<T>> =
        centers.into_par_iter().with_min_len(PATCHES_AT_ONCE).filter_map(|index| warp.patch(index as usize)).collect();
    let share = 1.0 / patches.len().max(1) as f64;
    let factor = T::from_f64(d_loss * share);
    let mut sum = 0.0;
    for patch in &patches {
        sum += patch.loss.to_f64();
        for axis in 0..3 {
            d_normal[axis][patch.index] += factor * patch.d_normal[axis];
        }
        d_distance[patch.index] += factor * patch.d_distance;
    }
    (sum * share, patches.len())
}

/// Pixels whose patch lies in the mask: all of them, or one from each of `patch_limit` equal runs.
fn draw<T: Scalar>(inputs: &NccInputs<'_, T>) -> Vec<u32> {
    let fits = |index: usize| inputs.weights[index] > T::zero() && inputs.view.patch_fits[index];
    let all: Vec<u32> = (0..inputs.weights.len()).filter(|&index| fits(index)).map(|index| index as u32).collect();
    let (count, limit) = (all.len(), inputs.patch_limit);
    if count <= limit {
        return all;
    }
    let mut random = SplitMix64::new(inputs.seed);
    (0..limit)
        .map(|run| {
            let (start, end) = (run * count / limit, (run + 1) * count / limit);
            all[start + random.below(end - start)]
        })
        .collect()
}

/// The homographies between two views.
struct Warp<'a, T> {
    inputs: &'a NccInputs<'a, T>,
    own: Lens<T>,
    other: Lens<T>,
    between: Between<T>,
}

/// Where the 49 samples fell in the neighbour, and what they read there.
struct Samples<T> {
    grey: [T; SAMPLES],
    slope: [[T; 2]; SAMPLES],
    point: [Vec3<T>; SAMPLES],
}

impl<'a, T: Scalar> Warp<'a, T> {
    fn new(inputs: &'a NccInputs<'a, T>) -> Self {
        let own = Lens::new(&inputs.view.camera);
        let other = Lens::new(&inputs.neighbor.camera);
        Self { inputs, own, other, between: Between::new(inputs.view, inputs.neighbor) }
    }

    #[inline(always)]
    fn normal(&self, index: usize) -> Vec3<T> {
        self.inputs.normal.map(|map| map[index])
    }

    /// The ray of a patch's first pixel, three rows and columns before the centre.
    #[inline(always)]
    fn first_ray(&self, index: usize) -> Vec3<T> {
        let (x, y) = (index % self.inputs.view.width - PATCH_HALF, index / self.inputs.view.width - PATCH_HALF);
        self.own.ray(T::from_f64(x as f64), T::from_f64(y as f64))
    }

    /// Reads the patch in the reference, less its mean.
    #[inline(always)]
    fn own(&self, index: usize) -> [T; SAMPLES] {
        let view = self.inputs.view;
        let first = index - PATCH_HALF * (view.width + 1);
        let mut own = [T::zero(); SAMPLES];
        for (row, own) in own.chunks_exact_mut(SIDE).enumerate() {
            let grey = &view.gray[first + row * view.width..][..SIDE];
            own.iter_mut().zip(grey).for_each(|(own, &grey)| *own = T::from_f32(grey));
        }
        center(&mut own);
        own
    }

    /// Reads it in the neighbour; `None` where it leaves the mask there or turns away. The homography is linear in the
    /// pixel, so that one column or row on is one constant step:
    ///     y = A r − b (N · r) / D
    #[inline(always)]
    fn samples(&self, index: usize) -> Option<Samples<T>> {
        let neighbor = self.inputs.neighbor;
        let (normal, inverse) = (self.normal(index), T::one() / self.inputs.distance[index]);
        let carried = |ray: Vec3<T>| {
            let k = dot(normal, ray) * inverse;
            sub(mat_vec(&self.between.rotation, ray), scale(self.between.translation, k))
        };
        let zero = T::zero();
        let start = carried(self.first_ray(index));
        let column = carried([T::one() / self.own.focal[0], zero, zero]);
        let row = carried([zero, T::one() / self.own.focal[1], zero]);
        let mut samples = Samples { grey: [zero; SAMPLES], slope: [[zero; 2]; SAMPLES], point: [[zero; 3]; SAMPLES] };
        for i in 0..SAMPLES {
            let (across, down) = (T::from_f64((i % SIDE) as f64), T::from_f64((i / SIDE) as f64));
            let point = std::array::from_fn(|axis| start[axis] + across * column[axis] + down * row[axis]);
            if point[2] <= T::from_f64(1e-6) {
                return None;
            }
            let (tap, fraction) = footing(neighbor, screen(&self.other, point))?;
            let below = tap + neighbor.width;
            let corners = [tap, tap + 1, below, below + 1].map(|at| T::from_f32(neighbor.gray[at]));
            (samples.grey[i], samples.slope[i]) = bilinear(corners, fraction);
            samples.point[i] = point;
        }
        center(&mut samples.grey);
        Some(samples)
    }

    #[inline(always)]
    fn patch(&self, index: usize) -> Option<Patch<T>> {
        if self.inputs.distance[index] <= T::zero() {
            return None;
        }
        let flat = T::from_f64(FLAT * SAMPLES as f64);
        let reference = self.own(index);
        let own = product(&reference, &reference);
        if own < flat {
            return None;
        }
        let samples = self.samples(index)?;
        let other = product(&samples.grey, &samples.grey);
        let cross = product(&reference, &samples.grey);
        if other < flat || cross <= T::zero() {
            return None;
        }
        let both = own * other + T::from_f64(EPSILON);
        let loss = (T::one() - cross * cross / both).max(T::zero());
        if !loss.less(T::from_f64(KEEP_BELOW)) {
            return None;
        }
        let weight = self.inputs.weights[index];
        let two = T::from_f64(2.0);
        let pull = [-two * cross / both * weight, two * cross * cross * own / (both * both) * weight];
        let d_normal = self.differentiate(index, &reference, &samples, pull);
        // N · ĝN is the sum that D needs: ĝD = −Σ s (N · r) / D².
        let d_distance = -dot(self.normal(index), d_normal) / self.inputs.distance[index];
        Some(Patch { index, loss: weight * loss, d_normal, d_distance })
    }

    /// ∂e/∂x_i = −(2 Σr̃x̃/P) r̃_i + (2 (Σr̃x̃)² Σr̃²/P²) x̃_i, through the bilinear slope and y to N:
    ///     s = −ĝy · b,   ĝN = Σ s r / D
    #[inline(always)]
    fn differentiate(&self, index: usize, own: &[T; SAMPLES], samples: &Samples<T>, pull: [T; 2]) -> Vec3<T> {
        // Moments of s over the patch: rays are linear in column and row.
        let mut moments = [T::zero(); 3];
        for i in 0..SAMPLES {
            let d_grey = pull[0] * own[i] + pull[1] * samples.grey[i];
            let d_screen = samples.slope[i].map(|slope| slope * d_grey);
            let d_point = screen_grad(&self.other, samples.point[i], d_screen);
            let along = -dot(d_point, self.between.translation);
            moments[0] += along;
            moments[1] += along * T::from_f64((i % SIDE) as f64);
            moments[2] += along * T::from_f64((i / SIDE) as f64);
        }
        let first = scale(self.first_ray(index), moments[0]);
        let steps = [moments[1] / self.own.focal[0], moments[2] / self.own.focal[1], T::zero()];
        scale(add(first, steps), T::one() / self.inputs.distance[index])
    }
}

#[inline(always)]
fn product<T: Scalar>(a: &[T; SAMPLES], b: &[T; SAMPLES]) -> T {
    let mut sum = T::zero();
    for (a, b) in a.iter().zip(b) {
        sum += *a * *b;
    }
    sum
}

#[inline(always)]
fn center<T: Scalar>(values: &mut [T; SAMPLES]) {
    let mut sum = T::zero();
    for value in values.iter() {
        sum += *value;
    }
    let mean = sum / T::from_f64(SAMPLES as f64);
    for value in values.iter_mut() {
        *value -= mean;
    }
}

#[cfg(test)]
mod tests;
