//! What was typed -> what it means: defaults < preset < file < `--set` < flags, and where each value came from.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context as _, Result};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use pgsag_group::VoteOptions;
use pgsag_group::blocks::BlockOptions;
use pgsag_group::geometry::GeometryOptions;
use pgsag_group::refine::RefineOptions;
use pgsag_mesh::TsdfOptions;
use pgsag_mesh::fuse::{FilterOptions, SupportOptions};
use pgsag_mesh::score::ScoreOptions;
use pgsag_splat::train::{DepthOptions, InitialiseOptions, NeighborOptions, TrainOptions};

use crate::error::UserError;
use crate::networks::LanguageOptions;
use crate::run::settings::Settings;
use crate::stages::coarse::CoarseOptions;
use crate::stages::group::GroupingOptions;
use crate::stages::merge::BuildingOptions;
use crate::stages::mesh::SurfaceOptions;
use crate::stages::score::evidence::EvidenceOptions;

pub mod keys;
pub mod sizes;

pub use sizes::{parse_size, size_text};

/// Which set of values a run starts from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// CPU minutes.
    Fast,
    /// Best quality per hour.
    #[default]
    Standard,
    /// The printed equations and weights.
    Paper,
}

/// Which images are learnt from. Two runs, one of the odd and one of the even images, share no photograph: how far their
/// meshes lie apart says how sure either is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum ImageChoice {
    /// All.
    #[default]
    All,
    /// The first, third, fifth … by sorted name.
    Odd,
    /// The second, fourth, sixth … by sorted name.
    Even,
}

/// Everything that can be set. The first part does not change any answer, but that a given memory limit says how large
/// a group may be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// `fast`, `standard` or `paper`.
    pub preset: Preset,
    /// Jobs of a stage at once; 0: as many as the machine's threads allow at four threads each.
    pub jobs: u32,
    /// Threads of all jobs together; 0: all of the machine's.
    pub threads: u32,
    /// Memory of all jobs together, such as `8GiB`; empty: 80 % of what is available.
    pub memory_limit: String,
    /// The last stage to run; empty: all.
    pub until: String,
    /// Where jobs run: `local`.
    pub engine: String,
    /// The scene's folder; given as an argument.
    pub scene: String,

    /// Seed of everything random.
    pub seed: u64,
    /// `auto`, a folder, `geometry`, `language` or `none`.
    pub masks: String,
    /// Rasters of building numbers per image: `auto` (`SCENE/instances` where it exists), a folder, or `none`.
    pub instances: String,
    /// Longest side of the images in training, pixels; 0: original.
    pub image_width: u32,
    /// `auto` (a GPU where there is one), `cpu`, `gpu`, `gpu:N` or several: `gpu:N,gpu:M`.
    pub device: String,
    /// `auto` or a SIMD level that `pgsag doctor` lists.
    pub simd: String,
    /// Every Nth image by sorted name is kept out of training; 0: none.
    pub holdout: u32,
    /// `all`, `odd` or `even` by sorted name; the others are kept out of training.
    pub images: ImageChoice,
    /// Metres in one unit of the scene; 0: as the scene's own files say.
    pub metres_per_unit: f64,
    /// A GeoJSON polygon in scene coordinates; empty: everything.
    pub aoi: String,
    /// Truth to score against; empty: no score.
    pub truth: String,

    /// Points on everything, to begin from.
    pub coarse: CoarseOptions,
    /// Masks from the shape of the scene.
    pub geometry: GeometryOptions,
    /// Masks by language.
    pub language: LanguageOptions,
    /// Votes of the views on points.
    pub vote: VoteOptions,
    /// Masks to pixel classes.
    pub refine: RefineOptions,
    /// Buildings to groups.
    pub groups: GroupingOptions,
    /// Background to blocks.
    pub blocks: BlockOptions,
    /// The first Gaussians.
    pub initialise: InitialiseOptions,
    /// Which views are compared.
    pub neighbors: NeighborOptions,
    /// Training.
    pub train: TrainOptions,
    /// Which rendered depths deserve belief.
    pub depth: DepthOptions,
    /// Which pixels lie near or between points.
    pub support: SupportOptions,
    /// Which depths the other views confirm.
    pub filter: FilterOptions,
    /// Depth to surface.
    pub surface: SurfaceOptions,
    /// Surface to buildings.
    pub buildings: BuildingOptions,
    /// How to score.
    pub score: ScoreOptions,
    /// What is asked where there is no truth.
    pub evidence: EvidenceOptions,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            preset: Preset::Standard,
            jobs: 0,
            threads: 0,
            memory_limit: String::new(),
            until: String::new(),
            engine: "local".into(),
            scene: String::new(),
            seed: 0,
            masks: "auto".into(),
            instances: "auto".into(),
            image_width: 0,
            device: "auto".into(),
            simd: "auto".into(),
            holdout: 0,
            images: ImageChoice::All,
            metres_per_unit: 0.0,
            aoi: String::new(),
            truth: String::new(),
            coarse: CoarseOptions::default(),
            geometry: GeometryOptions::default(),
            language: LanguageOptions::default(),
            vote: VoteOptions::default(),
            refine: RefineOptions::default(),
            groups: GroupingOptions::default(),
            blocks: BlockOptions::default(),
            initialise: InitialiseOptions::default(),
            neighbors: NeighborOptions::default(),
            train: TrainOptions::default(),
            depth: DepthOptions::default(),
            support: SupportOptions::default(),
            filter: FilterOptions::default(),
            surface: SurfaceOptions::default(),
            buildings: BuildingOptions::default(),
            score: ScoreOptions::default(),
            evidence: EvidenceOptions::default(),
        }
    }
}

impl Config {
    /// The values of a preset.
    #[must_use]
    pub fn preset(preset: Preset) -> Self {
        let standard = Self { preset, ..Self::default() };
        match preset {
            Preset::Standard => standard,
            Preset::Fast => Self { train: TrainOptions::fast(), ..standard },
            Preset::Paper => {
                let initialise = InitialiseOptions { sh_degree: 3, ..standard.initialise };
                // The paper trains every group for all steps, and on nothing but its buildings.
                let groups = GroupingOptions { equal_looks: false, collar_px: 0.0, ..standard.groups };
                // Nor does it add surface where there was none, or weigh a measurement by where it is asked.
                let buildings = BuildingOptions { max_hole_rim_m: 0.0, ..standard.buildings };
                let tsdf = TsdfOptions { behind_weight: 1.0, ..standard.surface.tsdf };
                let surface = SurfaceOptions { max_gap_m: 0.0, tsdf, ..standard.surface };
                Self { train: TrainOptions::paper(), initialise, groups, surface, buildings, ..standard }
            }
        }
    }

    /// Whether a view is kept out of training.
    #[must_use]
    pub fn is_held_out(&self, view_index: usize) -> bool {
        let is_other_half = match self.images {
            ImageChoice::All => false,
            ImageChoice::Odd => !view_index.is_multiple_of(2),
            ImageChoice::Even => view_index.is_multiple_of(2),
        };
        is_other_half || (self.holdout > 1 && view_index.is_multiple_of(self.holdout as usize))
    }

    /// As dotted keys, in one spelling per value.
    ///
    /// # Panics
    /// Never: a configuration is plain data.
    #[must_use]
    pub fn settings(&self) -> Settings {
        let mut settings = Settings::flatten(&serde_json::to_value(self).expect("plain data becomes JSON"));
        // Bounds of memory come from --memory-limit and change no answer.
        settings.remove("train.view_cache_bytes");
        settings.remove("surface.tsdf.max_bytes");
        settings
    }

    /// From dotted keys as [`Self::settings`] wrote them.
    ///
    /// # Errors
    /// Where a key or value is not one of ours.
    pub fn from_settings(settings: &Settings) -> Result<Self> {
        serde_json::from_value(settings.nest()).context("settings")
    }
}

/// Where a value came from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// Built in.
    Default,
    /// The preset of this name.
    Preset(String),
    /// `--config` of this path.
    File(String),
    /// `--set`.
    Set,
    /// A flag of its own.
    Flag,
}

impl std::fmt::Display for Source {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Default => write!(f, "default"),
            Self::Preset(name) => write!(f, "preset {name}"),
            Self::File(path) => write!(f, "{path}"),
            Self::Set => write!(f, "--set"),
            Self::Flag => write!(f, "flag"),
        }
    }
}

/// What was typed, before it is understood.
#[derive(Clone, Debug, Default)]
pub struct Typed {
    /// `--config`: its path and text.
    pub file: Option<(String, String)>,
    /// `--set key=value`, in order.
    pub set: Vec<String>,
    /// Flags: dotted key and value.
    pub flags: Vec<(String, Value)>,
}

/// The configuration in force and where each key came from.
#[derive(Clone, Debug, PartialEq)]
pub struct Resolved {
    /// In force.
    pub config: Config,
    /// Dotted key -> source; keys that are missing have their default.
    pub sources: BTreeMap<String, Source>,
}

impl Typed {
    /// Applies the layers in order.
    ///
    /// # Errors
    /// [`UserError`] naming the key and the place where it was typed.
    pub fn resolve(&self) -> Result<Resolved> {
        let mut layers: Vec<(Source, String, Settings)> = Vec::new();
        if let Some((path, text)) = &self.file {
            let nested: Value = toml::from_str(text).map_err(|error| {
                let place = error.span().map_or(1, |span| text[..span.start].matches('\n').count() + 1);
                UserError::new(format!("{path}: line {place}"), first_line(error.message()), "write it as TOML")
            })?;
            layers.push((Source::File(path.clone()), path.clone(), Settings::flatten(&nested)));
        }
        let mut set = Settings::default();
        for assignment in &self.set {
            let (key, value) = parse_assignment(assignment)?;
            set.set(&key, value);
        }
        layers.push((Source::Set, "--set".into(), set));
        let mut flags = Settings::default();
        for (key, value) in &self.flags {
            flags.set(key, value.clone());
        }
        layers.push((Source::Flag, "options".into(), flags));
        layers.iter_mut().for_each(|(_, _, layer)| layer.rename("losses.", "train.weights."));

        let defaults = Config::default().settings();
        for (_, place, layer) in &layers {
            check_keys(layer, &defaults, place)?;
        }
        let preset = preset_of(&layers)?;
        let mut sources = BTreeMap::new();
        let mut merged = defaults.clone();
        for (key, value) in Config::preset(preset).settings().iter() {
            if defaults.get(key) != Some(value) {
                sources.insert(key.to_owned(), Source::Preset(preset_name(preset)));
                merged.set(key, value.clone());
            }
        }
        for (source, place, layer) in &layers {
            for (key, value) in layer.iter() {
                let before = merged.get(key).cloned();
                merged.set(key, value.clone());
                if let Err(error) = Config::from_settings(&merged).and_then(|config| Ok(config.surface.tsdf.check()?)) {
                    let cause = first_line(&error.root_cause().to_string());
                    let cure = before.map_or_else(String::new, |value| format!("it was {value}; "));
                    return Err(UserError::new(
                        format!("{place}: {key}"),
                        cause,
                        format!("{cure}`pgsag config` lists every key"),
                    )
                    .into());
                }
                sources.insert(key.to_owned(), source.clone());
            }
        }
        let mut config = Config::from_settings(&merged)?;
        if !matches!(sources.get(POSITION_STEP), Some(Source::File(_) | Source::Set | Source::Flag)) {
            config.train.rates.position_gsd = Config::preset(preset).train.position_gsd_for(config.train.iterations);
        }
        Ok(Resolved { config, sources })
    }
}

/// Follows the number of iterations where nobody sets it.
const POSITION_STEP: &str = "train.rates.position_gsd";

fn preset_name(preset: Preset) -> String {
    serde_json::to_value(preset).ok().and_then(|value| value.as_str().map(str::to_owned)).unwrap_or_default()
}

/// The preset is a layer of its own, so it is looked for before the others are applied.
fn preset_of(layers: &[(Source, String, Settings)]) -> Result<Preset> {
    let mut preset = Preset::default();
    for (_, place, layer) in layers {
        if let Some(value) = layer.get("preset") {
            preset = serde_json::from_value(value.clone()).map_err(|_| {
                UserError::new(format!("{place}: preset"), format!("{value} is none"), "use fast, standard or paper")
            })?;
        }
    }
    Ok(preset)
}

fn check_keys(layer: &Settings, defaults: &Settings, place: &str) -> Result<()> {
    for (key, _) in layer.iter() {
        if defaults.get(key).is_none() {
            let near = defaults
                .iter()
                .map(|(known, _)| known)
                .find(|known| known.rsplit('.').next() == key.rsplit('.').next())
                .map_or_else(String::new, |known| format!("perhaps {known}; "));
            return Err(UserError::new(
                format!("{place}: {key}"),
                "there is no such key",
                format!("{near}`pgsag config` lists them"),
            )
            .into());
        }
    }
    Ok(())
}

fn parse_assignment(text: &str) -> Result<(String, Value)> {
    let Some((key, value)) = text.split_once('=') else {
        return Err(UserError::new(format!("--set {text}"), "has no =", "write --set key=value").into());
    };
    let (key, value) = (key.trim(), value.trim());
    let parsed = toml::from_str::<BTreeMap<String, Value>>(&format!("value = {value}"))
        .ok()
        .and_then(|mut table| table.remove("value"))
        .unwrap_or_else(|| Value::String(value.to_owned()));
    Ok((key.to_owned(), parsed))
}

fn first_line(text: &str) -> String {
    text.lines().next().unwrap_or_default().to_owned()
}

/// Reads the file of `--config`.
///
/// # Errors
/// [`UserError`] where it cannot be read.
pub fn read_file(path: &Path) -> Result<(String, String)> {
    let text = std::fs::read_to_string(path)
        .map_err(|error| UserError::at(path, format!("cannot be read ({error})"), "check the path of --config"))?;
    Ok((path.display().to_string(), text))
}

#[cfg(test)]
mod tests;
