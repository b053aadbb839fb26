use pgsag_scene::numbers::SplitMix64;

use super::*;
use crate::losses::tests::{loss_view, planes, planes_mut, print_processor_time};
use crate::proof;

const EXPOSURE: Exposure = Exposure { gain: [1.1, 0.9, 1.05], bias: [0.02, -0.03, 0.01] };

fn prove(masked: bool, mean_over_mask: bool, l1: f64, dssim: f64) {
    // Higher than a band, so that the seam is proven too.
    let view = loss_view(14, 106, 3, masked);
    let weights = PhotometricWeights { l1, dssim, mean_over_mask };
    let at = proof::numbers(&mut SplitMix64::new(5), 14 * 106 * 3, 0.0, 1.0);
    let mut gradient = vec![0.0; at.len()];
    photometric(&view, planes(&at), &EXPOSURE, &weights, planes_mut(&mut gradient), &Spare::default());
    let value = |at: &[f64]| {
        let mut unused = vec![0.0; at.len()];
        let term = photometric(&view, planes(at), &EXPOSURE, &weights, planes_mut(&mut unused), &Spare::default());
        l1 * term.l1 + dssim * term.dssim
    };
    let largest = gradient.iter().fold(0.0f64, |a, b| a.max(b.abs()));
    let rows = [0usize, 20, 21, 50, 90, 95, 96, 97, 105];
    for i in rows.iter().flat_map(|row| (0..14 * 3).step_by(5).map(move |x| x / 14 * 14 * 106 + row * 14 + x % 14)) {
        let numeric = proof::difference(&value, &at, i, 1e-5);
        assert!((numeric - gradient[i]).abs() < 1e-6 * largest, "{i}: {} {numeric}", gradient[i]);
    }
}

#[test]
fn photometric_grad_matches_differences_with_mask() {
    prove(true, true, 0.8, 0.2);
    prove(true, true, 1.0, 0.0);
}

#[test]
fn photometric_grad_matches_differences_over_frame() {
    prove(true, false, 0.0, 1.0);
    prove(false, false, 0.8, 0.2);
}

#[test]
fn exposure_grad_matches_differences() {
    let view = loss_view(20, 16, 3, true);
    let weights = PhotometricWeights { l1: 0.8, dssim: 0.2, mean_over_mask: true };
    let color = proof::numbers(&mut SplitMix64::new(9), 20 * 16 * 3, 0.0, 1.0);
    let mut unused = vec![0.0; color.len()];
    let term = photometric(&view, planes(&color), &EXPOSURE, &weights, planes_mut(&mut unused), &Spare::default());
    // Exposures are f32: differences wide enough not to see their rounding.
    for channel in 0..3 {
        let quotient = |change: &dyn Fn(&mut Exposure, f32)| {
            let at = |by: f32| {
                let mut exposure = EXPOSURE;
                change(&mut exposure, by);
                let mut unused = vec![0.0; color.len()];
                let term =
                    photometric(&view, planes(&color), &exposure, &weights, planes_mut(&mut unused), &Spare::default());
                0.8 * term.l1 + 0.2 * term.dssim
            };
            (at(1.0 / 4096.0) - at(-1.0 / 4096.0)) * 2048.0
        };
        let gain = quotient(&|exposure, by| exposure.gain[channel] += by);
        let bias = quotient(&|exposure, by| exposure.bias[channel] += by);
        assert!((gain - term.d_gain[channel]).abs() < 2e-3, "{gain} {}", term.d_gain[channel]);
        assert!((bias - term.d_bias[channel]).abs() < 2e-3, "{bias} {}", term.d_bias[channel]);
    }
}

/// SSIM by its definition: no separable window, no streaming.
fn slow_dssim(view: &LossView, color: [&[f64]; 3], mean_over_mask: bool) -> f64 {
    let (width, height) = (view.width as isize, view.height as isize);
    let kernel: Vec<f64> = (-5..=5).map(|i: i32| libm::exp(-f64::from(i * i) / 4.5)).collect();
    let total: f64 = kernel.iter().sum();
    let (mut sum, mut count) = (0.0, 0.0);
    for (y, x, channel) in (0..height).flat_map(|y| (0..width).flat_map(move |x| (0..3).map(move |c| (y, x, c)))) {
        if mean_over_mask && !view.is_active((y * width + x) as usize) {
            continue;
        }
        let mut m = [0.0; 5];
        for (dy, dx) in (-5..=5).flat_map(|dy| (-5..=5).map(move |dx| (dy, dx))) {
            let (px, py) = (x + dx, y + dy);
            let index = (py * width + px) as usize;
            if px < 0 || py < 0 || px >= width || py >= height || !view.is_active(index) {
                continue;
            }
            let k = kernel[(dy + 5) as usize] * kernel[(dx + 5) as usize] / (total * total);
            let a = f64::from(EXPOSURE.gain[channel]) * color[channel][index] + f64::from(EXPOSURE.bias[channel]);
            let b = f64::from(view.photo[channel][index]) / 255.0;
            [a, b, a * a, b * b, a * b].iter().zip(&mut m).for_each(|(value, m)| *m += k * value);
        }
        let (va, vb, ab) = (m[2] - m[0] * m[0], m[3] - m[1] * m[1], m[4] - m[0] * m[1]);
        sum += (2.0 * m[0] * m[1] + 1e-4) * (2.0 * ab + 9e-4) / ((m[0] * m[0] + m[1] * m[1] + 1e-4) * (va + vb + 9e-4));
        count += 1.0;
    }
    1.0 - sum / count
}

#[test]
fn dssim_equals_its_definition() {
    let view = loss_view(24, 30, 3, true);
    let color = proof::numbers(&mut SplitMix64::new(5), 24 * 30 * 3, 0.0, 1.0);
    for mean_over_mask in [true, false] {
        let weights = PhotometricWeights { l1: 0.0, dssim: 1.0, mean_over_mask };
        let mut unused = vec![0.0; color.len()];
        let term = photometric(&view, planes(&color), &EXPOSURE, &weights, planes_mut(&mut unused), &Spare::default());
        let slow = slow_dssim(&view, planes(&color), mean_over_mask);
        assert!((term.dssim - slow).abs() < 1e-12, "{} {slow}", term.dssim);
    }
}

#[test]
fn equal_images_cost_nothing() {
    let view = loss_view(40, 30, 3, true);
    let color: Vec<f64> = view.photo.concat().into_iter().map(|value| f64::from(value) / 255.0).collect();
    let weights = PhotometricWeights { l1: 0.8, dssim: 0.2, mean_over_mask: true };
    let mut d_color = vec![0.0; color.len()];
    let term =
        photometric(&view, planes(&color), &Exposure::NEUTRAL, &weights, planes_mut(&mut d_color), &Spare::default());
    assert!(term.l1 < 1e-15 && term.dssim.abs() < 1e-12);
}

#[test]
#[ignore = "a measurement: cargo test --release -p pgsag-splat -- --ignored photometric_speed --nocapture"]
fn photometric_speed() {
    let view = loss_view(800, 600, 3, false);
    let color = vec![0.4f32; 3 * 800 * 600];
    let weights = PhotometricWeights { l1: 0.8, dssim: 0.2, mean_over_mask: true };
    print_processor_time("photometric, 800 x 600", || {
        let mut d_color = vec![0.0; color.len()];
        photometric(&view, planes(&color), &Exposure::NEUTRAL, &weights, planes_mut(&mut d_color), &Spare::default());
    });
}
