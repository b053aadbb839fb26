//! Artifacts written and read back; damage is refused.

use super::*;

fn attempts() -> (tempfile::TempDir, Vec<PathBuf>) {
    let folder = tempfile::tempdir().expect("temporary folder");
    let attempts: Vec<_> = ["a", "b"].iter().map(|name| folder.path().join(name)).collect();
    attempts.iter().for_each(|attempt| fs::create_dir(attempt).expect("folder"));
    (folder, attempts)
}

#[test]
fn the_newest_checkpoint_of_any_attempt_wins() {
    let (_folder, attempts) = attempts();
    Checkpoint::save(&attempts[0], "key", 200, b"early").expect("saved");
    Checkpoint::save(&attempts[1], "key", 1000, b"late").expect("saved");
    assert_eq!(Checkpoint::newest(&attempts, "key"), Some(Checkpoint { step: 1000, state: b"late".to_vec() }));
    assert_eq!(Checkpoint::newest(&attempts, "other"), None);
}

#[test]
fn a_damaged_checkpoint_falls_back_to_the_one_before() {
    let (_folder, attempts) = attempts();
    for step in [100, 200, 300] {
        Checkpoint::save(&attempts[0], "key", step, &step.to_le_bytes()).expect("saved");
    }
    let newest = attempts[0].join("checkpoint.0000000300");
    let mut bytes = fs::read(&newest).expect("there");
    bytes[60] ^= 1;
    fs::write(&newest, bytes).expect("written");
    assert_eq!(Checkpoint::newest(&attempts, "key").map(|found| found.step), Some(200));
    assert_eq!(Checkpoint::list(&attempts[0]).len(), 2, "two are kept");
    fs::write(attempts[0].join("checkpoint.0000000400"), b"cut").expect("written");
    assert_eq!(Checkpoint::newest(&attempts, "key").map(|found| found.step), Some(200));
}

#[test]
fn a_changed_middle_changes_the_source_fingerprint() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("photo.jpg");
    let mut bytes = vec![7_u8; 400_000];
    fs::write(&path, &bytes).expect("written");
    let before = fingerprint_source(&path).expect("read");
    bytes[200_001] = 8;
    fs::write(&path, &bytes).expect("written");
    assert_ne!(before, fingerprint_source(&path).expect("read"));
}

#[test]
fn words_are_told_apart() {
    assert_ne!(fingerprint_words(["ab", "c"]), fingerprint_words(["a", "bc"]));
}
