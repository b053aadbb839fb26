//! What was typed, and what it comes to mean.

use serde_json::json;

use super::*;
use crate::error::one_line;

fn typed(file: &str, set: &[&str], flags: &[(&str, Value)]) -> Typed {
    Typed {
        file: Some(("city.toml".into(), file.into())),
        set: set.iter().map(|&text| text.into()).collect(),
        flags: flags.iter().map(|(key, value)| ((*key).into(), value.clone())).collect(),
    }
}

#[test]
fn later_layers_win_and_are_named() {
    let found = typed("seed = 3\nholdout = 8\nsimd = \"avx2\"", &["seed=4", "holdout=5"], &[("seed", json!(5))])
        .resolve()
        .expect("good");
    assert_eq!((found.config.seed, found.config.holdout, found.config.simd.as_str()), (5, 5, "avx2"));
    assert_eq!(found.sources["seed"], Source::Flag);
    assert_eq!(found.sources["holdout"], Source::Set);
    assert_eq!(found.sources["simd"], Source::File("city.toml".into()));
    assert!(!found.sources.contains_key("masks"));
}

#[test]
fn losses_is_short_for_the_weights_of_training() {
    let found = typed("losses = { reading = \"paper\" }", &["losses.ncc=0.2"], &[]).resolve().expect("good");
    assert_eq!(found.config.train.weights.reading, pgsag_splat::backend::Reading::Paper);
    assert!((found.config.train.weights.ncc - 0.2).abs() < 1e-6);
    assert_eq!(found.sources["train.weights.reading"], Source::File("city.toml".into()));
}

#[test]
fn positions_take_shorter_steps_where_training_is_longer() {
    let step =
        |set: &[&str]| typed("preset = \"fast\"", set, &[]).resolve().expect("good").config.train.rates.position_gsd;
    let fast = step(&[]);
    assert_eq!(step(&["train.iterations=500"]), fast);
    let longer = step(&["train.iterations=30000"]);
    assert!((longer / fast - 0.37).abs() < 0.01, "{longer} of {fast}");
    assert_eq!(step(&["train.iterations=30000", "train.rates.position_gsd=0.5"]), 0.5);
}

#[test]
fn mistakes_are_one_line_with_a_place() {
    let line = |typed: Typed| one_line(&typed.resolve().expect_err("bad"));
    assert_eq!(line(typed("sead = 3", &[], &[])), "city.toml: sead: there is no such key; `pgsag config` lists them");
    assert!(line(typed("seed = 3\nseed = ", &[], &[])).starts_with("city.toml: line 2: "));
    assert!(line(typed("", &["seed=often"], &[])).starts_with("--set: seed: invalid type"));
    assert!(line(typed("", &["preset=best"], &[])).contains("use fast, standard or paper"));
    assert!(line(typed("", &["surface.tsdf.behind_weight=2"], &[])).contains("0 to 1"));
    assert!(line(typed("", &["seed"], &[])).contains("write --set key=value"));
}

#[test]
fn settings_survive_the_round_trip() {
    let config = Config { seed: 9, image_width: 640, ..Config::preset(Preset::Fast) };
    assert_eq!(Config::from_settings(&config.settings()).expect("ours"), config);
}

#[test]
fn halves_share_no_image_and_leave_none_out() {
    let half = |images| Config { images, ..Config::default() };
    let (odd, even) = (half(ImageChoice::Odd), half(ImageChoice::Even));
    assert!((0..9).all(|view| odd.is_held_out(view) != even.is_held_out(view)));
    assert!(!odd.is_held_out(0), "the first image is odd");
    assert!((0..9).all(|view| !Config::default().is_held_out(view)));
    let both = Config { holdout: 4, ..odd };
    assert_eq!((0..6).filter(|view| !both.is_held_out(*view)).collect::<Vec<_>>(), [2]);
}
