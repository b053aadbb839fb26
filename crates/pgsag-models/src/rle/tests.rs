use super::*;
use crate::golden;

#[derive(serde::Deserialize)]
struct Case {
    width: u32,
    height: u32,
    mask: Vec<u8>,
    counts: String,
    area: u64,
}

#[derive(serde::Deserialize)]
struct Goldens {
    rle: Vec<Case>,
}

#[test]
fn strings_are_pycocotools_s() {
    for case in golden::read::<Goldens>("shapes.json").rle {
        let values = case.mask.iter().map(|value| *value != 0).collect();
        let mask = Map { width: case.width, height: case.height, values };
        assert_eq!(encode(&mask), case.counts);
        assert_eq!(decode(&case.counts, case.width, case.height), Some(mask));
        let ones: u64 = runs(&decode(&case.counts, case.width, case.height).expect("a mask"))
            .chunks(2)
            .map(|pair| u64::from(*pair.get(1).unwrap_or(&0)))
            .sum();
        assert_eq!(ones, case.area);
    }
}

#[test]
fn a_string_of_another_size_is_refused() {
    assert_eq!(decode("04", 3, 3), None);
    assert_eq!(decode("\u{7f}\u{7f}\u{7f}\u{7f}\u{7f}\u{7f}\u{7f}\u{7f}\u{7f}\u{7f}\u{7f}\u{7f}\u{7f}", 3, 3), None);
    assert_eq!(decode("oooooooooooooooooooooooooooooo", 3, 3), None);
}
