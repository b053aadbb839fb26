//! One case of the benchmark: a whole training iteration, timed phase by phase on each thread.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pgsag_splat::backend::{
    Backend, Exposure, LossWeights, OptimizerState, Rates, RenderOptions, Sample, TrainingView, ViewCamera,
};
use pgsag_splat::cpu::{Cpu, CpuCloud, CpuOptions, CpuView, SimdLevel};
use rayon::ThreadPool;

use crate::Failure;
use crate::clock::{thread_ms, wall_ms};
use crate::scene::{Scene, ellipse};

/// What is measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Case {
    /// Gaussians of the synthetic cloud.
    pub(crate) gaussians: usize,
    /// Pixels.
    pub(crate) size: (u32, u32),
    /// All 8 channels, flattening and normal loss; else colours alone with L1 and SSIM.
    pub(crate) planes: bool,
    /// Share of the pixels that the mask leaves.
    pub(crate) share: f64,
    /// Patches of the multi-view terms; 0: none, and no second render.
    pub(crate) patches: u32,
    /// Threads.
    pub(crate) threads: usize,
    /// Adam steps only what the view shows.
    pub(crate) sparse: bool,
}

impl Case {
    /// The case that others are variations of.
    pub(crate) const PLAIN: Self =
        Self { gaussians: 100_000, size: (708, 522), planes: true, share: 1.0, patches: 0, threads: 1, sparse: false };

    fn weights(&self) -> LossWeights {
        let multi_view = self.patches > 0;
        let on = |switch: bool, weight: f32| if switch { weight } else { 0.0 };
        let whole = LossWeights::default();
        LossWeights {
            flatness: on(self.planes, whole.flatness),
            normal: on(self.planes, whole.normal),
            geometric: on(multi_view, whole.geometric),
            ncc: on(multi_view, whole.ncc),
            ncc_patches: self.patches,
            ..whole
        }
    }
}

/// CPU milliseconds of a phase: all threads together, and the thread that worked most.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Phase {
    pub(crate) name: &'static str,
    pub(crate) sum: f64,
    pub(crate) largest: f64,
}

/// One iteration.
#[derive(Clone, Debug, Default)]
pub(crate) struct Turn {
    /// In order; a phase that comes twice (second render) is summed.
    pub(crate) phases: Vec<Phase>,
    /// Milliseconds on the wall.
    pub(crate) wall: f64,
}

impl Turn {
    /// CPU milliseconds, all threads.
    pub(crate) fn total(&self) -> f64 {
        self.phases.iter().map(|phase| phase.sum).sum()
    }

    /// CPU milliseconds of the busiest thread of each phase: what the iteration would last on idle cores.
    pub(crate) fn critical(&self) -> f64 {
        self.phases.iter().map(|phase| phase.largest).sum()
    }

    /// CPU milliseconds of a phase, all threads; 0 where there is none of that name.
    pub(crate) fn phase(&self, name: &str) -> f64 {
        self.phases.iter().find(|phase| phase.name == name).map_or(0.0, |phase| phase.sum)
    }
}

/// Clocks of all threads at the end of the last phase, and the phases so far.
#[derive(Debug, Default)]
struct Marks {
    clocks: Vec<f64>,
    turn: Turn,
}

#[derive(Clone, Debug, Default)]
struct Meter(Arc<Mutex<Marks>>);

impl Meter {
    fn marks(&self) -> MutexGuard<'_, Marks> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn start(&self) {
        let clocks = rayon::broadcast(|_| thread_ms());
        *self.marks() = Marks { clocks, turn: Turn::default() };
    }

    fn end_phase(&self, name: &'static str) {
        let now = rayon::broadcast(|_| thread_ms());
        let mut marks = self.marks();
        let spent: Vec<f64> = now.iter().zip(&marks.clocks).map(|(now, before)| now - before).collect();
        let (sum, largest) = (spent.iter().sum(), spent.iter().copied().fold(0.0, f64::max));
        match marks.turn.phases.iter_mut().find(|phase| phase.name == name) {
            Some(phase) => {
                phase.sum += sum;
                phase.largest += largest;
            }
            None => marks.turn.phases.push(Phase { name, sum, largest }),
        }
        marks.clocks = rayon::broadcast(|_| thread_ms());
    }
}

/// A case with its buffers, ready to be run again and again.
pub(crate) struct Bench {
    pub(crate) case: Case,
    /// Entries blended per drawn pixel.
    pub(crate) per_pixel: f64,
    /// Pixels that the mask leaves.
    pub(crate) pixels: usize,
    /// What was measured so far.
    pub(crate) turns: Vec<Turn>,
    pool: Arc<ThreadPool>,
    cpu: Cpu,
    cloud: CpuCloud,
    cameras: [ViewCamera; 2],
    views: [CpuView; 2],
    scale: f32,
    meter: Meter,
    step: u32,
}

impl Bench {
    /// Uploads, and counts what is blended.
    pub(crate) fn new(simd: SimdLevel, case: Case, scene: &Scene) -> Result<Self, Failure> {
        let meter = Meter::default();
        let probe = meter.clone();
        let cpu = Cpu::new(CpuOptions { simd, ..CpuOptions::default() })?;
        let cpu = cpu.with_probe(Box::new(move |name| probe.end_phase(name)));
        let pool = Arc::new(rayon::ThreadPoolBuilder::new().num_threads(case.threads).build()?);
        let mut state = OptimizerState::fresh(scene.cloud.clone());
        // As in training, where other views have set everything in motion: no group may be passed over.
        state.first.opacity_logits.fill(1e-12);
        let cloud = cpu.upload(&state)?;
        let view = |k: usize| {
            let pinhole = scene.cameras[k].pinhole;
            let mask = (case.share < 1.0).then(|| ellipse(pinhole.width, pinhole.height, case.share));
            let image = scene.photographs[k].clone();
            cpu.prepare(&TrainingView { camera: scene.cameras[k], image, mask, inner_edges: None })
        };
        let views = [view(0)?, view(1)?];
        let options = RenderOptions { sh_degree: 3, load: true, ..RenderOptions::default() };
        let counted = pool.install(|| cpu.render(&cloud, &scene.cameras[0], Some(&views[0]), &options))?;
        let load = cpu.read(&counted)?.load.values;
        drop(counted);
        let pixels = (load.len() as f64 * case.share).round() as usize;
        let per_pixel = load.iter().map(|&value| f64::from(value)).sum::<f64>() / pixels as f64;
        let (turns, cameras, scale) = (Vec::new(), scene.cameras, scene.scale);
        Ok(Self { case, per_pixel, pixels, turns, pool, cpu, cloud, cameras, views, scale, meter, step: 0 })
    }

    /// One iteration more; the first, which allocates, is not kept.
    pub(crate) fn run(&mut self) -> Result<(), Failure> {
        self.step += 1;
        let pool = Arc::clone(&self.pool);
        let turn = pool.install(|| self.iterate())?;
        if self.step > 1 {
            self.turns.push(turn);
        }
        Ok(())
    }

    fn iterate(&mut self) -> pgsag_splat::backend::Result<Turn> {
        self.meter.start();
        let start = wall_ms();
        let cpu = &self.cpu;
        let planes = self.case.planes;
        let options =
            RenderOptions { sh_degree: 3, planes, gradient: true, statistics: true, ..RenderOptions::default() };
        let mut render = cpu.render(&self.cloud, &self.cameras[0], Some(&self.views[0]), &options)?;
        let beside = RenderOptions { planes: true, without_color: true, gradient: true, ..RenderOptions::default() };
        let mut second = None;
        if self.case.patches > 0 {
            second = Some(cpu.render(&self.cloud, &self.cameras[1], Some(&self.views[1]), &beside)?);
        }
        let weights = self.case.weights();
        let mut sample = Sample {
            view: &self.views[0],
            render: &mut render,
            neighbor: second.as_mut().map(|render| (&self.views[1], render)),
            exposure: Exposure::NEUTRAL,
            weights: &weights,
            scene_scale: self.scale,
            seed: u64::from(self.step),
        };
        cpu.losses(&self.cloud, &mut sample)?;
        cpu.backward(&mut self.cloud, &sample)?;
        cpu.adam(&mut self.cloud, &Rates { sparse: self.case.sparse, ..RATES }, self.step)?;
        let wall = wall_ms() - start;
        let turn = std::mem::take(&mut self.meter.marks().turn);
        Ok(Turn { wall, ..turn })
    }
}

/// So small that the cloud stays what it is.
const RATES: Rates =
    Rates { means: 1e-7, scales: 1e-7, rotations: 1e-7, opacity: 1e-7, color: 1e-7, harmonics: 1e-7, sparse: false };
