use super::*;
use crate::golden;
use crate::picture::test_picture;
use crate::rle;
use pgsag_scene::Map;

#[test]
fn choices_take_the_tokens_that_they_name() {
    let sure = vec![vec![9.0; 4], vec![9.0; 4], vec![9.0; 4], vec![9.0; 4]];
    let masks = MaskLogits { size: [2, 2], masks: sure, scores: vec![0.1, 0.5, 0.9, 0.2] };
    assert_eq!(
        [MaskChoice::Single, MaskChoice::Stable, MaskChoice::Best].map(|choice| masks.chosen(choice)),
        [0, 0, 2]
    );
    let mut unsure = masks.clone();
    unsure.masks[0] = vec![0.01, 9.0, 9.0, -9.0];
    assert_eq!(unsure.chosen(MaskChoice::Stable), 2);
    unsure.masks.remove(0);
    unsure.scores.remove(0);
    assert_eq!(unsure.chosen(MaskChoice::Single), 1);
}

#[derive(serde::Deserialize)]
struct Click {
    seed: u64,
    size: [u32; 2],
    points: Vec<[f32; 2]>,
    labels: Vec<u8>,
    scores: Vec<f32>,
    masks: Vec<String>,
}

#[derive(serde::Deserialize)]
struct Goldens {
    clicks: Vec<Click>,
}

/// Pixels in both, as a share of those in either.
pub(crate) fn likeness(a: &Map<bool>, b: &Map<bool>) -> f64 {
    let count =
        |wanted: fn(bool, bool) -> bool| a.values.iter().zip(&b.values).filter(|(a, b)| wanted(**a, **b)).count();
    let either = count(|a, b| a || b);
    if either == 0 { 1.0 } else { count(|a, b| a && b) as f64 / either as f64 }
}

#[test]
fn points_and_boxes_give_the_masks_that_pytorch_gives() {
    let segmenter = golden::bundle("tiny-sam2").segmenter(&golden::engine()).expect("a segmenter");
    assert!(segmenter.has_single());
    for click in golden::read::<Goldens>("runs.json").clicks {
        let [width, height] = click.size;
        let kinds = [PointKind::Negative, PointKind::Positive, PointKind::Upper, PointKind::Lower];
        let points =
            click.points.iter().zip(&click.labels).map(|(at, kind)| (*at, kinds[usize::from(*kind)])).collect();
        let embedding = segmenter.embed(&test_picture(click.seed, width, height)).expect("an embedding");
        let found = &segmenter.decode(&embedding, &[PointPrompt { points }]).expect("masks")[0];
        for (token, (wanted, score)) in click.masks.iter().zip(&click.scores).enumerate() {
            let mut mask = Map::filled(width, height, false);
            crate::enlarge::mark(found.logits(token), &mut mask, [0, 0, width, height]);
            let like = likeness(&mask, &rle::decode(wanted, width, height).expect("a mask"));
            assert!(like >= 0.999, "seed {}, token {token}: {like}", click.seed);
            assert!((found.scores[token] - score).abs() <= 1e-4 * score.abs().max(1.0));
        }
    }
}

#[test]
fn a_prompt_without_points_is_refused() {
    let segmenter = golden::bundle("tiny-sam2").segmenter(&golden::engine()).expect("a segmenter");
    let embedding = segmenter.embed(&test_picture(1, 40, 30)).expect("an embedding");
    let error = segmenter.decode(&embedding, &[PointPrompt::default()]).expect_err("no points");
    assert!(error.to_string().contains("without points"), "{error}");
}
