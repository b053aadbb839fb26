//! L_mvrgb: what the plane under a pixel shows looks the same to a neighbour. PGSR, section 3.3.
//!
//! A 7 x 7 patch of grey about a reference pixel is carried to the neighbour by the homography of the blended plane at
//! its centre, and compared by squared normalised cross-correlation. The gradient goes to N and D of the centre alone.

use pgsag_scene::numbers::SplitMix64;
use rayon::prelude::*;

use super::geometric::{Between, bilinear, footing};
use super::view::{LossView, PATCH_HALF};
use crate::equations::Scalar;
use crate::equations::algebra::{Vec3, dot, mat_vec, scale, sub};
use crate::equations::projection::{Lens, screen, screen_grad};

/// Samples of a patch.
const SAMPLES: usize = (2 * PATCH_HALF + 1) * (2 * PATCH_HALF + 1);
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
    /// Blended N of the reference, camera frame, `[H * W]`.
    pub normal: &'a [Vec3<T>],
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
    d_normal: &mut [Vec3<T>],
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
            d_normal[patch.index][axis] += factor * patch.d_normal[axis];
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

/// Where the 49 samples fell in the neighbour, and what they read.
struct Samples<T> {
    grey: [T; SAMPLES],
    own: [T; SAMPLES],
    slope: [[T; 2]; SAMPLES],
    ray: [Vec3<T>; SAMPLES],
    point: [Vec3<T>; SAMPLES],
}

impl<'a, T: Scalar> Warp<'a, T> {
    fn new(inputs: &'a NccInputs<'a, T>) -> Self {
        let own = Lens::new(&inputs.view.camera);
        let other = Lens::new(&inputs.neighbor.camera);
        Self { inputs, own, other, between: Between::new(inputs.view, inputs.neighbor) }
    }

    /// Reads a patch in both views; `None` where it leaves the neighbour's mask or turns away.
    #[inline(always)]
    fn samples(&self, index: usize) -> Option<Samples<T>> {
        let (view, neighbor) = (self.inputs.view, self.inputs.neighbor);
        let inverse = T::one() / self.inputs.distance[index];
        let zero = T::zero();
        let mut samples = Samples {
            grey: [zero; SAMPLES],
            own: [zero; SAMPLES],
            slope: [[zero; 2]; SAMPLES],
            ray: [[zero; 3]; SAMPLES],
            point: [[zero; 3]; SAMPLES],
        };
        let side = 2 * PATCH_HALF + 1;
        for i in 0..SAMPLES {
            let at = index + (i / side) * view.width + i % side - PATCH_HALF * (view.width + 1);
            let ray = self.own.ray(T::from_f64((at % view.width) as f64), T::from_f64((at / view.width) as f64));
            // y = A r − b (N · r) / D: the plane's point on this ray, up to its depth.
            let k = dot(self.inputs.normal[index], ray) * inverse;
            let point = sub(mat_vec(&self.between.rotation, ray), scale(self.between.translation, k));
            if point[2] <= T::from_f64(1e-6) {
                return None;
            }
            let (tap, fraction) = footing(neighbor, screen(&self.other, point))?;
            let below = tap + neighbor.width;
            let corners = [tap, tap + 1, below, below + 1].map(|at| T::from_f32(neighbor.gray[at]));
            (samples.grey[i], samples.slope[i]) = bilinear(corners, fraction);
            samples.own[i] = T::from_f32(view.gray[at]);
            (samples.ray[i], samples.point[i]) = (ray, point);
        }
        Some(samples)
    }

    #[inline(always)]
    fn patch(&self, index: usize) -> Option<Patch<T>> {
        if self.inputs.distance[index] <= T::zero() {
            return None;
        }
        let mut samples = self.samples(index)?;
        center(&mut samples.own);
        center(&mut samples.grey);
        let [mut own, mut other, mut cross] = [T::zero(); 3];
        for i in 0..SAMPLES {
            own += samples.own[i] * samples.own[i];
            other += samples.grey[i] * samples.grey[i];
            cross += samples.own[i] * samples.grey[i];
        }
        let flat = T::from_f64(FLAT * SAMPLES as f64);
        if own < flat || other < flat || cross <= T::zero() {
            return None;
        }
        let product = own * other + T::from_f64(EPSILON);
        let loss = (T::one() - cross * cross / product).max(T::zero());
        if !loss.less(T::from_f64(KEEP_BELOW)) {
            return None;
        }
        let weight = self.inputs.weights[index];
        let two = T::from_f64(2.0);
        let pull = [-two * cross / product * weight, two * cross * cross * own / (product * product) * weight];
        Some(self.differentiate(index, &samples, pull, weight * loss))
    }

    /// ∂e/∂x_i = −(2 Σr̃x̃/P) r̃_i + (2 (Σr̃x̃)² Σr̃²/P²) x̃_i, through the bilinear slope and y to N and D:
    ///     s = −ĝy · b,   ĝN += s r / D,   ĝD −= s (N · r) / D²
    #[inline(always)]
    fn differentiate(&self, index: usize, samples: &Samples<T>, pull: [T; 2], loss: T) -> Patch<T> {
        let inverse = T::one() / self.inputs.distance[index];
        let mut d_normal = [T::zero(); 3];
        for i in 0..SAMPLES {
            let d_grey = pull[0] * samples.own[i] + pull[1] * samples.grey[i];
            let d_screen = samples.slope[i].map(|slope| slope * d_grey);
            let d_point = screen_grad(&self.other, samples.point[i], d_screen);
            let along = -dot(d_point, self.between.translation) * inverse;
            for axis in 0..3 {
                d_normal[axis] += along * samples.ray[i][axis];
            }
        }
        // N · Σ s r / D is the same sum that D needs.
        let d_distance = -dot(self.inputs.normal[index], d_normal) * inverse;
        Patch { index, loss, d_normal, d_distance }
    }
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
