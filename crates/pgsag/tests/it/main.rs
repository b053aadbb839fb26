//! The product as a person or a script meets it: the binary, on a tiny town of two buildings and twelve small images.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

mod bad_input;
mod killed;
mod masked;
mod segmented;
mod whole;

/// Everything small enough for a few CPU-seconds.
const FAST: [&str; 9] = [
    "--preset",
    "fast",
    "--iterations",
    "200",
    "--set",
    "coarse.stereo=false",
    "--set",
    "score.bootstrap=10",
    "--json",
];

fn pgsag<S: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = S>) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pgsag"));
    command.args(args);
    command
}

/// A town that all tests read.
fn town() -> &'static Path {
    static TOWN: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let (_, scene) = TOWN.get_or_init(|| {
        let folder = tempfile::tempdir().expect("temporary folder");
        let scene = folder.path().join("town");
        let output = pgsag(["town", "--houses", "2", "--row-houses", "0", "--views", "12", "--points", "700"])
            .args(["--width", "96", "--height", "64", "--gsd", "0.4", "--exact-masks", "--no-depth", "-o"])
            .arg(&scene)
            .output()
            .expect("runs");
        assert!(output.status.success(), "{}", words(&output));
        (folder, scene)
    });
    scene
}

/// `pgsag reconstruct` of a scene with its truth.
fn reconstruct(scene: &Path, run: &Path) -> Command {
    let mut command = pgsag(["reconstruct"]);
    command.arg(scene).arg("-o").arg(run).args(FAST);
    if scene.join("truth").exists() {
        command.arg("--truth").arg(scene.join("truth"));
    }
    command
}

fn finish(mut command: Command) -> Output {
    let output = command.output().expect("runs");
    assert!(output.status.success(), "{}", words(&output));
    output
}

fn words(output: &Output) -> String {
    format!("{}\n{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

/// The last JSON line of a command.
fn last_line(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    serde_json::from_str(text.lines().last().unwrap_or_default()).unwrap_or_else(|_| panic!("no JSON: {text}"))
}

/// Every file of a result but the report, which tells times.
fn result_of(run: &Path) -> BTreeMap<String, Vec<u8>> {
    fn visit(folder: &Path, prefix: &str, files: &mut BTreeMap<String, Vec<u8>>) {
        for entry in fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry")) {
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            if entry.path().is_dir() {
                visit(&entry.path(), &format!("{name}/"), files);
            } else if name != "report.html" {
                files.insert(name, fs::read(entry.path()).expect("a file"));
            }
        }
    }
    let mut files = BTreeMap::new();
    visit(&run.join("result"), "", &mut files);
    files
}

/// Names of the files that differ, for a message that a person can read.
fn differing(a: &BTreeMap<String, Vec<u8>>, b: &BTreeMap<String, Vec<u8>>) -> Vec<String> {
    let names: std::collections::BTreeSet<&String> = a.keys().chain(b.keys()).collect();
    names.into_iter().filter(|name| a.get(*name) != b.get(*name)).cloned().collect()
}

/// The undisturbed run on one thread: where it is, its result, and the time that it took.
fn reference() -> &'static (TempDir, BTreeMap<String, Vec<u8>>, Duration) {
    static REFERENCE: OnceLock<(TempDir, BTreeMap<String, Vec<u8>>, Duration)> = OnceLock::new();
    REFERENCE.get_or_init(|| {
        let folder = tempfile::tempdir().expect("temporary folder");
        let mut command = reconstruct(town(), &folder.path().join("run"));
        command.args(["--threads", "1"]);
        let start = Instant::now();
        finish(command);
        let took = start.elapsed();
        let result = result_of(&folder.path().join("run"));
        (folder, result, took)
    })
}
