//! Small chores: the demo town, and the release checklist as CONTRIBUTING.md has it.

use std::path::Path;

use crate::Result;
use crate::steps::shell;

/// Where the demo's run folder lies, below the target folder's usual place.
const TOWN_RUN: &str = "target/town.run";

pub(crate) fn town(root: &Path) -> Result<()> {
    shell(root, "cargo", &["run", "--release", "--locked", "-p", "pgsag", "--", "demo", "-o", TOWN_RUN])?;
    println!("report: {}", root.join(TOWN_RUN).join("result/report.html").display());
    Ok(())
}

pub(crate) fn corrupt_masks(root: &Path, arguments: impl Iterator<Item = String>) -> Result<()> {
    example(root, &["masks", "--", "corrupt"], arguments)
}

pub(crate) fn harden(root: &Path, arguments: impl Iterator<Item = String>) -> Result<()> {
    example(root, &["harden", "--"], arguments)
}

fn example(root: &Path, name: &[&str], arguments: impl Iterator<Item = String>) -> Result<()> {
    let arguments: Vec<String> = arguments.collect();
    let mut words = vec!["run", "--release", "--locked", "-p", "pgsag", "--example"];
    words.extend(name);
    words.extend(arguments.iter().map(String::as_str));
    shell(root, "cargo", &words)
}

pub(crate) fn release(root: &Path) -> Result<()> {
    let text =
        std::fs::read_to_string(root.join("CONTRIBUTING.md")).map_err(|cause| format!("CONTRIBUTING.md: {cause}"))?;
    let list = section(&text, "## Release checklist").ok_or("CONTRIBUTING.md has no `## Release checklist`")?;
    println!("{list}");
    Ok(())
}

/// The text below a heading, up to the next heading of the same level.
fn section<'a>(text: &'a str, heading: &str) -> Option<&'a str> {
    let start = text.find(&format!("{heading}\n"))? + heading.len() + 1;
    let rest = &text[start..];
    Some(rest[..rest.find("\n## ").unwrap_or(rest.len())].trim())
}

#[cfg(test)]
mod tests {
    use super::section;

    #[test]
    fn a_section_ends_at_the_next_heading() {
        let text = "# a\n## one\n1. x\n2. y\n\n## two\nz\n";
        assert_eq!(section(text, "## one"), Some("1. x\n2. y"));
        assert_eq!(section(text, "## two"), Some("z"));
        assert_eq!(section(text, "## three"), None);
    }
}
