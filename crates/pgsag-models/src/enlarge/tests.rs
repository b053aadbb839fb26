use super::*;
use crate::golden;

#[derive(serde::Deserialize)]
struct Case {
    to: [u32; 2],
    values: Vec<f32>,
    above: u64,
    stability: f32,
}

#[derive(serde::Deserialize)]
struct Goldens {
    logits: Vec<f32>,
    upsample: Vec<Case>,
}

#[test]
fn logits_grow_as_torch_lets_them_grow() {
    let goldens: Goldens = golden::read("pixels.json");
    let logits = Logits { size: [16, 16], values: &goldens.logits };
    for case in goldens.upsample {
        let [width, height] = case.to;
        let mut all = Vec::new();
        rows(logits, width, height, |_, row| all.extend_from_slice(row));
        for (got, wanted) in all.iter().step_by(7).zip(&case.values) {
            assert!((got - wanted).abs() < 2e-6, "{got} instead of {wanted}");
        }
        let outline = outline(logits, width, height, 1.0);
        assert_eq!(outline.area_px, case.above);
        assert!((outline.stability - case.stability).abs() < 1e-6);
    }
}

#[test]
fn a_window_of_the_mask_is_marked_and_nothing_else() {
    let mut mask = Map::filled(6, 5, false);
    mark(Logits { size: [2, 1], values: &[-1.0, 1.0] }, &mut mask, [1, 2, 5, 4]);
    let on: Vec<usize> = (0..30).filter(|&at| mask.values[at]).collect();
    assert_eq!(on, [15, 16, 21, 22]);
    let outline = outline(Logits { size: [2, 1], values: &[-1.0, 1.0] }, 4, 2, 0.4);
    assert_eq!((outline.area_px, outline.corners), (4, [2.0, 0.0, 3.0, 1.0]));
}

#[test]
fn the_stability_of_a_small_map_is_a_share_of_pixels() {
    assert_eq!(small_stability(&[0.06, -0.01, 0.2, -3.0], 0.05), 2.0 / 3.0);
    assert_eq!(small_stability(&[-1.0], 0.05), 1.0);
}
