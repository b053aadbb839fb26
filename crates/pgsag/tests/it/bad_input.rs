//! Bad input: one line, exit 2, nothing overwritten.

use super::*;

/// The one line that a command must fail with.
fn refusal(mut command: Command) -> String {
    let output = command.output().expect("runs");
    assert_eq!(output.status.code(), Some(2), "{}", words(&output));
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    let errors: Vec<&str> = text.lines().filter(|line| line.starts_with("error: ")).collect();
    assert_eq!(errors.len(), 1, "{text}");
    assert!(!text.contains("panicked"), "{text}");
    errors[0].to_owned()
}

fn copied_town() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("temporary folder");
    let scene = folder.path().join("scene");
    let copied = Command::new("cp").arg("-r").arg(town()).arg(&scene).status().expect("cp");
    assert!(copied.success());
    (folder, scene)
}

#[test]
fn a_damaged_model_is_named() {
    let (folder, scene) = copied_town();
    let path = scene.join("sparse/0/points3D.bin");
    let bytes = fs::read(&path).expect("a model");
    fs::write(&path, &bytes[..bytes.len() / 2]).expect("written");
    let run = folder.path().join("run");
    let line = refusal(reconstruct(&scene, &run));
    assert!(line.contains("points3D.bin"), "{line}");
    assert!(!run.join("result").exists());
}

#[test]
fn a_damaged_photograph_is_named() {
    let (folder, scene) = copied_town();
    let image = fs::read_dir(scene.join("images")).expect("images").next().expect("one").expect("an entry").path();
    fs::write(&image, b"not a photograph").expect("written");
    let line = refusal(reconstruct(&scene, &folder.path().join("run")));
    let name = image.file_name().expect("a name").to_string_lossy().into_owned();
    assert!(line.contains(&name), "{line}");
}

#[test]
fn a_run_that_is_being_worked_on_is_left_alone() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = folder.path().join("run");
    fs::create_dir_all(run.join("log")).expect("a folder");
    let lock = fs::File::create(run.join("lock")).expect("a file");
    lock.lock().expect("free");
    let line = refusal(reconstruct(town(), &run));
    assert!(line.contains("another pgsag works on it"), "{line}");
}

#[test]
fn wrong_words_are_named_with_a_cure() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = folder.path().join("run");
    let with = |args: &[&str]| {
        let mut command = reconstruct(town(), &run);
        command.args(args);
        refusal(command)
    };
    assert!(with(&["--masks", "language"]).contains("--masks none"));
    assert!(with(&["--set", "train.iteration=7"]).contains("there is no such key"));
    assert!(with(&["--memory-limit", "lots"]).contains("write it like 8GiB"));
    assert!(with(&["--simd", "mmx"]).contains("scalar"));
    assert!(with(&["--set", "metres_per_unit=-2"]).contains("is not a scale"));
    assert!(with(&["--until", "lunch"]).contains("import coarse masks"));
    let line = with(&["--memory-limit", "1MiB"]);
    assert!(line.contains("needs about") && line.contains("--memory-limit"), "{line}");
    let mut elsewhere = pgsag(["reconstruct", "/nowhere/at/all", "-o"]);
    elsewhere.arg(&run);
    assert!(refusal(elsewhere).contains("/nowhere/at/all"));
}

#[test]
fn a_folder_with_other_files_is_not_taken_for_a_run() {
    let folder = tempfile::tempdir().expect("temporary folder");
    fs::write(folder.path().join("thesis.txt"), "precious").expect("written");
    let line = refusal(reconstruct(town(), folder.path()));
    assert!(line.contains("holds other files"), "{line}");
    assert_eq!(fs::read_to_string(folder.path().join("thesis.txt")).expect("still there"), "precious");
}
