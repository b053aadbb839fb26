use pgsag_scene::numbers::SplitMix64;

use super::*;
use crate::losses::tests::{loss_view, no_weights, planes, turned};
use crate::proof;

const COUNT: usize = 30 * 24;

/// Maps of a fronto-parallel wall with noise.
struct Maps {
    color: Vec<f64>,
    normal: Vec<f64>,
    distance: Vec<f64>,
    opacity: Vec<f64>,
    load: Vec<f64>,
}

impl Maps {
    fn new(seed: u64) -> Self {
        let mut random = SplitMix64::new(seed);
        Self {
            color: proof::numbers(&mut random, 3 * COUNT, 0.0, 1.0),
            normal: [proof::numbers(&mut random, 2 * COUNT, -0.1, 0.1), vec![-0.9; COUNT]].concat(),
            distance: proof::numbers(&mut random, COUNT, 3.5, 3.6),
            opacity: proof::numbers(&mut random, COUNT, 0.8, 1.0),
            load: proof::numbers(&mut random, COUNT, 1.0, 20.0),
        }
    }

    fn rendered(&self) -> RenderedMaps<'_, f64> {
        let Self { color, normal, distance, opacity, load } = self;
        RenderedMaps { color: planes(color), normal: planes(normal), distance, opacity, load }
    }
}

fn run(weights: &LossWeights) -> Evaluation<f64> {
    let (own, other) = (Maps::new(1), Maps::new(2));
    let (view, neighbor) = (loss_view(30, 24, 3, true), turned(30, 24, 4, true));
    evaluate(&Inputs {
        view: &view,
        maps: own.rendered(),
        neighbor: Some((&neighbor, other.rendered())),
        exposure: Exposure::NEUTRAL,
        weights,
        flatness: 0.25,
        seed: 1,
    })
}

#[test]
fn terms_without_weight_cost_nothing() {
    let out = run(&no_weights());
    assert_eq!(out.reference, MapGradients::default());
    assert_eq!(out.neighbor, MapGradients::default());
    assert_eq!(out.total, 0.0);
    let out = run(&LossWeights { normal: 1.0, ..no_weights() });
    assert!(out.reference.color[0].is_empty() && out.reference.load.is_empty() && out.neighbor.distance.is_empty());
    assert!(out.total > 0.0);
}

#[test]
fn the_total_is_the_weighted_sum() {
    let weights = LossWeights {
        l1: 0.8,
        dssim: 0.2,
        flatness: 2.0,
        normal: 0.5,
        geometric: 0.3,
        geometric_gate_px: 4.0,
        ncc: 0.1,
        free_opacity: 0.7,
        ..no_weights()
    };
    let Evaluation { values, total, .. } = run(&weights);
    let sum = 0.8 * values.l1 + 0.2 * values.dssim + 2.0 * values.flatness + 0.5 * values.normal;
    let sum = sum + 0.3 * values.geometric + 0.1 * values.ncc + 0.7 * values.free_opacity;
    assert!((f64::from(sum) - total).abs() < 1e-6, "{sum} {total}");
    assert!(values.geometric > 0.0 && values.geometric_valid > 0.1 && values.free_opacity > 0.8);
}

#[test]
fn the_load_term_is_a_tenth_of_the_main_loss() {
    let main = run(&LossWeights { l1: 1.0, ..no_weights() });
    let both = run(&LossWeights { l1: 1.0, load: 0.41, ..no_weights() });
    let ratio = both.total / main.total - 1.0;
    assert!((ratio - 0.1 * 0.41 / 0.59).abs() < 1e-6, "{ratio}");
    // L_load = s σ grows in proportion when every load does: Σ load ∂L/∂load = s σ.
    let load = Maps::new(1).load;
    let euler: f64 = both.reference.load.iter().zip(&load).map(|(d, load)| d * load).sum();
    assert!((euler - (both.total - main.total)).abs() < 1e-9);
}
