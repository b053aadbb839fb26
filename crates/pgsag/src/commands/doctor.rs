//! `pgsag doctor`: what is wrong with a scene, before hours are spent.

use std::path::Path;

use anyhow::Result;
use pgsag_scene::files::folder::{SceneFolder, open_scene};
use serde::Serialize;

use super::{existing, print};
use crate::cli::DoctorArgs;
use crate::config::size_text;
use crate::engine;
use crate::error::UserError;
use crate::networks;
use crate::run::machine;

mod geometry;
mod pixels;

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Severity {
    /// Good to know.
    Note,
    /// The result will be worse than it could be.
    Warning,
    /// There will be no result.
    Error,
}

/// One thing that was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Finding {
    /// Stable name of the kind of finding.
    pub(super) code: String,
    /// How much it matters.
    pub(super) severity: Severity,
    /// What was found, with names and numbers.
    pub(super) text: String,
    /// What to do about it; empty where nothing has to be done.
    pub(super) cure: String,
}

impl Finding {
    fn new(severity: Severity, code: &str, text: impl Into<String>, cure: &str) -> Self {
        Self { code: code.into(), severity, text: text.into(), cure: cure.into() }
    }
}

/// Names of a few of many.
fn some_of<'a>(names: impl ExactSizeIterator<Item = &'a str>) -> String {
    const SHOWN: usize = 5;
    let count = names.len();
    let listed: Vec<&str> = names.take(SHOWN).collect();
    if count > SHOWN { format!("{} and {} more", listed.join(", "), count - SHOWN) } else { listed.join(", ") }
}

/// Looks at everything and prints what was found, the worst first.
pub(super) fn run(args: &DoctorArgs, json: bool) -> Result<()> {
    let folder = existing(&args.scene, "the scene")?;
    let mut scene = open_scene(&folder)?;
    match args.masks.as_deref() {
        None | Some("geometry" | "language") => {}
        Some("none") => scene.mask_paths = vec![None; scene.scene.views.len()],
        Some(masks) => scene.attach_masks(Path::new(masks))?,
    }
    let mut findings = notes(&scene);
    findings.extend(geometry::findings(&scene.scene));
    findings.extend(pixels::findings(&scene));
    findings.extend(devices());
    findings.push(models());
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    for finding in &findings {
        if json {
            print(&serde_json::to_string(finding)?)?;
            continue;
        }
        let severity = format!("{:?}", finding.severity).to_lowercase();
        let cure = if finding.cure.is_empty() { String::new() } else { format!("; {}", finding.cure) };
        print(&format!("{severity:8} {:20} {}{cure}", finding.code, finding.text))?;
    }
    let count = |severity| findings.iter().filter(|finding| finding.severity == severity).count();
    let errors = count(Severity::Error);
    if !json {
        print(&format!("{errors} errors, {} warnings", count(Severity::Warning)))?;
    }
    match findings.first().filter(|finding| finding.severity == Severity::Error) {
        Some(finding) => {
            Err(UserError::new(folder.display().to_string(), finding.text.clone(), finding.cure.clone()).into())
        }
        None => Ok(()),
    }
}

/// What opening the scene has to say.
fn notes(scene: &SceneFolder) -> Vec<Finding> {
    scene.notes.iter().map(|note| Finding::new(Severity::Note, note.code, note.text.clone(), "")).collect()
}

/// Which networks are there for masks by language.
fn models() -> Finding {
    let cure = "docs/models.md says how to get one, if masks by language are wanted";
    let Ok(folder) = networks::models_folder("") else {
        return Finding::new(Severity::Note, "models", "no folder of models", cure);
    };
    let found = pgsag_models::bundle::list(&folder);
    if found.is_empty() {
        return Finding::new(Severity::Note, "models", format!("no model bundle in {}", folder.display()), cure);
    }
    let said = |bundle: &Result<pgsag_models::Bundle, pgsag_models::ModelError>| match bundle {
        Ok(bundle) => format!("{} ({:?})", bundle.manifest.name, bundle.manifest.kind).to_lowercase(),
        Err(error) => error.to_string(),
    };
    let list: Vec<String> = found.iter().map(said).collect();
    let runtimes: Vec<String> = [pgsag_models::RuntimeKind::Rten, pgsag_models::RuntimeKind::Ort]
        .iter()
        .filter_map(|kind| networks::engine(*kind, "cpu", 1).ok().map(|engine| engine.description()))
        .collect();
    let text = format!("{}: {}; runtimes: {}", folder.display(), list.join(", "), runtimes.join(", "));
    Finding::new(Severity::Note, "models", text, "")
}

fn devices() -> Vec<Finding> {
    let memory = machine::available_memory_bytes().map_or_else(|| "unknown".into(), size_text);
    let text = format!(
        "cpu: {} threads, SIMD levels {}, {memory} of memory available",
        machine::thread_count(),
        engine::levels().join(", ")
    );
    vec![Finding::new(Severity::Note, "device", text, "")]
}
