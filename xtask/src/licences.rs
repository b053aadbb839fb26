//! Every dependency's licence against the allow-list of `deny.toml`, from `cargo metadata` alone; then `cargo deny`
//! where it is installed, which also looks at bans and sources.

use std::path::Path;

use crate::Result;
use crate::json::Json;
use crate::steps::{output_of, shell};

pub(crate) fn run(root: &Path) -> Result<()> {
    let list = std::fs::read_to_string(root.join("deny.toml")).map_err(|cause| format!("deny.toml: {cause}"))?;
    let allowed = allow_list(&list);
    let metadata = output_of(root, "cargo", &["metadata", "--format-version", "1", "--locked"])?;
    let (count, refused) = check(&metadata, &allowed)?;
    if !refused.is_empty() {
        return Err(format!("deny.toml does not allow:\n  {}", refused.join("\n  ")));
    }
    println!("{count} packages, every licence among: {}", allowed.join(", "));
    if output_of(root, "cargo", &["--list"])?.lines().any(|line| line.trim_start().starts_with("deny ")) {
        return shell(root, "cargo", &["deny", "--locked", "check", "licenses", "bans", "sources"]);
    }
    println!("cargo-deny is not installed here: bans and sources were not checked");
    Ok(())
}

/// How many packages there are, and those that may not be used.
fn check(metadata: &str, allowed: &[String]) -> Result<(usize, Vec<String>)> {
    let metadata = Json::parse(metadata)?;
    let packages = metadata.get("packages").map(Json::list).unwrap_or_default();
    if packages.is_empty() {
        return Err("`cargo metadata` names no package".into());
    }
    let mut refused = Vec::new();
    for package in packages {
        let word = |key| package.get(key).and_then(Json::text);
        let licence = word("license");
        if !licence.is_some_and(|expression| is_allowed(expression, allowed)) {
            let name = word("name").unwrap_or("?");
            refused.push(format!(
                "{name} {}: {}",
                word("version").unwrap_or("?"),
                licence.unwrap_or("no licence given")
            ));
        }
    }
    Ok((packages.len(), refused))
}

/// The quoted words between `allow = [` and `]`.
fn allow_list(deny: &str) -> Vec<String> {
    let mut words = Vec::new();
    let mut inside = false;
    for line in deny.lines().map(|line| line.split('#').next().unwrap_or_default()) {
        let opens = line.trim_start().starts_with("allow = [");
        inside |= opens;
        if inside {
            words.extend(line.split('"').skip(1).step_by(2).map(str::to_owned));
            inside = !line.contains(']');
        }
    }
    words
}

/// Whether an SPDX expression can be satisfied with licences of the list. `/` is the old spelling of `OR`.
fn is_allowed(expression: &str, allowed: &[String]) -> bool {
    let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
    let words: Vec<&str> = spaced.split_whitespace().collect();
    let mut reader = Expression { words: &words, at: 0, allowed };
    reader.either() == Some(true) && reader.at == words.len()
}

struct Expression<'a> {
    words: &'a [&'a str],
    at: usize,
    allowed: &'a [String],
}

impl Expression<'_> {
    fn take(&mut self, word: &str) -> bool {
        let found = self.words.get(self.at) == Some(&word);
        self.at += usize::from(found);
        found
    }

    fn either(&mut self) -> Option<bool> {
        let mut good = self.both()?;
        while self.take("OR") {
            good |= self.both()?;
        }
        Some(good)
    }

    fn both(&mut self) -> Option<bool> {
        let mut good = self.one()?;
        while self.take("AND") {
            good &= self.one()?;
        }
        Some(good)
    }

    fn one(&mut self) -> Option<bool> {
        if self.take("(") {
            let good = self.either()?;
            return self.take(")").then_some(good);
        }
        let mut name = (*self.words.get(self.at)?).to_owned();
        self.at += 1;
        if self.take("WITH") {
            name = format!("{name} WITH {}", self.words.get(self.at)?);
            self.at += 1;
        }
        Some(self.allowed.contains(&name))
    }
}

#[cfg(test)]
mod tests;
