//! Masks by tiny networks of random weights: what they mark means nothing, how they get there is the real path.

use super::*;

/// The bundles that the models wing is tested with.
fn bundles() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../pgsag-models/tests/golden/bundles")
}

fn mask(output: &Path) -> Command {
    let mut command = pgsag(["mask"]);
    command.arg(town().join("images")).arg("-o").arg(output).arg("--models-dir").arg(bundles());
    command
}

#[track_caller]
fn refused(mut command: Command, part: &str) {
    let output = command.output().expect("runs");
    assert_eq!(output.status.code(), Some(2), "{}", words(&output));
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(text.contains(part) && text.trim_end().lines().count() == 1, "{text}");
}

#[test]
fn masks_are_made_once_checked_and_shown() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let masks = folder.path().join("masks");
    let again = || {
        let mut command = mask(&masks);
        command.args(["--box-threshold", "0.7", "--preview", "--coco"]);
        finish(command)
    };
    let first = words(&again());
    assert!(first.contains("12 masks made, 0 there before"), "{first}");
    let second = words(&again());
    assert!(second.contains("0 masks made, 12 there before"), "{second}");
    let made = fs::read_dir(&masks)
        .expect("a folder")
        .flatten()
        .find(|entry| entry.path().extension() == Some("png".as_ref()));
    fs::remove_file(made.expect("a mask").path()).expect("removed");
    let third = words(&again());
    assert!(third.contains("1 masks made, 11 there before"), "{third}");
    let page = fs::read_to_string(masks.join("preview/index.html")).expect("a page");
    assert_eq!(page.matches("<figure>").count(), 12);
    let coco: Value =
        serde_json::from_slice(&fs::read(masks.join("detections.coco.json")).expect("a file")).expect("JSON");
    assert_eq!(coco["annotations"].as_array().map(Vec::len), Some(12));
    let mut check = pgsag(["mask", "check"]);
    check.arg(town().join("images")).arg(&masks);
    finish(check);
}

#[test]
fn points_change_the_masks_that_they_name() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let image = fs::read_dir(town().join("images")).expect("images").flatten().next().expect("one").file_name();
    let image = image.to_string_lossy().into_owned();
    let points = folder.path().join("points.json");
    let masks = folder.path().join("masks");
    let run = |text: String| {
        fs::write(&points, text).expect("written");
        let mut command = mask(&masks);
        command.args(["--mode", "points", "--points"]).arg(&points);
        command
    };
    finish(run(format!("{{\"{image}\": [{{\"box\": [10, 10, 60, 50]}}]}}")));
    assert!(masks.join(format!("{image}.png")).is_file());
    refused(run(format!("{{\"{image}\": [{{}}]}}")), "without points");
    refused(run("{\"no such.jpg\": []}".into()), "is no photograph of that folder");
}

#[test]
fn wrong_questions_get_one_line() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let with = |arguments: &[&str]| {
        let mut command = mask(&folder.path().join("masks"));
        command.args(arguments);
        command
    };
    refused(with(&["--prompt", " "]), "the prompt is empty");
    refused(with(&["--runtime", "onnx"]), "use rten or ort");
    refused(with(&["--device", "cuda:0"]), "runs on the CPU only");
    refused(with(&["--segmenter", "tiny-dino"]), "wanted is a segmenter");
    refused(with(&["--detector", "none"]), "no model bundle here");
    refused(with(&["--only", "x*"]), "no photograph fits");
    let mut ort = mask(&folder.path().join("masks"));
    ort.args(["--runtime", "ort"]).env("ORT_DYLIB_PATH", "/nowhere/libonnxruntime.so");
    refused(ort, if cfg!(feature = "ort") { "cannot be loaded" } else { "not part of this build" });
}

#[test]
fn bundles_are_verified_and_nothing_unpinned_is_fetched() {
    let models = |arguments: &[&str]| {
        let mut command = pgsag(["models"]);
        command.args(arguments).arg("--models-dir").arg(bundles());
        command
    };
    let text = words(&finish(models(&["verify"])));
    assert_eq!(text.matches("right  tiny-").count(), 4, "{text}");
    assert!(words(&finish(models(&["list"]))).contains("tiny-sam2"));
    refused(models(&["fetch", "sam2.1-hiera-small"]), "is not pinned yet");
    let manifest = bundles().join("tiny-sam2/manifest.toml");
    refused(models(&["fetch", manifest.to_str().expect("a name")]), "no revision of 40 digits");
}

#[test]
fn a_pinned_bundle_is_fetched_verified_and_published() {
    if Command::new("curl").arg("--version").output().is_err() {
        eprintln!("not tried: there is no curl");
        return;
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let revision = "0123456789abcdef0123456789abcdef01234567";
    let text = fs::read_to_string(bundles().join("tiny-sam2/manifest.toml")).expect("a manifest");
    let pinned = |text: &str| format!("revision = \"{revision}\"\n{text}");
    let manifest = folder.path().join("manifest.toml");
    let source = text.lines().find_map(|line| line.strip_prefix("source = ")).expect("a source").trim_matches('"');
    let served = folder.path().join("server").join(source).join("resolve").join(revision);
    fs::create_dir_all(&served).expect("a folder");
    for file in fs::read_dir(bundles().join("tiny-sam2")).expect("a bundle").flatten() {
        fs::copy(file.path(), served.join(file.file_name())).expect("copied");
    }
    let fetch = || {
        let mut command = pgsag(["models", "fetch", manifest.to_str().expect("a name")]);
        command.arg("--models-dir").arg(folder.path().join("models")).arg("--accept-license");
        command.env("HF_ENDPOINT", format!("file://{}", folder.path().join("server").display()));
        command
    };
    fs::write(&manifest, pinned(&text.replace("\"tiny-sam2\"", "\"../tiny-sam2\""))).expect("written");
    refused(fetch(), "cannot be a folder's name");
    fs::write(&manifest, pinned(&text)).expect("written");
    finish(fetch());
    let mut verify = pgsag(["models", "verify", "tiny-sam2"]);
    verify.arg("--models-dir").arg(folder.path().join("models"));
    assert!(words(&finish(verify)).contains("right  tiny-sam2"));
}

#[test]
fn a_town_is_reconstructed_with_masks_by_language() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = folder.path().join("run");
    let mut command = reconstruct(town(), &run);
    command.args(["--masks", "language", "--until", "group", "--set", "language.box_threshold=0.99", "--set"]);
    command.arg(format!("language.models={}", bundles().display()));
    let text = words(&finish(command));
    assert!(text.contains("implausible"), "{text}");
    assert!(run.join("05-refine").is_dir());
}
