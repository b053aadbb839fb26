//! How well held-out photographs are predicted: PSNR and SSIM over the active pixels (method.md 4.4).

use pgsag_scene::{Image, Map, Mask};

use crate::backend::{Backend, Exposure, RenderOptions, TrainingView};
use crate::train::Result;

/// Agreement of one render with its photograph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageMetrics {
    /// Decibels, from the mean square over active pixels and channels.
    pub psnr: f64,
    /// Mean structural similarity over active pixels and channels (11 x 11, deviation 1.5).
    pub ssim: f64,
    /// Pixels that were compared.
    pub pixels: usize,
}

/// Renders a view that was not trained on and compares. `fit_exposure` first fits gain and bias per channel, so that
/// light is not judged.
///
/// # Errors
/// Where the device fails.
pub fn evaluate_view<B: Backend>(
    backend: &B,
    cloud: &B::Cloud,
    view: &TrainingView,
    sh_degree: u8,
    fit_exposure: bool,
) -> Result<ImageMetrics> {
    let options = RenderOptions { sh_degree, ..RenderOptions::default() };
    let maps = backend.read(&backend.render(cloud, &view.camera, None, &options)?)?;
    Ok(image_metrics(&maps.color, &view.image, view.mask.as_ref(), fit_exposure))
}

/// Compares a render with a photograph over the active pixels; a perfect match has 100 dB.
#[must_use]
pub fn image_metrics(rendered: &Map<[f32; 3]>, image: &Image, mask: Option<&Mask>, fit_exposure: bool) -> ImageMetrics {
    let active: Vec<bool> = match mask {
        Some(mask) => mask.classes.iter().map(|class| class.is_active()).collect(),
        None => vec![true; image.pixels.len()],
    };
    let exposure = if fit_exposure { fitted(rendered, image, &active) } else { Exposure::NEUTRAL };
    let pixels = active.iter().filter(|active| **active).count();
    let (mut square, mut ssim) = (0.0, 0.0);
    for channel in 0..3 {
        let (gain, bias) = (f64::from(exposure.gain[channel]), f64::from(exposure.bias[channel]));
        let shade = |i: usize, value: f64| if active[i] { value } else { 0.0 };
        let corrected: Vec<f64> = (0..active.len())
            .map(|i| shade(i, (gain * f64::from(rendered.values[i][channel]) + bias).clamp(0.0, 1.0)))
            .collect();
        let truth: Vec<f64> =
            (0..active.len()).map(|i| shade(i, f64::from(image.pixels[i][channel]) / 255.0)).collect();
        square += corrected.iter().zip(&truth).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
        ssim += ssim_sum(&corrected, &truth, image.width as usize, &active);
    }
    let count = (3 * pixels).max(1) as f64;
    let psnr = (-10.0 * libm::log10((square / count).max(1e-10))).min(100.0);
    ImageMetrics { psnr, ssim: ssim / count, pixels }
}

/// Least squares of `gain · rendered + bias = photograph`, per channel.
fn fitted(rendered: &Map<[f32; 3]>, image: &Image, active: &[bool]) -> Exposure {
    let mut exposure = Exposure::NEUTRAL;
    for channel in 0..3 {
        let (mut n, mut sx, mut sy, mut sxx, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for i in (0..active.len()).filter(|i| active[*i]) {
            let x = f64::from(rendered.values[i][channel]);
            let y = f64::from(image.pixels[i][channel]) / 255.0;
            n += 1.0;
            sx += x;
            sy += y;
            sxx += x * x;
            sxy += x * y;
        }
        let spread = n * sxx - sx * sx;
        if spread > 1e-9 * n * n {
            let gain = (n * sxy - sx * sy) / spread;
            exposure.gain[channel] = gain as f32;
            exposure.bias[channel] = ((sy - gain * sx) / n) as f32;
        }
    }
    exposure
}

/// Half width of the window.
const HALF: usize = 5;

/// Sum of SSIM over the active pixels of one channel; zero padding, as the loss.
fn ssim_sum(a: &[f64], b: &[f64], width: usize, active: &[bool]) -> f64 {
    let product = |x: &[f64], y: &[f64]| -> Vec<f64> { x.iter().zip(y).map(|(x, y)| x * y).collect() };
    let (ma, mb) = (blurred(a, width), blurred(b, width));
    let (aa, bb, ab) = (blurred(&product(a, a), width), blurred(&product(b, b), width), blurred(&product(a, b), width));
    (0..a.len())
        .filter(|i| active[*i])
        .map(|i| {
            let (va, vb, cov) = (aa[i] - ma[i] * ma[i], bb[i] - mb[i] * mb[i], ab[i] - ma[i] * mb[i]);
            (2.0 * ma[i] * mb[i] + 1e-4) * (2.0 * cov + 9e-4)
                / ((ma[i] * ma[i] + mb[i] * mb[i] + 1e-4) * (va + vb + 9e-4))
        })
        .sum()
}

fn blurred(values: &[f64], width: usize) -> Vec<f64> {
    let mut kernel: [f64; 2 * HALF + 1] = std::array::from_fn(|k| {
        let d = k as f64 - HALF as f64;
        libm::exp(-d * d / (2.0 * 1.5 * 1.5))
    });
    let total: f64 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= total);
    let height = values.len() / width.max(1);
    let mut rows = vec![0.0; values.len()];
    for y in 0..height {
        let row = &values[y * width..(y + 1) * width];
        for x in 0..width {
            let taps = x.saturating_sub(HALF)..(x + HALF + 1).min(width);
            rows[y * width + x] = taps.map(|t| kernel[t + HALF - x] * row[t]).sum();
        }
    }
    let mut out = vec![0.0; values.len()];
    for y in 0..height {
        for t in y.saturating_sub(HALF)..(y + HALF + 1).min(height) {
            for x in 0..width {
                out[y * width + x] += kernel[t + HALF - y] * rows[t * width + x];
            }
        }
    }
    out
}

#[cfg(test)]
mod tests;
