//! Arrows that must never exist, read from the paths in the code. The drawing is in `ARCHITECTURE.md`.

use super::Finding;
use crate::source::Source;

/// A room, what it must not name, and why. Prefixes of module paths; tests are free.
const NEVER: &[(&str, &[&str], &str)] = &[
    (
        "pgsag_scene",
        &["pgsag_group", "pgsag_splat", "pgsag_mesh", "pgsag_gpu", "pgsag_models", "pgsag"],
        "floor 1 stands on nothing",
    ),
    (
        "pgsag_group",
        &["pgsag_splat", "pgsag_mesh", "pgsag_gpu", "pgsag_models", "pgsag"],
        "a stage can be replaced alone",
    ),
    (
        "pgsag_splat",
        &["pgsag_group", "pgsag_mesh", "pgsag_gpu", "pgsag_models", "pgsag"],
        "a stage can be replaced alone",
    ),
    (
        "pgsag_mesh",
        &["pgsag_group", "pgsag_splat", "pgsag_gpu", "pgsag_models", "pgsag"],
        "a stage can be replaced alone",
    ),
    ("pgsag_gpu", &["pgsag_group", "pgsag_mesh", "pgsag_models", "pgsag"], "the wing knows the narrow waist only"),
    ("pgsag_models", &["pgsag_splat", "pgsag_mesh", "pgsag_gpu", "pgsag"], "the wing knows `Segmenter` only"),
    (
        "pgsag_splat::train",
        &["pgsag_splat::cpu", "pgsag_splat::reference", "pgsag_splat::conformance"],
        "the schedule is written once",
    ),
    (
        "pgsag_splat::backend",
        &["pgsag_splat::cpu", "pgsag_splat::reference", "pgsag_splat::train", "pgsag_splat::conformance"],
        "the narrow waist knows no device and no schedule",
    ),
    (
        "pgsag_splat::equations",
        &[
            "pgsag_splat::backend::Backend",
            "pgsag_splat::Backend",
            "pgsag_splat::losses",
            "pgsag_splat::cpu",
            "pgsag_splat::reference",
            "pgsag_splat::train",
            "pgsag_splat::conformance",
            "std::vec",
            "std::collections",
            "Vec",
            "Box",
            "String",
            "tracing",
        ],
        "an equation is pure: one source for f64 and lanes",
    ),
    (
        "pgsag_splat::losses",
        &["pgsag_splat::cpu", "pgsag_splat::reference", "pgsag_splat::train", "pgsag_splat::conformance"],
        "a loss knows no device and no schedule",
    ),
    (
        "pgsag_splat::stereo",
        &["pgsag_splat::cpu", "pgsag_splat::reference", "pgsag_splat::train", "pgsag_splat::conformance"],
        "stereo comes before there is any Gaussian",
    ),
    ("pgsag_splat::cpu", &["pgsag_splat::reference", "pgsag_splat::train"], "a device knows no schedule and no twin"),
    ("pgsag_splat::reference", &["pgsag_splat::cpu", "pgsag_splat::train"], "a device knows no schedule and no twin"),
    ("pgsag::run", &["pgsag::stages", "pgsag::pipeline"], "the runner can be tested with three toy stages"),
    ("pgsag::stages", &["pgsag::pipeline"], "a stage does not know the table"),
    ("pgsag_group", &["std::fs"], "paths are the product's"),
    ("pgsag_splat", &["std::fs"], "paths are the product's"),
    ("pgsag_mesh", &["std::fs"], "paths are the product's"),
    ("pgsag_scene", &["std::fs"], "only `files` touches files"),
];

/// Where a rule of `NEVER` does not hold.
const EXCEPT: &[(&str, &str)] = &[("pgsag_scene::files", "std::fs")];

/// The rows of the pipeline; `run/` must not spell them.
const STAGES: [&str; 13] = [
    "import", "coarse", "masks", "vote", "refine", "group", "train", "depth", "fuse", "mesh", "merge", "score",
    "report",
];

pub(super) fn arrows(source: &Source) -> Vec<Finding> {
    let Some(room) = module_of(&source.path) else { return Vec::new() };
    let room_path = room.join("::");
    let mut findings = Vec::new();
    for (line, parts) in source.paths() {
        if source.is_test_line(line) {
            continue;
        }
        let target = absolute(&room, &parts).join("::");
        for (from, never, why) in NEVER {
            let excepted = EXCEPT.iter().any(|(room, what)| is_below(&room_path, room) && is_below(&target, what));
            if is_below(&room_path, from) && !excepted && never.iter().any(|what| is_below(&target, what)) {
                findings.push(Finding::new(&source.path, line, format!("{from} must not name `{target}`: {why}")));
            }
        }
    }
    findings
}

pub(super) fn stage_names(source: &Source) -> Vec<Finding> {
    let in_runner = module_of(&source.path).is_some_and(|room| is_below(&room.join("::"), "pgsag::run"));
    let spelled = source
        .literals
        .iter()
        .filter(|(line, text)| in_runner && !source.is_test_line(*line) && STAGES.contains(&text.as_str()));
    spelled.map(|(line, text)| Finding::new(&source.path, *line, format!("run/ names the stage \"{text}\""))).collect()
}

/// `crates/pgsag-splat/src/train/density.rs` -> `[pgsag_splat, train, density]`; `None` outside of `src`.
fn module_of(path: &str) -> Option<Vec<String>> {
    let (name, rest) = path.strip_prefix("crates/")?.split_once("/src/")?;
    let mut parts = vec![name.replace('-', "_")];
    parts.extend(rest.trim_end_matches(".rs").split('/').map(str::to_owned));
    if matches!(parts.last().map(String::as_str), Some("lib" | "main" | "mod")) {
        parts.pop();
    }
    Some(parts)
}

/// A path as seen from the crates' roots. Modules within a file are not followed; `super` there leads too high, which
/// the rules forgive.
fn absolute(room: &[String], parts: &[String]) -> Vec<String> {
    let mut base: Vec<String> = Vec::new();
    let mut rest = parts;
    match parts.first().map(String::as_str) {
        Some("crate") => {
            base.extend(room.first().cloned());
            rest = &parts[1..];
        }
        Some("self") => {
            base.extend_from_slice(room);
            rest = &parts[1..];
        }
        Some("super") => {
            base.extend_from_slice(room);
            while rest.first().is_some_and(|word| word == "super") {
                base.pop();
                rest = &rest[1..];
            }
        }
        _ => {}
    }
    base.extend_from_slice(rest);
    base
}

fn is_below(path: &str, prefix: &str) -> bool {
    path.strip_prefix(prefix).is_some_and(|rest| rest.is_empty() || rest.starts_with("::"))
}
