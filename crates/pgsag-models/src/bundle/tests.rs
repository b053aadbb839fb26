use super::*;
use crate::golden;

/// A copy of a golden bundle that may be broken.
fn copy(name: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let target = folder.path().join(name);
    std::fs::create_dir(&target).expect("made");
    for entry in std::fs::read_dir(golden::folder().join("bundles").join(name)).expect("there").flatten() {
        std::fs::copy(entry.path(), target.join(entry.file_name())).expect("copied");
    }
    (folder, target)
}

#[test]
fn whole_bundles_pass_their_self_test() {
    for name in ["tiny-dino", "tiny-sam2"] {
        let bundle = golden::bundle(name);
        bundle.check_files(true).expect("whole");
        for case in verify_answers(&bundle, &golden::engine()).expect("it runs") {
            assert!(case.is_right, "{name}, {}: {}", case.case, case.words);
        }
    }
}

#[test]
fn a_graph_with_frozen_sizes_fails_its_self_test() {
    let (_kept, folder) = copy("tiny-dino");
    std::fs::copy(golden::folder().join("bundles/frozen-dino/detector.onnx"), folder.join("detector.onnx"))
        .expect("copied");
    let mut bundle = Bundle::open(&folder).expect("a manifest");
    let file = bundle.manifest.files.iter_mut().find(|file| file.role == FileRole::Detector).expect("a detector");
    file.bytes = std::fs::metadata(folder.join("detector.onnx")).expect("there").len();
    let cases = verify_answers(&bundle, &golden::engine()).expect("it runs");
    assert!(cases[0].is_right, "the size that it was made at: {}", cases[0].words);
    assert!(!cases[1].is_right, "another size must differ: {}", cases[1].words);
}

#[test]
fn broken_files_are_told_by_name() {
    let (_kept, folder) = copy("tiny-sam2");
    let bundle = Bundle::open(&folder).expect("a manifest");
    let path = folder.join("decoder.onnx");
    let whole = std::fs::read(&path).expect("there");
    std::fs::write(&path, &whole[..whole.len() / 2]).expect("written");
    let text = bundle.check_files(true).expect_err("half").to_string();
    assert!(text.contains("decoder.onnx: ") && text.contains("the manifest says"), "{text}");
    let text = bundle.segmenter(&golden::engine()).err().expect("half").to_string();
    assert!(text.contains("decoder.onnx"), "{text}");
    let text = crate::onnx::Graph::open(&path).expect_err("half").to_string();
    assert!(text.contains("not a whole ONNX file"), "{text}");

    let mut other = whole.clone();
    *other.last_mut().expect("bytes") ^= 1;
    std::fs::write(&path, &other).expect("written");
    let text = bundle.check_files(true).expect_err("changed").to_string();
    assert!(text.contains("SHA-256 is "), "{text}");

    std::fs::remove_file(&path).expect("removed");
    assert!(bundle.check_files(false).expect_err("gone").to_string().contains("decoder.onnx"));
    assert!(Bundle::open(Path::new("/nowhere")).expect_err("none").to_string().contains("no model bundle here"));
}

#[test]
fn a_manifest_cannot_lead_out_of_its_folder() {
    let (_kept, folder) = copy("tiny-sam2");
    let path = folder.join(MANIFEST);
    let text = std::fs::read_to_string(&path).expect("there");
    std::fs::write(&path, text.replace("\"encoder.onnx\"", "\"../encoder.onnx\"")).expect("written");
    assert!(Bundle::open(&folder).expect_err("outside").to_string().contains("not beside it"));
    std::fs::write(&path, text.replace("square = 128", "square = 0")).expect("written");
    assert!(Bundle::open(&folder).expect_err("no size").to_string().contains("cannot be"));
}

#[test]
fn a_bundle_of_the_other_kind_is_refused() {
    let text = golden::bundle("tiny-sam2").detector(&golden::engine()).err().expect("a segmenter").to_string();
    assert!(text.contains("a segmenter, wanted is a detector"), "{text}");
    let mut bundle = golden::bundle("tiny-sam2");
    bundle.manifest.image.square = Some(1024);
    let text = bundle.segmenter(&golden::engine()).err().expect("another size").to_string();
    assert!(text.contains("made for another size") && text.contains("1024 x 1024"), "{text}");
}

#[test]
fn a_self_test_that_tests_nothing_is_refused() {
    for name in ["tiny-dino", "tiny-sam2"] {
        let (_kept, folder) = copy(name);
        let path = folder.join("selftest.json");
        let mut test: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(&path).expect("there")).expect("JSON");
        let refused = |test: &serde_json::Value| {
            std::fs::write(&path, test.to_string()).expect("written");
            let bundle = Bundle::open(&folder).expect("a manifest");
            let text = verify_answers(&bundle, &golden::engine()).expect_err("nothing to compare").to_string();
            assert!(text.contains("do not hold together"), "{text}");
        };
        test["cases"][1]["scores"] = serde_json::json!([]);
        refused(&test);
        test["cases"][1]["width"] = 4_000_000_000_u32.into();
        refused(&test);
        refused(&serde_json::json!({ "cases": [] }));
    }
}
