//! `pgsag models`: bundles that are there, where to get them, whether they compute rightly. Only `fetch` touches a network.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use pgsag_models::bundle::{self, Bundle, MANIFEST, verify_answers};
use serde_json::json;

use super::print;
use crate::cli::{ModelsArgs, ModelsWhat};
use crate::error::UserError;
use crate::networks;

mod fetch;
mod import;

/// Bundles that people use: name, licence of the weights, where those come from.
const KNOWN: [(&str, &str, &str); 6] = [
    ("grounding-dino-base", "Apache-2.0", "IDEA-Research/grounding-dino-base"),
    ("grounding-dino-tiny", "Apache-2.0", "IDEA-Research/grounding-dino-tiny"),
    ("sam2.1-hiera-tiny", "Apache-2.0", "facebook/sam2.1-hiera-tiny"),
    ("sam2.1-hiera-small", "Apache-2.0", "facebook/sam2.1-hiera-small"),
    ("sam2.1-hiera-base-plus", "Apache-2.0", "facebook/sam2.1-hiera-base-plus"),
    ("sam2.1-hiera-large", "Apache-2.0", "facebook/sam2.1-hiera-large"),
];

pub(super) fn run(args: &ModelsArgs, json: bool) -> Result<()> {
    let typed = args.networks.models_dir.as_ref().map(|path| path.to_string_lossy().into_owned()).unwrap_or_default();
    let models = networks::models_folder(&typed)?;
    match &args.what {
        ModelsWhat::List => list(&models, json),
        ModelsWhat::Fetch { what, accept_license } => fetch::run(&models, what, *accept_license),
        ModelsWhat::Verify { bundle } => verify(&models, bundle.as_deref(), args, json),
        ModelsWhat::Import { files, name, size, licence } => {
            import::run(&models, files, name.as_deref(), size.as_deref(), licence)
        }
    }
}

/// Where a known bundle's weights come from and how it is made.
fn how_to_get(name: &str, source: &str) -> String {
    let kind = if name.starts_with("sam") { "segmenter" } else { "detector" };
    format!("download {source} and run: python tools/export_models.py {kind} {name} -o MODELS/{name}")
}

fn list(models: &Path, json: bool) -> Result<()> {
    let found = bundle::list(models);
    if !json {
        print(&format!("{}: {} bundles", models.display(), found.len()))?;
    }
    for bundle in &found {
        match bundle {
            Ok(Bundle { folder, manifest }) => {
                let bytes: u64 = manifest.files.iter().map(|file| file.bytes).sum();
                let kind = format!("{:?}", manifest.kind).to_lowercase();
                if json {
                    let line = json!({ "name": manifest.name, "kind": kind, "bytes": bytes, "licence": manifest.licence, "folder": folder });
                    print(&line.to_string())?;
                } else {
                    print(&format!(
                        "  {:24} {kind:10} {:7.1} MB  {}",
                        manifest.name,
                        bytes as f64 / 1e6,
                        manifest.licence
                    ))?;
                }
            }
            Err(error) => print(&format!("  {error}"))?,
        }
    }
    if !json {
        print("known, not pinned yet (no revision and no hash that we have seen):")?;
        for (name, licence, source) in KNOWN {
            print(&format!("  {name:24} {licence}: {}", how_to_get(name, source)))?;
        }
    }
    Ok(())
}

fn verify(models: &Path, which: Option<&str>, args: &ModelsArgs, json: bool) -> Result<()> {
    let bundles: Vec<Bundle> = match which {
        Some(name) if Path::new(name).join(MANIFEST).is_file() => vec![Bundle::open(Path::new(name))?],
        Some(name) => vec![Bundle::open(&models.join(name))?],
        None => bundle::list(models).into_iter().collect::<Result<_, _>>()?,
    };
    if bundles.is_empty() {
        return Err(UserError::at(models, "there is no bundle here", "--models-dir says where they are").into());
    }
    let kind = super::mask::runtime_kind(&args.networks.runtime)?;
    let engine = networks::engine(kind, &args.networks.device, args.networks.threads)?;
    let mut wrong = None;
    for bundle in &bundles {
        bundle.check_files(true)?;
        for case in verify_answers(bundle, &engine)? {
            let word = if case.is_right { "right" } else { "WRONG" };
            if json {
                let line = json!({ "bundle": bundle.manifest.name, "case": case.case, "right": case.is_right, "text": case.words });
                print(&line.to_string())?;
            } else {
                print(&format!("{word}  {}: {}: {}", bundle.manifest.name, case.case, case.words))?;
            }
            if !case.is_right {
                wrong.get_or_insert((bundle.folder.clone(), case));
            }
        }
    }
    let Some((folder, case)) = wrong else { return Ok(()) };
    let cause = format!("self-test failed on {} ({}: {})", engine.description(), case.case, case.words);
    Err(UserError::at(&folder, cause, "export it with tools/export_models.py, or choose another --runtime").into())
}

/// Whether a name is one folder, here and on any system.
fn is_plain(name: &str) -> bool {
    let is_harmless = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, '-' | '_' | '.');
    !name.is_empty() && !name.starts_with('.') && name.chars().all(is_harmless)
}

/// Puts a finished folder in its place.
fn publish(from: &Path, to: &PathBuf) -> Result<()> {
    if to.exists() {
        return Err(UserError::at(to, "is there already", "remove it, or give another --name").into());
    }
    std::fs::rename(from, to).with_context(|| to.display().to_string())
}
