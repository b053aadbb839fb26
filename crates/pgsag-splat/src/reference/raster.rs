//! Eq. 1 at every pixel, forward and back.

use std::sync::atomic::Ordering;

use rayon::prelude::*;

use super::Render;
use super::cloud::Cloud;
use super::project::{CHANNELS, Projected, ScreenGradient};
use crate::backend::Limits;
use crate::equations::blend;

/// A Gaussian blended at a pixel.
pub(super) struct Entry {
    /// Place in the front-to-back list.
    place: usize,
    delta: [f64; 2],
    falloff: f64,
    pub(super) alpha: f64,
    /// Before it.
    transmittance: f64,
}

/// The entries of one pixel, front to back.
pub(super) fn entries(splats: &[Projected], limits: &Limits, column: usize, row: usize) -> Vec<Entry> {
    let mut found = Vec::new();
    let mut transmittance = 1.0;
    for (place, splat) in splats.iter().enumerate() {
        let delta = [splat.screen[0] - (column as f64 + 0.5), splat.screen[1] - (row as f64 + 0.5)];
        let falloff = blend::falloff(splat.conic, delta);
        let alpha = blend::alpha(splat.opacity, falloff);
        if alpha < f64::from(limits.alpha_cut) {
            continue;
        }
        let after = transmittance * (1.0 - alpha);
        if after < f64::from(limits.transmittance_stop) {
            break;
        }
        found.push(Entry { place, delta, falloff, alpha, transmittance });
        transmittance = after;
    }
    found
}

/// What one pixel shows.
#[derive(Clone, Copy, Default)]
struct Shown {
    channels: [f64; CHANNELS],
    load: f64,
}

/// Draws; marks who is visible and who is observed.
pub(super) fn forward(render: &mut Render, limits: &Limits, cloud: &Cloud) {
    let (width, splats, drawn) = (render.width, &render.splats, &render.drawn);
    let rows: Vec<(Vec<Shown>, Vec<bool>, Vec<bool>)> = (0..render.height)
        .into_par_iter()
        .map(|row| {
            let mut shown = vec![Shown::default(); width];
            let (mut visible, mut observed) = (vec![false; cloud.rows.len()], vec![false; cloud.rows.len()]);
            for column in (0..width).filter(|column| drawn[row * width + column]) {
                let out = &mut shown[column];
                for entry in entries(splats, limits, column, row) {
                    let splat = &splats[entry.place];
                    blend::over(&mut out.channels, &splat.channels, entry.alpha, entry.transmittance);
                    out.load += 1.0;
                    visible[splat.index] = true;
                    observed[splat.index] |= entry.transmittance > 0.5;
                }
            }
            (shown, visible, observed)
        })
        .collect();
    let mut observed = vec![false; cloud.rows.len()];
    for (shown, row_visible, row_observed) in rows {
        for Shown { channels: [r, g, b, x, y, z, distance, opacity], load } in shown {
            render.color.iter_mut().zip([r, g, b]).for_each(|(map, value)| map.push(value));
            render.normal.iter_mut().zip([x, y, z]).for_each(|(map, value)| map.push(value));
            render.distance.push(distance);
            render.opacity.push(opacity);
            render.load.push(load);
        }
        render.visible.iter_mut().zip(row_visible).for_each(|(any, one)| *any |= one);
        observed.iter_mut().zip(row_observed).for_each(|(any, one)| *any |= one);
    }
    if render.options.observe {
        for (count, _) in cloud.observed.iter().zip(observed).filter(|(_, observed)| *observed) {
            count.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Gradients of all projected Gaussians, in the order of `render.splats`.
pub(super) fn backward(render: &Render, limits: &Limits) -> Vec<ScreenGradient> {
    let rows: Vec<Vec<ScreenGradient>> = (0..render.height)
        .into_par_iter()
        .map(|row| {
            let mut sums = vec![ScreenGradient::default(); render.splats.len()];
            for column in (0..render.width).filter(|column| render.drawn[row * render.width + column]) {
                backward_pixel(render, limits, column, row, &mut sums);
            }
            sums
        })
        .collect();
    let mut sums = vec![ScreenGradient::default(); render.splats.len()];
    for row in rows {
        sums.iter_mut().zip(&row).for_each(|(sum, row)| sum.add(row));
    }
    sums
}

fn backward_pixel(render: &Render, limits: &Limits, column: usize, row: usize, sums: &mut [ScreenGradient]) {
    let (d_out, d_load) = gradient_at(render, row * render.width + column);
    let mut behind = [0.0; CHANNELS];
    for entry in entries(&render.splats, limits, column, row).iter().rev() {
        let splat = &render.splats[entry.place];
        let sum = &mut sums[entry.place];
        let (d_channels, d_alpha) =
            blend::over_grad(&splat.channels, entry.alpha, entry.transmittance, &mut behind, &d_out);
        sum.channels.iter_mut().zip(d_channels).for_each(|(sum, d)| *sum += d);
        let main = blend::alpha_grad(splat.opacity, entry.falloff, d_alpha);
        let load = blend::alpha_grad(splat.opacity, entry.falloff, blend::load_grad(entry.alpha, d_load));
        sum.opacity += main.0 + load.0;
        let (d_screen, d_conic) = blend::falloff_grad(splat.conic, entry.delta, entry.falloff, main.1 + load.1);
        let (d_main, _) = blend::falloff_grad(splat.conic, entry.delta, entry.falloff, main.1);
        for i in 0..2 {
            sum.screen[i] += d_screen[i];
            sum.signed[i] += d_main[i];
            sum.absolute[i] += d_main[i].abs();
        }
        sum.conic.iter_mut().zip(d_conic).for_each(|(sum, d)| *sum += d);
        sum.pixels += 1.0;
    }
}

/// Gradient of the total with respect to a pixel's channels and load; 0 where a map has none.
fn gradient_at(render: &Render, index: usize) -> ([f64; CHANNELS], f64) {
    let maps = &render.gradients;
    let number = |map: &Vec<f64>| map.get(index).copied().unwrap_or_default();
    let ([r, g, b], [x, y, z]) = (maps.color.each_ref().map(number), maps.normal.each_ref().map(number));
    ([r, g, b, x, y, z, number(&maps.distance), number(&maps.opacity)], number(&maps.load))
}
