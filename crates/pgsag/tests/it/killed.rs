//! Killed at any instant, the same command line finishes with the same bytes.

use std::process::Stdio;
use std::time::Duration;

use pgsag_scene::numbers::SplitMix64;

use super::*;

/// So many kills, then it may finish.
const KILLS: usize = 10;
/// Each comes within this share of an undisturbed run's time, so that most stages are hit and all of them together
/// go on far enough to hit the last.
const WITHIN: f64 = 0.35;

#[test]
fn a_killed_run_goes_on_to_the_same_bytes() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = folder.path().join("run");
    let whole = reference().2;
    let mut stream = SplitMix64::new(3);
    for _ in 0..KILLS {
        let mut command = reconstruct(town(), &run);
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("starts");
        std::thread::sleep(whole.mul_f64(WITHIN * stream.uniform()));
        // It may have finished by then, which is no failure.
        let _ = child.kill();
        child.wait().expect("ends");
    }
    finish(reconstruct(town(), &run));
    assert_eq!(differing(&result_of(&run), &reference().1), Vec::<String>::new());
    let leftovers: Vec<_> = fs::read_dir(&run)
        .expect("a folder")
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .filter(|name| name.starts_with('.'))
        .collect();
    assert!(leftovers.iter().all(|name| !name.contains(".old") && !name.contains("mirror")), "{leftovers:?}");
}

#[cfg(unix)]
#[test]
fn an_interrupted_run_saves_its_state_and_exits_130() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = folder.path().join("run");
    let long = |run: &Path| {
        let mut command = reconstruct(town(), run);
        command.args(["--iterations", "200000", "--until", "train"]);
        command
    };
    let log = run.join("log/train.bg01.jsonl");
    let mut child = long(&run).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("starts");
    for _ in 0..600 {
        std::thread::sleep(Duration::from_millis(100));
        if fs::read_to_string(&log).is_ok_and(|text| text.lines().count() >= 2) {
            break;
        }
    }
    let told = Command::new("kill").arg("-INT").arg(child.id().to_string()).status().expect("kill");
    assert!(told.success());
    assert_eq!(child.wait().expect("ends").code(), Some(130));
    let saved = fs::read_dir(&run)
        .expect("a folder")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(".07-train.")))
        .flat_map(|attempt| fs::read_dir(attempt).expect("a folder").map(|entry| entry.expect("an entry").path()))
        .filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("checkpoint.")))
        .count();
    assert!(saved > 0, "a checkpoint is kept");
}
