//! Takes a bundle's folder among the models, or makes a bundle of graphs that others exported.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use pgsag_models::Bundle;
use pgsag_models::bundle::{BundleFile, BundleKind, FileRole, MANIFEST, Manifest, TextRules, sha256_of};
use pgsag_models::onnx::Graph;
use pgsag_models::picture::PictureRules;

use super::super::{existing, print};
use super::{is_plain, publish};
use crate::error::UserError;

/// ImageNet's mean and deviation, which every network here was trained with.
const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
const STD: [f32; 3] = [0.229, 0.224, 0.225];

pub(super) fn run(
    models: &Path,
    files: &[PathBuf],
    name: Option<&str>,
    size: Option<&str>,
    licence: &str,
) -> Result<()> {
    let files = files.iter().map(|file| existing(file, "a file to import")).collect::<Result<Vec<_>>>()?;
    let is_bundle = files.len() == 1 && files[0].is_dir();
    let (manifest, sources) = if is_bundle {
        let bundle = Bundle::open(&files[0])?;
        bundle.check_files(true)?;
        let sources = bundle.manifest.files.iter().map(|file| files[0].join(&file.name)).collect();
        (bundle.manifest, sources)
    } else {
        (manifest_of(&files, name, size, licence)?, files)
    };
    let name = name.unwrap_or(&manifest.name).to_owned();
    if !is_plain(&name) {
        return Err(UserError::new(format!("--name {name:?}"), "cannot be a folder's name", "give another").into());
    }
    let part = models.join(format!(".{name}.part"));
    if part.is_dir() {
        std::fs::remove_dir_all(&part).with_context(|| part.display().to_string())?;
    }
    std::fs::create_dir_all(&part).with_context(|| part.display().to_string())?;
    for source in &sources {
        let target = part.join(source.file_name().unwrap_or_default());
        std::fs::copy(source, &target).with_context(|| target.display().to_string())?;
    }
    let text = toml::to_string(&Manifest { name: name.clone(), ..manifest }).context(MANIFEST)?;
    std::fs::write(part.join(MANIFEST), text).with_context(|| part.display().to_string())?;
    Bundle::open(&part)?.check_files(true)?;
    publish(&part, &models.join(&name))?;
    print(&format!("{name} is there{}", if is_bundle { "" } else { "; it has no self-test: look at its masks" }))
}

/// A file's role, by what its graph takes.
fn role_of(path: &Path) -> Result<(FileRole, Option<Graph>)> {
    match path.extension().and_then(|ending| ending.to_str()) {
        Some("json") => return Ok((FileRole::Tokenizer, None)),
        Some("onnx") => {}
        _ => return Ok((FileRole::Weights, None)),
    }
    let graph = Graph::open(path)?;
    let has = |name: &str| graph.input(name).is_some();
    let role = if has("input_ids") {
        FileRole::Detector
    } else if has("input_points") || has("point_coords") {
        FileRole::Decoder
    } else {
        FileRole::Encoder
    };
    Ok((role, Some(graph)))
}

/// Width and height as typed.
fn size_of(typed: &str) -> Result<[u32; 2]> {
    let parsed = typed.split_once('x').and_then(|(width, height)| Some([width.parse().ok()?, height.parse().ok()?]));
    parsed.ok_or_else(|| UserError::new(format!("--size {typed}"), "is no size", "such as 1200x800").into())
}

fn manifest_of(files: &[PathBuf], name: Option<&str>, size: Option<&str>, licence: &str) -> Result<Manifest> {
    let Some(name) = name else {
        return Err(UserError::new("--name", "graphs of others need a name", "give one").into());
    };
    let (mut listed, mut picture, mut kind) = (Vec::new(), None, BundleKind::Segmenter);
    for path in files {
        let (role, graph) = role_of(path)?;
        if let Some(info) = graph.as_ref().and_then(|graph| graph.inputs.iter().find(|info| info.shape.len() == 4)) {
            let fixed = info.shape[3].zip(info.shape[2]).map(|(width, height)| [width as u32, height as u32]);
            if role == FileRole::Detector {
                kind = BundleKind::Detector;
                picture = Some((size.map(size_of).transpose()?.or(fixed), None));
            } else if role == FileRole::Encoder {
                picture = Some((None, Some(fixed.map_or(1024, |size| size[0]))));
            }
        }
        let file_name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let bytes = std::fs::metadata(path).with_context(|| path.display().to_string())?.len();
        listed.push(BundleFile { role, name: file_name, bytes, sha256: sha256_of(path)? });
    }
    let Some((fixed, square)) = picture else {
        let cure = "give detector and tokenizer.json, or encoder and decoder";
        return Err(UserError::new("pgsag models import", "no graph takes a picture", cure).into());
    };
    if kind == BundleKind::Detector && fixed.is_none() {
        let cause = "a graph with open sizes may be right at one only, and no self-test says which";
        return Err(UserError::new("--size", cause, "give the size that it was exported at, such as 1200x800").into());
    }
    let is_detector = kind == BundleKind::Detector;
    let shortest = is_detector.then_some(800);
    let longest = is_detector.then_some(1333);
    Ok(Manifest {
        name: name.into(),
        kind,
        licence: licence.into(),
        source: "imported".into(),
        revision: None,
        exporter: None,
        image: PictureRules { shortest, longest, square, fixed, mean: MEAN, std: STD },
        text: is_detector.then_some(TextRules { longest: 256 }),
        files: listed,
    })
}
