//! L_rgb: what is drawn looks like the photograph. 0.8 L1 + 0.2 (1 − SSIM), 3DGS section 5; SSIM by Wang et al. 2004.
//!
//! Both images are black outside the mask and both terms see the exposed render. SSIM: Gaussian window of 11 pixels,
//! σ = 1.5, zero padding. Bands of rows of one channel run in parallel (windows are recomputed at the seams); within a
//! band rows stream through two rings, four at a time, so that what is read serves four windows: four blurs forward and
//! three back. Sums are kept per row: how an image is cut into bands changes no bit.

use std::ops::Range;

use rayon::prelude::*;

use super::spare::Spare;
use super::total::clear_rows;
use super::view::LossView;
use crate::backend::Exposure;
use crate::equations::algebra::each;
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
/// Rows of a band at least.
const BAND: usize = 64;
/// Bands of a channel for each thread, so that the last to end is not far behind.
const BANDS_PER_THREAD: usize = 4;
/// Rows of a window.
const TAPS: usize = 2 * HALF + 1;
/// Rows that are blurred together.
const STEP: usize = 4;
/// Rows that windows of [`STEP`] rows see together.
const SEEN: usize = TAPS + STEP - 1;
/// Rows of a ring: a multiple of [`STEP`] and at least [`SEEN`].
const RING: usize = 16;

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
/// `color` I and `d_color`: R, G, B, `[H * W]` each. `rooms` is memory to work in.
pub fn photometric<T: Scalar>(
    view: &LossView,
    color: [&[T]; 3],
    exposure: &Exposure,
    weights: &PhotometricWeights,
    d_color: [&mut [T]; 3],
    rooms: &Spare<Vec<T>>,
) -> Photometric {
    let threads = rayon::current_num_threads();
    let bands = if threads == 1 { 1 } else { threads * BANDS_PER_THREAD };
    let band = view.height.div_ceil(bands).max(BAND);
    let mut tasks = Vec::new();
    for (channel, out) in d_color.into_iter().enumerate() {
        let plane = Plane { view, color: color[channel], channel, exposure, weights };
        tasks.extend(out.chunks_mut((view.width * band).max(1)).enumerate().map(|(i, out)| (plane, i * band, out)));
    }
    let window = window();
    let sums: Vec<(usize, Vec<Sums>)> = tasks
        .into_par_iter()
        .with_max_len(1)
        .map(|(plane, first, out)| {
            let rows = rooms.lend(|room| T::widest(Band { plane, first, out, window, room }));
            (plane.channel, rows)
        })
        .collect();
    let rows = sums.into_iter().flat_map(|(channel, rows)| rows.into_iter().map(move |row| (channel, row)));
    rows.fold(Photometric::default(), |mut sum, (channel, row)| {
        sum.l1 += row.l1;
        sum.dssim += row.dssim;
        sum.d_gain[channel] += row.d_gain;
        sum.d_bias[channel] += row.d_bias;
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
    /// The columns in which SSIM matters for the rows from `first`; empty where nothing does. They begin where a vector
    /// would in any band.
    fn columns(&self, first: usize, rows: usize) -> Range<usize> {
        if !self.weights.mean_over_mask {
            return 0..self.view.width;
        }
        let reach = first.saturating_sub(2 * HALF)..(first + rows + 2 * HALF).min(self.view.height);
        let spans = self.view.spans[reach].iter().filter(|span| !span.is_empty());
        let (start, end) = spans.fold((usize::MAX, 0), |(start, end), span| (start.min(span.start), end.max(span.end)));
        if start < end { start / LANES * LANES..end } else { 0..0 }
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

/// Sums over a row of one channel.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    l1: f64,
    dssim: f64,
    d_gain: f64,
    d_bias: f64,
}

/// A band of rows of one channel.
struct Band<'a, T> {
    plane: Plane<'a, T>,
    /// First row of the result.
    first: usize,
    out: &'a mut [T],
    window: [f64; HALF + 1],
    /// Memory for [`Work`].
    room: &'a mut Vec<T>,
}

impl<T: Scalar> Kernel<T> for Band<'_, T> {
    type Output = Vec<Sums>;

    #[inline(always)]
    fn run<P: Pixels<T>>(self) -> Vec<Sums> {
        let Self { plane, first, out, window, room } = self;
        clear_rows(plane.view, first, out);
        let rows = out.len() / plane.view.width;
        let mut sums = vec![Sums::default(); rows];
        let columns = plane.columns(first, rows);
        if columns.is_empty() {
            return sums;
        }
        let kernel = each(|tap| P::from_f64(window[tap]));
        let stride = if plane.weights.dssim == 0.0 { 0 } else { (columns.len().div_ceil(LANES) | 1) * LANES };
        let mut strip = Strip { plane, first, rows, columns, kernel, work: Work::new(room, stride) };
        if stride == 0 {
            for turn in 0..rows.div_ceil(STEP) {
                strip.finish::<false>(turn, out, &mut sums);
            }
            return sums;
        }
        // Input rows begin 2 HALF before the result's, slopes HALF before: whole steps later all that a window sees is there.
        const DELAY: usize = (SEEN - STEP).div_ceil(STEP);
        for turn in 0..rows.div_ceil(STEP) + 2 * DELAY {
            strip.load(turn);
            if let Some(turn) = turn.checked_sub(DELAY) {
                strip.compare(turn, &mut sums);
            }
            if let Some(turn) = turn.checked_sub(2 * DELAY) {
                strip.finish::<true>(turn, out, &mut sums);
            }
        }
        sums
    }
}

/// Rows of a band. *Wide* ones have [`LANES`] columns of zeros on each side.
struct Work<'a, T> {
    /// Columns of the others.
    stride: usize,
    /// Wide: x, y, x² + y² and x y of one row.
    pair: [&'a mut [T]; 4],
    /// Wide: ∂S/∂(window sums) of [`STEP`] rows.
    slopes: [&'a mut [T]; 3],
    /// Horizontal blurs of the pair: the last [`RING`] rows.
    means: [&'a mut [T]; 4],
    /// Horizontal blurs of the slopes: the last [`RING`] rows.
    blurred: [&'a mut [T]; 3],
}

impl<'a, T: Scalar> Work<'a, T> {
    /// Zeros, in a memory whose rows begin where cache lines do.
    fn new(room: &'a mut Vec<T>, stride: usize) -> Self {
        let wide = stride + 2 * LANES;
        room.clear();
        room.resize(LANES + (4 + 3 * STEP) * wide + 7 * RING * stride, T::zero());
        let begin = room.as_ptr().align_offset(64).min(LANES);
        let mut rest = &mut room[begin..];
        let mut take = |length: usize| {
            let (taken, left) = std::mem::take(&mut rest).split_at_mut(length);
            rest = left;
            taken
        };
        Self {
            stride,
            pair: [(); 4].map(|()| take(wide)),
            slopes: [(); 3].map(|()| take(STEP * wide)),
            means: [(); 4].map(|()| take(RING * stride)),
            blurred: [(); 3].map(|()| take(RING * stride)),
        }
    }
}

/// A band on its way.
struct Strip<'a, T, P> {
    plane: Plane<'a, T>,
    first: usize,
    rows: usize,
    columns: Range<usize>,
    kernel: [P; HALF + 1],
    work: Work<'a, T>,
}

impl<T: Scalar, P: Pixels<T>> Strip<'_, T, P> {
    /// Where the columns lie in an image row.
    #[inline(always)]
    fn place(&self, y: usize) -> Range<usize> {
        y * self.plane.view.width + self.columns.start..y * self.plane.view.width + self.columns.end
    }

    /// Reads image rows from `first − 10 + 4 turn` on and blurs them along the row.
    #[inline(always)]
    fn load(&mut self, turn: usize) {
        let view = self.plane.view;
        for row in STEP * turn..STEP * (turn + 1) {
            let to = row % RING * self.work.stride..(row % RING + 1) * self.work.stride;
            let y = (self.first + row).checked_sub(2 * HALF).filter(|&y| y < view.height && !view.spans[y].is_empty());
            let Some(Range { start, end }) = y.map(|y| self.place(y)) else {
                self.work.means.iter_mut().for_each(|means| means[to.clone()].fill(T::zero()));
                continue;
            };
            let [xs, ys, squares, products] = &mut self.work.pair;
            for at in (0..end - start).step_by(P::LEN) {
                let [a, b, _] = self.plane.pair::<P>(start + at, end);
                let to = LANES + at..LANES + at + P::LEN;
                a.store(&mut xs[to.clone()]);
                b.store(&mut ys[to.clone()]);
                a.times_plus(a, b * b).store(&mut squares[to.clone()]);
                (a * b).store(&mut products[to]);
            }
            for (row, means) in self.work.pair.iter().zip(&mut self.work.means) {
                blur_along(&self.kernel, row, &mut means[to.clone()]);
            }
        }
    }

    /// SSIM of image rows from `first − 5 + 4 turn` on: slopes, blurred along the row; adds the sums of 1 − S.
    #[inline(always)]
    fn compare(&mut self, turn: usize, sums: &mut [Sums]) {
        let (view, everywhere) = (self.plane.view, !self.plane.weights.mean_over_mask);
        let (length, stride) = (self.columns.len(), self.work.stride);
        let wide = stride + 2 * LANES;
        let y: [Option<usize>; STEP] =
            each(|j| (self.first + STEP * turn + j).checked_sub(HALF).filter(|&y| y < view.height));
        let mut loss = [P::zero(); STEP];
        let rings = self.work.means.each_ref().map(|ring| seen(ring, stride, turn));
        for at in (0..length).step_by(P::LEN) {
            let mut means = [[P::zero(); STEP]; 4];
            for k in 0..4 {
                means[k] = blur_across(&self.kernel, &rings[k], at);
            }
            for j in 0..STEP {
                let mut counts = P::zero();
                if let Some(Range { start, end }) = y[j].map(|y| self.place(y)) {
                    // Lanes past the last column lie in the next row: they do not count.
                    counts = P::from_bytes(bytemuck::cast_slice(&view.active[start + at..end]));
                    if everywhere {
                        counts = P::each(|lane| if at + lane < length { T::one() } else { T::zero() });
                    }
                }
                let (s, slopes) = similarity(each(|k| means[k][j]));
                loss[j] += counts * (P::one() - s);
                for k in 0..3 {
                    (counts * slopes[k]).store(&mut self.work.slopes[k][j * wide + LANES + at..][..P::LEN]);
                }
            }
        }
        for (slopes, blurred) in self.work.slopes.iter().zip(&mut self.work.blurred) {
            for (j, row) in slopes.chunks_exact(wide).enumerate() {
                let to = (STEP * turn + j) % RING * stride;
                blur_along(&self.kernel, row, &mut blurred[to..to + stride]);
            }
        }
        for (j, loss) in loss.into_iter().enumerate() {
            if let Some(sum) = (STEP * turn + j).checked_sub(HALF).and_then(|row| sums.get_mut(row)) {
                sum.dssim = loss.total() * self.plane.share();
            }
        }
    }

    /// Writes rows of the result from `4 turn` on: L1 and, with `SSIM`, its part.
    #[inline(always)]
    fn finish<const SSIM: bool>(&mut self, turn: usize, out: &mut [T], sums: &mut [Sums]) {
        let (plane, width) = (self.plane, self.plane.view.width);
        let share = plane.share();
        let l1 = P::from_f64(plane.weights.l1 * share);
        let dssim = P::from_f64(-plane.weights.dssim * share);
        let gain = P::from_f64(f64::from(plane.exposure.gain[plane.channel]));
        let own = STEP * turn..(STEP * (turn + 1)).min(self.rows);
        let mut totals = [[P::zero(); 3]; STEP];
        let rings = self.work.blurred.each_ref().map(|ring| seen(ring, self.work.stride, turn));
        for at in (0..self.columns.len()).step_by(P::LEN) {
            let mut slopes = [[P::zero(); STEP]; 3];
            if SSIM {
                for k in 0..3 {
                    slopes[k] = blur_across(&self.kernel, &rings[k], at);
                }
            }
            for j in 0..STEP {
                if j >= own.len() {
                    continue;
                }
                let Range { start, end } = self.place(self.first + own.start + j);
                let [a, b, active] = plane.pair::<P>(start + at, end);
                let mut d = l1 * (a - b).sign();
                if SSIM {
                    let d_ssim = slopes[1][j].times_plus(a + a, slopes[0][j]);
                    d = slopes[2][j].times_plus(b, d_ssim).times_plus(dssim, d);
                }
                d = d * active;
                (gain * d).store(
                    &mut out[(own.start + j) * width + self.columns.start + at..]
                        [..P::LEN.min(self.columns.len() - at)],
                );
                totals[j][0] += (a - b).abs();
                totals[j][1] += d * P::load(&plane.color[start + at..end]);
                totals[j][2] += d;
            }
        }
        for (sum, [distance, d_gain, d_bias]) in sums[own].iter_mut().zip(totals) {
            *sum = Sums { l1: distance.total() * share, d_gain: d_gain.total(), d_bias: d_bias.total(), ..*sum };
        }
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

/// Convolves a row: `out[i]` is the window about `row[LANES + i]`.
#[inline(always)]
fn blur_along<T: Scalar, P: Pixels<T>>(kernel: &[P; HALF + 1], row: &[T], out: &mut [T]) {
    for at in (0..out.len()).step_by(P::LEN) {
        let row = &row[LANES - HALF + at..][..P::LEN + 2 * HALF];
        let mut sum = kernel[0] * P::load(&row[HALF..]);
        for tap in 1..=HALF {
            sum = kernel[tap].times_plus(P::load(&row[HALF - tap..]) + P::load(&row[HALF + tap..]), sum);
        }
        sum.store(&mut out[at..]);
    }
}

/// The rows of a ring that the windows of a turn see, first to last.
#[inline(always)]
fn seen<T>(ring: &[T], stride: usize, turn: usize) -> [&[T]; SEEN] {
    each(|i| &ring[(STEP * turn + i) % RING * stride..][..stride])
}

/// Convolves across the rows of a turn, at one place along them.
#[inline(always)]
fn blur_across<T: Scalar, P: Pixels<T>>(kernel: &[P; HALF + 1], rows: &[&[T]; SEEN], at: usize) -> [P; STEP] {
    let mut values = [P::zero(); SEEN];
    for i in 0..SEEN {
        values[i] = P::load(&rows[i][at..at + P::LEN]);
    }
    let mut sums = [P::zero(); STEP];
    for j in 0..STEP {
        sums[j] = kernel[0] * values[j + HALF];
        for tap in 1..=HALF {
            // Sums have units of their own on some processors.
            sums[j] = kernel[tap].times_plus(values[j + HALF - tap] + values[j + HALF + tap], sums[j]);
        }
    }
    sums
}

#[cfg(test)]
mod tests;
