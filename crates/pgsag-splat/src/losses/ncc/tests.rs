use super::*;
use crate::equations::algebra::transpose_vec;
use crate::losses::tests::{loss_view, planes, planes_mut, print_processor_time, turned};
use crate::proof;

const WIDTH: u32 = 30;
const HEIGHT: u32 = 24;
const COUNT: usize = (WIDTH * HEIGHT) as usize;

fn wave(x: f64, y: f64) -> f32 {
    (0.5 + 0.2 * libm::sin(2.3 * x + 0.4) * libm::cos(1.7 * y) + 0.15 * libm::sin(3.1 * y - 0.9 * x)) as f32
}

/// Two views of one smooth texture on the plane z = 4.
fn views() -> (LossView, LossView) {
    let mut pair = (loss_view(WIDTH, HEIGHT, 1, false), turned(WIDTH, HEIGHT, 2, false));
    for view in [&mut pair.0, &mut pair.1] {
        let lens = Lens::<f64>::new(&view.camera);
        for index in 0..COUNT {
            let ray = lens.ray((index % WIDTH as usize) as f64, (index / WIDTH as usize) as f64);
            let world = transpose_vec(&lens.rotation, ray);
            let depth = (4.0 - lens.eye[2]) / world[2];
            view.gray[index] = wave(lens.eye[0] + depth * world[0], lens.eye[1] + depth * world[1]);
        }
    }
    pair
}

fn inputs<'a>(
    pair: &'a (LossView, LossView),
    normal: &'a [f64],
    distance: &'a [f64],
    weights: &'a [f64],
) -> NccInputs<'a, f64> {
    NccInputs { view: &pair.0, neighbor: &pair.1, normal: planes(normal), distance, weights, patch_limit: 50, seed: 11 }
}

#[test]
fn ncc_grad_matches_differences() {
    let pair = views();
    let weights = vec![0.8; COUNT];
    let mut random = SplitMix64::new(6);
    let mut at: Vec<f64> = (0..COUNT).map(|_| random.range(3.0, 3.3)).collect();
    for (low, high) in [(-0.1, 0.1), (-0.1, 0.1), (-0.85, -0.8)] {
        at.extend((0..COUNT).map(|_| random.range(low, high)));
    }
    let value = |at: &[f64]| {
        let (mut d_normal, mut d_distance) = (vec![0.0; 3 * COUNT], vec![0.0; COUNT]);
        let inputs = inputs(&pair, &at[COUNT..], &at[..COUNT], &weights);
        let (value, kept) = ncc(&inputs, 1.0, planes_mut(&mut d_normal), &mut d_distance);
        (value, kept, [d_distance, d_normal].concat())
    };
    let (loss, kept, gradient) = value(&at);
    assert!(kept > 30 && loss > 0.0, "{kept} {loss}");
    proof::gradient_with_step(|at| value(at).0, &at, &gradient, 1e-6, 1e-7);
}

#[test]
fn the_true_plane_correlates_and_a_wrong_one_does_not() {
    let pair = views();
    let weights = vec![1.0; COUNT];
    let normal = [0.0, 0.0, -1.0].map(|value| vec![value; COUNT]).concat();
    let loss = |distance: f64| {
        let distance = vec![distance; COUNT];
        ncc(&inputs(&pair, &normal, &distance, &weights), 0.0, planes_mut(&mut vec![0.0; 3 * COUNT]), &mut [0.0; COUNT])
    };
    let (right, kept) = loss(4.0);
    assert!(kept > 30 && right < 0.05, "{right} {kept}");
    assert!(loss(3.4).0 > 2.0 * right);
}

#[test]
fn inverted_contrast_is_refused() {
    let mut pair = views();
    pair.1.gray.iter_mut().for_each(|value| *value = 1.0 - *value);
    let normal = [0.0, 0.0, -1.0].map(|value| vec![value; COUNT]).concat();
    let (distance, weights) = (vec![4.0; COUNT], vec![1.0; COUNT]);
    let found = ncc(
        &inputs(&pair, &normal, &distance, &weights),
        0.0,
        planes_mut(&mut vec![0.0; 3 * COUNT]),
        &mut [0.0; COUNT],
    );
    assert_eq!(found.1, 0);
}

#[test]
fn patches_are_drawn_once_and_by_seed() {
    let pair = views();
    let normal = [0.0, 0.0, -1.0].map(|value| vec![value; COUNT]).concat();
    let (distance, weights) = (vec![4.0; COUNT], vec![1.0; COUNT]);
    let mut ask = inputs(&pair, &normal, &distance, &weights);
    let first = draw(&ask);
    assert_eq!(first.len(), 50);
    assert!(first.windows(2).all(|two| two[0] < two[1]));
    assert_eq!(first, draw(&ask));
    ask.seed = 12;
    assert_ne!(first, draw(&ask));
}

#[test]
#[ignore = "a measurement: cargo test --release -p pgsag-splat -- --ignored ncc_speed --nocapture"]
fn ncc_speed() {
    let (width, height) = (800, 600);
    let pair = (loss_view(width, height, 1, false), turned(width, height, 2, false));
    let count = (width * height) as usize;
    let normal = [0.0f32, 0.0, -1.0].map(|value| vec![value; count]).concat();
    let (distance, weights) = (vec![4.0; count], vec![1.0; count]);
    let (view, neighbor) = (&pair.0, &pair.1);
    let (normal, distance, weights) = (planes(&normal), &distance[..], &weights[..]);
    let inputs = NccInputs { view, neighbor, normal, distance, weights, patch_limit: 10_000, seed: 1 };
    print_processor_time("10000 patches", || {
        ncc(&inputs, 1.0, planes_mut(&mut vec![0.0; 3 * count]), &mut vec![0.0; count]);
    });
}
