//! Where model bundles lie and how two of them become what the stages ask.

use std::path::{Path, PathBuf};

use anyhow::Result;
use pgsag_models::bundle::{self, BundleKind};
use pgsag_models::language::Tiling;
use pgsag_models::{Bundle, Device, Engine, LanguageSegmenter, MaskChoice, Prompt, RuntimeKind, SessionOptions, Wing};
use serde::{Deserialize, Serialize};

use crate::error::UserError;

/// Which networks find buildings, and how they are asked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LanguageOptions {
    /// Folder of model bundles; empty: `PGSAG_MODELS`, else the user's own data folder.
    pub models: String,
    /// Name of the detector's bundle; empty: the only one there is.
    pub detector: String,
    /// Name of the segmenter's bundle; empty: the only one there is.
    pub segmenter: String,
    /// `rten` or `ort`.
    pub runtime: RuntimeKind,
    /// `cpu` or `cuda:N`.
    pub device: String,
    /// What to look for, each kind ended by a full stop.
    pub words: String,
    /// Least score of a box, 0 to 1; lower than lang-segment-anything's 0.3, since votes sort out what is wrong. Paper 4.1.
    pub box_threshold: f32,
    /// Which of a box's masks is taken: `single`, `stable` or `best`.
    pub mask: MaskChoice,
    /// Side of the tiles that photographs are cut into, pixels; 0: none.
    pub tile_px: u32,
    /// Share of a tile's side that its neighbour shows as well.
    pub tile_overlap: f64,
}

impl Default for LanguageOptions {
    fn default() -> Self {
        Self {
            models: String::new(),
            detector: String::new(),
            segmenter: String::new(),
            runtime: RuntimeKind::Rten,
            device: "cpu".into(),
            words: "buildings.".into(),
            box_threshold: 0.2,
            mask: MaskChoice::Single,
            tile_px: 0,
            tile_overlap: 0.2,
        }
    }
}

/// Names the folder where nobody does.
const VARIABLE: &str = "PGSAG_MODELS";

/// What to do without networks.
const NO_BUNDLE: &str =
    "docs/models.md says how to get one; without, give a folder of masks, --masks geometry, or --masks none";

/// The folder of model bundles: as typed, as the environment says, or the user's own.
pub(crate) fn models_folder(typed: &str) -> Result<PathBuf> {
    if !typed.is_empty() {
        return Ok(typed.into());
    }
    let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let own = || {
        let data = variable("XDG_DATA_HOME").or_else(|| variable("LOCALAPPDATA"));
        data.or_else(|| Some(variable("HOME")?.join(".local/share"))).map(|data| data.join("pgsag/models"))
    };
    variable(VARIABLE).or_else(own).ok_or_else(|| {
        UserError::new("--models-dir", "there is no home folder to look for models in", "say where they are").into()
    })
}

/// A device as typed.
pub(crate) fn device(typed: &str) -> Result<Device> {
    let cuda = typed.strip_prefix("cuda").map(|rest| rest.strip_prefix(':').unwrap_or("0").parse());
    match (typed, cuda) {
        ("auto" | "cpu", _) => Ok(Device::Cpu),
        (_, Some(Ok(number))) => Ok(Device::Cuda(number)),
        _ => Err(UserError::new(format!("--device {typed}"), "there is no such device", "use cpu or cuda:N").into()),
    }
}

/// Starts a runtime.
pub(crate) fn engine(runtime: RuntimeKind, typed_device: &str, threads: usize) -> Result<Engine> {
    Ok(Engine::new(runtime, SessionOptions { threads, device: device(typed_device)? })?)
}

/// The bundle of this name below a folder; an empty name is the only one of its kind.
pub(crate) fn bundle_of(models: &Path, kind: BundleKind, name: &str) -> Result<Bundle> {
    if !name.is_empty() {
        return Ok(Bundle::open(&models.join(name))?);
    }
    let word = format!("{kind:?}").to_lowercase();
    let (mut found, mut damaged) = (Vec::new(), None);
    for bundle in bundle::list(models) {
        match bundle {
            Ok(bundle) if bundle.manifest.kind == kind => found.push(bundle),
            Ok(_) => {}
            Err(error) => damaged = damaged.or(Some(error)),
        }
    }
    match (found.len(), found.pop(), damaged) {
        (1, Some(only), _) => Ok(only),
        (0, _, Some(error)) => Err(error.into()),
        (0, ..) => Err(UserError::at(models, format!("there is no {word} here"), NO_BUNDLE).into()),
        (count, ..) => {
            let cause = format!("there are {count} bundles that are a {word}");
            Err(UserError::at(models, cause, format!("choose one with --{word} NAME")).into())
        }
    }
}

/// The detector's and the segmenter's bundle.
///
/// # Errors
/// Where one is missing or damaged.
pub fn bundles(options: &LanguageOptions) -> Result<[Bundle; 2]> {
    let models = models_folder(&options.models)?;
    let detector = bundle_of(&models, BundleKind::Detector, &options.detector)?;
    Ok([detector, bundle_of(&models, BundleKind::Segmenter, &options.segmenter)?])
}

/// Smaller tiles show nothing whole, pixels.
const LEAST_TILE_PX: u32 = 64;

/// Refuses a share outside of 0 to `most`.
pub(crate) fn must_be_share(what: &str, value: f64, most: f64) -> Result<()> {
    if (0.0..=most).contains(&value) {
        return Ok(());
    }
    Err(UserError::new(format!("{what} {value}"), "cannot be", format!("give a number from 0 to {most}")).into())
}

/// Loads both networks; `threads` for each computation, 0 for all.
///
/// # Errors
/// Where one is missing, damaged or refused.
pub fn wing(options: &LanguageOptions, threads: usize) -> Result<Wing> {
    must_be_share("box threshold", options.box_threshold.into(), 1.0)?;
    must_be_share("overlap of tiles", options.tile_overlap, 0.9)?;
    if (1..LEAST_TILE_PX).contains(&options.tile_px) {
        let cause = format!("is less than {LEAST_TILE_PX} pixels");
        return Err(
            UserError::new(format!("tile of {}", options.tile_px), cause, "take larger tiles, or 0: none").into()
        );
    }
    let [detector, segmenter] = bundles(options)?;
    let engine = engine(options.runtime, &options.device, threads)?;
    tracing::info!("{}: {} and {}", engine.description(), detector.manifest.name, segmenter.manifest.name);
    let networks = LanguageSegmenter {
        detector: detector.detector(&engine)?,
        segmenter: segmenter.segmenter(&engine)?,
        choice: options.mask,
        tiling: Tiling { side_px: options.tile_px, overlap: options.tile_overlap },
    };
    if options.mask == MaskChoice::Single && !networks.segmenter.has_single() {
        tracing::warn!("{} has no mask token 0: the best of three is taken", segmenter.manifest.name);
    }
    let prompt = Prompt { text: options.words.clone(), box_threshold: options.box_threshold, ..Prompt::default() };
    networks.detector.ids(&prompt.text)?;
    Ok(Wing { networks, prompt })
}

/// What decides the networks' answers beside the settings: a name and the fingerprint of each manifest.
pub(crate) fn sources(options: &LanguageOptions) -> Result<Vec<(String, String)>> {
    let fingerprint = |bundle: Bundle| -> Result<(String, String)> {
        let manifest = bundle.folder.join(bundle::MANIFEST);
        Ok((bundle.manifest.name.clone(), bundle::sha256_of(&manifest)?))
    };
    // Where there is none, the stage itself says so.
    bundles(options).map_or(Ok(Vec::new()), |bundles| bundles.into_iter().map(fingerprint).collect())
}

/// What a pixel of a network's input needs while it runs, beside twice the weights, bytes: from the peaks in docs/models.md.
fn bytes_per_pixel(runtime: RuntimeKind) -> u64 {
    match runtime {
        RuntimeKind::Rten => 650,
        RuntimeKind::Ort => 2000,
    }
}

/// What both networks need, bytes: their weights as read and as held, and the larger of the two computations.
pub(crate) fn memory_bytes(options: &LanguageOptions) -> u64 {
    let mut bytes = 0;
    let mut most_pixels = 0;
    for bundle in bundles(options).into_iter().flatten() {
        bytes += 2 * bundle.manifest.files.iter().map(|file| file.bytes).sum::<u64>();
        let rules = &bundle.manifest.image;
        let longest = u64::from(rules.longest.unwrap_or(0)) * u64::from(rules.shortest.unwrap_or(0));
        let fixed = rules.fixed.map_or(0, |[width, height]| u64::from(width) * u64::from(height));
        most_pixels = most_pixels.max(longest).max(fixed).max(u64::from(rules.square.unwrap_or(0)).pow(2));
    }
    bytes + most_pixels * bytes_per_pixel(options.runtime)
}
