//! `cargo x ci`: exactly what the server runs, so that red there is red here.

use std::path::Path;

use crate::steps::{Steps, shell, shell_with};
use crate::{Result, ledger, licences, tidy};

pub(crate) fn run(root: &Path) -> Result<()> {
    let mut steps = Steps::default();
    steps.run("fmt", || fmt(root));
    steps.run("tidy", || tidy::run(root));
    steps.run("ledger", || ledger::run(root));
    steps.run("licences", || licences::run(root));
    steps.run("clippy", || {
        let words = ["clippy", "--workspace", "--all-targets", "--locked", "--", "-D", "warnings"];
        shell(root, "cargo", &words)
    });
    steps.run("clippy gpu", || {
        let words = ["clippy", "-p", "pgsag", "--features", "gpu", "--all-targets", "--locked", "--", "-D", "warnings"];
        shell(root, "cargo", &words)
    });
    steps.run("tests", || shell(root, "cargo", &["test", "--workspace", "--locked", "--no-fail-fast"]));
    steps.run("tests gpu", || {
        let words = ["test", "-p", "pgsag", "--features", "gpu", "--test", "cards", "--locked"];
        shell(root, "cargo", &words)
    });
    steps.run("doc", || {
        let words = ["doc", "--workspace", "--no-deps", "--locked"];
        shell_with(root, "cargo", &words, &[("RUSTDOCFLAGS", "-D warnings")])
    });
    steps.finish()
}

/// Also the first step of `quick`.
pub(crate) fn fmt(root: &Path) -> Result<()> {
    shell(root, "cargo", &["fmt", "--all", "--check"])
}
