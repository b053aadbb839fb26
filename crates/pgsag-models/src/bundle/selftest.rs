//! The self-test of a bundle: pictures that are made by rule, answers that PyTorch gave. It catches what no look at a
//! graph can: a kernel that rounds elsewhere, an operator computed as another, sizes frozen into the graph.

use serde::Deserialize;

use super::{Bundle, BundleKind, Engine, FileRole};
use crate::error::ModelError;
use crate::grounding::GroundingDino;
use crate::picture::{Canvasful, PictureRules, test_picture};
use crate::sam::{PointKind, PointPrompt, Sam2};

/// Largest difference of a box's centre or size, shares of the picture.
const BOX_TOLERANCE: f32 = 1e-4;
/// Largest difference of scores and masks, as a share of the largest.
const SCORE_TOLERANCE: f32 = 1e-2;
const MASK_TOLERANCE: f32 = 1e-3;
/// Rows of nearly equal rank may trade places at the cut of the best; so many of a hundred may find no partner.
const LOST_PER_CENT: usize = 1;

#[derive(Debug, Deserialize)]
struct Cases<C> {
    cases: Vec<C>,
}

#[derive(Debug, Deserialize)]
struct DetectorCase {
    seed: u64,
    width: u32,
    height: u32,
    ids: Vec<u32>,
    boxes: Vec<[f32; 4]>,
    scores: Vec<f32>,
}

#[derive(Debug, Deserialize)]
struct SegmenterCase {
    seed: u64,
    width: u32,
    height: u32,
    points: Vec<Vec<[f32; 2]>>,
    labels: Vec<Vec<u8>>,
    masks: Vec<Vec<Vec<Vec<f32>>>>,
    mask_step: usize,
    scores: Vec<Vec<f32>>,
    largest: f32,
}

/// How one case came out.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// The case, for people.
    pub case: String,
    /// What differs, for people.
    pub words: String,
    /// Whether that is within the tolerance.
    pub is_right: bool,
}

/// Runs a bundle's self-test.
///
/// # Errors
/// [`ModelError`] where the bundle has none, cannot be loaded, or stops.
pub fn verify_answers(bundle: &Bundle, engine: &Engine) -> Result<Vec<Comparison>, ModelError> {
    let path = bundle.file(FileRole::Selftest)?;
    let cure = "export the bundle again";
    let text = std::fs::read_to_string(&path).map_err(|cause| ModelError::file(&path, cause, cure))?;
    let image = &bundle.manifest.image;
    let refused = || ModelError::file(&path, "its cases are none, or do not hold together", cure);
    match bundle.manifest.kind {
        BundleKind::Detector => {
            let file: Cases<DetectorCase> =
                serde_json::from_str(&text).map_err(|cause| ModelError::file(&path, cause, cure))?;
            let is_sound = |case: &DetectorCase| !case.boxes.is_empty() && case.scores.len() == case.boxes.len();
            if file.cases.is_empty()
                || !file.cases.iter().all(|case| is_sound(case) && is_sane(case.width, case.height))
            {
                return Err(refused());
            }
            let detector = bundle.detector(engine)?;
            file.cases.iter().map(|case| compare_detector(&detector, image, case)).collect()
        }
        BundleKind::Segmenter => {
            let file: Cases<SegmenterCase> =
                serde_json::from_str(&text).map_err(|cause| ModelError::file(&path, cause, cure))?;
            let is_sound = |case: &SegmenterCase| {
                let count = case.points.len();
                count > 0 && [case.labels.len(), case.masks.len(), case.scores.len()] == [count; 3]
            };
            if file.cases.is_empty()
                || !file.cases.iter().all(|case| is_sound(case) && is_sane(case.width, case.height))
            {
                return Err(refused());
            }
            let segmenter = bundle.segmenter(engine)?;
            file.cases.iter().map(|case| compare_segmenter(&segmenter, case)).collect()
        }
    }
}

/// Whether a picture of a self-test has a size that a network could be given.
fn is_sane(width: u32, height: u32) -> bool {
    [width, height].iter().all(|side| (1..=super::LARGEST_SIDE).contains(side))
}

fn compare_detector(
    detector: &GroundingDino,
    image: &PictureRules,
    case: &DetectorCase,
) -> Result<Comparison, ModelError> {
    let size = [case.width, case.height].map(|side| side as usize);
    // The picture has the size that the case was made at: nothing is resized here.
    let rules = PictureRules { shortest: Some(case.width.min(case.height)), fixed: None, ..image.clone() };
    let rules = PictureRules { longest: Some(case.width.max(case.height)), ..rules };
    let pixels = rules.detector_picture(&test_picture(case.seed, case.width, case.height))?.pixels;
    let queries =
        detector.queries(&Canvasful { pixels, canvas: size, covered: size }, std::slice::from_ref(&case.ids))?;
    let lost = unmatched(&case.boxes, &case.scores, &queries.boxes, &queries.best());
    Ok(Comparison {
        case: format!("{} x {}, {} tokens", case.width, case.height, case.ids.len()),
        words: format!("{lost} of {} boxes without a partner", case.boxes.len()),
        is_right: 100 * lost <= LOST_PER_CENT * case.boxes.len(),
    })
}

/// Expected rows that have no partner among the given ones.
pub(crate) fn unmatched(boxes: &[[f32; 4]], scores: &[f32], found: &[[f32; 4]], found_scores: &[f32]) -> usize {
    let largest =
        scores.iter().copied().filter(|score| *score > -1e29).fold(1.0, |most: f32, score| most.max(score.abs()));
    let is_near = |row: usize, other: usize| {
        (0..4).all(|side| (boxes[row][side] - found[other][side]).abs() <= BOX_TOLERANCE)
            && (scores[row] - found_scores[other]).abs() <= SCORE_TOLERANCE * largest
    };
    (0..boxes.len()).filter(|&row| !(0..found.len()).any(|other| is_near(row, other))).count()
}

fn compare_segmenter(segmenter: &Sam2, case: &SegmenterCase) -> Result<Comparison, ModelError> {
    let embedding = segmenter.embed(&test_picture(case.seed, case.width, case.height))?;
    let kind = |label: u8| match label {
        0 => PointKind::Negative,
        1 => PointKind::Positive,
        2 => PointKind::Upper,
        _ => PointKind::Lower,
    };
    let prompt = |(points, labels): (&Vec<[f32; 2]>, &Vec<u8>)| PointPrompt {
        points: points.iter().zip(labels).map(|(at, label)| (*at, kind(*label))).collect(),
    };
    let prompts: Vec<PointPrompt> = case.points.iter().zip(&case.labels).map(prompt).collect();
    let mut worst = 0.0f32;
    for ((found, masks), scores) in segmenter.decode(&embedding, &prompts)?.iter().zip(&case.masks).zip(&case.scores) {
        let first = masks.len().saturating_sub(found.masks.len());
        for (token, (mask, score)) in masks.iter().zip(scores).enumerate().skip(first) {
            let got = found.logits(token - first);
            for (row, expected) in mask.iter().enumerate() {
                for (column, expected) in expected.iter().enumerate() {
                    let at = row * case.mask_step * got.size[0] + column * case.mask_step;
                    let value = got.values.get(at).copied().unwrap_or(f32::INFINITY);
                    worst = worst.max((value - expected).abs() / case.largest.max(1e-6));
                }
            }
            worst = worst.max((found.scores[token - first] - score).abs() / score.abs().max(1.0));
        }
    }
    Ok(Comparison {
        case: format!("picture {}, {} prompts", case.seed, prompts.len()),
        words: format!("largest relative difference {worst:.1e}"),
        is_right: worst <= MASK_TOLERANCE,
    })
}
