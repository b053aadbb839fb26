use pgsag_scene::numbers::SplitMix64;

use super::*;
use crate::losses::tests::loss_view;
use crate::proof;

fn prove(reading: Reading, mean_over_mask: bool) {
    let view = loss_view(16, 12, 3, true);
    let at = proof::numbers(&mut SplitMix64::new(5), 16 * 12, 0.0, 20.0);
    let value = |at: &[f64]| {
        let mut d_load = vec![0.0; at.len()];
        let sigma = load_balance(&view, at, reading, mean_over_mask, |_| 1.0, &mut d_load);
        (sigma, d_load)
    };
    let (sigma, gradient) = value(&at);
    assert!(sigma > 0.0);
    proof::gradient(|at| value(at).0, &at, &gradient, 1e-6);
}

#[test]
fn load_balance_grad_matches_differences_as_code() {
    prove(Reading::Code, true);
}

#[test]
fn load_balance_grad_matches_differences_as_printed() {
    prove(Reading::Paper, false);
}

#[test]
fn equal_load_costs_nothing() {
    let mut view = loss_view(16, 12, 3, true);
    view.gradient.printed.fill(0.0);
    let mut d_load = vec![0.0; 192];
    assert_eq!(load_balance(&view, &[7.0; 192], Reading::Code, true, |_| 1.0, &mut d_load), 0.0);
    assert!(d_load.iter().all(|&d| d == 0.0));
}
