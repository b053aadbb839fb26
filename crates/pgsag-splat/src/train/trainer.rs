//! The training loop of one group: sample, render, compare, differentiate, step; multiply and trim (method.md 1.9).
//!
//! Every choice is a function of (seed, iteration), so a run resumed from a checkpoint is the run itself.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use crate::backend::{Backend, BackendError, Exposure, LossValues, LossWeights, OptimizerState, RenderOptions, Sample};
use crate::backend::{DensityPlan, TrainingView, ViewCamera};
use crate::cloud::{SplatCloud, curve_order};
use crate::train::checkpoint::{Checkpoint, fingerprint};
use crate::train::density::{AGREEMENT_VIEWS, Agreement, DensityInput, plan_density, plan_trim};
use crate::train::exposure::Exposures;
use crate::train::footprint::{footprints, locate, medians};
use crate::train::neighbors::Neighbor;
use crate::train::plateau::Plateau;
use crate::train::prefetch::Prefetch;
use crate::train::schedule::TrainOptions;
use crate::train::view_cache::{Prepared, ViewCache};
use crate::train::{Result, TrainError, stream};

/// Where views come from; they may be decoded on demand within the product's own memory bound.
pub trait ViewSource: Sync {
    /// Number of views.
    fn len(&self) -> usize;

    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Camera of a view, without decoding its image; the same as in [`Self::view`].
    fn camera(&self, index: usize) -> ViewCamera;

    /// The view itself.
    ///
    /// # Errors
    /// [`TrainError::View`] with the image's name where it cannot be read.
    fn view(&self, index: usize) -> Result<Arc<TrainingView>>;
}

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Steps done, from 1.
    pub iteration: u32,
    /// Steps in all.
    pub iterations: u32,
    /// Gaussians after the step.
    pub gaussians: usize,
    /// The reference view.
    pub view: usize,
    /// Loss terms of this step; terms that were off are 0.
    pub values: LossValues,
    /// Since this trainer was made, seconds (not since the beginning where the run was resumed).
    pub seconds: f64,
}

/// Trains one cloud on one set of views.
pub struct Trainer<'a, B: Backend> {
    backend: &'a B,
    views: &'a dyn ViewSource,
    neighbors: Vec<Vec<Neighbor>>,
    options: TrainOptions,
    seed: u64,
    cloud: B::Cloud,
    gaussians: usize,
    sh_degree: u8,
    iteration: u32,
    /// Views not yet drawn in this round; the last is next.
    stack: Vec<u32>,
    round: u32,
    exposures: Exposures,
    exposure_frozen: bool,
    plateau: Plateau,
    scene_scale: f32,
    gsd: f32,
    cameras: Vec<ViewCamera>,
    cache: ViewCache<B>,
    /// While steps follow one another.
    ahead: Option<Prefetch>,
    started: Instant,
}

impl<'a, B: Backend> Trainer<'a, B> {
    /// A run from its beginning. `neighbors[i]` lists positions in `views`, from [`crate::train::neighbors_of`].
    ///
    /// # Errors
    /// Where there is nothing to train, options are out of range, or the device cannot hold the cloud.
    pub fn new(
        backend: &'a B,
        views: &'a dyn ViewSource,
        neighbors: Vec<Vec<Neighbor>>,
        cloud: SplatCloud,
        options: TrainOptions,
        seed: u64,
    ) -> Result<Self> {
        let cameras: Vec<ViewCamera> = (0..views.len()).map(|i| views.camera(i)).collect();
        let cloud = cloud.reordered(&curve_order(&cloud.means));
        let (scene_scale, gsd) = medians(&cloud, &cameras).ok_or(TrainError::Empty("no Gaussian lies in any view"))?;
        let checkpoint = Checkpoint {
            options: fingerprint(&options),
            seed,
            iteration: 0,
            round: 0,
            stack: Vec::new(),
            scene_scale,
            gsd,
            exposure_frozen: false,
            exposures: Exposures::neutral(views.len()),
            plateau: Plateau::default(),
            state: OptimizerState::fresh(cloud),
        };
        Self::resume(backend, views, neighbors, options, &checkpoint)
    }

    /// Goes on from a checkpoint as if nothing had happened. Views, neighbours and options must be those of then.
    ///
    /// # Errors
    /// Where views or options are not those of the checkpoint, or the device cannot hold the cloud.
    pub fn resume(
        backend: &'a B,
        views: &'a dyn ViewSource,
        neighbors: Vec<Vec<Neighbor>>,
        options: TrainOptions,
        checkpoint: &Checkpoint,
    ) -> Result<Self> {
        options.check()?;
        if views.is_empty() {
            return Err(TrainError::Empty("no views"));
        }
        if checkpoint.options != fingerprint(&options) {
            return Err(TrainError::Checkpoint("it was made with other options; start afresh or restore them".into()));
        }
        if checkpoint.exposures.values.len() != views.len() || neighbors.len() != views.len() {
            return Err(TrainError::Options(format!(
                "{} views, but {} exposures and {} lists of neighbours",
                views.len(),
                checkpoint.exposures.values.len(),
                neighbors.len()
            )));
        }
        if neighbors.iter().flatten().any(|n| n.view as usize >= views.len()) {
            return Err(TrainError::Options("a neighbour is not among the views".into()));
        }
        let cameras = (0..views.len()).map(|i| with_near(views.camera(i), checkpoint.scene_scale, &options)).collect();
        Ok(Self {
            cloud: backend.upload(&checkpoint.state)?,
            gaussians: checkpoint.state.cloud.len(),
            sh_degree: checkpoint.state.cloud.sh_degree,
            iteration: checkpoint.iteration,
            stack: checkpoint.stack.clone(),
            round: checkpoint.round,
            exposures: checkpoint.exposures.clone(),
            exposure_frozen: checkpoint.exposure_frozen,
            plateau: checkpoint.plateau.clone(),
            scene_scale: checkpoint.scene_scale,
            gsd: checkpoint.gsd,
            seed: checkpoint.seed,
            cache: ViewCache::new(views, options.view_cache_bytes),
            ahead: None,
            started: Instant::now(),
            cameras,
            backend,
            views,
            neighbors,
            options,
        })
    }

    /// Starts from given exposures, one per view; `frozen` keeps them as they are.
    ///
    /// # Errors
    /// Where there are not as many as views.
    pub fn with_exposures(mut self, exposures: &[Exposure], frozen: bool) -> Result<Self> {
        if exposures.len() != self.views.len() {
            return Err(TrainError::Options(format!("{} exposures for {} views", exposures.len(), self.views.len())));
        }
        self.exposures = Exposures::given(exposures);
        self.exposure_frozen = frozen;
        Ok(self)
    }

    /// Steps done.
    #[must_use]
    pub fn iteration(&self) -> u32 {
        self.iteration
    }

    /// Whether all steps are done, or no more are worth it.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.iteration >= self.options.iterations || self.plateau.is_reached(&self.options)
    }

    /// The cloud on the device, for renders between steps.
    #[must_use]
    pub fn cloud(&self) -> &B::Cloud {
        &self.cloud
    }

    /// Exposure of every view now.
    #[must_use]
    pub fn exposures(&self) -> Vec<Exposure> {
        self.exposures.all()
    }

    /// Median depth of the cloud over the views, scene units: the unit of lengths in losses.
    #[must_use]
    pub fn scene_scale(&self) -> f32 {
        self.scene_scale
    }

    /// Degree of harmonics in use after the steps done.
    #[must_use]
    pub fn sh_degree(&self) -> u8 {
        self.options.sh_degree_at(self.iteration.max(1), self.sh_degree)
    }

    /// Everything needed to go on later.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn checkpoint(&self) -> Result<Checkpoint> {
        Ok(Checkpoint {
            options: fingerprint(&self.options),
            seed: self.seed,
            iteration: self.iteration,
            round: self.round,
            stack: self.stack.clone(),
            scene_scale: self.scene_scale,
            gsd: self.gsd,
            exposure_frozen: self.exposure_frozen,
            exposures: self.exposures.clone(),
            plateau: self.plateau.clone(),
            state: self.backend.download(&self.cloud)?,
        })
    }

    /// Steps until `until` steps are done in all, or all are, or the observer breaks.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn run(&mut self, until: u32, on_progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>) -> Result<()> {
        let views = self.views;
        std::thread::scope(|scope| {
            self.ahead = Some(Prefetch::start(scope, views));
            let done = self.run_steps(until, on_progress);
            // Its thread ends with it, and the scope with the thread.
            self.ahead = None;
            done
        })
    }

    fn run_steps(&mut self, until: u32, on_progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>) -> Result<()> {
        while self.iteration < until && !self.is_done() {
            let progress = self.step()?;
            if on_progress(&progress).is_break() {
                break;
            }
        }
        Ok(())
    }

    /// One step, density control included.
    ///
    /// # Errors
    /// Where a value stops being finite (the error names iteration and view), a view cannot be brought, or the device
    /// fails.
    pub fn step(&mut self) -> Result<Progress> {
        self.iteration += 1;
        let iteration = self.iteration;
        let view = self.draw_view();
        let weights = self.options.weights_at(iteration);
        let values = self.learn(view, &weights).map_err(|error| diverged(error, iteration, view))?;
        self.control_density()?;
        let photometric = f64::from(values.l1) + f64::from(values.dssim);
        self.plateau.note(photometric, iteration, self.views.len(), &self.options);
        Ok(Progress {
            iteration,
            iterations: self.options.iterations,
            gaussians: self.gaussians,
            view,
            values,
            seconds: self.started.elapsed().as_secs_f64(),
        })
    }

    /// The trained cloud and the exposure of every view.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn finish(self) -> Result<(SplatCloud, Vec<Exposure>)> {
        Ok((self.backend.download(&self.cloud)?.cloud, self.exposures.all()))
    }

    /// Views without replacement; a new round is shuffled by (seed, round).
    fn draw_view(&mut self) -> usize {
        if self.stack.is_empty() {
            self.stack = self.shuffled();
            self.round += 1;
        }
        self.stack.pop().map_or(0, |view| view as usize)
    }

    /// All views, in the order of the next round from the last to the first.
    fn shuffled(&self) -> Vec<u32> {
        let mut stack: Vec<u32> = (0..self.views.len() as u32).collect();
        let mut random = stream(self.seed, self.round, 0x5eed);
        for last in (1..stack.len()).rev() {
            stack.swap(last, random.below(last + 1));
        }
        stack
    }

    /// Has the photographs of the next step decoded while this one computes.
    fn look_ahead(&mut self) {
        let next = self.iteration + 1;
        if self.ahead.is_none() || next > self.options.iterations {
            return;
        }
        let Some(view) = self.stack.last().copied().or_else(|| self.shuffled().pop()) else { return };
        let neighbor = self.draw_neighbor(view as usize, next, &self.options.weights_at(next));
        for index in std::iter::once(view as usize).chain(neighbor) {
            if let Some(ahead) = self.ahead.as_mut().filter(|_| !self.cache.holds(index)) {
                ahead.want(index);
            }
        }
    }

    fn draw_neighbor(&self, view: usize, iteration: u32, weights: &LossWeights) -> Option<usize> {
        let list = &self.neighbors[view];
        if list.is_empty() || (weights.geometric == 0.0 && weights.ncc == 0.0) {
            return None;
        }
        let drawn = stream(self.seed, iteration, 0x0e1f).below(list.len());
        Some(list[drawn].view as usize)
    }

    fn prepared(&mut self, view: usize) -> Result<Arc<Prepared<B::View>>> {
        let (views, ahead) = (self.views, self.ahead.as_mut());
        self.cache.get(self.backend, view, || match ahead {
            Some(ahead) => ahead.take(views, view),
            None => views.view(view),
        })
    }

    /// Forward, losses, backward, Adam.
    fn learn(&mut self, view: usize, weights: &LossWeights) -> Result<LossValues> {
        let reference = self.prepared(view)?;
        let other = match self.draw_neighbor(view, self.iteration, weights) {
            Some(neighbor) => Some((neighbor, self.prepared(neighbor)?)),
            None => None,
        };
        self.look_ahead();
        let multi_view = other.is_some();
        let options = RenderOptions {
            sh_degree: self.options.sh_degree_at(self.iteration, self.sh_degree),
            planes: multi_view || weights.normal > 0.0,
            load: weights.load > 0.0,
            gradient: true,
            statistics: self.options.gathers_at(self.iteration),
            observe: false,
            without_color: false,
            free_pixels: weights.free_opacity > 0.0,
        };
        let mut render = self.backend.render(&self.cloud, &self.cameras[view], Some(&reference.view), &options)?;
        // Only planes of the neighbour are compared.
        let beside = RenderOptions { planes: true, without_color: true, gradient: true, ..RenderOptions::default() };
        let mut neighbor_render = match &other {
            Some((index, prepared)) => {
                Some(self.backend.render(&self.cloud, &self.cameras[*index], Some(&prepared.view), &beside)?)
            }
            None => None,
        };
        let mut sample = Sample {
            view: &reference.view,
            render: &mut render,
            neighbor: other.as_ref().zip(neighbor_render.as_mut()).map(|((_, p), render)| (&p.view, render)),
            exposure: self.exposures.of(view),
            weights,
            scene_scale: self.scene_scale,
            seed: stream(self.seed, self.iteration, 0x9a7c).next_u64(),
        };
        let values = self.backend.losses(&self.cloud, &mut sample)?;
        if !values.total.is_finite() {
            return Err(BackendError::NotFinite("the loss").into());
        }
        self.backend.backward(&mut self.cloud, &sample)?;
        let rates = self.options.rates_at(self.iteration, self.gsd);
        self.backend.adam(&mut self.cloud, &rates, self.iteration)?;
        if self.options.exposure && !self.exposure_frozen {
            self.exposures.step(view, values.d_gain, values.d_bias, self.options.rates.exposure);
        }
        Ok(values)
    }

    fn control_density(&mut self) -> Result<()> {
        let iteration = self.iteration;
        let densify = self.options.densifies_at(iteration);
        let reset = self.options.resets_opacity_at(iteration);
        if densify || reset {
            let state = self.backend.download(&self.cloud)?;
            let mut plan = DensityPlan { keep: (0..state.cloud.len() as u32).collect(), ..DensityPlan::default() };
            if densify {
                let agreement = self.agreement(&state.cloud.means)?;
                let input = DensityInput {
                    cloud: &state.cloud,
                    statistics: &state.statistics,
                    footprints: &footprints(&state.cloud.means, &self.cameras),
                    cull: self.options.culls_at(iteration, self.views.len()),
                    agreement: agreement.as_ref(),
                    seed: self.seed,
                    iteration,
                };
                plan = plan_density(&input, &self.options.density);
            }
            if densify {
                // Births lie at the end, in the order of their parents: what is kept takes them in again.
                let kept: Vec<[f32; 3]> = plan.keep.iter().map(|&i| state.cloud.means[i as usize]).collect();
                plan.keep = curve_order(&kept).into_iter().map(|i| plan.keep[i as usize]).collect();
            }
            plan.opacity_ceiling = reset.then_some(self.options.density.reset_opacity);
            self.reshape(&plan)?;
        }
        if self.options.trims_at(iteration) {
            self.trim()?;
        }
        Ok(())
    }

    /// Where drawn views show errors, if births depend on it.
    fn agreement(&mut self, means: &[[f32; 3]]) -> Result<Option<Agreement>> {
        if self.options.density.agreement == 0.0 {
            return Ok(None);
        }
        let mut agreement = Agreement::of(means.len());
        let sh_degree = self.options.sh_degree_at(self.iteration, self.sh_degree);
        let options = RenderOptions { planes: true, sh_degree, ..RenderOptions::default() };
        let mut random = stream(self.seed, self.iteration, 0xfa57);
        for _ in 0..AGREEMENT_VIEWS {
            let index = random.below(self.views.len());
            let prepared = self.prepared(index)?;
            let render = self.backend.render(&self.cloud, &self.cameras[index], Some(&prepared.view), &options)?;
            let maps = self.backend.read(&render)?;
            let error = self.views.view(index)?.errors(&maps.color.values, &self.exposures.of(index));
            agreement.note(means, &self.cameras[index], &maps.depth.values, &error);
        }
        Ok(Some(agreement))
    }

    /// Renders every view and removes what too few of them see (method.md 2.8, 8.8).
    fn trim(&mut self) -> Result<()> {
        self.backend.statistics(&mut self.cloud, true)?;
        let means = self.backend.download(&self.cloud)?.cloud.means;
        let mut could_see = vec![0u32; means.len()];
        let options = RenderOptions { observe: true, ..RenderOptions::default() };
        for view in 0..self.views.len() {
            let prepared = self.prepared(view)?;
            let camera = &self.cameras[view];
            self.backend.render(&self.cloud, camera, Some(&prepared.view), &options)?;
            for (count, mean) in could_see.iter_mut().zip(&means) {
                *count += u32::from(locate(camera, *mean).is_some_and(|(_, at)| prepared.active.is_active(at)));
            }
        }
        let observed = self.backend.statistics(&mut self.cloud, true)?.observed_count;
        self.reshape(&plan_trim(&observed, &could_see, &self.options.density))
    }

    fn reshape(&mut self, plan: &DensityPlan) -> Result<()> {
        let count = plan.keep.len() + plan.births.len();
        if count == 0 {
            return Err(TrainError::Empty("density control removed every Gaussian; check masks and cameras"));
        }
        self.backend.reshape(&mut self.cloud, plan)?;
        self.gaussians = count;
        Ok(())
    }
}

fn with_near(camera: ViewCamera, scene_scale: f32, options: &TrainOptions) -> ViewCamera {
    ViewCamera { near: camera.near.max(f64::from(scene_scale) * f64::from(options.near)), ..camera }
}

fn diverged(error: TrainError, iteration: u32, view: usize) -> TrainError {
    match error {
        TrainError::Backend(BackendError::NotFinite(what)) => {
            TrainError::NotFinite { iteration, view, what: what.to_owned() }
        }
        other => other,
    }
}

#[cfg(test)]
pub(crate) mod fake;
#[cfg(test)]
mod tests;
