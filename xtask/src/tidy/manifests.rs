//! Who may depend on whom, read from the manifests. The same table as the arrows, one level up.

use super::Finding;

/// A crate of the house and the only crates of the house that it may depend on, tests included.
const MAY: &[(&str, &[&str])] = &[
    ("pgsag-scene", &[]),
    ("pgsag-group", &["pgsag-scene"]),
    ("pgsag-splat", &["pgsag-scene"]),
    ("pgsag-mesh", &["pgsag-scene"]),
    ("pgsag-gpu", &["pgsag-scene", "pgsag-splat"]),
    ("pgsag-models", &["pgsag-scene", "pgsag-group"]),
    ("pgsag", &["pgsag-scene", "pgsag-group", "pgsag-splat", "pgsag-mesh", "pgsag-gpu", "pgsag-models"]),
    ("xtask", &[]),
    ("pgsag-fuzz", &["pgsag-scene"]),
];

pub(super) fn check(path: &str, manifest: &str) -> Vec<Finding> {
    if path == "Cargo.toml" {
        return Vec::new();
    }
    let Some(name) = value_of(manifest, "name") else {
        return vec![Finding::new(path, 1, "no package name")];
    };
    let Some((_, may)) = MAY.iter().find(|(known, _)| *known == name) else {
        return vec![Finding::new(
            path,
            1,
            format!("`{name}` has no place in the house: ARCHITECTURE.md, xtask/src/tidy/manifests.rs"),
        )];
    };
    let mut findings = Vec::new();
    let mut in_dependencies = false;
    for (index, line) in manifest.lines().map(str::trim).enumerate() {
        if line.starts_with('[') {
            in_dependencies = line.contains("dependencies");
            continue;
        }
        let key = line.split(['=', '.', ' ']).next().unwrap_or_default();
        let ours = MAY.iter().any(|(known, _)| *known == key);
        if in_dependencies && ours && !may.contains(&key) {
            findings.push(Finding::new(path, index + 1, format!("`{name}` must not depend on `{key}`")));
        }
        if in_dependencies && name == "xtask" && !key.is_empty() && !key.starts_with('#') && !ours {
            findings.push(Finding::new(path, index + 1, format!("xtask is std only, not `{key}`")));
        }
    }
    let takes_lints = manifest.contains("[lints]\nworkspace = true") || manifest.contains("[lints.rust]");
    if !takes_lints && name != "pgsag-fuzz" {
        findings.push(Finding::new(path, 1, "the workspace's lints are not taken: `[lints] workspace = true`"));
    }
    findings
}

/// The first `key = "value"`.
fn value_of<'a>(manifest: &'a str, key: &str) -> Option<&'a str> {
    let line = manifest.lines().find(|line| line.split('=').next().is_some_and(|word| word.trim() == key))?;
    line.split('"').nth(1)
}
