//! L_rgb: what is drawn looks like the photograph. 0.8 L1 + 0.2 (1 − SSIM), 3DGS section 5; SSIM by Wang et al. 2004.
//!
//! Both images are black outside the mask and both terms see the exposed render. SSIM: Gaussian window of 11 pixels,
//! σ = 1.5, zero padding. Bands of rows of one channel run in parallel (windows are recomputed at the seams); within a
//! band rows stream through two rings of eleven, so that all stays in cache: four blurs forward and three back.

use std::ops::Range;

use rayon::prelude::*;

use super::total::clear_rows;
use super::view::LossView;
use crate::backend::Exposure;
use crate::equations::number::{Kernel, Pixels};
use crate::equations::{Number, Scalar};

/// Half the SSIM window, pixels.
const HALF: usize = 5;
/// Standard deviation of the SSIM window, pixels. Wang 2004.
const SIGMA_PX: f64 = 1.5;
/// (0.01)². Wang 2004.
const C1: f64 = 1e-4;
/// (0.03)². Wang 2004.
const C2: f64 = 9e-4;
/// Rows of scratch are as long as a multiple of this, which every width of vectors divides.
const LANES: usize = 16;
/// Rows of a band.
const BAND: usize = 96;
/// Rows of a window.
const TAPS: usize = 2 * HALF + 1;

/// How the term is weighed.
#[derive(Clone, Copy, Debug)]
pub struct PhotometricWeights {
    /// Factor of L1.
    pub l1: f64,
    /// Factor of 1 − SSIM; 0: it is not computed.
    pub dssim: f64,
    /// Average over active pixels; false: over the full frame.
    pub mean_over_mask: bool,
}

/// Values of the term and the gradient of the exposure.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Photometric {
    /// Mean absolute difference over pixels and channels.
    pub l1: f64,
    /// 1 − mean SSIM.
    pub dssim: f64,
    /// d weighted / d gain.
    pub d_gain: [f64; 3],
    /// d weighted / d bias.
    pub d_bias: [f64; 3],
}

/// The term; its gradient is written to `d_color` (of the render before exposure), 0 at inactive pixels.
///     x = m (gain · I + bias),   y = m I*,   L = l1 · mean |x − y| + dssim · (1 − mean SSIM(x, y))
/// `color` I and `d_color`: R, G, B, `[H * W]` each.
pub fn photometric<T: Scalar>(
    view: &LossView,
    color: [&[T]; 3],
    exposure: &Exposure,
    weights: &PhotometricWeights,
    d_color: [&mut [T]; 3],
) -> Photometric {
    let mut tasks = Vec::new();
    for (channel, out) in d_color.into_iter().enumerate() {
        let plane = Plane { view, color: color[channel], channel, exposure, weights };
        tasks.extend(out.chunks_mut((view.width * BAND).max(1)).enumerate().map(|(i, out)| (plane, i * BAND, out)));
    }
    let window = window();
    let sums: Vec<(usize, Sums)> = tasks
        .into_par_iter()
        .map_init(Scratch::default, |scratch, (plane, first, out)| {
            (plane.channel, T::widest(Band { plane, first, out, window, scratch }))
        })
        .collect();
    sums.into_iter().fold(Photometric::default(), |mut sum, (channel, band)| {
        sum.l1 += band.l1;
        sum.dssim += band.dssim;
        sum.d_gain[channel] += band.d_gain;
        sum.d_bias[channel] += band.d_bias;
        sum
    })
}

/// Centre and one side of the normalised Gaussian window.
fn window() -> [f64; HALF + 1] {
    let raw: [f64; HALF + 1] = std::array::from_fn(|i| libm::exp(-((i * i) as f64) / (2.0 * SIGMA_PX * SIGMA_PX)));
    let sum = raw[0] + 2.0 * raw[1..].iter().sum::<f64>();
    raw.map(|value| value / sum)
}

/// One channel of the two images.
#[derive(Clone, Copy)]
struct Plane<'a, T> {
    view: &'a LossView,
    color: &'a [T],
    channel: usize,
    exposure: &'a Exposure,
    weights: &'a PhotometricWeights,
}

impl<T: Scalar> Plane<'_, T> {
    /// The columns in which SSIM matters for the rows from `first`; empty where nothing does.
    fn columns(&self, first: usize, rows: usize) -> Range<usize> {
        let reach = first.saturating_sub(2 * HALF)..(first + rows + 2 * HALF).min(self.view.height);
        let spans = self.view.spans[reach].iter().filter(|span| !span.is_empty());
        let (start, end) = spans.fold((usize::MAX, 0), |(start, end), span| (start.min(span.start), end.max(span.end)));
        let beyond = if self.weights.mean_over_mask { 0 } else { HALF };
        if start < end { start.saturating_sub(beyond)..(end + beyond).min(self.view.width) } else { 0..0 }
    }

    /// 1 / (3 · pixels averaged over).
    fn share(&self) -> f64 {
        1.0 / (3.0 * self.view.mean_count(self.weights.mean_over_mask) as f64)
    }

    /// The exposed render x, the photograph y and whether a pixel is active (1, else 0 and both black), from `index` on,
    /// up to `end`.
    #[inline(always)]
    fn pair<P: Pixels<T>>(&self, index: usize, end: usize) -> [P; 3] {
        let gain = P::from_f64(f64::from(self.exposure.gain[self.channel]));
        let bias = P::from_f64(f64::from(self.exposure.bias[self.channel]));
        let active = P::from_bytes(bytemuck::cast_slice(&self.view.active[index..end]));
        let photo = P::from_bytes(&self.view.photo[self.channel][index..end]) * P::from_f64(1.0 / 255.0);
        let shown = P::load(&self.color[index..end]).times_plus(gain, bias);
        [shown * active, photo * active, active]
    }
}

/// Sums over a band of one channel.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    l1: f64,
    dssim: f64,
    d_gain: f64,
    d_bias: f64,
}

/// Rows of a band, kept from band to band. Rows with `HALF` columns more on each side are *wide*.
#[derive(Default)]
struct Scratch<T> {
    /// Wide: x, y, x² + y² and x y of one row.
    pair: [Vec<T>; 4],
    /// Wide: ∂S/∂(window sums) of one row.
    slopes: [Vec<T>; 3],
    /// Horizontal blurs of the pair: the last eleven rows.
    means: [Vec<T>; 4],
    /// Horizontal blurs of the slopes: the last eleven rows.
    blurred: [Vec<T>; 3],
}

/// A band of rows of one channel.
struct Band<'a, T> {
    plane: Plane<'a, T>,
    /// First row of the result.
    first: usize,
    out: &'a mut [T],
    window: [f64; HALF + 1],
    scratch: &'a mut Scratch<T>,
}

impl<T: Scalar> Kernel<T> for Band<'_, T> {
    type Output = Sums;

    #[inline(always)]
    fn run<P: Pixels<T>>(mut self) -> Sums {
        clear_rows(self.plane.view, self.first, self.out);
        let rows = self.out.len() / self.plane.view.width;
        let columns = self.plane.columns(self.first, rows);
        let mut sums = Sums::default();
        if columns.is_empty() {
            return sums;
        }
        if self.plane.weights.dssim == 0.0 {
            for row in 0..rows {
                self.finish_row::<P>(row, &columns, None, &mut sums);
            }
            return sums;
        }
        let mut kernel = [P::zero(); HALF + 1];
        for tap in 0..=HALF {
            kernel[tap] = P::from_f64(self.window[tap]);
        }
        let stride = self.scratch.fit(columns.len());
        for turn in 0..rows + 4 * HALF {
            let ring = Ring { turn, stride };
            self.load::<P>(&kernel, &columns, ring);
            if turn >= 2 * HALF {
                let loss = self.compare::<P>(&kernel, &columns, ring);
                sums.dssim += if (3 * HALF..rows + 3 * HALF).contains(&turn) { loss } else { 0.0 };
            }
            if turn >= 4 * HALF {
                self.finish_row::<P>(turn - 4 * HALF, &columns, Some((&kernel, ring)), &mut sums);
            }
        }
        sums.dssim *= self.plane.share();
        sums
    }
}

impl<T: Scalar> Scratch<T> {
    /// Makes room for rows of so many columns and clears the margins; returns the length of a row in a ring.
    fn fit(&mut self, columns: usize) -> usize {
        // An odd multiple: rows of a ring a power of two apart would fight for the same cache lines.
        let stride = (columns.div_ceil(LANES) | 1) * LANES;
        for row in self.pair.iter_mut().chain(&mut self.slopes) {
            row.clear();
            row.resize(stride + 2 * HALF, T::zero());
        }
        for ring in self.means.iter_mut().chain(&mut self.blurred) {
            ring.resize(stride * TAPS, T::zero());
        }
        stride
    }
}

/// Where the rows of a ring are whose newest was written at `turn`.
#[derive(Clone, Copy)]
struct Ring {
    turn: usize,
    stride: usize,
}

impl Ring {
    /// Offset of the newest row.
    #[inline(always)]
    fn newest(self) -> usize {
        self.turn % TAPS * self.stride
    }

    /// Offsets of all rows, oldest first.
    #[inline(always)]
    fn rows(self) -> [usize; TAPS] {
        let mut rows = [0; TAPS];
        for (i, row) in rows.iter_mut().enumerate() {
            *row = (self.turn + 1 + i) % TAPS * self.stride;
        }
        rows
    }
}

impl<T: Scalar> Band<'_, T> {
    /// Reads image row `first + turn − 10` and blurs it along the row.
    #[inline(always)]
    fn load<P: Pixels<T>>(&mut self, kernel: &[P; HALF + 1], columns: &Range<usize>, ring: Ring) {
        let view = self.plane.view;
        let y = (self.first + ring.turn).checked_sub(2 * HALF).filter(|&y| y < view.height);
        let [xs, ys, squares, products] = &mut self.scratch.pair;
        let Some(y) = y.filter(|&y| !view.spans[y].is_empty()) else {
            for means in &mut self.scratch.means {
                means[ring.newest()..][..ring.stride].fill(T::zero());
            }
            return;
        };
        let (start, end) = (y * view.width + columns.start, y * view.width + columns.end);
        for at in (0..columns.len()).step_by(P::LEN) {
            let [a, b, _] = self.plane.pair::<P>(start + at, end);
            let to = HALF + at..HALF + at + P::LEN;
            a.store(&mut xs[to.clone()]);
            b.store(&mut ys[to.clone()]);
            a.times_plus(a, b * b).store(&mut squares[to.clone()]);
            (a * b).store(&mut products[to]);
        }
        for (row, means) in self.scratch.pair.iter().zip(&mut self.scratch.means) {
            blur_along(kernel, row, &mut means[ring.newest()..][..ring.stride]);
        }
    }

    /// SSIM of image row `first + turn − 15`: its slopes, blurred along the row; returns the row's sum of 1 − S.
    #[inline(always)]
    fn compare<P: Pixels<T>>(&mut self, kernel: &[P; HALF + 1], columns: &Range<usize>, ring: Ring) -> f64 {
        let view = self.plane.view;
        let y = (self.first + ring.turn).checked_sub(3 * HALF).filter(|&y| y < view.height);
        let Some(y) = y else {
            for blurred in &mut self.scratch.blurred {
                blurred[ring.newest()..][..ring.stride].fill(T::zero());
            }
            return 0.0;
        };
        let (start, end) = (y * view.width + columns.start, y * view.width + columns.end);
        let (rows, everywhere) = (ring.rows(), !self.plane.weights.mean_over_mask);
        let mut loss = P::zero();
        for at in (0..columns.len()).step_by(P::LEN) {
            let mut means = [P::zero(); 4];
            for (mean, ring) in means.iter_mut().zip(&self.scratch.means) {
                *mean = blur_across(kernel, ring, &rows, at);
            }
            // Lanes past the last column lie in the next row: they do not count.
            let mut counts = P::from_bytes(bytemuck::cast_slice(&view.active[start + at..end]));
            if everywhere {
                counts = P::each(|lane| if at + lane < columns.len() { T::one() } else { T::zero() });
            }
            let (s, slopes) = similarity(means);
            loss += counts * (P::one() - s);
            for (row, slope) in self.scratch.slopes.iter_mut().zip(slopes) {
                (counts * slope).store(&mut row[HALF + at..HALF + at + P::LEN]);
            }
        }
        for (row, blurred) in self.scratch.slopes.iter().zip(&mut self.scratch.blurred) {
            blur_along(kernel, row, &mut blurred[ring.newest()..][..ring.stride]);
        }
        loss.total()
    }

    /// Writes a row of the result: L1, and SSIM where its slopes are given.
    #[inline(always)]
    fn finish_row<P: Pixels<T>>(
        &mut self,
        row: usize,
        columns: &Range<usize>,
        slopes: Option<(&[P; HALF + 1], Ring)>,
        sums: &mut Sums,
    ) {
        let plane = self.plane;
        let width = plane.view.width;
        let (start, end) = ((self.first + row) * width + columns.start, (self.first + row) * width + columns.end);
        let out = &mut self.out[row * width..][columns.clone()];
        let share = plane.share();
        let l1 = P::from_f64(plane.weights.l1 * share);
        let dssim = P::from_f64(-plane.weights.dssim * share);
        let gain = P::from_f64(f64::from(plane.exposure.gain[plane.channel]));
        let (mut distance, mut d_gain, mut d_bias) = (P::zero(), P::zero(), P::zero());
        let rows = slopes.map(|(kernel, ring)| (kernel, ring.rows()));
        for at in (0..columns.len()).step_by(P::LEN) {
            let [a, b, active] = plane.pair::<P>(start + at, end);
            let mut d = l1 * (a - b).sign();
            if let Some((kernel, rows)) = &rows {
                let [p, q, r] = &self.scratch.blurred;
                let mut d_ssim = blur_across(kernel, p, rows, at);
                d_ssim = blur_across(kernel, q, rows, at).times_plus(a + a, d_ssim);
                d_ssim = blur_across(kernel, r, rows, at).times_plus(b, d_ssim);
                d = d_ssim.times_plus(dssim, d);
            }
            d = d * active;
            (gain * d).store(&mut out[at..]);
            distance += (a - b).abs();
            d_gain += d * P::load(&plane.color[start + at..end]);
            d_bias += d;
        }
        sums.l1 += distance.total() * share;
        sums.d_gain += d_gain.total();
        sums.d_bias += d_bias.total();
    }
}

/// S of one window, and what multiplies the blurs in its gradient: (P, ∂S/∂σx², ∂S/∂σxy).
///     a₁ = 2 μx μy + C1,  a₂ = 2 σxy + C2,  b₁ = μx² + μy² + C1,  b₂ = σx² + σy² + C2,  S = a₁ a₂ / (b₁ b₂)
///     P = ∂S/∂μx − 2 μx ∂S/∂σx² − μy ∂S/∂σxy
/// `means` window means of x, y, x² + y², x y.
#[inline(always)]
fn similarity<P: Number>(means: [P; 4]) -> (P, [P; 3]) {
    let [x, y, squares, product] = means;
    let (c1, c2) = (P::from_f64(C1), P::from_f64(C2));
    let (xy, both) = (x * y, x * x + y * y);
    let a1 = xy + xy + c1;
    let a2 = (product - xy) + (product - xy) + c2;
    let b1 = both + c1;
    let b2 = squares - both + c2;
    let inverse = P::one() / (b1 * b2);
    let s = a1 * a2 * inverse;
    // 1/b₂ = b₁/(b₁ b₂), and so on: one division in all.
    let d_square = -s * b1 * inverse;
    let d_product = (a1 + a1) * inverse;
    let d_mean = (y + y) * a2 * inverse - (x + x) * s * b2 * inverse;
    (s, [d_mean - (x + x) * d_square - y * d_product, d_square, d_product])
}

/// Convolves a row: `out[i]` is the window about `row[i + HALF]`.
#[inline(always)]
fn blur_along<T: Scalar, P: Pixels<T>>(kernel: &[P; HALF + 1], row: &[T], out: &mut [T]) {
    for at in (0..out.len()).step_by(P::LEN) {
        let row = &row[at..at + P::LEN + 2 * HALF];
        let mut sum = kernel[0] * P::load(&row[HALF..]);
        for tap in 1..=HALF {
            sum = kernel[tap].times_plus(P::load(&row[HALF - tap..]) + P::load(&row[HALF + tap..]), sum);
        }
        sum.store(&mut out[at..]);
    }
}

/// Convolves across the eleven rows of a ring, at one place along them.
#[inline(always)]
fn blur_across<T: Scalar, P: Pixels<T>>(kernel: &[P; HALF + 1], ring: &[T], rows: &[usize; TAPS], at: usize) -> P {
    let row = |i: usize| P::load(&ring[rows[i] + at..][..P::LEN]);
    let mut sum = kernel[0] * row(HALF);
    for tap in 1..=HALF {
        sum = kernel[tap].times_plus(row(HALF - tap) + row(HALF + tap), sum);
    }
    sum
}

#[cfg(test)]
mod tests;
