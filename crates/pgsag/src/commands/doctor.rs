//! `pgsag doctor`: what is wrong with a scene, before hours are spent.

use std::path::Path;

use anyhow::{Result, bail};
use pgsag_scene::files::folder::{SceneFolder, open_scene};
use pgsag_splat::conformance::Comparison;
use serde::Serialize;
use serde_json::json;

use super::{existing, print};
use crate::cli::DoctorArgs;
use crate::config::size_text;
use crate::engine;
use crate::error::UserError;
use crate::networks;
use crate::run::machine;

mod cards;
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
    if args.self_test {
        return self_test(args, json);
    }
    let mut findings = match &args.scene {
        Some(folder) => of_scene(folder, args)?,
        None => Vec::new(),
    };
    findings.extend(devices());
    findings.extend(cards::findings());
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
            let place = args.scene.as_ref().map_or_else(|| finding.code.clone(), |scene| scene.display().to_string());
            Err(UserError::new(place, finding.text.clone(), finding.cure.clone()).into())
        }
        None => Ok(()),
    }
}

/// What is wrong with a scene.
fn of_scene(folder: &Path, args: &DoctorArgs) -> Result<Vec<Finding>> {
    let mut scene = open_scene(&existing(folder, "the scene")?)?;
    match args.masks.as_deref() {
        None | Some("geometry" | "language") => {}
        Some("none") => scene.mask_paths = vec![None; scene.scene.views.len()],
        Some(masks) => scene.attach_masks(Path::new(masks))?,
    }
    let mut findings = notes(&scene);
    findings.extend(geometry::findings(&scene.scene));
    findings.extend(pixels::findings(&scene));
    Ok(findings)
}

/// Prints how a device differs from the reference, by what was compared; fails where it differs too much.
fn self_test(args: &DoctorArgs, json: bool) -> Result<()> {
    let (device, report) = engine::self_test(&args.device, &args.simd)?;
    for found in report.comparisons.iter().filter(|found| json || !found.passed()) {
        let Comparison { name, norm, relative_error, cosine, bias, tolerance } = found;
        print(
            &json!({"name": name, "norm": norm, "relative_error": relative_error, "cosine": cosine, "bias": bias,
            "tolerance": tolerance, "passed": found.passed()})
            .to_string(),
        )?;
    }
    let failed = report.comparisons.iter().filter(|found| !found.passed()).count();
    let worst = report.worst().map_or_else(String::new, |worst| {
        format!("; worst is {}: {:.1e} of at most {:.0e}", worst.name, worst.relative_error, worst.tolerance)
    });
    let count = report.comparisons.len();
    if json {
        print(&json!({"device": device, "compared": count, "failed": failed, "faults": report.faults}).to_string())?;
    } else {
        print(&format!("{device}: {} of {count} quantities agree with the reference{worst}", count - failed))?;
    }
    if report.passed() {
        return Ok(());
    }
    let fault = report.faults.first().map_or_else(String::new, |fault| format!(", {fault}"));
    bail!(
        "{device} does not compute what it should ({failed} of {count} quantities{fault}); use another driver, or --device cpu"
    )
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
