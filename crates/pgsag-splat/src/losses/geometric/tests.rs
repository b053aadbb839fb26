use super::*;
use crate::losses::tests::{loss_view, turned};
use crate::proof;

const WIDTH: usize = 20;
const HEIGHT: usize = 16;
const COUNT: usize = WIDTH * HEIGHT;

/// Depth of a wavy wall about the plane z = 4 + slope, seen from a view.
fn depths(view: &LossView, seed: u64) -> Vec<f64> {
    let lens = Lens::<f64>::new(&view.camera);
    let mut random = pgsag_scene::numbers::SplitMix64::new(seed);
    (0..COUNT)
        .map(|index| {
            let ray = lens.ray((index % WIDTH) as f64, (index / WIDTH) as f64);
            // The plane n · X = 4 of the group, along the ray from the eye.
            let normal = [0.1, -0.2, 1.0];
            let world = transpose_vec(&lens.rotation, ray);
            let along = dot(normal, world);
            (4.0 - dot(normal, lens.eye)) / along + random.range(-0.02, 0.02)
        })
        .collect()
}

#[test]
fn geometric_grad_matches_differences_in_both_depths() {
    let reference = loss_view(WIDTH as u32, HEIGHT as u32, 1, true);
    let neighbor = turned(WIDTH as u32, HEIGHT as u32, 2, true);
    let at = [depths(&reference, 3), depths(&neighbor, 4)].concat();
    // Weights are detached: they are held at their values at `at`.
    let found = |at: &[f64], d: [&mut [f64]; 2]| {
        let side = |view, depth| DepthView { view, depth };
        let mut weights = vec![0.0; COUNT];
        let term = geometric(side(&reference, &at[..COUNT]), side(&neighbor, &at[COUNT..]), 2.0, 1.0, &mut weights, d);
        (term, weights)
    };
    let (mut d_reference, mut d_neighbor) = (vec![0.0; COUNT], vec![0.0; COUNT]);
    let (held, weights) = found(&at, [&mut d_reference, &mut d_neighbor]);
    assert!(held.valid_count > 60, "{}", held.valid_count);
    let pair = Pair::<f64>::new(&reference, &neighbor, 2.0);
    let value = |at: &[f64]| {
        let side = DepthView { view: &neighbor, depth: &at[COUNT..] };
        let error = |index: usize| {
            let pixel = [(index % WIDTH) as f64, (index / WIDTH) as f64];
            let ray = pair.lenses[0].ray(pixel[0], pixel[1]);
            let there = add(mat_vec(&pair.between.rotation, scale(ray, at[index])), pair.between.translation);
            read(&side, &pair, there, at[index]).map_or(f64::NAN, |read| trip(&pair, pixel, ray, there, &read).error)
        };
        let sum: f64 =
            (0..COUNT).filter(|&index| weights[index] > 0.0).map(|index| weights[index] * error(index)).sum();
        sum / held.valid_count as f64
    };
    assert!((value(&at) - held.value).abs() < 1e-12);
    proof::gradient_with_step(value, &at, &[d_reference, d_neighbor].concat(), 1e-6, 1e-6);
}

#[test]
fn one_plane_seen_twice_comes_back() {
    let reference = loss_view(WIDTH as u32, HEIGHT as u32, 1, false);
    // The same camera: every trip ends where it began, but for rounding at the very border.
    let depth = depths(&reference, 3);
    let side = DepthView { view: &reference, depth: &depth };
    let found = geometric(side, side, 1.0, 0.0, &mut [0.0; COUNT], [&mut [], &mut []]);
    assert!(found.value < 1e-12);
    assert!(found.valid_count >= (WIDTH - 2) * (HEIGHT - 2));
}

#[test]
fn masks_of_both_views_gate() {
    let reference = loss_view(WIDTH as u32, HEIGHT as u32, 1, true);
    let mut neighbor = turned(WIDTH as u32, HEIGHT as u32, 2, false);
    let (a, b) = (depths(&reference, 3), depths(&neighbor, 4));
    let count = |neighbor: &LossView| {
        let n = DepthView { view: neighbor, depth: &b };
        let mut weights = vec![0.0; COUNT];
        let r = DepthView { view: &reference, depth: &a };
        (geometric(r, n, 2.0, 0.0, &mut weights, [&mut [], &mut []]), weights)
    };
    let (_, open) = count(&neighbor);
    assert!((0..COUNT).all(|index| open[index] == 0.0 || reference.is_active(index)));
    neighbor.quad_fits.fill(false);
    assert_eq!(count(&neighbor).0.valid_count, 0);
}
