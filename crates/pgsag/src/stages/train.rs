//! `train`: planar Gaussians of one group.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use pgsag_group::territory::Share;
use pgsag_group::{Group, GroupView};
use pgsag_scene::error::FileError;
use pgsag_scene::{Mask, View};
use pgsag_splat::SplatCloud;
use pgsag_splat::backend::{Backend, Exposure, OptimizerState, TrainingView, ViewCamera};
use pgsag_splat::train::density::{DensityOptions, bytes_per_gaussian};
use pgsag_splat::train::{
    Checkpoint, Neighbor, Progress, TrainError, TrainOptions, Trainer, ViewSource, evaluate_view, initialise,
    neighbors_of,
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::cloud::{read_cloud, write_cloud};
use super::coarse::Coarse;
use super::group::{group_names, group_of, share_of};
use super::import::Imported;
use super::{config, read_json, view_camera, write_json};
use crate::config::Config;
use crate::engine;
use crate::photographs::Photographs;
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan, LiveLog};

/// Between two checkpoints: the most work that a kill can lose.
const CHECKPOINT_INTERVAL: Duration = Duration::from_secs(120);
/// Steps between two lines of the live log.
const LOG_INTERVAL: u32 = 100;
/// Training never grows a group beyond this many Gaussians per point it began with …
pub(crate) const MAX_GROWTH: usize = 8;
/// … and this many more.
pub(crate) const MAX_GROWTH_FLOOR: usize = 20_000;
/// Bytes per pixel of a view in training: maps and their gradients, for the view and its neighbour.
pub(crate) const BYTES_PER_PIXEL: u64 = 400;
/// Bytes that a job needs whatever it trains, where the scene's points are not yet known.
pub(crate) const FIXED_BYTES: u64 = 128 << 20;

/// A trained group.
#[derive(Clone, Debug, PartialEq)]
pub struct Trained {
    /// The Gaussians.
    pub cloud: SplatCloud,
    /// What else is known.
    pub summary: Summary,
}

/// What training a group came to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Degree of harmonics in use.
    pub sh_degree: u8,
    /// Median depth, scene units.
    pub scene_scale: f32,
    /// Steps.
    pub iterations: u32,
    /// Gaussians at the end.
    pub gaussians: usize,
    /// View index, gain and bias per channel.
    pub exposures: Vec<(u32, [f32; 3], [f32; 3])>,
    /// How well images that were kept out are predicted.
    pub held_out: Vec<HeldOut>,
}

/// One image that was kept out of training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// Index of the view.
    pub view_index: usize,
    /// Decibels over the active pixels, exposure fitted.
    pub psnr: f64,
    /// Structural similarity over the same.
    pub ssim: f64,
    /// Pixels compared.
    pub pixels: usize,
}

impl Artifact for Trained {
    const FORMAT: &'static str = "pgsag-cloud";
    const VERSION: u32 = 1;

    fn read(folder: &Path) -> Result<Self> {
        Ok(Self { cloud: read_cloud(&folder.join("cloud.ply"))?, summary: read_json(&folder.join("train.json"))? })
    }

    fn write(&self, folder: &Path) -> Result<()> {
        write_cloud(&folder.join("cloud.ply"), &self.cloud)?;
        write_json(&folder.join("train.json"), &self.summary)
    }
}

impl Trained {
    /// What training came to, without the Gaussians.
    ///
    /// # Errors
    /// Where it is damaged.
    pub fn summary_of(folder: &Path) -> Result<Summary> {
        read_json(&folder.join("train.json"))
    }
}

/// The views of a group, decoded when they are needed.
pub struct GroupViews<'a> {
    /// The group.
    pub group: &'a Group,
    views: &'a [View],
    photographs: &'a Photographs,
    shares: std::path::PathBuf,
}

impl<'a> GroupViews<'a> {
    /// The views of `group` in a run.
    #[must_use]
    pub fn new(group: &'a Group, views: &'a [View], photographs: &'a Photographs, job: &Job<'_>) -> Self {
        Self { group, views, photographs, shares: job.input("group") }
    }

    /// Camera of a window of any view of the scene, about the group's origin.
    #[must_use]
    pub fn camera_of(&self, view_index: usize, window_px: [u32; 4]) -> ViewCamera {
        let camera = self.photographs.camera(view_index);
        view_camera(&self.views[view_index], &camera, window_px, self.group.origin_world)
    }

    /// Pixel classes of the window of one of the group's views; `None` where the group takes all of it.
    ///
    /// # Errors
    /// Where the raster is damaged.
    pub fn mask_of(&self, view: &GroupView) -> Result<Option<Mask>> {
        Ok(self.share_of(view)?.map(|share| share.mask))
    }

    fn share_of(&self, view: &GroupView) -> Result<Option<Share>> {
        share_of(&self.shares, &self.group.id.to_string(), view)
    }

    /// The window of one of the group's views, ready for training or comparison.
    ///
    /// # Errors
    /// Where photograph or mask cannot be read.
    pub fn training_view(&self, view: &GroupView) -> Result<TrainingView> {
        let image = self.photographs.window(view.view_index as usize, view.window_px)?;
        let (mask, inner_edges) = self.share_of(view)?.map(|share| (share.mask, share.inner_edges)).unzip();
        Ok(TrainingView {
            camera: self.camera_of(view.view_index as usize, view.window_px),
            image: Arc::unwrap_or_clone(image),
            mask,
            inner_edges,
        })
    }
}

impl ViewSource for GroupViews<'_> {
    fn len(&self) -> usize {
        self.group.views.len()
    }

    fn camera(&self, index: usize) -> ViewCamera {
        let view = &self.group.views[index];
        self.camera_of(view.view_index as usize, view.window_px)
    }

    fn view(&self, index: usize) -> Result<Arc<TrainingView>, TrainError> {
        let found = self.training_view(&self.group.views[index]).map(Arc::new);
        // A damaged photograph stays what it is, the user's to mend, on its way through the trainer.
        found.map_err(|error| TrainError::View {
            view: index,
            source: error.downcast::<FileError>().map_or_else(Into::into, Into::into),
        })
    }
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let config = config(run)?;
    let folder = run.stage_folder("group");
    let names = group_names(&folder)?;
    let points = run.stage_folder("coarse").join("points.bin");
    let coarse = std::fs::metadata(points).map_or(0, |found| found.len());
    let plan = |name: String| -> Result<JobPlan> {
        let group = group_of(&folder, &name)?;
        let pixels = |count: fn(&GroupView) -> u64| group.views.iter().map(count).max().unwrap_or(0);
        let window = pixels(|view| u64::from(view.window_px[2]) * u64::from(view.window_px[3]));
        let active =
            group.views.iter().map(|view| view.active_count).sum::<u64>() as f64 / group.views.len().max(1) as f64;
        let gaussians = gaussian_bound(&group, &config) as u64;
        let each = bytes_per_gaussian(config.initialise.sh_degree);
        let all = group.views.iter().map(|view| u64::from(view.window_px[2]) * u64::from(view.window_px[3])).sum();
        let cost = Cost {
            memory_bytes: needs(gaussians, each, coarse, window, all),
            disk_bytes: gaussians * 180,
            cpu_secs: f64::from(steps_of(&group, &config)) * (active * 1.2e-6 + gaussians as f64 * 0.4e-6),
        };
        let inputs = vec![("import", None), ("coarse", None), ("group", Some(name.clone()))];
        Ok(JobPlan { name, inputs, cost })
    };
    names.into_iter().map(plan).collect()
}

/// Bytes of a process before it has read anything.
const BASE_BYTES: u64 = 16 << 20;
/// Bytes per pixel of all windows of a group: photographs and what is derived from them, both cached.
const CACHE_BYTES_PER_PIXEL: u64 = 20;

/// Memory of a job with so many Gaussians of `each` bytes, a file of `coarse` bytes, and windows of at most `window` and
/// together `all` pixels. Caches take at most two fifths of the job's share, and never more than the images are.
fn needs(gaussians: u64, each: u64, coarse: u64, window: u64, all: u64) -> u64 {
    let held = BASE_BYTES + coarse * 5 / 2 + gaussians * (each + each / 10) + window * BYTES_PER_PIXEL;
    held + (all * CACHE_BYTES_PER_PIXEL).min(held * 2 / 3)
}

/// No group takes fewer steps than this, unless the whole run does.
const MIN_STEPS: u32 = 500;

/// Steps of a group's training.
fn steps_of(group: &Group, config: &Config) -> u32 {
    let all = config.train.iterations;
    let share = (f64::from(all) * f64::from(group.steps_share)).round() as u32;
    share.clamp(MIN_STEPS.min(all), all)
}

/// How a group is trained.
fn options_of(group: &Group, config: &Config) -> TrainOptions {
    TrainOptions { iterations: steps_of(group, config), ..config.train.clone() }
}

/// The most Gaussians that training may come to: known before it starts, so that memory is.
fn gaussian_bound(group: &Group, config: &Config) -> usize {
    let most = (MAX_GROWTH * group.points.len() + MAX_GROWTH_FLOOR).min(config.train.density.max_gaussians);
    options_of(group, config).gaussian_bound(group.points.len()).min(most)
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let config = config(job.run)?;
    let imported: Imported = job.read("import")?;
    let coarse: Coarse = job.read("coarse")?;
    let group = group_of(&job.input("group"), &job.name)?;
    let view_indices: Vec<u32> = group.views.iter().map(|view| view.view_index).collect();
    let neighbors = neighbors_of(&imported.scene, &view_indices, &config.neighbors);
    if neighbors.iter().any(Vec::is_empty) {
        let lonely = neighbors.iter().filter(|list| list.is_empty()).count();
        job.warn(format!("{lonely} images have no neighbour to compare with"));
    }
    let photographs = Photographs::new(&imported, &config, job, job.memory_bytes / 5);
    let views = GroupViews::new(&group, &imported.scene.views, &photographs, job);
    let points: Vec<_> = group.points.iter().map(|index| coarse.initial_point(*index as usize)).collect();
    let cloud = initialise(&points, group.origin_world, &config.initialise)?;
    let density = DensityOptions { max_gaussians: gaussian_bound(&group, &config), ..config.train.density };
    let options = TrainOptions { view_cache_bytes: job.memory_bytes / 5, density, ..options_of(&group, &config) };
    let work = Train { job, views, neighbors, cloud, options };
    let trained = engine::run(job.device(&config.device), &config.simd, work)?;
    job.write(&trained)
}

struct Train<'a, 'j> {
    job: &'a Job<'j>,
    views: GroupViews<'a>,
    neighbors: Vec<Vec<Neighbor>>,
    cloud: SplatCloud,
    options: TrainOptions,
}

impl engine::Work for Train<'_, '_> {
    type Output = Trained;

    fn on<B: Backend>(self, backend: &B) -> Result<Trained> {
        let job = self.job;
        let resumed = job.checkpoint().and_then(|found| Checkpoint::from_bytes(&found.state).ok());
        let start = resumed.as_ref().map_or(0, Checkpoint::iteration);
        let mut log = job.log(start.into())?;
        let mut trainer = match resumed {
            Some(state) => {
                job.say(&format!("goes on from step {start}"));
                Trainer::resume(backend, &self.views, self.neighbors, self.options, &state)?
            }
            None => Trainer::new(backend, &self.views, self.neighbors, self.cloud, self.options, job.seed())?,
        };
        while !trainer.is_done() {
            learn(job, &mut trainer, &mut log)?;
            if !trainer.is_done() {
                let state = trainer.checkpoint()?;
                job.save(state.iteration().into(), &state.to_bytes())?;
                job.check()?;
            }
        }
        let (sh_degree, scene_scale, iterations) = (trainer.sh_degree(), trainer.scene_scale(), trainer.iteration());
        let (cloud, exposures) = trainer.finish()?;
        let indices = self.views.group.views.iter().map(|view| view.view_index);
        let exposures = indices.zip(&exposures).map(|(view, Exposure { gain, bias })| (view, *gain, *bias)).collect();
        let held_out = evaluate(job, backend, &self.views, &cloud, sh_degree)?;
        let summary = Summary { sh_degree, scene_scale, iterations, gaussians: cloud.len(), exposures, held_out };
        Ok(Trained { cloud, summary })
    }
}

/// Trains until a checkpoint is due, the job is stopped, or all is done.
fn learn<B: Backend>(job: &Job<'_>, trainer: &mut Trainer<'_, B>, log: &mut LiveLog) -> Result<()> {
    let due = Instant::now() + CHECKPOINT_INTERVAL;
    let mut failure = None;
    trainer.run(u32::MAX, &mut |progress| {
        let is_due = progress.iteration.is_multiple_of(LOG_INTERVAL) || progress.iteration == progress.iterations;
        if is_due && let Err(error) = log.line(&log_line(progress)) {
            failure = Some(error);
            return ControlFlow::Break(());
        }
        job.advance(progress.iteration.into(), progress.iterations.into(), "steps");
        if job.is_cancelled() || Instant::now() >= due { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    failure.map_or(Ok(()), Err)
}

fn log_line(progress: &Progress) -> Value {
    let values = &progress.values;
    json!({
        "iteration": progress.iteration, "iterations": progress.iterations, "seconds": progress.seconds, "gaussians": progress.gaussians,
        "loss": values.total, "l1": values.l1, "dssim": values.dssim, "flatness": values.flatness,
        "normal": values.normal, "geometric": values.geometric, "geometric_valid": values.geometric_valid,
        "ncc": values.ncc, "load": values.load, "free_opacity": values.free_opacity,
    })
}

/// Renders the views that were kept out and compares.
fn evaluate<B: Backend>(
    job: &Job<'_>,
    backend: &B,
    views: &GroupViews<'_>,
    cloud: &SplatCloud,
    sh_degree: u8,
) -> Result<Vec<HeldOut>> {
    let on_device = backend.upload(&OptimizerState::fresh(cloud.clone()))?;
    let mut found = Vec::new();
    for seen in &views.group.held_out {
        job.check()?;
        let view_index = seen.view_index as usize;
        let view = views.training_view(seen)?;
        let metrics = evaluate_view(backend, &on_device, &view, sh_degree, true)
            .with_context(|| views.views[view_index].name.clone())?;
        if metrics.pixels > 0 {
            found.push(HeldOut { view_index, psnr: metrics.psnr, ssim: metrics.ssim, pixels: metrics.pixels });
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Groups of finished runs: points, bytes of the coarse points, largest window, all windows, steps, measured peak (MiB).
    const MEASURED: [(usize, u64, u64, u64, u32, u64); 8] = [
        (117_183, 43 << 20, 480_000, 16_640_146, 500, 751),
        (55_512, 43 << 20, 468_000, 7_936_139, 500, 457),
        (92_720, 43 << 20, 480_000, 15_813_548, 500, 819),
        (1_053, 43 << 20, 6_006, 187_050, 500, 126),
        (427_649, 40 << 20, 426_400, 11_086_400, 1000, 1664),
        (120_200, 12 << 20, 475_200, 4_276_800, 1000, 679),
        (14_456, 2 << 20, 76_800, 1_843_200, 800, 105),
        (3_014, 2 << 20, 26_180, 329_407, 800, 37),
    ];

    #[test]
    fn estimates_hold_and_are_no_more_than_two_fifths_too_large() {
        for (points, coarse, window, all, iterations, measured) in MEASURED {
            let options = TrainOptions { iterations, ..TrainOptions::fast() };
            let gaussians = options.gaussian_bound(points) as u64;
            let estimate = needs(gaussians, bytes_per_gaussian(2), coarse, window, all) >> 20;
            let ratio = estimate as f64 / measured as f64;
            assert!((1.0..1.4).contains(&ratio), "{points} points: {estimate} MiB estimated, {measured} measured");
        }
    }
}
