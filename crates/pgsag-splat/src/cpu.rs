//! The embedded backend: the same code on every processor, as fast as its vector units allow.
//!
//! `project` (cloud to records and lists of tiles) > `bins` (lists, front to back) > `forward` (blending) > `maps` and
//! the losses > `backward` (sums per Gaussian and tile) > `gradient` (back to parameters) > `adam`.
//! Everything of size N or pixels runs on the current rayon pool; every sum has a fixed order and nothing is atomic
//! but plain stores, so results are the same bytes on any number of threads. Vector levels differ by rounding alone.

mod adam;
mod backward;
mod bins;
mod bounds;
mod cloud;
mod forward;
mod gradient;
mod layout;
mod maps;
mod project;
mod reduce;
mod render;
mod sort;

use std::{
    fmt,
    sync::{Arc, Mutex, PoisonError, atomic::Ordering::Relaxed},
};

use fearless_simd::Level;
use pgsag_scene::{Map, PixelClass};
use rayon::prelude::*;

pub use crate::lanes::SimdLevel;
pub use cloud::CpuCloud;
pub use render::CpuRender;

use crate::backend::{
    Backend, BackendError, DensityPlan, DensityStatistics, Limits, LossValues, OptimizerState, PlaneMaps, Rates,
    RenderOptions, Result, Sample, TrainingView, ViewCamera,
};
use crate::cloud::SplatCloud;
use crate::equations::{plane as planes, projection::Lens};
use crate::lanes::{self, wide};
use crate::losses::{Evaluation, Inputs, LossView, evaluate_into, spare::Spare};
use forward::Cuts;
use gradient::Return;
use layout::Layout;
use maps::PartGradients;
use project::{Projection, project};
use reduce::{Sums, reduce};
use render::{Buffers, Pool, leaves_color_out};

/// Gaussians whose scales are added at a time.
const FLATNESS_CHUNK: usize = 4096;

/// How [`Cpu`] works.
#[derive(Clone, Copy, Debug, Default)]
pub struct CpuOptions {
    /// Vector instructions.
    pub simd: SimdLevel,
    /// Where blending begins and ends.
    pub limits: Limits,
}

/// Called with the name of every phase as it ends, on the thread that called the backend.
pub type Probe = Box<dyn Fn(&'static str) + Send + Sync>;

/// The embedded backend.
pub struct Cpu {
    level: Level,
    cuts: Cuts,
    pool: Arc<Pool>,
    scratch: Mutex<Vec<Scratch>>,
    whole: Mutex<Option<Arc<Layout>>>,
    probe: Option<Probe>,
}

/// Buffers between calls. Taken out of their lock while in use: a thread that waits inside a call may be given
/// another call to run.
#[derive(Default)]
struct Scratch {
    losses: Evaluation<f32>,
    sums: Vec<lanes::Line>,
    plain: Vec<[f32; 2]>,
    parts: Spare<PartGradients>,
}

impl fmt::Debug for Cpu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Cpu").field("level", &self.level).field("cuts", &self.cuts).finish_non_exhaustive()
    }
}

/// A view on the CPU: what the losses need of it, and what is drawn of it.
#[derive(Clone, Debug)]
pub struct CpuView {
    losses: LossView,
    active: Arc<Layout>,
    with_free: Arc<Layout>,
}

impl Cpu {
    /// The backend with these options.
    ///
    /// # Errors
    /// Where this machine lacks the vector instructions that were asked for.
    pub fn new(options: CpuOptions) -> Result<Self> {
        let level = options.simd.detected().ok_or_else(|| {
            BackendError::Device(format!(
                "this machine has no {:?} instructions; choose one of {:?}, or Auto",
                options.simd,
                SimdLevel::available()
            ))
        })?;
        let cuts = Cuts {
            alpha_log2: libm::log2f(options.limits.alpha_cut).max(-100.0),
            stop: options.limits.transmittance_stop,
        };
        Ok(Self { level, cuts, pool: Arc::default(), scratch: Mutex::default(), whole: Mutex::default(), probe: None })
    }

    /// The same, telling `probe` when phases end: for benchmarks.
    #[must_use]
    pub fn with_probe(mut self, probe: Probe) -> Self {
        self.probe = Some(probe);
        self
    }

    fn phase(&self, name: &'static str) {
        if let Some(probe) = &self.probe {
            probe(name);
        }
    }

    fn take_scratch(&self) -> Scratch {
        self.scratch.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    fn give_scratch(&self, scratch: Scratch) {
        self.scratch.lock().unwrap_or_else(PoisonError::into_inner).push(scratch);
    }

    fn buffers(&self) -> Buffers {
        self.pool.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    /// What to draw of a view or, without one, of a camera.
    fn layout(&self, camera: &ViewCamera, view: Option<&CpuView>, free_pixels: bool) -> Result<Arc<Layout>> {
        let (width, height) = (camera.pinhole.width, camera.pinhole.height);
        if let Some(view) = view {
            let layout = if free_pixels { &view.with_free } else { &view.active };
            if (layout.width, layout.height) != (width, height) {
                return Err(BackendError::Device(format!(
                    "a camera of {width} x {height} pixels cannot draw a view of {} x {}",
                    layout.width, layout.height
                )));
            }
            return Ok(Arc::clone(layout));
        }
        let mut whole = self.whole.lock().unwrap_or_else(PoisonError::into_inner);
        match &*whole {
            Some(layout) if (layout.width, layout.height) == (width, height) => Ok(Arc::clone(layout)),
            _ => Ok(Arc::clone(whole.insert(Arc::new(Layout::new(width, height, |_, _| true))))),
        }
    }

    /// Mean smallest scale of the visible Gaussians in scene scales, and its gradient per Gaussian and scene unit.
    fn flatness(render: &CpuRender, scene_scale: f32) -> (f64, f64) {
        let Buffers { bins, blocks, .. } = &render.buffers;
        let sums: Vec<(f64, usize)> = bins
            .entries
            .par_chunks(FLATNESS_CHUNK)
            .map(|entries| {
                let visible = entries.iter().filter(|entry| bins.any(entry, blocks));
                visible.fold((0.0, 0), |(sum, count), entry| (sum + f64::from(entry.thickness), count + 1))
            })
            .collect();
        let (sum, count) = sums.into_iter().fold((0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        if count == 0 {
            return (0.0, 0.0);
        }
        let share = 1.0 / (count as f64 * f64::from(scene_scale));
        (sum * share, share)
    }

    fn back(&self, cloud: &mut CpuCloud, render: &CpuRender, averaged_pixels: usize, accumulate: bool) {
        let mut scratch = self.take_scratch();
        render.unblend(self.level, &mut scratch.sums, &mut scratch.plain, &scratch.parts);
        self.phase("backward");
        let sums = Sums {
            bins: &render.buffers.bins,
            pairs: &scratch.sums,
            blocks: &render.buffers.blocks,
            plain: &scratch.plain,
            averaged_pixels: render.options.statistics.then_some(averaged_pixels as f32),
        };
        let back = Return {
            camera: render.camera,
            sh_degree: render.options.sh_degree,
            planes: render.options.planes,
            color: !leaves_color_out(&render.options),
            d_smallest_scale: if accumulate { 0.0 } else { render.d_smallest_scale },
        };
        reduce(self.level, cloud, &sums, back, accumulate);
        self.give_scratch(scratch);
        self.phase("gradient");
    }
}

impl Backend for Cpu {
    type Cloud = CpuCloud;
    type View = CpuView;
    type Render = CpuRender;

    fn upload(&self, state: &OptimizerState) -> Result<CpuCloud> {
        Ok(CpuCloud::new(self.level, state))
    }

    fn download(&self, cloud: &CpuCloud) -> Result<OptimizerState> {
        Ok(cloud.state())
    }

    fn prepare(&self, view: &TrainingView) -> Result<CpuView> {
        let losses = LossView::new(view);
        let (width, height) = (view.camera.pinhole.width, view.camera.pinhole.height);
        if (losses.width, losses.height) != (width as usize, height as usize) {
            return Err(BackendError::Device(format!(
                "an image of {} x {} pixels does not belong to a camera of {width} x {height}",
                losses.width, losses.height
            )));
        }
        let class = |x: u32, y: u32| losses.classes[y as usize * width as usize + x as usize];
        let active = Arc::new(Layout::new(width, height, |x, y| class(x, y).is_active()));
        let with_free = if losses.free_count == 0 {
            Arc::clone(&active)
        } else {
            Arc::new(Layout::new(width, height, |x, y| class(x, y) != PixelClass::Occluded))
        };
        Ok(CpuView { losses, active, with_free })
    }

    fn render(
        &self,
        cloud: &CpuCloud,
        camera: &ViewCamera,
        mask: Option<&CpuView>,
        options: &RenderOptions,
    ) -> Result<CpuRender> {
        let options = RenderOptions { sh_degree: options.sh_degree.min(cloud.sh_degree), ..*options };
        let layout = self.layout(camera, mask, options.free_pixels)?;
        let mut buffers = self.buffers();
        let projection = Projection {
            camera,
            layout: &layout,
            sh_degree: options.sh_degree,
            planes: options.planes,
            color: !leaves_color_out(&options),
            cut: self.cuts.alpha_log2,
        };
        project(self.level, cloud, &projection, &mut buffers.records, &mut buffers.found, &mut buffers.bins);
        self.phase("project");
        buffers.bins.fill(layout.tiles.len());
        self.phase("bin");
        let pool = Arc::clone(&self.pool);
        let (camera, cuts) = (*camera, self.cuts);
        let mut render =
            CpuRender { options, camera, layout, cuts, buffers, differentiated: false, d_smallest_scale: 0.0, pool };
        render.blend(self.level);
        if options.observe {
            for gaussian in render.gaussians_with(&render.buffers.seen) {
                cloud.observed[gaussian as usize].fetch_add(1, Relaxed);
            }
        }
        self.phase("forward");
        Ok(render)
    }

    fn read(&self, render: &CpuRender) -> Result<PlaneMaps> {
        let (width, height) = (render.layout.width, render.layout.height);
        let maps = render.maps();
        let drawn = |from: &[f32]| render.layout.only_drawn(from);
        let [color, normal] = [maps.color, maps.normal].map(|planes| planes.map(drawn));
        let distance = drawn(maps.distance);
        let lens = Lens::<f32>::new(&render.camera);
        let depth = distance.par_iter().enumerate().map(|(pixel, &distance)| {
            let ray = lens.ray((pixel % width as usize) as f32, (pixel / width as usize) as f32);
            planes::depth(distance, normal.each_ref().map(|map| map[pixel]), ray)
        });
        Ok(PlaneMaps {
            depth: map(width, height, depth.collect()),
            color: map(width, height, triples(&color)),
            normal: map(width, height, triples(&normal)),
            distance: map(width, height, distance),
            opacity: map(width, height, drawn(maps.opacity)),
            load: map(width, height, drawn(maps.load)),
        })
    }

    fn losses(&self, _cloud: &CpuCloud, sample: &mut Sample<'_, Self>) -> Result<LossValues> {
        let (mut flatness, mut share) = (0.0, 0.0);
        if sample.weights.flatness != 0.0 {
            (flatness, share) = Self::flatness(sample.render, sample.scene_scale);
        }
        let mut scratch = self.take_scratch();
        let result = &mut scratch.losses;
        let neighbor = sample.neighbor.as_ref().map(|(view, render)| (&view.losses, render.maps()));
        let inputs = Inputs {
            view: &sample.view.losses,
            maps: sample.render.maps(),
            neighbor,
            exposure: sample.exposure,
            weights: sample.weights,
            flatness,
            seed: sample.seed,
        };
        evaluate_into(&inputs, result);
        self.phase("losses");
        sample.render.d_smallest_scale = (f64::from(sample.weights.flatness) * share) as f32;
        sample.render.take_gradients(&mut result.reference);
        if let Some((_, render)) = &mut sample.neighbor {
            render.take_gradients(&mut result.neighbor);
        }
        let values = result.values;
        self.give_scratch(scratch);
        if values.total.is_finite() { Ok(values) } else { Err(BackendError::NotFinite("the loss")) }
    }

    fn backward(&self, cloud: &mut CpuCloud, sample: &Sample<'_, Self>) -> Result<()> {
        let neighbor = sample.neighbor.as_ref().map(|(view, render)| (*view, &**render));
        for render in [Some(&*sample.render), neighbor.map(|(_, render)| render)].into_iter().flatten() {
            if !render.options.gradient {
                return Err(BackendError::Device("a render without `gradient` cannot go backward".into()));
            }
        }
        let averaged = |view: &CpuView| view.losses.mean_count(sample.weights.mean_over_mask);
        self.back(cloud, sample.render, averaged(sample.view), false);
        if let Some((view, render)) = neighbor.filter(|(_, render)| render.has_gradients()) {
            self.back(cloud, render, averaged(view), true);
        }
        Ok(())
    }

    fn gradients(&self, cloud: &CpuCloud) -> Result<SplatCloud> {
        Ok(cloud.to_cloud(&gradient::all(self.level, cloud)))
    }

    fn adam(&self, cloud: &mut CpuCloud, rates: &Rates, step: u32) -> Result<()> {
        adam::step(self.level, cloud, rates, step)?;
        self.phase("adam");
        Ok(())
    }

    fn statistics(&self, cloud: &mut CpuCloud, reset: bool) -> Result<DensityStatistics> {
        let statistics = cloud.statistics_now();
        if reset {
            cloud.reset_statistics();
        }
        Ok(statistics)
    }

    fn reshape(&self, cloud: &mut CpuCloud, plan: &DensityPlan) -> Result<()> {
        cloud.reshape(self.level, plan);
        Ok(())
    }
}

/// Planes as values of three.
fn triples(planes: &[Vec<f32>; 3]) -> Vec<[f32; 3]> {
    (0..planes[0].len()).map(|index| planes.each_ref().map(|plane| plane[index])).collect()
}

/// A map of the camera's size, or 0 x 0 where there are no values.
fn map<T>(width: u32, height: u32, values: Vec<T>) -> Map<T> {
    if values.is_empty() { Map { width: 0, height: 0, values } } else { Map { width, height, values } }
}

#[cfg(test)]
mod tests;
