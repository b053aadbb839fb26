//! `cargo x quick`: the loop while writing. Only crates that differ from `main` are checked.

use std::collections::BTreeSet;
use std::path::Path;

use crate::ci::fmt;
use crate::steps::{Steps, output_of, shell};
use crate::{Result, tidy};

pub(crate) fn run(root: &Path) -> Result<()> {
    let crates = changed_crates(&changed_paths(root)?);
    let mut steps = Steps::default();
    steps.run("fmt", || fmt(root));
    steps.run("tidy", || tidy::run(root));
    if crates.is_empty() {
        println!("\nno crate differs from main");
        return steps.finish();
    }
    let packages: Vec<&str> = crates.iter().flat_map(|name| ["-p", name]).collect();
    steps.run("clippy", || {
        shell(root, "cargo", &[&["clippy"], packages.as_slice(), &["--all-targets", "--", "-D", "warnings"]].concat())
    });
    steps.run("tests", || {
        shell(root, "cargo", &[&["test"], packages.as_slice(), &["--lib", "--bins", "--no-fail-fast"]].concat())
    });
    steps.finish()
}

/// Paths that differ from where this branch left `main`, untracked files included.
fn changed_paths(root: &Path) -> Result<Vec<String>> {
    let base =
        ["origin/main", "main"].iter().find_map(|name| output_of(root, "git", &["merge-base", "HEAD", name]).ok());
    let base = base.unwrap_or_else(|| "HEAD".to_owned());
    let tracked = output_of(root, "git", &["diff", "--name-only", base.trim()])?;
    let untracked = output_of(root, "git", &["ls-files", "--others", "--exclude-standard"])?;
    Ok(tracked.lines().chain(untracked.lines()).map(str::to_owned).collect())
}

fn changed_crates(paths: &[String]) -> BTreeSet<String> {
    let mut crates = BTreeSet::new();
    for path in paths {
        let mut parts = path.split('/');
        match (parts.next(), parts.next()) {
            (Some("crates"), Some(name)) => crates.insert(name.to_owned()),
            (Some("xtask"), Some(_)) => crates.insert("xtask".to_owned()),
            _ => false,
        };
    }
    crates
}

#[cfg(test)]
mod tests {
    use super::changed_crates;

    #[test]
    fn a_path_belongs_to_its_crate_and_a_document_to_none() {
        let paths = ["crates/pgsag-mesh/src/tsdf.rs", "xtask/src/ci.rs", "README.md", "crates/pgsag-mesh/Cargo.toml"];
        let crates = changed_crates(&paths.map(str::to_owned));
        assert_eq!(crates.into_iter().collect::<Vec<_>>(), ["pgsag-mesh", "xtask"]);
    }
}
