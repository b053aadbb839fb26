//! L_mvrgb: what the plane under a pixel shows looks the same to a neighbour. PGSR, section 3.3.
//!
//! A 7 x 7 patch of grey about a reference pixel is carried to the neighbour by the homography of the blended plane at
//! its centre, and compared by squared normalised cross-correlation. The gradient goes to N and D of the centre alone.

use pgsag_scene::numbers::SplitMix64;
use rayon::prelude::*;

use super::geometric::{Between, bilinear};
use super::view::{LossView, PATCH_HALF};
use crate::equations::Scalar;
use crate::equations::algebra::{Vec3, add, dot, each, mat_vec, scale, sub};
use crate::equations::number::{Kernel, Pixels};
use crate::equations::projection::{Lens, screen, screen_grad};

/// Pixels along a side of a patch.
const SIDE: usize = 2 * PATCH_HALF + 1;
/// Samples of a patch.
const SAMPLES: usize = SIDE * SIDE;
/// Samples as kernels hold them: eight rows of eight, of which the last row and column are empty.
const PADDED: usize = 64;
/// Mean squared deviation of grey below which a patch is flat and says nothing: (a hundredth of full scale)².
const FLAT: f64 = 1e-4;
/// Loss beyond which a patch does not show the same thing. PGSR.
const KEEP_BELOW: f64 = 0.9;
/// Added to the product of variances. PGSR.
const EPSILON: f64 = 1e-8;
/// Pixels a thread asks at a time, at least.
const PIXELS_AT_ONCE: usize = 8192;
/// Patches a thread takes at a time.
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
    let patches: Vec<Patch<T>> =
        centers.par_chunks(PATCHES_AT_ONCE).flat_map_iter(|centers| T::widest(Compare { inputs, centers })).collect();
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
    let pixels = (0..inputs.weights.len()).into_par_iter().with_min_len(PIXELS_AT_ONCE);
    let all: Vec<u32> = pixels.filter(|&index| fits(index)).map(|index| index as u32).collect();
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

/// Some patches.
struct Compare<'a, T> {
    inputs: &'a NccInputs<'a, T>,
    centers: &'a [u32],
}

impl<T: Scalar> Kernel<T> for Compare<'_, T> {
    type Output = Vec<Patch<T>>;

    #[inline(always)]
    fn run<P: Pixels<T>>(self) -> Vec<Patch<T>> {
        let warp = Warp::<T, P>::new(self.inputs);
        let mut kept = Vec::with_capacity(self.centers.len());
        for &index in self.centers {
            kept.extend(warp.patch(index as usize));
        }
        kept
    }
}

/// The homographies between two views.
struct Warp<'a, T, P> {
    inputs: &'a NccInputs<'a, T>,
    own: Lens<T>,
    other: Lens<P>,
    /// For single patches, and for their samples.
    between: (Between<T>, Between<P>),
    /// Column and row of each sample, and whether there is one (1 or 0).
    across: [T; PADDED],
    down: [T; PADDED],
    filled: [T; PADDED],
}

/// Where the samples of a patch fell in the neighbour, and what they read there.
struct Samples<T> {
    grey: [T; PADDED],
    slope: [[T; PADDED]; 2],
    point: [[T; PADDED]; 3],
}

impl<'a, T: Scalar, P: Pixels<T>> Warp<'a, T, P> {
    #[inline(always)]
    fn new(inputs: &'a NccInputs<'a, T>) -> Self {
        let (mut across, mut down, mut filled) = ([T::zero(); PADDED], [T::zero(); PADDED], [T::zero(); PADDED]);
        for i in 0..PADDED {
            across[i] = T::from_f64((i % 8) as f64);
            down[i] = T::from_f64((i / 8) as f64);
            filled[i] = if i % 8 < SIDE && i / 8 < SIDE { T::one() } else { T::zero() };
        }
        Self {
            inputs,
            own: Lens::new(&inputs.view.camera),
            other: Lens::new(&inputs.neighbor.camera),
            between: (Between::new(inputs.view, inputs.neighbor), Between::new(inputs.view, inputs.neighbor)),
            across,
            down,
            filled,
        }
    }

    #[inline(always)]
    fn normal(&self, index: usize) -> Vec3<T> {
        each(|k| self.inputs.normal[k][index])
    }

    /// The ray of a patch's first pixel, three rows and columns before the centre.
    #[inline(always)]
    fn first_ray(&self, index: usize) -> Vec3<T> {
        let (x, y) = (index % self.inputs.view.width - PATCH_HALF, index / self.inputs.view.width - PATCH_HALF);
        self.own.ray(T::from_f64(x as f64), T::from_f64(y as f64))
    }

    /// Reads the patch in the reference, less its mean.
    #[inline(always)]
    fn own(&self, index: usize) -> [T; PADDED] {
        let view = self.inputs.view;
        let first = index - PATCH_HALF * (view.width + 1);
        let mut own = [T::zero(); PADDED];
        for row in 0..SIDE {
            let grey = &view.gray[first + row * view.width..][..SIDE];
            for column in 0..SIDE {
                own[row * 8 + column] = T::from_f32(grey[column]);
            }
        }
        self.center(&mut own);
        own
    }

    /// Reads it in the neighbour; `None` where it leaves the mask there or turns away. The homography is linear in the
    /// pixel, so that one column or row on is one constant step:
    ///     y = A r − b (N · r) / D
    #[inline(always)]
    fn samples(&self, index: usize) -> Option<Samples<T>> {
        let (normal, inverse) = (self.normal(index), T::one() / self.inputs.distance[index]);
        let carried = |ray: Vec3<T>| {
            let k = dot(normal, ray) * inverse;
            sub(mat_vec(&self.between.0.rotation, ray), scale(self.between.0.translation, k))
        };
        let (zero, one) = (T::zero(), T::one());
        let start = carried(self.first_ray(index));
        let column = carried([one / self.own.focal[0], zero, zero]);
        let row = carried([zero, one / self.own.focal[1], zero]);
        let wide = |v: Vec3<T>| -> Vec3<P> { each(|k| P::from_f64(v[k].to_f64())) };
        let (start, column, row) = (wide(start), wide(column), wide(row));
        let mut samples = Samples { grey: [zero; PADDED], slope: [[zero; PADDED]; 2], point: [[zero; PADDED]; 3] };
        let half = P::from_f64(0.5);
        for at in (0..PADDED).step_by(P::LEN) {
            let (across, down) = (P::load(&self.across[at..]), P::load(&self.down[at..]));
            let filled = P::zero().less(P::load(&self.filled[at..]));
            let mut point: Vec3<P> = each(|k| down.times_plus(row[k], across.times_plus(column[k], start[k])));
            let ahead = P::select(filled, point[2], P::one());
            if P::any(ahead.less(P::from_f64(1e-6))) {
                return None;
            }
            point[2] = ahead;
            let [u, v] = screen(&self.other, point);
            let (value, slope) = self.read(at, P::select(filled, u, half) - half, P::select(filled, v, half) - half)?;
            value.store(&mut samples.grey[at..]);
            for k in 0..2 {
                slope[k].store(&mut samples.slope[k][at..]);
            }
            for k in 0..3 {
                point[k].store(&mut samples.point[k][at..]);
            }
        }
        self.center(&mut samples.grey);
        Some(samples)
    }

    /// Grey of the neighbour and its slope at pixel centres' coordinates, of the samples from `at` on; `None` where one of
    /// them is off its mask.
    #[inline(always)]
    fn read(&self, at: usize, x: P, y: P) -> Option<(P, [P; 2])> {
        let view = self.inputs.neighbor;
        let (right, bottom) = (P::from_f64((view.width - 1) as f64), P::from_f64((view.height - 1) as f64));
        let least = x.min(y).min(right - x).min(bottom - y);
        if P::any(least.less(P::zero())) {
            return None;
        }
        let ((left, columns), (top, rows)) = (x.whole(), y.whole());
        let mut corners = [[T::zero(); 16]; 4];
        let mut fits = true;
        for lane in 0..P::LEN {
            if (at + lane) % 8 == SIDE || (at + lane) / 8 == SIDE {
                continue;
            }
            let tap = rows[lane] as usize * view.width + columns[lane] as usize;
            fits &= view.quad_fits.get(tap).is_some_and(|&fits| fits);
            let window = view.gray.get(tap..tap + view.width + 2)?;
            for (corner, place) in corners.iter_mut().zip([0, 1, view.width, view.width + 1]) {
                corner[lane] = T::from_f32(window[place]);
            }
        }
        let corners = each(|k| P::load(&corners[k][..P::LEN]));
        fits.then(|| bilinear(corners, [x - left, y - top]))
    }

    #[inline(always)]
    fn patch(&self, index: usize) -> Option<Patch<T>> {
        if self.inputs.distance[index] <= T::zero() {
            return None;
        }
        let flat = T::from_f64(FLAT * SAMPLES as f64);
        let reference = self.own(index);
        let own = product::<T, P>(&reference, &reference);
        if own < flat {
            return None;
        }
        let samples = self.samples(index)?;
        let other = product::<T, P>(&samples.grey, &samples.grey);
        let cross = product::<T, P>(&reference, &samples.grey);
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
    fn differentiate(&self, index: usize, own: &[T; PADDED], samples: &Samples<T>, pull: [T; 2]) -> Vec3<T> {
        // Moments of s over the patch: rays are linear in column and row.
        let mut moments = [P::zero(); 3];
        let pull: [P; 2] = each(|k| P::from_f64(pull[k].to_f64()));
        for at in (0..PADDED).step_by(P::LEN) {
            let d_grey = pull[0] * P::load(&own[at..]) + pull[1] * P::load(&samples.grey[at..]);
            let d_screen = each(|k| P::load(&samples.slope[k][at..]) * d_grey);
            let point = each(|k| P::load(&samples.point[k][at..]));
            let along = -dot(screen_grad(&self.other, point, d_screen), self.between.1.translation);
            moments[0] += along;
            moments[1] += along * P::load(&self.across[at..]);
            moments[2] += along * P::load(&self.down[at..]);
        }
        let moments: [T; 3] = each(|k| T::from_f64(moments[k].total()));
        let first = scale(self.first_ray(index), moments[0]);
        let steps = [moments[1] / self.own.focal[0], moments[2] / self.own.focal[1], T::zero()];
        scale(add(first, steps), T::one() / self.inputs.distance[index])
    }

    /// Takes the mean off the samples; where there is none, 0 remains.
    #[inline(always)]
    fn center(&self, values: &mut [T; PADDED]) {
        let mut sum = P::zero();
        for at in (0..PADDED).step_by(P::LEN) {
            sum += P::load(&values[at..]) * P::load(&self.filled[at..]);
        }
        let mean = P::from_f64(sum.total() / SAMPLES as f64);
        for at in (0..PADDED).step_by(P::LEN) {
            ((P::load(&values[at..]) - mean) * P::load(&self.filled[at..])).store(&mut values[at..]);
        }
    }
}

#[inline(always)]
fn product<T: Scalar, P: Pixels<T>>(a: &[T; PADDED], b: &[T; PADDED]) -> T {
    let mut sum = P::zero();
    for at in (0..PADDED).step_by(P::LEN) {
        sum += P::load(&a[at..]) * P::load(&b[at..]);
    }
    T::from_f64(sum.total())
}

#[cfg(test)]
mod tests;
