use super::*;
use crate::golden;
use crate::picture::test_picture;
use crate::rle;
use crate::sam::tests::likeness;

#[derive(serde::Deserialize)]
struct Run {
    seed: u64,
    size: [u32; 2],
    prompt: String,
    box_threshold: f32,
    boxes: Vec<[f32; 4]>,
    scores: Vec<f32>,
    labels: Vec<String>,
    union: String,
    best_union: String,
}

#[derive(serde::Deserialize)]
struct Goldens {
    language: Vec<Run>,
}

pub(crate) fn networks() -> LanguageSegmenter {
    let engine = golden::engine();
    LanguageSegmenter {
        detector: golden::bundle("tiny-dino").detector(&engine).expect("a detector"),
        segmenter: golden::bundle("tiny-sam2").segmenter(&engine).expect("a segmenter"),
        choice: MaskChoice::Single,
        tiling: Tiling::default(),
    }
}

fn go_on() -> Result<(), ModelError> {
    Ok(())
}

#[test]
fn words_give_the_boxes_and_masks_of_the_reference_pipeline() {
    let mut networks = networks();
    for run in golden::read::<Goldens>("runs.json").language {
        let [width, height] = run.size;
        let image = test_picture(run.seed, width, height);
        let prompt = Prompt { text: run.prompt.clone(), box_threshold: run.box_threshold, text_threshold: 0.25 };
        for (choice, wanted) in [(MaskChoice::Single, &run.union), (MaskChoice::Best, &run.best_union)] {
            networks.choice = choice;
            let found = networks.find(&image, &prompt, &go_on).expect("a mask");
            assert_eq!(found.detections.len(), run.boxes.len(), "{:?}", found.detections);
            for ((corners, score), label) in run.boxes.iter().zip(&run.scores).zip(&run.labels) {
                let near = |found: &&Detection| {
                    (0..4).all(|side| (found.corners[side] - corners[side]).abs() < 0.3)
                        && (found.score - score).abs() < 0.01
                };
                let partner = found.detections.iter().find(near);
                let partner = partner.unwrap_or_else(|| panic!("{corners:?} {score} in {:?}", found.detections));
                assert_eq!(&partner.label, label);
            }
            let like = likeness(&found.mask, &rle::decode(wanted, width, height).expect("a mask"));
            eprintln!("seed {}, {choice:?}: {} boxes, IoU {like:.5}", run.seed, run.boxes.len());
            assert!(like >= 0.999, "seed {}, {choice:?}: {like}", run.seed);
        }
    }
}

#[test]
fn tiles_join_without_a_seam() {
    let mut networks = networks();
    networks.tiling = Tiling { side_px: 100, overlap: 0.3 };
    let prompt = Prompt { box_threshold: 0.0, ..Prompt::default() };
    let image = test_picture(12, 150, 100);
    let found = networks.find(&image, &prompt, &go_on).expect("a mask");
    // The same by hand: two tiles, each as a picture of its own.
    networks.tiling.side_px = 0;
    let mut wanted = Map::filled(150, 100, false);
    for x0 in [0, 50] {
        let part = networks.find(&image.cropped(x0, 0, 100, 100), &prompt, &go_on).expect("a mask").mask;
        for (index, _) in part.values.iter().enumerate().filter(|(_, inside)| **inside) {
            wanted.set(x0 + index as u32 % 100, index as u32 / 100, true);
        }
    }
    assert_eq!(found.mask, wanted);
    assert!(wanted.values.iter().any(|inside| *inside) && wanted.values.iter().any(|inside| !*inside));
}

#[test]
fn nothing_found_is_an_empty_mask() {
    let prompt = Prompt { box_threshold: 1.0, ..Prompt::default() };
    let found = networks().find(&test_picture(11, 60, 50), &prompt, &go_on).expect("a mask");
    assert!(found.detections.is_empty() && !found.mask.values.contains(&true));
}
