//! `score`: the buildings against the truth, where there is one, and against photographs and points, always.

use std::path::Path;

use anyhow::{Context as _, Result};
use pgsag_group::GroupKind;
use pgsag_mesh::score::{Score, ScoreOptions, Truth, off_buildings};
use pgsag_scene::files::ply::{Cloud, read_cloud, read_mesh};
use pgsag_scene::{Frame, Mesh};

use self::evidence::{Evidence, gather, in_words};
use self::pictures::{Easel, write_pictures};
use super::aoi::Area;
use super::coarse::Coarse;
use super::group::Groups;
use super::import::Imported;
use super::mesh::{lattice_of, read_surface};
use super::{config, read_json, source_fingerprint, write_json};
use crate::config::{Config, parse_size};
use crate::error::UserError;
use crate::report::pictures::chosen;
use crate::run::Run;
use crate::run::artifact::{Artifact, fingerprint_file};
use crate::run::stage::{Cost, Job, JobPlan};

pub mod evidence;
pub mod pictures;

/// A score, if there was something to score against.
#[derive(Clone, Debug, PartialEq)]
pub struct Scored(pub Option<Score>);

impl Artifact for Scored {
    const FORMAT: &'static str = "pgsag-score";
    const VERSION: u32 = 1;

    fn read(folder: &Path) -> Result<Self> {
        let path = folder.join("score.json");
        Ok(Self(if path.exists() { Some(read_json(&path)?) } else { None }))
    }

    fn write(&self, folder: &Path) -> Result<()> {
        self.0.as_ref().map_or(Ok(()), |score| write_json(&folder.join("score.json"), score))
    }
}

/// A truth in memory.
pub enum TruthFile {
    /// Triangles.
    Mesh(Mesh),
    /// Points.
    Cloud(Vec<[f64; 3]>),
    /// `scene.ply` and `visible.ply`.
    Folder {
        /// All true triangles.
        scene: Mesh,
        /// Points on true building surfaces.
        visible: Cloud,
    },
}

impl TruthFile {
    /// Reads a truth.
    ///
    /// # Errors
    /// [`UserError`] or [`pgsag_scene::error::FileError`] with the file and the cure.
    pub fn read(path: &Path) -> Result<Self> {
        if path.is_dir() {
            let visible = ply(&path.join("visible.ply"))?;
            let scene = path.join("scene.ply");
            let scene = read_surface(&scene).map_err(|error| match error.downcast_ref::<std::io::Error>() {
                Some(reason) => unreadable(&scene, reason).into(),
                None => error,
            })?;
            return Ok(Self::Folder { scene, visible: read_cloud(&visible.0, &visible.1)? });
        }
        let (file, bytes) = ply(path)?;
        let mesh = read_mesh(&file, &bytes);
        Ok(match mesh {
            Ok(mesh) if !mesh.faces.is_empty() => Self::Mesh(mesh),
            _ => Self::Cloud(read_cloud(&file, &bytes)?.positions),
        })
    }

    /// As the library wants it.
    #[must_use]
    pub fn as_truth(&self) -> Truth<'_> {
        match self {
            Self::Mesh(mesh) => Truth::Mesh(mesh),
            Self::Cloud(points) => Truth::Cloud(points),
            Self::Folder { scene, visible } => {
                let building = visible.attribute("building").unwrap_or_default();
                Truth::Folder { scene, visible: &visible.positions, building }
            }
        }
    }
}

fn ply(path: &Path) -> Result<(String, Vec<u8>)> {
    let bytes = std::fs::read(path).map_err(|error| unreadable(path, &error))?;
    Ok((path.display().to_string(), bytes))
}

fn unreadable(path: &Path, error: &std::io::Error) -> UserError {
    let cure = "give a PLY file, or a folder with scene.ply and visible.ply";
    UserError::at(path, format!("cannot be read ({error})"), cure)
}

/// Scores a mesh file and says what was judged.
///
/// # Errors
/// A truth or mesh that cannot be judged.
pub fn score_file(mesh: &Path, truth: &Path, options: &ScoreOptions) -> Result<Score> {
    score_against(mesh, truth, &TruthFile::read(truth)?, options)
}

fn score_against(mesh: &Path, truth: &Path, read: &TruthFile, options: &ScoreOptions) -> Result<Score> {
    let surface = read_surface(mesh)?;
    let mut score = pgsag_mesh::score::score(&surface, &read.as_truth(), options)
        .map_err(|error| UserError::at(truth, error.to_string(), "see `pgsag score --help`"))?;
    score.inputs.insert("mesh".into(), fingerprint_file(mesh)?);
    score.inputs.insert("truth".into(), source_fingerprint(truth)?);
    Ok(score)
}

/// How much of what the building groups own lies on no building.
fn points_off_buildings(job: &Job<'_>, groups: &Groups, truth: &TruthFile) -> Result<Option<f64>> {
    let Coarse { points, .. } = job.read("coarse")?;
    let buildings = groups.groups.iter().filter(|group| group.id.kind == GroupKind::Building);
    let position = |index: &u32| points[*index as usize].position_world;
    let positions: Vec<_> = buildings.flat_map(|group| group.core()).map(position).collect();
    Ok(off_buildings(&positions, &truth.as_truth()))
}

/// Options in the frame of a scene.
#[must_use]
pub fn in_frame(options: &ScoreOptions, frame: &Frame) -> ScoreOptions {
    let up = frame.up_world.to_array();
    ScoreOptions { metres_per_unit: frame.metres_per_unit.unwrap_or(1.0), up, ..options.clone() }
}

pub(crate) fn sources(run: &Run) -> Result<Vec<(String, String)>> {
    let truth = config(run)?.truth;
    Ok(if truth.is_empty() { Vec::new() } else { vec![("truth".into(), source_fingerprint(Path::new(&truth))?)] })
}

/// What was found without a truth.
///
/// # Errors
/// Where it is damaged.
pub fn read_evidence(folder: &Path) -> Result<Evidence> {
    read_json(&folder.join("evidence.json"))
}

/// Of a judged point, with the lists that order statistics are taken of.
const BYTES_PER_SAMPLE: u64 = 20;
/// Of a face with half a vertex, in a mesh file.
const BYTES_PER_FACE: u64 = 38;

/// About how many points of a surface of so many bytes are judged: a face is half a square of the volume's lattice.
fn sample_count(run: &Run, config: &Config, bytes: u64) -> Result<u64> {
    let scale = Imported::read(&run.stage_folder("import"))?.scene.frame.metres_per_unit;
    let extent = Groups::read(&run.stage_folder("group"))?.extent;
    let voxel_m = lattice_of(&extent, config, scale).voxel * scale.unwrap_or(1.0);
    let smallest = config.score.thresholds_m.iter().copied().fold(f64::INFINITY, f64::min);
    let spacing_m = config.score.spacing_m.unwrap_or(smallest / 3.0);
    Ok((0.5 * (voxel_m / spacing_m).powi(2) * (bytes / BYTES_PER_FACE) as f64) as u64)
}

/// What the stage needs.
struct Needs {
    cost: Cost,
    /// Whether photographs and points are asked as well: not where a `--memory-limit` that was given forbids it.
    with_evidence: bool,
    /// With it, bytes.
    evidence_bytes: u64,
    /// Whether pictures of the distances from the truth are drawn, which search the whole city: alike.
    with_distances: bool,
}

impl Needs {
    fn of(run: &Run, config: &Config) -> Result<Self> {
        let length = |path: &Path| std::fs::metadata(path).map_or(0, |found| found.len());
        let merge = run.stage_folder("merge");
        let (city, buildings) = (length(&merge.join("city.ply")), length(&merge.join("buildings.ply")));
        let coarse = length(&run.stage_folder("coarse").join("points.bin"));
        let base = 176 << 20;
        let (mut secs, mut judged) = (2.0, 0);
        if !config.truth.is_empty() {
            let known = Path::new(&config.truth);
            let truth = length(known) + length(&known.join("scene.ply")) + length(&known.join("visible.ply"));
            judged = 6 * buildings / 5 + 6 * truth + BYTES_PER_SAMPLE * sample_count(run, config, buildings)?;
            secs += 5.0 + buildings as f64 * 1e-6;
        }
        // Trees are made of a part of the city at a time.
        let evidence_bytes = base + 17 * city / 10 + 3 * coarse;
        let limit = match config.memory_limit.as_str() {
            "" => u64::MAX,
            given => parse_size(given)?,
        };
        let with_evidence = evidence_bytes <= limit;
        if with_evidence {
            secs += (6e-9 * f64::from(config.evidence.pairs) + 60e-9) * city as f64;
        }
        // The city is gone before the buildings are judged.
        let drawn = base + 3 * coarse + judged.max(17 * city / 10);
        let with_distances = drawn <= limit && judged > 0;
        let without = if with_distances { drawn } else { base + 3 * coarse + judged.max(6 * city / 5) };
        let memory_bytes = if with_evidence { evidence_bytes.max(without) } else { without };
        let cost = Cost { memory_bytes, disk_bytes: 1 << 20, cpu_secs: secs };
        Ok(Self { cost, with_evidence, evidence_bytes, with_distances })
    }
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let needs = Needs::of(run, &config(run)?)?;
    Ok(JobPlan::whole(&["import", "coarse", "group", "merge"], needs.cost))
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let config = config(job.run)?;
    let imported: Imported = job.read("import")?;
    let groups: Groups = job.read("group")?;
    let city = read_surface(&job.input("merge").join("city.ply"))?;
    let mut easel = Easel { job, config: &config, imported: &imported, drawn: Vec::new() };
    let needs = Needs::of(job.run, &config)?;
    let evidence = if needs.with_evidence {
        let (evidence, shown) = gather(job, &config, &imported, &city)?;
        easel.residuals(&shown)?;
        job.say(&in_words(&evidence).unwrap_or_else(|| "nothing can be said of the surface without truth".into()));
        evidence
    } else {
        let gib = needs.evidence_bytes as f64 / f64::from(1 << 30);
        job.warn(format!("photographs and points were not asked about the surface: that takes {gib:.1} GiB"));
        Evidence::default()
    };
    write_json(&job.output().join("evidence.json"), &evidence)?;
    if config.truth.is_empty() {
        write_pictures(job, &easel.drawn)?;
        return job.write(&Scored(None));
    }
    let truth = TruthFile::read(Path::new(&config.truth))?;
    let views = chosen(&groups.groups, imported.scene.views.len());
    if needs.with_distances {
        easel.distances(&views, &city, &truth).context("pictures of the score")?;
    } else {
        job.warn("no pictures of the distances from the truth: the memory limit forbids them");
    }
    write_pictures(job, &easel.drawn)?;
    drop(city);
    job.write(&Scored(Some(scored(job, &config, &imported, &groups, &truth)?)))
}

/// The buildings against the truth.
fn scored(job: &Job<'_>, config: &Config, imported: &Imported, groups: &Groups, truth: &TruthFile) -> Result<Score> {
    if imported.scene.frame.metres_per_unit.is_none() {
        job.warn("the scale is unknown: thresholds count in scene units");
    }
    // What lies beyond the area of interest was not asked for.
    let area = Area::of(config)?;
    let crop = config.score.crop.clone().or_else(|| (!area.is_everything()).then(|| area.outline()));
    let options = ScoreOptions { seed: config.seed, crop, ..in_frame(&config.score, &imported.scene.frame) };
    let mesh = job.input("merge").join("buildings.ply");
    let score = score_against(&mesh, Path::new(&config.truth), truth, &options).context("score")?;
    let points_off_buildings = if groups.masked { points_off_buildings(job, groups, truth)? } else { None };
    for note in &score.notes {
        job.warn(note.clone());
    }
    Ok(Score { points_off_buildings, ..score })
}
