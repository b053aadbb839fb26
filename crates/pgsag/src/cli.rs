//! The command line: what may be typed, and nothing about what it does.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Parser, Subcommand};
use serde_json::{Value, json};

use crate::config::{self, ImageChoice, Preset, Resolved, Typed};

/// Drone photographs of a city to clean, separate, measurable building meshes.
#[derive(Debug, Parser)]
#[command(args_override_self = true, name = "pgsag", version, max_term_width = 110)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// One JSON object per line on standard output.
    #[arg(long, global = true)]
    pub json: bool,
    /// What to log on standard error: error, warn, info, debug, or a filter.
    #[arg(long, global = true, value_name = "LEVEL", default_value = "warn")]
    pub log: String,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Makes a small synthetic town, reconstructs it on the CPU and scores it.
    #[command(after_help = "Example:\n  pgsag demo -o demo.run")]
    Demo(DemoArgs),
    /// Images and cameras -> building meshes. The same line again resumes.
    #[command(after_help = "Example:\n  pgsag reconstruct my-city -o my-city.run --preset fast --image-width 1600")]
    Reconstruct(ReconstructArgs),
    /// Checks a scene before hours are spent.
    #[command(after_help = "Example:\n  pgsag doctor my-city\n  pgsag doctor --self-test --device gpu")]
    Doctor(DoctorArgs),
    /// Building masks by language, or a look at masks that are there.
    #[command(after_help = "Example:\n  pgsag mask photos -o masks --prompt \"buildings.\" --preview")]
    Mask(MaskCommand),
    /// Model bundles: which are there, where to get them, whether they compute rightly.
    #[command(after_help = "Example:\n  pgsag models verify grounding-dino-tiny")]
    Models(ModelsArgs),
    /// What would run and why, with memory, disk and time.
    #[command(after_help = "Example:\n  pgsag plan my-city --memory-limit 8GiB")]
    Plan(PlanArgs),
    /// Jobs done, running, waiting, failed; time left.
    #[command(after_help = "Example:\n  pgsag status my-city.run")]
    Status(StatusArgs),
    /// One job of a run: what local slots and clusters call.
    #[command(after_help = "Example:\n  pgsag job train g012 --run my-city.run")]
    Job(JobArgs),
    /// Precision, recall, F1, accuracy and completeness of any mesh.
    #[command(
        after_help = "Example:\n  pgsag score result/buildings.ply --truth truth\n  pgsag score odd.run/result/buildings.ply --against even.run/result/buildings.ply"
    )]
    Score(ScoreArgs),
    /// Writes a synthetic town as an ordinary scene with exact truth.
    #[command(after_help = "Example:\n  pgsag town -o town --seed 7 --houses 12")]
    Town(TownCommand),
    /// Every key, its default, its unit, and where its value came from.
    #[command(after_help = "Example:\n  pgsag config --preset fast --set seed=7")]
    Config(SettingArgs),
}

/// `pgsag demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// The run folder; it also holds the town.
    #[arg(short, long, value_name = "RUN", default_value = "demo.run")]
    pub output: PathBuf,
    /// Seed of the town and of everything random.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Threads of all jobs together; 0: all of the machine's.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub threads: u32,
}

/// `pgsag reconstruct`.
#[derive(Debug, Args)]
pub struct ReconstructArgs {
    /// Folder with images/, sparse/ and perhaps masks/.
    #[arg(value_name = "SCENE")]
    pub scene: PathBuf,
    /// The run folder.
    #[arg(short, long, value_name = "RUN")]
    pub output: PathBuf,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingArgs,
    /// `no` forgets everything that RUN holds and starts over.
    #[arg(long, value_name = "yes|no", default_value = "yes")]
    pub resume: YesNo,
}

/// `pgsag doctor`.
#[derive(Debug, Args)]
pub struct DoctorArgs {
    /// Folder with images/, sparse/ and perhaps masks/; without one only the machine is looked at.
    #[arg(value_name = "SCENE")]
    pub scene: Option<PathBuf>,
    /// Building masks, if not in SCENE/masks.
    #[arg(long, value_name = "DIR|none", requires = "scene")]
    pub masks: Option<String>,
    /// Compare what a device computes with the slow true reference: a minute.
    #[arg(long, conflicts_with = "scene")]
    pub self_test: bool,
    /// The device to compare.
    #[arg(long, value_name = "auto|cpu|gpu[:N]", default_value = "auto", requires = "self_test")]
    pub device: String,
    /// Its SIMD level.
    #[arg(long, value_name = "LEVEL", default_value = "auto", requires = "self_test")]
    pub simd: String,
}

/// `pgsag mask`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct MaskCommand {
    /// Something else than making masks.
    #[command(subcommand)]
    pub look: Option<MaskLook>,
    /// How masks are made.
    #[command(flatten)]
    pub make: MaskArgs,
}

/// A look at masks that are there.
#[derive(Debug, Subcommand)]
pub enum MaskLook {
    /// Says which masks are missing, of another size, empty, full or not black and white.
    #[command(after_help = "Example:\n  pgsag mask check photos masks")]
    Check {
        /// Folder of photographs.
        #[arg(value_name = "IMAGES")]
        images: PathBuf,
        /// Folder of masks.
        #[arg(value_name = "MASKS")]
        masks: PathBuf,
    },
}

/// How masks are made.
#[derive(Debug, Args)]
pub struct MaskArgs {
    /// Folder of photographs; sub-folders are searched.
    #[arg(value_name = "IMAGES", required = true)]
    pub images: Option<PathBuf>,
    /// Folder for masks: a/b.jpg becomes a/b.jpg.png.
    #[arg(short, long, value_name = "MASKS", required = true)]
    pub output: Option<PathBuf>,
    /// What to look for; each kind of thing ended by a full stop.
    #[arg(long, value_name = "WORDS", default_value = "buildings.")]
    pub prompt: String,
    /// Least score of a box, 0 to 1; lower finds more, also more that is wrong.
    #[arg(long, value_name = "P", default_value_t = 0.3)]
    pub box_threshold: f32,
    /// Least score of a word to be named in a box's label.
    #[arg(long, value_name = "P", default_value_t = 0.25)]
    pub text_threshold: f32,
    /// By words, everything that stands out, or by points of --points.
    #[arg(long, value_enum, default_value = "language")]
    pub mode: MaskMode,
    /// Which of a box's masks is taken: single, as lang-segment-anything does, stable or best.
    #[arg(long, value_name = "single|stable|best", default_value = "single")]
    pub choice: String,
    /// Cut photographs into tiles of this side, pixels; for those above 8 megapixels; 0: never.
    #[arg(long, value_name = "PX", default_value_t = 0)]
    pub tile: u32,
    /// Share of a tile's side that its neighbour shows as well.
    #[arg(long, value_name = "SHARE", default_value_t = 0.2)]
    pub overlap: f64,
    /// JSON of points and boxes per photograph (docs/models.md); only those photographs are done.
    #[arg(long, value_name = "FILE")]
    pub points: Option<PathBuf>,
    /// Overlays and a page of them, the most unusual first.
    #[arg(long)]
    pub preview: bool,
    /// COCO annotations with run lengths, in detections.coco.json.
    #[arg(long)]
    pub coco: bool,
    /// `no` makes masks again that are there.
    #[arg(long, value_name = "yes|no", default_value = "yes")]
    pub resume: YesNo,
    /// Photographs at once.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub jobs: usize,
    /// Only photographs whose name fits; * is any text.
    #[arg(long, value_name = "GLOB")]
    pub only: Option<String>,
    /// Fill holes of at most so many pixels.
    #[arg(long, value_name = "PX", default_value_t = 0)]
    pub fill_holes: u32,
    /// Remove pieces of fewer pixels.
    #[arg(long, value_name = "PX", default_value_t = 0)]
    pub min_area: u32,
    /// Move edges outwards.
    #[arg(long, value_name = "PX", default_value_t = 0)]
    pub dilate: u32,
    /// Which networks.
    #[command(flatten)]
    pub networks: NetworkArgs,
}

/// How `pgsag mask` finds things.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum MaskMode {
    /// By the words of --prompt.
    Language,
    /// Everything that stands out, whatever it is.
    Everything,
    /// By the points of --points.
    Points,
}

/// Which networks, and what computes them.
#[derive(Clone, Debug, Args)]
pub struct NetworkArgs {
    /// Folder of model bundles; default: PGSAG_MODELS, else the user's data folder.
    #[arg(long, global = true, value_name = "DIR")]
    pub models_dir: Option<PathBuf>,
    /// The detector's bundle, if there are several.
    #[arg(long, global = true, value_name = "NAME", default_value = "")]
    pub detector: String,
    /// The segmenter's bundle, if there are several.
    #[arg(long, global = true, value_name = "NAME", default_value = "")]
    pub segmenter: String,
    /// What computes: rten, pure Rust, or ort, ONNX Runtime.
    #[arg(long, global = true, value_name = "rten|ort", default_value = "rten")]
    pub runtime: String,
    /// Where: cpu, or cuda:N with ort; never another than was asked for.
    #[arg(long, global = true, value_name = "cpu|cuda:N", default_value = "cpu")]
    pub device: String,
    /// Threads; 0: all.
    #[arg(long, global = true, value_name = "N", default_value_t = 0)]
    pub threads: usize,
}

/// `pgsag models`.
#[derive(Debug, Args)]
pub struct ModelsArgs {
    /// What to do.
    #[command(subcommand)]
    pub what: ModelsWhat,
    /// Which networks.
    #[command(flatten)]
    pub networks: NetworkArgs,
}

/// What to do with model bundles.
#[derive(Debug, Subcommand)]
pub enum ModelsWhat {
    /// Bundles that are there, and where known ones come from.
    List,
    /// Downloads what a manifest pins: revision, size and SHA-256 of each file.
    Fetch {
        /// A manifest.toml with `revision`, or a known name.
        #[arg(value_name = "MANIFEST|NAME")]
        what: String,
        /// The licence that the manifest names is accepted.
        #[arg(long)]
        accept_license: bool,
    },
    /// Compares files with their hashes and runs the self-test.
    Verify {
        /// A bundle's name or folder; default: all.
        #[arg(value_name = "NAME|DIR")]
        bundle: Option<String>,
    },
    /// Takes a bundle's folder, or graphs of others, among the models.
    Import {
        /// A bundle's folder, or .onnx files and tokenizer.json.
        #[arg(value_name = "FILES", required = true)]
        files: Vec<PathBuf>,
        /// The bundle's name.
        #[arg(long, value_name = "NAME")]
        name: Option<String>,
        /// The only size that a detector of others is right at.
        #[arg(long, value_name = "WIDTHxHEIGHT")]
        size: Option<String>,
        /// Licence of the weights.
        #[arg(long, value_name = "NAME", default_value = "unknown")]
        licence: String,
    },
}

/// `pgsag plan`.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// A scene, or a run.
    #[arg(value_name = "SCENE|RUN")]
    pub target: PathBuf,
    /// Settings (of a run: in place of its own).
    #[command(flatten)]
    pub settings: SettingArgs,
}

/// `pgsag status`.
#[derive(Debug, Args)]
pub struct StatusArgs {
    /// The run folder.
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
}

/// `pgsag job`.
#[derive(Debug, Args)]
pub struct JobArgs {
    /// Which stage.
    #[arg(value_name = "STAGE")]
    pub stage: String,
    /// Which of its jobs; `all` for a stage that is not divided.
    #[arg(value_name = "JOB")]
    pub job: String,
    /// The run folder.
    #[arg(long, value_name = "RUN")]
    pub run: PathBuf,
    /// Threads; 0: all of the machine's.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub threads: u32,
    /// Memory, such as 8GiB; default: as the run was started with.
    #[arg(long, value_name = "SIZE")]
    pub memory_limit: Option<String>,
    /// What computes; default: as the run was started with.
    #[arg(long, value_name = "cpu|gpu[:N][,gpu:M]")]
    pub device: Option<String>,
    /// Save and stop when standard input is closed: how a parent takes its jobs along.
    #[arg(long, hide = true)]
    pub supervised: bool,
}

/// `pgsag score`.
#[derive(Debug, Args)]
pub struct ScoreArgs {
    /// A PLY mesh.
    #[arg(value_name = "MESH")]
    pub mesh: PathBuf,
    /// A mesh, a cloud, or a folder with scene.ply and visible.ply.
    #[arg(long, value_name = "TRUTH", required_unless_present = "against")]
    pub truth: Option<PathBuf>,
    /// In place of a truth: a second mesh of the same place, made of other images (reconstruct --images odd, and even).
    #[arg(long, value_name = "MESH", conflicts_with = "truth")]
    pub against: Option<PathBuf>,
    /// Distances that count as right, metres; several with commas.
    #[arg(long, value_name = "D,D,…", value_delimiter = ',')]
    pub threshold: Vec<f64>,
    /// Distance between samples, metres; default: a third of the smallest threshold.
    #[arg(long, value_name = "D")]
    pub spacing: Option<f64>,
    /// Whose rules: pgsag, pg-sag, citygs-v2 or tanks-and-temples; all but ours set everything as published.
    #[arg(long, value_name = "NAME", default_value = "pgsag")]
    pub protocol: String,
    /// Move the mesh onto the truth first.
    #[arg(long, value_name = "none|icp|icp-scale", default_value = "none")]
    pub align: String,
    /// Score only inside this GeoJSON polygon.
    #[arg(long, value_name = "POLYGON")]
    pub crop: Option<PathBuf>,
    /// Metres per unit of the mesh's and the truth's coordinates.
    #[arg(long, value_name = "M", default_value_t = 1.0)]
    pub metres_per_unit: f64,
    /// Seed of samples and intervals.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Where to write score.json as well.
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
}

/// `pgsag town`.
#[derive(Debug, Args)]
pub struct TownCommand {
    /// The scene's folder.
    #[arg(short, long, value_name = "SCENE")]
    pub output: PathBuf,
    /// Knobs.
    #[command(flatten)]
    pub town: crate::town_folder::TownArgs,
}

/// A switch that is typed in words.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum YesNo {
    /// On.
    Yes,
    /// Off.
    No,
}

/// Everything that is also a key of `--config`.
#[derive(Clone, Debug, Default, Args)]
pub struct SettingArgs {
    /// Where building masks come from; default: SCENE/masks where it exists, else geometry.
    #[arg(long, value_name = "DIR|geometry|language|none")]
    pub masks: Option<String>,
    /// Which set of values to start from.
    #[arg(long, value_enum)]
    pub preset: Option<Preset>,
    /// Training steps per group.
    #[arg(long, value_name = "N")]
    pub iterations: Option<u32>,
    /// Longest side of the images in training.
    #[arg(long, value_name = "PX|original")]
    pub image_width: Option<String>,
    /// What computes; auto takes a GPU where there is one.
    #[arg(long, value_name = "auto|cpu|gpu[:N][,gpu:M]")]
    pub device: Option<String>,
    /// Jobs of a stage at once.
    #[arg(long, value_name = "N")]
    pub jobs: Option<u32>,
    /// Threads of all jobs together.
    #[arg(long, value_name = "N")]
    pub threads: Option<u32>,
    /// Memory of all jobs together, such as 8GiB.
    #[arg(long, value_name = "SIZE")]
    pub memory_limit: Option<String>,
    /// Keep every Nth image out of training, for PSNR and SSIM.
    #[arg(long, value_name = "N")]
    pub holdout: Option<u32>,
    /// Learn from half of the images only, by sorted name; the others are kept out as with --holdout.
    #[arg(long, value_enum)]
    pub images: Option<ImageChoice>,
    /// Reconstruct only inside this GeoJSON polygon (scene coordinates).
    #[arg(long, value_name = "POLYGON")]
    pub aoi: Option<PathBuf>,
    /// Stop after this stage.
    #[arg(long, value_name = "STAGE")]
    pub until: Option<String>,
    /// Where jobs run.
    #[arg(long, value_name = "local")]
    pub engine: Option<String>,
    /// SIMD level; `pgsag doctor` lists them.
    #[arg(long, value_name = "LEVEL")]
    pub simd: Option<String>,
    /// Seed of everything random.
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Truth to score the result against.
    #[arg(long, value_name = "TRUTH")]
    pub truth: Option<PathBuf>,
    /// A TOML file of keys.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Sets any key; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

impl SettingArgs {
    /// The configuration that was typed.
    ///
    /// # Errors
    /// [`crate::error::UserError`] naming the key.
    pub fn resolve(&self) -> Result<Resolved> {
        let file = self.config.as_deref().map(config::read_file).transpose()?;
        let text = |value: &Option<String>| value.clone().map(Value::from);
        let number = |value: Option<u32>| value.map(Value::from);
        let path = |value: &Option<PathBuf>| value.as_ref().map(|path| json!(path.to_string_lossy()));
        let width = self.image_width.as_ref().map(|width| match width.as_str() {
            "original" => json!(0),
            typed => typed.parse::<u32>().map_or_else(|_| json!(typed), |px| json!(px)),
        });
        let flags = [
            ("masks", text(&self.masks)),
            ("preset", self.preset.and_then(|preset| serde_json::to_value(preset).ok())),
            ("train.iterations", number(self.iterations)),
            ("image_width", width),
            ("device", text(&self.device)),
            ("jobs", number(self.jobs)),
            ("threads", number(self.threads)),
            ("memory_limit", text(&self.memory_limit)),
            ("holdout", number(self.holdout)),
            ("images", self.images.and_then(|choice| serde_json::to_value(choice).ok())),
            ("aoi", path(&self.aoi)),
            ("until", text(&self.until)),
            ("engine", text(&self.engine)),
            ("simd", text(&self.simd)),
            ("seed", self.seed.map(Value::from)),
            ("truth", path(&self.truth)),
        ];
        let flags = flags.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?))).collect();
        Typed { file, set: self.set.clone(), flags }.resolve()
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn flags_become_keys() {
        let cli =
            Cli::parse_from(["pgsag", "config", "--image-width", "original", "--holdout", "8", "--set", "seed=3"]);
        let Command::Config(settings) = cli.command else { panic!("config was typed") };
        let config = settings.resolve().expect("good").config;
        assert_eq!((config.image_width, config.holdout, config.seed), (0, 8, 3));
    }

    #[test]
    fn every_command_shows_an_example() {
        for command in Cli::command().get_subcommands_mut() {
            assert!(command.render_help().to_string().contains("Example:"), "{}", command.get_name());
        }
    }
}
