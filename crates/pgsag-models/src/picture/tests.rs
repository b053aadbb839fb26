use super::*;
use crate::golden;

#[derive(serde::Deserialize)]
struct Case {
    seed: u64,
    from: [u32; 2],
    to: [u32; 2],
    step: usize,
    pillow: Vec<u8>,
    torch: Vec<f32>,
}

#[derive(serde::Deserialize)]
struct Goldens {
    resize: Vec<Case>,
    sizes: Vec<[u32; 4]>,
}

#[test]
fn pictures_are_resized_as_pillow_and_torch_do() {
    for case in golden::read::<Goldens>("pixels.json").resize {
        let image = test_picture(case.seed, case.from[0], case.from[1]);
        let bytes = pillow::resize(&image.pixels, case.from, case.to);
        let sampled: Vec<u8> = bytes.into_iter().step_by(case.step).collect();
        assert_eq!(sampled, case.pillow, "{:?} to {:?}", case.from, case.to);
        let floats = resized_floats(&image, case.to).expect("resized");
        for (got, wanted) in floats.iter().step_by(case.step).zip(&case.torch) {
            assert!((got - wanted).abs() < 1e-5, "{:?} to {:?}: {got} instead of {wanted}", case.from, case.to);
        }
    }
}

fn rules() -> PictureRules {
    let (mean, std) = ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]);
    PictureRules { shortest: Some(800), longest: Some(1333), square: None, fixed: None, mean, std }
}

#[test]
fn sizes_are_the_reference_s() {
    for [width, height, wide, high] in golden::read::<Goldens>("pixels.json").sizes {
        assert_eq!(rules().resized_size(width, height), [wide, high], "{width} x {height}");
    }
}

#[test]
fn a_fixed_canvas_is_padded_not_squashed() {
    let rules = PictureRules { fixed: Some([96, 64]), shortest: Some(64), ..rules() };
    let picture = rules.detector_picture(&test_picture(1, 300, 100)).expect("a picture");
    assert_eq!((picture.canvas, picture.covered), ([96, 64], [96, 32]));
    assert_eq!(picture.pixels.shape, [1, 3, 64, 96]);
    let values = picture.pixels.as_floats("pixels", 4).expect("floats");
    assert!(values[32 * 96..64 * 96].iter().all(|value| *value == 0.0));
    assert!(values[..32 * 96].iter().any(|value| *value != 0.0));
}
