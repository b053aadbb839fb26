use super::*;
use crate::golden;
use crate::picture::test_picture;
use crate::rle;
use crate::sam::tests::likeness;

#[derive(serde::Deserialize)]
struct Mask {
    counts: String,
    iou: f32,
}

#[derive(serde::Deserialize)]
struct Run {
    seed: u64,
    size: [u32; 2],
    layers: u32,
    side: u32,
    least_iou: f32,
    least_stability: f32,
    overlap: f32,
    masks: Vec<Mask>,
}

#[derive(serde::Deserialize)]
struct Goldens {
    everything: Vec<Run>,
}

#[test]
fn a_grid_of_clicks_gives_the_reference_s_masks() {
    let segmenter = golden::bundle("tiny-sam2").segmenter(&golden::engine()).expect("a segmenter");
    for run in golden::read::<Goldens>("runs.json").everything {
        let [width, height] = run.size;
        let options = EverythingOptions {
            points_per_side: run.side,
            least_iou: run.least_iou,
            least_stability: run.least_stability,
            crop_layers: run.layers,
            most_overlap: run.overlap,
            ..EverythingOptions::default()
        };
        let go_on = || Ok::<(), ModelError>(());
        let found = segments(&segmenter, &test_picture(run.seed, width, height), &options, &go_on).expect("segments");
        assert_eq!(found.len(), run.masks.len());
        let (mut union, mut numbers) = (Map::filled(width, height, false), Map::filled(width, height, 0));
        (1..).zip(&found).for_each(|(number, segment)| {
            segment.mark(&mut union);
            segment.paint(&mut numbers, number);
        });
        assert!(union.values.iter().zip(&numbers.values).all(|(inside, number)| *inside == (*number > 0)));
        for wanted in &run.masks {
            let truth = rle::decode(&wanted.counts, width, height).expect("a mask");
            let best = found.iter().map(|segment| {
                let mut mask = Map::filled(width, height, false);
                segment.mark(&mut mask);
                (likeness(&mask, &truth), segment.score)
            });
            let (like, score) = best.max_by(|a, b| a.0.total_cmp(&b.0)).expect("segments");
            assert!(like >= 0.99 && (score - wanted.iou).abs() < 1e-3, "seed {}: {like} {score}", run.seed);
        }
    }
}
