//! Masks by tiny networks of random weights: what they mark means nothing, how they get there is the real path.

use std::io::Write as _;

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
    refused(run(format!("{{\"{image}\": [{{\"positive\": [[900, 5]]}}]}}")), "lies outside of");
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
    refused(with(&["--prompt", " . . "]), "the prompt names nothing");
    refused(with(&["--box-threshold", "30"]), "give a number from 0 to 1");
    refused(with(&["--tile", "20"]), "take larger tiles");
    refused(with(&["--runtime", "onnx"]), "use rten or ort");
    refused(with(&["--device", "cuda:0"]), "runs on the CPU only");
    refused(with(&["--segmenter", "tiny-dino"]), "wanted is a segmenter");
    refused(with(&["--detector", "none"]), "no model bundle here");
    refused(with(&["--only", "x*"]), "no photograph fits");
    let mut ort = mask(&folder.path().join("masks"));
    ort.args(["--runtime", "ort"]).env("ORT_DYLIB_PATH", "/nowhere/libonnxruntime.so");
    refused(ort, if cfg!(feature = "ort") { "cannot be loaded" } else { "not part of this build" });
}

/// A copy of the bundles that may be broken.
struct Broken {
    _folder: TempDir,
    models: PathBuf,
}

impl Broken {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        let models = folder.path().join("models");
        for name in ["tiny-dino", "tiny-sam2"] {
            fs::create_dir_all(models.join(name)).expect("a folder");
            for file in fs::read_dir(bundles().join(name)).expect("a bundle").flatten() {
                fs::copy(file.path(), models.join(name).join(file.file_name())).expect("copied");
            }
        }
        Self { _folder: folder, models }
    }

    /// Another content for a file; the manifest goes along with its size.
    fn swap(&self, bundle: &str, file: &str, content: &[u8]) {
        let path = self.models.join(bundle).join(file);
        let before = fs::metadata(&path).expect("there").len();
        fs::write(&path, content).expect("written");
        self.amend(bundle, &format!("bytes = {before}"), &format!("bytes = {}", content.len()));
    }

    fn amend(&self, bundle: &str, from: &str, to: &str) {
        let path = self.models.join(bundle).join("manifest.toml");
        let text = fs::read_to_string(&path).expect("a manifest");
        assert!(text.contains(from), "{from} in {text}");
        fs::write(&path, text.replacen(from, to, 1)).expect("written");
    }
}

fn bundled(path: &str) -> Vec<u8> {
    fs::read(bundles().join(path)).expect("a file of a bundle")
}

#[test]
fn each_wrong_bundle_has_its_own_line() {
    const MASK: &[&str] = &["mask", "--mode", "everything"];
    const WORDS: &[&str] = &["mask"];
    const VERIFY: &[&str] = &["models", "verify"];
    type Break = fn(&Broken);
    let cases: [(&[&str], &str, Break); 11] = [
        (MASK, "`/pos_embed/Resize` resizes with mode cubic, which the runtime rten computes as linear", |broken| {
            broken.swap("tiny-sam2", "encoder.onnx", &bundled("cubic-sam2/encoder.onnx"));
        }),
        (MASK, "not a SAM 2 encoder that is known: inputs input_points", |broken| {
            broken.swap("tiny-sam2", "encoder.onnx", &bundled("tiny-sam2/decoder.onnx"));
        }),
        (MASK, "not a SAM 2 decoder that is known and fits the encoder: inputs pixel_values", |broken| {
            broken.swap("tiny-sam2", "decoder.onnx", &bundled("tiny-sam2/encoder.onnx"));
        }),
        (WORDS, "not a GroundingDINO that is known: inputs pixel_values", |broken| {
            broken.swap("tiny-dino", "detector.onnx", &bundled("tiny-sam2/encoder.onnx"));
        }),
        (MASK, "made for another size: pixel_values F32[?,3,128,128], the manifest says 256 x 256", |broken| {
            broken.amend("tiny-sam2", "square = 128", "square = 256");
        }),
        (MASK, "decoder.onnx: 1000 bytes, the manifest says 237724; copy or fetch the file again", |broken| {
            let path = broken.models.join("tiny-sam2/decoder.onnx");
            fs::write(path, &bundled("tiny-sam2/decoder.onnx")[..1000]).expect("written");
        }),
        (MASK, "decoder.onnx: not a whole ONNX file", |broken| {
            broken.swap("tiny-sam2", "decoder.onnx", &bundled("tiny-sam2/decoder.onnx")[..100_000]);
        }),
        (VERIFY, "decoder.onnx: SHA-256 is ", |broken| {
            let mut bytes = bundled("tiny-sam2/decoder.onnx");
            *bytes.last_mut().expect("bytes") ^= 1;
            broken.swap("tiny-sam2", "decoder.onnx", &bytes);
        }),
        (WORDS, "tokenizer.json: no WordPiece vocabulary in it", |broken| {
            broken.swap("tiny-dino", "tokenizer.json", b"{}");
        }),
        (WORDS, "its sizes are open and no self-test covers two of them", |broken| {
            broken.amend("tiny-dino", "role = \"selftest\"", "role = \"weights\"");
        }),
        (MASK, "manifest.toml: TOML parse error", |broken| broken.amend("tiny-sam2", "[image]", "[image")),
    ];
    for (words, part, spoil) in cases {
        let broken = Broken::new();
        spoil(&broken);
        let mut command = pgsag(words);
        if words[0] == "mask" {
            command.arg(town().join("images")).arg("-o").arg(broken.models.join("masks"));
        }
        command.arg("--models-dir").arg(&broken.models);
        refused(command, part);
    }
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
    let mut without = fetch();
    without.env("PATH", "");
    refused(without, "curl: cannot be started");
    if Command::new("curl").arg("--version").output().is_err() {
        // Past the capture of test output: nobody shall believe that a download was tried.
        let said = writeln!(std::io::stderr(), "NOT TRIED: a download, for there is no curl on this machine");
        assert!(said.is_ok() && std::env::var_os("CI").is_none(), "install curl");
        return;
    }
    // What another attempt left: half of a file, to go on with, and a file of the right size that is something else.
    let part = folder.path().join("models/.tiny-sam2.part");
    fs::create_dir_all(&part).expect("a folder");
    fs::write(part.join("encoder.onnx"), &bundled("tiny-sam2/encoder.onnx")[..1000]).expect("written");
    fs::write(part.join("decoder.onnx"), vec![0; bundled("tiny-sam2/decoder.onnx").len()]).expect("written");
    finish(fetch());
    let mut verify = pgsag(["models", "verify", "tiny-sam2"]);
    verify.arg("--models-dir").arg(folder.path().join("models"));
    assert!(words(&finish(verify)).contains("right  tiny-sam2"));
}

#[test]
fn a_town_is_reconstructed_with_masks_by_language_to_its_end() {
    for (threshold, wanted) in [("0.7", "the model was asked for"), ("0.99", "% of its image: implausible")] {
        let folder = tempfile::tempdir().expect("temporary folder");
        let run = folder.path().join("run");
        let mut command = reconstruct(town(), &run);
        command.args(["--masks", "language", "--iterations", "60", "--set"]);
        command.arg(format!("language.box_threshold={threshold}"));
        command.arg("--set").arg(format!("language.models={}", bundles().display()));
        let text = words(&finish(command));
        assert!(text.contains(wanted), "{text}");
        for name in ["city.ply", "report.html", "score.json"] {
            assert!(run.join("result").join(name).is_file(), "{name} is missing");
        }
    }
}
