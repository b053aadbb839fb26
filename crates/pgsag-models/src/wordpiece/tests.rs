use super::*;
use crate::golden;

fn words() -> WordPiece {
    WordPiece::open(&golden::folder().join("bundles/tiny-dino/tokenizer.json")).expect("a tokenizer")
}

#[derive(serde::Deserialize)]
struct Goldens {
    encode: Vec<(String, Vec<u32>)>,
    decode: Vec<(Vec<u32>, String)>,
}

#[test]
fn texts_are_cut_as_python_cuts_them() {
    let (words, goldens) = (words(), golden::read::<Goldens>("words.json"));
    assert!(goldens.encode.len() >= 300);
    for (text, ids) in goldens.encode {
        assert_eq!(words.encode(&text).ids, ids, "{text:?}");
    }
}

#[test]
fn numbers_become_the_words_that_python_writes() {
    let (words, goldens) = (words(), golden::read::<Goldens>("words.json"));
    for (ids, text) in goldens.decode {
        assert_eq!(words.decode(&ids), text, "{ids:?}");
    }
}

#[test]
fn case_and_a_space_before_the_stop_change_nothing() {
    let words = words();
    assert_eq!(words.encode("Buildings ."), words.encode("buildings."));
}

#[test]
fn another_kind_of_tokenizer_is_refused() {
    let file = serde_json::json!({"model": {"type": "BPE", "vocab": {"a": 0}}});
    assert!(WordPiece::from_json(&file).expect_err("no WordPiece").contains("WordPiece"));
    let file = serde_json::json!({"model": {"vocab": {"[UNK]": 7}}});
    assert!(WordPiece::from_json(&file).is_err());
}
