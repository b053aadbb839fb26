use super::*;
use crate::bundle::Bundle;
use crate::golden;
use crate::picture::test_picture;

#[derive(serde::Deserialize)]
struct Blocks {
    ids: Vec<u32>,
    attention: Vec<Vec<u8>>,
    position: Vec<i64>,
}

#[derive(serde::Deserialize)]
struct Words {
    blocks: Vec<Blocks>,
}

#[test]
fn text_blocks_are_those_of_transformers() {
    for case in golden::read::<Words>("words.json").blocks {
        let blocks = text_blocks(&case.ids);
        assert_eq!(blocks.positions, case.position, "{:?}", case.ids);
        let wanted: Vec<bool> = case.attention.iter().flatten().map(|value| *value != 0).collect();
        assert_eq!(blocks.attention, wanted, "{:?}", case.ids);
    }
}

#[derive(serde::Deserialize)]
struct Parity {
    name: String,
    seeds: Vec<u64>,
    picture: [u32; 2],
    canvas: [usize; 2],
    ids: Vec<Vec<u32>>,
    boxes: Vec<Vec<[f32; 4]>>,
    scores: Vec<Vec<f32>>,
}

#[derive(serde::Deserialize)]
struct Goldens {
    detector: Vec<Parity>,
}

fn detector() -> GroundingDino {
    golden::bundle("tiny-dino").detector(&golden::engine()).expect("a detector")
}

/// The case's pictures in the upper left corners of their canvases.
fn canvas(case: &Parity, rules: &PictureRules) -> Canvasful {
    let size = case.picture.map(|side| side as usize);
    let rules = PictureRules { shortest: Some(case.picture[0].min(case.picture[1])), ..rules.clone() };
    let (mut pixels, plane) = (Vec::new(), case.canvas[0] * case.canvas[1]);
    for seed in &case.seeds {
        let one = rules.detector_picture(&test_picture(*seed, case.picture[0], case.picture[1])).expect("a picture");
        assert_eq!(one.canvas, size);
        let values = one.pixels.as_floats("pixels", 4).expect("floats").to_vec();
        let mut canvas = vec![0.0; 3 * plane];
        for row in 0..3 * size[1] {
            let (channel, y) = (row / size[1], row % size[1]);
            canvas[channel * plane + y * case.canvas[0]..][..size[0]]
                .copy_from_slice(&values[row * size[0]..][..size[0]]);
        }
        pixels.extend(canvas);
    }
    let shape = [case.seeds.len(), 3, case.canvas[1], case.canvas[0]];
    Canvasful { pixels: Tensor::floats(&shape, pixels), canvas: case.canvas, covered: size }
}

/// The largest difference of any side between an expected box and its partner.
fn farthest(boxes: &[[f32; 4]], found: &[[f32; 4]]) -> f32 {
    let apart = |a: &[f32; 4], b: &[f32; 4]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let nearest = |wanted| found.iter().map(|found| apart(wanted, found)).fold(f32::INFINITY, f32::min);
    boxes.iter().map(nearest).fold(0.0, f32::max)
}

#[test]
fn texts_sizes_padding_and_batches_agree_with_pytorch() {
    let (detector, rules) = (detector(), golden::bundle("tiny-dino").manifest.image);
    let cases = golden::read::<Goldens>("parity.json").detector;
    assert_eq!(cases.len(), 7);
    for case in cases {
        let texts: Vec<Vec<u32>> =
            case.ids.iter().map(|ids| ids.iter().copied().filter(|id| *id > 0).collect()).collect();
        let found = detector.queries(&canvas(&case, &rules), &texts).expect("queries");
        let (best, count) = (found.best(), case.boxes[0].len());
        for (row, (boxes, scores)) in case.boxes.iter().zip(&case.scores).enumerate() {
            let part = row * count..(row + 1) * count;
            let differs = farthest(boxes, &found.boxes[part.clone()]);
            eprintln!("{}, picture {row}: boxes differ by {differs:.1e} of the picture", case.name);
            let lost = crate::bundle::unmatched(boxes, scores, &found.boxes[part.clone()], &best[part]);
            assert_eq!(lost, 0, "{}, picture {row}", case.name);
        }
    }
}

#[test]
fn an_empty_prompt_is_refused() {
    let (detector, image) = (detector(), test_picture(1, 50, 40));
    for text in ["", "  ", ".", " . "] {
        let error = detector.detect(&image, &Prompt { text: text.into(), ..Prompt::default() }).expect_err("empty");
        assert!(error.to_string().starts_with("the prompt "), "{error}");
    }
    let long = "roof . ".repeat(40);
    let error = detector.detect(&image, &Prompt { text: long, ..Prompt::default() }).expect_err("too long");
    assert!(error.to_string().contains("82 tokens, the network reads 32"), "{error}");
}

#[test]
fn a_graph_of_other_names_is_refused_with_its_names() {
    let mut bundle: Bundle = golden::bundle("tiny-sam2");
    bundle.manifest.kind = crate::bundle::BundleKind::Detector;
    bundle.manifest.files[0].role = crate::bundle::FileRole::Detector;
    let words = golden::bundle("tiny-dino");
    let session =
        golden::engine().open(&bundle.file(crate::bundle::FileRole::Detector).expect("a file")).expect("a graph");
    let words = WordPiece::open(&words.file(crate::bundle::FileRole::Tokenizer).expect("a file")).expect("words");
    let rules = bundle.manifest.image.clone();
    let error = GroundingDino::new(Path::new("x.onnx"), session, words, rules, 256).err().expect("not a detector");
    let text = error.to_string();
    assert!(text.contains("inputs pixel_values F32[") && text.contains("image_embeddings.0"), "{text}");
}

/// Answers whatever it was given.
struct Parrot {
    graph: Graph,
    answers: Vec<Tensor>,
}

impl Session for Parrot {
    fn graph(&self) -> &Graph {
        &self.graph
    }

    fn run(&self, _: &[(&str, &Tensor)], _: &[&str]) -> Result<Vec<Tensor>, ModelError> {
        Ok(self.answers.clone())
    }
}

#[test]
fn answers_that_cannot_be_are_errors() {
    let bundle = golden::bundle("tiny-dino");
    let file = |role| bundle.file(role).expect("a file");
    let graph_file = file(crate::bundle::FileRole::Detector);
    let answer = |logits: Tensor, boxes: Tensor| {
        let words = WordPiece::open(&file(crate::bundle::FileRole::Tokenizer)).expect("words");
        let graph = Graph::open(&graph_file).expect("a graph");
        let session = Box::new(Parrot { graph, answers: vec![logits, boxes] });
        let detector =
            GroundingDino::new(&graph_file, session, words, bundle.manifest.image.clone(), 32).expect("a detector");
        detector.detect(&test_picture(1, 50, 40), &Prompt::default())
    };
    let floats = |shape: &[usize], value| Tensor::floats(shape, vec![value; shape.iter().product()]);
    assert_eq!(answer(floats(&[1, 2, 8], 3.0), floats(&[1, 2, 4], 0.5)).expect("boxes").len(), 2);
    for (logits, boxes, part) in [
        (floats(&[1, 2, 8], 3.0), floats(&[1, 2, 3], 0.5), "do not fit"),
        (floats(&[1, 3, 8], 3.0), floats(&[1, 2, 4], 0.5), "do not fit"),
        (floats(&[1, 2, 3], 3.0), floats(&[1, 2, 4], 0.5), "do not fit"),
        (floats(&[1, 2, 0], 3.0), floats(&[1, 2, 4], 0.5), "do not fit"),
        (floats(&[2, 8], 3.0), floats(&[1, 2, 4], 0.5), "expected 3 dimensions"),
        (floats(&[1, 2, 8], f32::NAN), floats(&[1, 2, 4], 0.5), "is not a number"),
    ] {
        let text = answer(logits, boxes).expect_err("refused").to_string();
        assert!(text.contains(part), "{text}");
    }
}
