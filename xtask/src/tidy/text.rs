//! What a file looks like: its length, its first line, its name, the marks and attributes in it.

use super::Finding;
use crate::source::Source;

/// A file is a chapter.
const LONGEST_FILE_LINES: usize = 600;

/// Names that say nothing of what is inside.
const EMPTY_NAMES: [&str; 10] =
    ["utils", "util", "helpers", "helper", "common", "misc", "manager", "data", "process", "glue"];

/// Words that say "not finished".
const UNFINISHED: [&str; 3] = ["TODO", "FIXME", "XXX"];

pub(super) fn length(source: &Source) -> Vec<Finding> {
    let count = source.text.lines().count();
    if count <= LONGEST_FILE_LINES {
        return Vec::new();
    }
    vec![Finding::new(&source.path, count, format!("{count} lines; a chapter has at most {LONGEST_FILE_LINES}"))]
}

/// `x/tests.rs` belongs to `x.rs`, whose header speaks for both.
pub(super) fn header(source: &Source) -> Vec<Finding> {
    if source.text.starts_with("//!") || source.path.ends_with("/tests.rs") {
        return Vec::new();
    }
    vec![Finding::new(&source.path, 1, "a file opens with `//!` and says what it is for")]
}

pub(super) fn unfinished_marks(source: &Source) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (line, comment) in &source.comments {
        for mark in UNFINISHED.iter().filter(|mark| has_word(comment, mark)) {
            findings.push(Finding::new(&source.path, *line, format!("{mark}: do it, or open an issue")));
        }
    }
    for (index, line) in source.code.lines().enumerate() {
        for mark in
            ["todo", "unimplemented"].iter().filter(|mark| has_word(line, mark) && line.contains(&format!("{mark}!")))
        {
            findings.push(Finding::new(&source.path, index + 1, format!("`{mark}!`: absent until it works; no stubs")));
        }
    }
    findings
}

/// `#[ignore]`, `#[allow(..)]` and `#[expect(..)]` must say why.
pub(super) fn attributes_without_reason(source: &Source) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (start, _) in source.code.match_indices('#') {
        let rest = source.code[start + 1..].trim_start_matches('!').trim_start();
        let Some(body) = rest.strip_prefix('[').and_then(bracketed) else { continue };
        let name: String =
            body.trim_start().chars().take_while(|letter| letter.is_alphanumeric() || *letter == '_').collect();
        let has_reason = match name.as_str() {
            "ignore" => body.contains('='),
            "allow" | "expect" => body.contains("reason"),
            _ => true,
        };
        if !has_reason {
            let line = source.code[..start].matches('\n').count() + 1;
            findings.push(Finding::new(&source.path, line, format!("`#[{name}]` without a reason")));
        }
    }
    findings
}

/// What stands before the bracket that closes an attribute.
fn bracketed(text: &str) -> Option<&str> {
    let mut depth = 1;
    for (at, letter) in text.char_indices() {
        match letter {
            '[' => depth += 1,
            ']' => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return Some(&text[..at]);
        }
    }
    None
}

/// `unsafe` is for the GPU wing, should it need any (decision 4).
pub(super) fn unsafe_code(source: &Source) -> Vec<Finding> {
    if source.path.starts_with("crates/pgsag-gpu/") {
        return Vec::new();
    }
    let lines = source.code.lines().enumerate().filter(|(_, line)| has_word(line, "unsafe"));
    let message = "`unsafe` outside of pgsag-gpu";
    lines.map(|(index, _)| Finding::new(&source.path, index + 1, message)).collect()
}

/// A library hands values and errors back; the product speaks.
pub(super) fn printing(source: &Source) -> Vec<Finding> {
    if !source.path.starts_with("crates/pgsag-") {
        return Vec::new();
    }
    let prints = |line: &str| ["print!", "println!", "eprint!", "eprintln!"].iter().any(|word| line.contains(word));
    let lines = source.product_lines().filter(|(_, line)| prints(line));
    lines.map(|(line, _)| Finding::new(&source.path, line, "a library does not print")).collect()
}

/// One question, one place: only `engine.rs` asks whether the GPU wing is there.
pub(super) fn device_switch(source: &Source) -> Vec<Finding> {
    if source.path == "crates/pgsag/src/engine.rs" || !source.path.starts_with("crates/") {
        return Vec::new();
    }
    let mut findings = Vec::new();
    for (index, (line, raw)) in source.code.lines().zip(source.text.lines()).enumerate() {
        if line.contains("cfg") && line.contains("feature") && raw.contains("feature = \"gpu\"") {
            findings.push(Finding::new(&source.path, index + 1, "`feature = \"gpu\"` outside engine.rs"));
        }
    }
    findings
}

/// Files and folders of empty names, and scripts: what a developer runs is `cargo x`.
pub(super) fn forbidden_names(paths: &[String]) -> Vec<Finding> {
    let mut findings = Vec::new();
    for path in paths {
        let parts = path.trim_end_matches(".rs").split('/');
        let is_code = path.ends_with(".rs");
        for part in parts.filter(|part| is_code && EMPTY_NAMES.contains(part)) {
            findings.push(Finding::new(path, 1, format!("`{part}` says nothing; name the noun")));
        }
        // How golden values came about is kept beside them; nobody runs it.
        let is_provenance = path.contains("/tests/golden/");
        // Networks are exported with the library that trained them (decision 19); a user runs that once.
        let is_exporter = path.starts_with("tools/") && path.ends_with(".py");
        if !is_provenance && !is_exporter && [".sh", ".py", ".bat", ".ps1"].iter().any(|ending| path.ends_with(ending))
        {
            findings.push(Finding::new(path, 1, "a script: write a word of `cargo x`"));
        }
    }
    findings
}

/// Whether a word stands in a text on its own.
pub(super) fn has_word(text: &str, word: &str) -> bool {
    let is_letter = |letter: char| letter.is_alphanumeric() || letter == '_';
    text.match_indices(word).any(|(at, _)| {
        let before = text[..at].chars().next_back();
        let after = text[at + word.len()..].chars().next();
        !before.is_some_and(is_letter) && !after.is_some_and(is_letter)
    })
}
