//! `docs/paper.md` against the code: every row of a ledger table names a living function and a living test.
//!
//! A table is a ledger table when its header has the columns `function` and `test`. A name is `path.rs::name` in
//! backticks, its path from `crates/pgsag-splat/src/`, or from `crates/` where it begins with a crate's name.

use std::path::Path;

use crate::Result;
use crate::source::Source;

const LEDGER: &str = "docs/paper.md";

pub(crate) fn run(root: &Path) -> Result<()> {
    let text = std::fs::read_to_string(root.join(LEDGER)).map_err(|cause| format!("{LEDGER}: {cause}"))?;
    let read = |path: &str| std::fs::read_to_string(root.join(path)).ok();
    let (row_count, faults) = check(&text, &read);
    if row_count == 0 {
        return Err(format!("{LEDGER}: there is no table with the columns `function` and `test`"));
    }
    if !faults.is_empty() {
        return Err(format!("{LEDGER}:\n  {}", faults.join("\n  ")));
    }
    println!("{row_count} rows, every function and test is alive");
    Ok(())
}

/// How many rows there are, and what is wrong with them.
fn check(ledger: &str, read: &dyn Fn(&str) -> Option<String>) -> (usize, Vec<String>) {
    let (mut row_count, mut faults) = (0, Vec::new());
    let mut columns: Option<(usize, usize)> = None;
    let mut in_table = false;
    for (index, line) in ledger.lines().enumerate() {
        if !line.trim_start().starts_with('|') {
            in_table = false;
            continue;
        }
        let cells = cells(line);
        if !in_table {
            in_table = true;
            let column = |name| cells.iter().position(|cell| cell == name);
            columns = column("function").zip(column("test"));
            continue;
        }
        let Some((function, test)) = columns else { continue };
        if cells.iter().all(|cell| cell.trim_matches([':', '-']).is_empty()) {
            continue;
        }
        row_count += 1;
        let mut fault = |message| faults.push(format!("line {}: {message}", index + 1));
        for (column, is_test) in [(function, false), (test, true)] {
            let names = names(cells.get(column).map_or("", String::as_str));
            if names.is_empty() {
                fault(format!("no {} is named", if is_test { "test" } else { "function" }));
            }
            for name in names {
                if let Err(message) = find(&name, is_test, read) {
                    fault(message);
                }
            }
        }
    }
    (row_count, faults)
}

/// The cells of a table row. A bar in backticks or behind a backslash is no border.
fn cells(line: &str) -> Vec<String> {
    let (mut found, mut cell, mut quoted, mut escaped) = (Vec::new(), String::new(), false, false);
    for letter in line.trim().trim_start_matches('|').chars() {
        if letter == '|' && !quoted && !escaped {
            found.push(std::mem::take(&mut cell).trim().to_owned());
        } else {
            cell.push(letter);
        }
        quoted ^= letter == '`';
        escaped = letter == '\\' && !escaped;
    }
    found
}

/// What stands in backticks and has the form `path.rs::name`.
fn names(cell: &str) -> Vec<String> {
    cell.split('`').skip(1).step_by(2).filter(|word| word.contains(".rs::")).map(str::to_owned).collect()
}

fn find(name: &str, is_test: bool, read: &dyn Fn(&str) -> Option<String>) -> Result<()> {
    let (file, item) = name.split_once(".rs::").ok_or_else(|| format!("`{name}`: `path.rs::name` expected"))?;
    let path =
        if file.starts_with("pgsag") { format!("crates/{file}") } else { format!("crates/pgsag-splat/src/{file}") };
    let text = read(&format!("{path}.rs")).ok_or_else(|| format!("`{name}`: there is no file {path}.rs"))?;
    let source = Source::new(&path, &text);
    let item = item.rsplit("::").next().unwrap_or(item);
    let alive = if is_test { has_test(&source.code, item) } else { has_item(&source.code, item) };
    let kind = if is_test { "test" } else { "function" };
    if alive { Ok(()) } else { Err(format!("`{name}`: {path}.rs has no {kind} `{item}`")) }
}

fn has_item(code: &str, item: &str) -> bool {
    let kinds = ["fn", "struct", "enum", "trait", "const", "macro_rules!"];
    code.lines().any(|line| kinds.iter().any(|kind| declares(line, kind, item)))
}

/// A function `item` with `#[test]` among the attributes above it, or made by `proptest!`.
fn has_test(code: &str, item: &str) -> bool {
    let lines: Vec<&str> = code.lines().collect();
    let Some(at) = lines.iter().position(|line| declares(line, "fn", item)) else { return false };
    let attributes = lines[..at].iter().rev().take_while(|line| {
        let line = line.trim();
        line.is_empty() || line.starts_with('#') || line.ends_with(']')
    });
    lines[at].contains("#[test]") || attributes.into_iter().any(|line| line.contains("#[test]"))
}

fn declares(line: &str, kind: &str, item: &str) -> bool {
    let Some(start) = line.find(&format!("{kind} {item}")) else { return false };
    let word_before = line[..start].chars().next_back().is_some_and(char::is_alphanumeric);
    let after = line[start + kind.len() + 1 + item.len()..].chars().next();
    !word_before && after.is_none_or(|letter| !letter.is_alphanumeric() && letter != '_')
}

#[cfg(test)]
mod tests;
