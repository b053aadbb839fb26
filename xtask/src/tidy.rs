//! `cargo x tidy`: the house rules that a machine can read, each with a failing example in `tidy/tests.rs`.
//!
//! `rooms` holds the arrows that must never exist, `text` what a file looks like, `manifests` who depends on whom.

mod manifests;
mod rooms;
mod text;

use std::collections::BTreeMap;
use std::path::Path;

use crate::Result;
use crate::source::{Source, files_below, read_all};

/// Lines of product code (tests left out), all crates together. Raised by a decision record only.
const LINE_BUDGET: usize = 40_400;

/// A rule that is broken, and where.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Finding {
    path: String,
    line: usize,
    message: String,
}

impl Finding {
    fn new(path: &str, line: usize, message: impl Into<String>) -> Self {
        Self { path: path.to_owned(), line, message: message.into() }
    }
}

pub(crate) fn run(root: &Path) -> Result<()> {
    let sources = read_all(root)?;
    let paths = files_below(root, "")?;
    let mut findings: Vec<Finding> = sources.iter().flat_map(check).collect();
    findings.extend(text::forbidden_names(&paths));
    for path in paths.iter().filter(|path| path.ends_with("Cargo.toml")) {
        let manifest = std::fs::read_to_string(root.join(path)).map_err(|cause| format!("{path}: {cause}"))?;
        findings.extend(manifests::check(path, &manifest));
    }
    findings.sort();
    let lines = lines_by_crate(&sources);
    print_budget(&lines);
    let total: usize = lines.values().map(|(product, _)| product).sum();
    if total > LINE_BUDGET {
        findings.push(Finding::new(
            "xtask/src/tidy.rs",
            1,
            format!("{total} lines of product code: delete some, or decide"),
        ));
    }
    if findings.is_empty() {
        return Ok(());
    }
    let list: Vec<String> = findings.iter().map(|at| format!("  {}:{}: {}", at.path, at.line, at.message)).collect();
    Err(format!("{} rules broken\n{}", findings.len(), list.join("\n")))
}

/// All rules that look at one file.
fn check(source: &Source) -> Vec<Finding> {
    let rules: [fn(&Source) -> Vec<Finding>; 9] = [
        text::length,
        text::header,
        text::unfinished_marks,
        text::attributes_without_reason,
        text::unsafe_code,
        text::printing,
        text::device_switch,
        rooms::arrows,
        rooms::stage_names,
    ];
    rules.iter().flat_map(|rule| rule(source)).collect()
}

/// Product and test lines of each crate: lines that hold code, comments and blanks left out.
fn lines_by_crate(sources: &[Source]) -> BTreeMap<String, (usize, usize)> {
    let mut lines = BTreeMap::new();
    for source in sources {
        let name = source.path.trim_start_matches("crates/").split('/').next().unwrap_or_default();
        let counts: &mut (usize, usize) = lines.entry(name.to_owned()).or_default();
        for (index, _) in source.code.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let is_test = source.is_test_line(index + 1);
            counts.0 += usize::from(!is_test);
            counts.1 += usize::from(is_test);
        }
    }
    lines
}

fn print_budget(lines: &BTreeMap<String, (usize, usize)>) {
    println!("{:<14} {:>8} {:>8}", "lines of code", "product", "tests");
    for (name, (product, tests)) in lines {
        println!("{name:<14} {product:>8} {tests:>8}");
    }
    let total: usize = lines.values().map(|(product, _)| product).sum();
    println!("{:<14} {total:>8} of {LINE_BUDGET}", "all");
}

#[cfg(test)]
mod tests;
