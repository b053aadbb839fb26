//! L_rgb: what is drawn looks like the photograph. 0.8 L1 + 0.2 (1 − SSIM), 3DGS section 5; SSIM by Wang et al. 2004.
//!
//! Both images are black outside the mask and both terms see the exposed render. SSIM: Gaussian window of 11 pixels,
//! σ = 1.5, zero padding. Bands of rows run in parallel (windows are recomputed at the seams); within a band rows stream
//! through two rings of eleven, so that all stays in cache: per channel four blurs forward and three back.

use std::ops::Range;

use super::rows::map_rows;
use super::view::LossView;
use crate::backend::Exposure;
use crate::equations::Scalar;

/// Half the SSIM window, pixels.
const HALF: usize = 5;
/// Standard deviation of the SSIM window, pixels. Wang 2004.
const SIGMA_PX: f64 = 1.5;
/// (0.01)². Wang 2004.
const C1: f64 = 1e-4;
/// (0.03)². Wang 2004.
const C2: f64 = 9e-4;
/// Columns that are worked at once: loops over so many are what compilers make vectors of.
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

/// The term, with its gradient added to `d_color` (of the render before exposure).
///     x = m (gain · I + bias),   y = m I*,   L = l1 · mean |x − y| + dssim · (1 − mean SSIM(x, y))
/// `color` I and `d_color` `[H * W]` R G B.
pub fn photometric<T: Scalar>(
    view: &LossView,
    color: &[[T; 3]],
    exposure: &Exposure,
    weights: &PhotometricWeights,
    d_color: &mut [[T; 3]],
) -> Photometric {
    let window = window();
    let level = fearless_simd::Level::new();
    let sums = map_rows(d_color, view.width * BAND, |index, out| {
        let first = index * BAND;
        let source = Source { view, color, exposure, weights };
        match source.columns(first, out.len() / view.width) {
            Some(columns) if weights.dssim != 0.0 => {
                let mut band = Band::new(source, columns, first, &window);
                fearless_simd::dispatch!(level, _simd => band.run(out))
            }
            Some(_) => source.absolute(first, out),
            None => Photometric::default(),
        }
    });
    sums.into_iter().fold(Photometric::default(), |mut sum, band| {
        sum.l1 += band.l1;
        sum.dssim += band.dssim;
        for channel in 0..3 {
            sum.d_gain[channel] += band.d_gain[channel];
            sum.d_bias[channel] += band.d_bias[channel];
        }
        sum
    })
}

/// Centre and one side of the normalised Gaussian window.
fn window<T: Scalar>() -> [T; HALF + 1] {
    let raw: [f64; HALF + 1] = std::array::from_fn(|i| libm::exp(-((i * i) as f64) / (2.0 * SIGMA_PX * SIGMA_PX)));
    let sum = raw[0] + 2.0 * raw[1..].iter().sum::<f64>();
    raw.map(|value| T::from_f64(value / sum))
}

/// What the two images are made of.
#[derive(Clone, Copy)]
struct Source<'a, T> {
    view: &'a LossView,
    color: &'a [[T; 3]],
    exposure: &'a Exposure,
    weights: &'a PhotometricWeights,
}

impl<T: Scalar> Source<'_, T> {
    /// The columns in which SSIM matters for the rows from `first`; `None` where nothing does.
    fn columns(&self, first: usize, rows: usize) -> Option<Range<usize>> {
        let reach = first.saturating_sub(2 * HALF)..(first + rows + 2 * HALF).min(self.view.height);
        let spans = self.view.spans[reach].iter().filter(|span| !span.is_empty());
        let (start, end) = spans.fold((usize::MAX, 0), |(start, end), span| (start.min(span.start), end.max(span.end)));
        let beyond = if self.weights.mean_over_mask { 0 } else { HALF };
        (start < end).then(|| start.saturating_sub(beyond)..(end + beyond).min(self.view.width))
    }

    /// 1 / (3 · pixels averaged over).
    fn share(&self) -> f64 {
        1.0 / (3.0 * self.view.mean_count(self.weights.mean_over_mask) as f64)
    }

    /// Exposed render x and photograph y of an active pixel.
    #[inline(always)]
    fn pair(&self, index: usize, channel: usize) -> [T; 2] {
        let gain = T::from_f32(self.exposure.gain[channel]);
        let bias = T::from_f32(self.exposure.bias[channel]);
        let photo = T::from_u8(self.view.image.pixels[index][channel]) * T::from_f64(1.0 / 255.0);
        [gain * self.color[index][channel] + bias, photo]
    }

    /// L1 alone, for the rows from `first`.
    fn absolute(&self, first: usize, out: &mut [[T; 3]]) -> Photometric {
        let mut sum = Photometric::default();
        for channel in 0..3 {
            for (offset, out) in out.iter_mut().enumerate() {
                let index = first * self.view.width + offset;
                if self.view.is_active(index) {
                    self.finish(index, channel, T::zero(), &mut out[channel], &mut sum);
                }
            }
        }
        sum
    }

    /// Adds L1 and the given gradient of the SSIM term (with respect to x) at an active pixel.
    #[inline(always)]
    fn finish(&self, index: usize, channel: usize, d_ssim: T, out: &mut T, sum: &mut Photometric) {
        let [x, y] = self.pair(index, channel);
        let share = self.share();
        let d_x = T::from_f64(self.weights.l1 * share) * (x - y).sign() + d_ssim;
        *out += T::from_f32(self.exposure.gain[channel]) * d_x;
        sum.l1 += (x - y).abs().to_f64() * share;
        sum.d_gain[channel] += (d_x * self.color[index][channel]).to_f64();
        sum.d_bias[channel] += d_x.to_f64();
    }
}

/// A band of rows, one channel at a time.
struct Band<'a, T> {
    source: Source<'a, T>,
    kernel: &'a [T; HALF + 1],
    /// Columns in which SSIM is evaluated.
    columns: Range<usize>,
    /// First row of the result.
    first: usize,
    /// x and y of one row, with `HALF` columns more on each side.
    pair: [Vec<T>; 2],
    /// x² + y² and x y of the same.
    products: [Vec<T>; 2],
    /// Horizontal blurs of x, y, x² + y², x y: the last eleven rows.
    means: [Vec<Vec<T>>; 4],
    /// ∂S/∂(window sums) of one row, with `HALF` columns more on each side.
    slopes: [Vec<T>; 3],
    /// Horizontal blurs of the slopes: the last eleven rows.
    blurred: [Vec<Vec<T>>; 3],
    /// Vertical blurs of one row.
    line: [Vec<T>; 4],
}

impl<'a, T: Scalar> Band<'a, T> {
    fn new(source: Source<'a, T>, columns: Range<usize>, first: usize, kernel: &'a [T; HALF + 1]) -> Self {
        let width = columns.len().next_multiple_of(LANES);
        let narrow = || vec![T::zero(); width];
        let wide = || vec![T::zero(); width + 2 * HALF];
        let ring = || (0..TAPS).map(|_| narrow()).collect::<Vec<_>>();
        Self {
            source,
            kernel,
            first,
            pair: std::array::from_fn(|_| wide()),
            products: std::array::from_fn(|_| wide()),
            means: std::array::from_fn(|_| ring()),
            slopes: std::array::from_fn(|_| wide()),
            blurred: std::array::from_fn(|_| ring()),
            line: std::array::from_fn(|_| narrow()),
            columns,
        }
    }

    #[inline(always)]
    fn run(&mut self, out: &mut [[T; 3]]) -> Photometric {
        let mut sum = Photometric::default();
        let rows = out.len() / self.source.view.width;
        for channel in 0..3 {
            for turn in 0..rows + 4 * HALF {
                self.load(turn, channel);
                if turn >= 2 * HALF {
                    sum.dssim += self.compare(turn, rows) * self.source.share();
                }
                if turn >= 4 * HALF {
                    self.emit(turn, channel, out, &mut sum);
                }
            }
        }
        sum
    }

    /// Reads image row `first + turn − 10` and blurs it along the row.
    #[inline(always)]
    fn load(&mut self, turn: usize, channel: usize) {
        let view = self.source.view;
        self.pair.iter_mut().for_each(|row| row.fill(T::zero()));
        if let Some(y) = (self.first + turn).checked_sub(2 * HALF).filter(|&y| y < view.height) {
            for x in view.spans[y].clone() {
                let index = y * view.width + x;
                if view.is_active(index) {
                    let at = x + HALF - self.columns.start;
                    let [x, y] = self.source.pair(index, channel);
                    self.pair[0][at] = x;
                    self.pair[1][at] = y;
                }
            }
        }
        let ([x, y], [squares, product]) = (&self.pair, &mut self.products);
        for ((x, y), (square, product)) in x.iter().zip(y).zip(squares.iter_mut().zip(product)) {
            *square = *x * *x + *y * *y;
            *product = *x * *y;
        }
        let slot = turn % TAPS;
        for (ring, row) in self.means.iter_mut().zip(self.pair.iter().chain(&self.products)) {
            blur_along(self.kernel, row, &mut ring[slot]);
        }
    }

    /// SSIM of image row `first + turn − 15`: its slopes, blurred along the row; returns the row's sum of 1 − S where
    /// the row belongs to the band.
    #[inline(always)]
    fn compare(&mut self, turn: usize, rows: usize) -> f64 {
        let view = self.source.view;
        for (ring, line) in self.means.iter().zip(&mut self.line) {
            blur_across(self.kernel, ring, turn, line);
        }
        self.slopes.iter_mut().for_each(|row| row.fill(T::zero()));
        let mut loss = 0.0;
        if let Some(y) = (self.first + turn).checked_sub(3 * HALF).filter(|&y| y < view.height) {
            let own = (3 * HALF..rows + 3 * HALF).contains(&turn);
            let classes = &view.classes[y * view.width..][self.columns.clone()];
            for (chunk, classes) in classes.chunks(LANES).enumerate() {
                let mut keep = [T::zero(); LANES];
                for (keep, class) in keep.iter_mut().zip(classes) {
                    *keep = if !self.source.weights.mean_over_mask || class.is_active() { T::one() } else { T::zero() };
                }
                let sum = self.compare_chunk(chunk, &keep);
                loss += if own { sum } else { 0.0 };
            }
        }
        let slot = turn % TAPS;
        for (ring, row) in self.blurred.iter_mut().zip(&self.slopes) {
            blur_along(self.kernel, row, &mut ring[slot]);
        }
        loss
    }

    /// SSIM of a chunk of the row whose window means are in `line`, where `keep` is 1: its slopes and sum of 1 − S.
    #[inline(always)]
    fn compare_chunk(&mut self, chunk: usize, keep: &[T; LANES]) -> f64 {
        let [x, y, squares, product] = &self.line;
        let lanes = |row: &Vec<T>| row.as_chunks::<LANES>().0[chunk];
        let (x, y, squares, product) = (lanes(x), lanes(y), lanes(squares), lanes(product));
        let mut slopes = [[T::zero(); LANES]; 3];
        let mut loss = [T::zero(); LANES];
        for i in 0..LANES {
            let (s, [mean, square, mixed]) = similarity([x[i], y[i], squares[i], product[i]]);
            loss[i] = keep[i] * (T::one() - s);
            slopes[0][i] = keep[i] * mean;
            slopes[1][i] = keep[i] * square;
            slopes[2][i] = keep[i] * mixed;
        }
        for (row, slope) in self.slopes.iter_mut().zip(&slopes) {
            row[chunk * LANES + HALF..][..LANES].copy_from_slice(slope);
        }
        loss.iter().map(|value| value.to_f64()).sum()
    }

    /// Writes image row `first + turn − 20`.
    #[inline(always)]
    fn emit(&mut self, turn: usize, channel: usize, out: &mut [[T; 3]], sum: &mut Photometric) {
        let view = self.source.view;
        for (ring, line) in self.blurred.iter().zip(&mut self.line) {
            blur_across(self.kernel, ring, turn, line);
        }
        let row = turn - 4 * HALF;
        let y = self.first + row;
        let factor = T::from_f64(-self.source.weights.dssim * self.source.share());
        for x in view.spans[y].clone() {
            let index = y * view.width + x;
            if !view.is_active(index) {
                continue;
            }
            let i = x - self.columns.start;
            let [a, b] = self.source.pair(index, channel);
            let d_ssim = self.line[0][i] + (a + a) * self.line[1][i] + b * self.line[2][i];
            self.source.finish(index, channel, factor * d_ssim, &mut out[row * view.width + x][channel], sum);
        }
    }
}

/// S of one window, and what multiplies the blurs in its gradient: (P, ∂S/∂σx², ∂S/∂σxy).
///     a₁ = 2 μx μy + C1,  a₂ = 2 σxy + C2,  b₁ = μx² + μy² + C1,  b₂ = σx² + σy² + C2,  S = a₁ a₂ / (b₁ b₂)
///     P = ∂S/∂μx − 2 μx ∂S/∂σx² − μy ∂S/∂σxy
/// `means` window means of x, y, x² + y², x y.
#[inline(always)]
fn similarity<T: Scalar>(means: [T; 4]) -> (T, [T; 3]) {
    let [x, y, squares, product] = means;
    let (c1, c2) = (T::from_f64(C1), T::from_f64(C2));
    let (xy, both) = (x * y, x * x + y * y);
    let a1 = xy + xy + c1;
    let a2 = (product - xy) + (product - xy) + c2;
    let b1 = both + c1;
    let b2 = squares - both + c2;
    let inverse = T::one() / (b1 * b2);
    let s = a1 * a2 * inverse;
    let d_square = -s / b2;
    let d_product = (a1 + a1) * inverse;
    let d_mean = (y + y) * a2 * inverse - (x + x) * s / b1;
    (s, [d_mean - (x + x) * d_square - y * d_product, d_square, d_product])
}

/// Convolves a row: `out[i]` is the window about `row[i + HALF]`.
#[inline(always)]
fn blur_along<T: Scalar>(kernel: &[T; HALF + 1], row: &[T], out: &mut [T]) {
    for (chunk, out) in out.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
        let row = &row[chunk * LANES..][..LANES + 2 * HALF];
        let mut sum = [T::zero(); LANES];
        for i in 0..LANES {
            sum[i] = kernel[0] * row[i + HALF];
        }
        for tap in 1..=HALF {
            for i in 0..LANES {
                sum[i] += kernel[tap] * (row[i + HALF - tap] + row[i + HALF + tap]);
            }
        }
        *out = sum;
    }
}

/// Convolves across the eleven rows of a ring whose newest was written at `turn`.
#[inline(always)]
fn blur_across<T: Scalar>(kernel: &[T; HALF + 1], ring: &[Vec<T>], turn: usize, out: &mut [T]) {
    for (chunk, out) in out.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
        let row = |i: usize| &ring[(turn + 1 + i) % TAPS].as_chunks::<LANES>().0[chunk];
        let middle = row(HALF);
        let mut sum = [T::zero(); LANES];
        for i in 0..LANES {
            sum[i] = kernel[0] * middle[i];
        }
        for tap in 1..=HALF {
            let (above, below) = (row(HALF - tap), row(HALF + tap));
            for i in 0..LANES {
                sum[i] += kernel[tap] * (above[i] + below[i]);
            }
        }
        *out = sum;
    }
}

#[cfg(test)]
mod tests;
