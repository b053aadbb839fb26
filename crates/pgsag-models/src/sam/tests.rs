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

/// By the number that the network knows them by.
const KINDS: [PointKind; 4] = [PointKind::Negative, PointKind::Positive, PointKind::Upper, PointKind::Lower];

#[test]
fn points_and_boxes_give_the_masks_that_pytorch_gives() {
    let segmenter = golden::bundle("tiny-sam2").segmenter(&golden::engine()).expect("a segmenter");
    assert!(segmenter.has_single());
    for click in golden::read::<Goldens>("runs.json").clicks {
        let [width, height] = click.size;
        let points =
            click.points.iter().zip(&click.labels).map(|(at, kind)| (*at, KINDS[usize::from(*kind)])).collect();
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

#[derive(serde::Deserialize)]
struct Sampled {
    step: usize,
    values: Vec<f32>,
    largest: f32,
}

impl Sampled {
    /// The largest difference, as a share of the largest value.
    fn error(&self, found: &[f32]) -> f32 {
        assert_eq!(found.len().div_ceil(self.step), self.values.len());
        let pairs = found.iter().step_by(self.step).zip(&self.values);
        pairs.map(|(found, wanted)| (found - wanted).abs()).fold(0.0, f32::max) / self.largest
    }
}

#[derive(serde::Deserialize)]
struct Parity {
    name: String,
    seed: u64,
    points: Vec<Vec<[f32; 2]>>,
    labels: Vec<Vec<u8>>,
    levels: Vec<Sampled>,
    masks: Sampled,
    scores: Vec<f32>,
}

#[derive(serde::Deserialize)]
struct ParityGoldens {
    segmenter: Vec<Parity>,
}

#[test]
fn embeddings_and_all_four_tokens_agree_with_pytorch() {
    let segmenter = golden::bundle("tiny-sam2").segmenter(&golden::engine()).expect("a segmenter");
    let (side, cases) = (segmenter.square(), golden::read::<ParityGoldens>("parity.json").segmenter);
    assert_eq!(cases.len(), 6);
    for case in cases {
        let embedding = segmenter.embed(&test_picture(case.seed, side, side)).expect("an embedding");
        assert_eq!(embedding.levels.len(), case.levels.len());
        let levels = embedding.levels.iter().zip(&case.levels);
        let encoder = levels
            .map(|(found, wanted)| wanted.error(found.as_floats("level", 4).expect("floats")))
            .fold(0.0, f32::max);
        let prompt = |(points, labels): (&Vec<[f32; 2]>, &Vec<u8>)| PointPrompt {
            points: points.iter().zip(labels).map(|(at, label)| (*at, KINDS[usize::from(*label)])).collect(),
        };
        let prompts: Vec<PointPrompt> = case.points.iter().zip(&case.labels).map(prompt).collect();
        let found = segmenter.decode(&embedding, &prompts).expect("masks");
        assert!(found.iter().all(|masks| masks.masks.len() == 4));
        let decoder = case.masks.error(&found.iter().flat_map(|masks| masks.masks.concat()).collect::<Vec<f32>>());
        let scores = found.iter().flat_map(|masks| &masks.scores).zip(&case.scores);
        let scores = scores.map(|(found, wanted)| (found - wanted).abs() / wanted.abs().max(1.0)).fold(0.0, f32::max);
        eprintln!("{}: encoder {encoder:.1e}, masks {decoder:.1e}, scores {scores:.1e}", case.name);
        assert!(encoder <= 1e-4 && decoder <= 1e-4 && scores <= 1e-4, "{}", case.name);
    }
}

#[test]
fn a_prompt_without_points_is_refused() {
    let segmenter = golden::bundle("tiny-sam2").segmenter(&golden::engine()).expect("a segmenter");
    let embedding = segmenter.embed(&test_picture(1, 40, 30)).expect("an embedding");
    let error = segmenter.decode(&embedding, &[PointPrompt::default()]).expect_err("no points");
    assert!(error.to_string().contains("without points"), "{error}");
}
