//! The developer's one command: `cargo x`. Standard library only, so that it builds in two seconds.
//!
//! `ci` is exactly what the server runs; `quick` is for the loop while writing; every other word is one step of them
//! or a chore of a release. A step prints the command that it runs, so that a person can run it alone.
#![expect(clippy::print_stdout, reason = "a developer's tool speaks on standard output")]

mod ablate;
mod bench;
mod chores;
mod ci;
mod clock;
mod json;
mod ledger;
mod licences;
mod quick;
mod source;
mod steps;
mod tidy;

use std::path::PathBuf;
use std::process::ExitCode;

/// What went wrong, in words for the person at the desk.
type Result<T> = std::result::Result<T, String>;

const USAGE: &str = "\
cargo x quick      fmt check, then clippy and unit tests of the crates that differ from main
cargo x ci         all that the server checks: fmt, tidy, ledger, licences, clippy, tests, documentation
cargo x tidy       the house rules: arrows between rooms, file lengths, headers, unfinished marks
cargo x ledger     docs/paper.md: every equation names a living function and a living test
cargo x licences   every dependency's licence against the list in deny.toml
cargo x bench      measure the CPU backend, append to benchmarks/results.json (options: benchmarks/README.md)
cargo x ablate     what each part is worth: rows of settings on scenes with truth, to docs/ablations.md
cargo x corrupt-masks MASKS OUT   masks made worse on purpose, always alike, to see what refinement mends
cargo x harden SCENE OUT …  a judged scene made harder: off-centre crop, gains, pose noise, offset, fewer views
cargo x town       reconstruct the demo town, print where its report lies
cargo x release    the release checklist";

fn main() -> ExitCode {
    let word = std::env::args().nth(1).unwrap_or_default();
    let root = root();
    let done = match word.as_str() {
        "quick" => quick::run(&root),
        "ci" => ci::run(&root),
        "tidy" => tidy::run(&root),
        "ledger" => ledger::run(&root),
        "licences" => licences::run(&root),
        "ablate" => ablate::run(&root, &std::env::args().skip(2).collect::<Vec<_>>()),
        "bench" => bench::run(&root, &std::env::args().skip(2).collect::<Vec<_>>()),
        "harden" => chores::harden(&root, std::env::args().skip(2)),
        "corrupt-masks" => chores::corrupt_masks(&root, std::env::args().skip(2)),
        "town" => chores::town(&root),
        "release" => chores::release(&root),
        "" | "help" | "--help" | "-h" => {
            println!("{USAGE}");
            Ok(())
        }
        other => Err(format!("there is no `cargo x {other}`\n\n{USAGE}")),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::from(1)
        }
    }
}

/// The repository's root: the folder above this crate.
fn root() -> PathBuf {
    let here = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    here.parent().map(PathBuf::from).unwrap_or(here)
}
