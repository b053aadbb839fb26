use pgsag_scene::numbers::SplitMix64;

use super::*;
use crate::losses::tests::{loss_view, no_weights, planes, planes_mut};
use crate::proof;

const WIDTH: usize = 18;
const HEIGHT: usize = 15;

/// A wavy surface with a hole, and normals that are about right.
fn depths_and_normals() -> Vec<f64> {
    let mut random = SplitMix64::new(4);
    let mut all: Vec<f64> = (0..WIDTH * HEIGHT)
        .map(|i| 5.0 + 0.5 * libm::sin(0.7 * (i % WIDTH) as f64) + 0.1 * (i / WIDTH) as f64 + random.range(0.0, 0.05))
        .collect();
    for (low, high) in [(-0.3, 0.3), (-0.3, 0.3), (-0.9, -0.6)] {
        all.extend((0..WIDTH * HEIGHT).map(|_| random.range(low, high)));
    }
    // Empty, and far enough below 0 for differences not to fill it.
    all[7 * WIDTH + 9] = -1.0;
    all
}

/// The term alone; nothing follows.
fn alone(
    (view, maps, weights): (&LossView, NormalMaps<'_, f64>, &LossWeights),
    d_normal: &mut [f64],
    depth: &mut [f64],
) -> f64 {
    let distance = &mut vec![0.0; depth.len()];
    let gradients = NormalGradients { normal: planes_mut(d_normal), depth, distance };
    boundary_normal(view, maps, weights, 1.0, gradients, |_, _, _, _| (), &Spare::default())
}

fn prove(reading: Reading, normal_image_gradient: bool, mean_over_mask: bool) {
    let view = loss_view(WIDTH as u32, HEIGHT as u32, 8, true);
    let weights = LossWeights { reading, normal_image_gradient, mean_over_mask, ..no_weights() };
    let opacity = proof::numbers(&mut SplitMix64::new(2), WIDTH * HEIGHT, 0.5, 1.0);
    let count = WIDTH * HEIGHT;
    let value = |at: &[f64]| {
        let maps = NormalMaps { normal: planes(&at[count..]), opacity: &opacity, depth: &at[..count] };
        let (mut d_normal, mut d_depth) = (vec![0.0; 3 * count], vec![0.0; count]);
        let value = alone((&view, maps, &weights), &mut d_normal, &mut d_depth);
        (value, [d_depth, d_normal].concat())
    };
    let mut at = depths_and_normals();
    for (depth, active) in at.iter_mut().zip(&view.active) {
        *depth = if *active { *depth } else { -1.0 };
    }
    let (loss, gradient) = value(&at);
    assert!(loss > 0.0);
    proof::gradient_with_step(|at| value(at).0, &at, &gradient, 1e-6, 1e-6);
}

#[test]
fn boundary_normal_grad_matches_differences_as_code() {
    prove(Reading::Code, false, true);
}

#[test]
fn boundary_normal_grad_matches_differences_as_printed() {
    prove(Reading::Paper, true, false);
}

#[test]
fn a_plane_agrees_with_itself() {
    let view = loss_view(24, 20, 8, true);
    let lens = Lens::<f64>::new(&view.camera);
    let (n, d) = ([0.36, -0.48, -0.8], 4.0);
    let depth: Vec<f64> = (0..24 * 20).map(|i| -d / dot(n, lens.ray((i % 24) as f64, (i / 24) as f64))).collect();
    let normal = n.map(|value| vec![0.7 * value; 24 * 20]).concat();
    let maps = NormalMaps { normal: planes(&normal), opacity: &[0.7; 24 * 20], depth: &depth };
    let mut d_normal = vec![0.0; 3 * 24 * 20];
    let loss = alone((&view, maps, &no_weights()), &mut d_normal, &mut [0.0; 24 * 20]);
    assert!(loss < 1e-12, "{loss}");
}

#[test]
fn boundary_weighs_a_tenth() {
    let mut view = loss_view(24, 20, 8, false);
    let depth = vec![3.0; 24 * 20];
    let normal = [0.5, 0.0, -0.8].map(|value| vec![value; 24 * 20]).concat();
    let maps = NormalMaps { normal: planes(&normal), opacity: &[1.0; 24 * 20], depth: &depth };
    let loss = |view: &LossView| alone((view, maps, &no_weights()), &mut [0.0; 3 * 480], &mut [0.0; 480]);
    let inside = loss(&view);
    view.edge.fill(true);
    let edge = loss(&view);
    assert!((edge / inside - 0.1).abs() < 1e-7, "{inside} {edge}");
}
