//! A device that computes nothing true but is deterministic: it counts calls and moves every parameter a little.

use std::collections::BTreeMap;
use std::sync::Mutex;

use pgsag_scene::{Image, Map, Pinhole};

use super::*;
use crate::backend::{Birth, DensityStatistics, PlaneMaps, Rates, Result as DeviceResult};

/// Counts calls.
#[derive(Default)]
pub(crate) struct Fake {
    calls: Mutex<BTreeMap<&'static str, usize>>,
    poison: Option<usize>,
    observed: Mutex<u32>,
}

pub(crate) struct FakeCloud(pub(crate) OptimizerState);

impl Fake {
    /// The loss of this call, from 1, is not finite.
    pub(crate) fn poisoned_at(call: usize) -> Self {
        Self { poison: Some(call), ..Self::default() }
    }

    fn count(&self, what: &'static str) -> usize {
        let mut calls = self.calls.lock().expect("one thread");
        let count = calls.entry(what).or_default();
        *count += 1;
        *count
    }

    pub(crate) fn calls(&self, what: &str) -> usize {
        self.calls.lock().expect("one thread").get(what).copied().unwrap_or(0)
    }
}

impl Backend for Fake {
    type Cloud = FakeCloud;
    type View = u32;
    type Render = RenderOptions;

    fn upload(&self, state: &OptimizerState) -> DeviceResult<FakeCloud> {
        Ok(FakeCloud(state.clone()))
    }

    fn download(&self, cloud: &FakeCloud) -> DeviceResult<OptimizerState> {
        Ok(cloud.0.clone())
    }

    fn prepare(&self, view: &TrainingView) -> DeviceResult<u32> {
        self.count("prepare");
        Ok(u32::from(view.image.pixels[0][0]))
    }

    fn render(
        &self,
        _: &FakeCloud,
        _: &ViewCamera,
        _: Option<&u32>,
        options: &RenderOptions,
    ) -> DeviceResult<RenderOptions> {
        self.count("render");
        self.count(if options.planes { "render planes" } else { "render colour" });
        if options.observe {
            *self.observed.lock().expect("one thread") += 1;
        }
        Ok(*options)
    }

    fn read(&self, _: &RenderOptions) -> DeviceResult<PlaneMaps> {
        Err(BackendError::Device("the fake draws nothing".into()))
    }

    fn losses(&self, _: &FakeCloud, sample: &mut Sample<'_, Self>) -> DeviceResult<LossValues> {
        let call = self.count("losses");
        let total = if self.poison == Some(call) { f32::NAN } else { 1.0 / call as f32 };
        let d_gain = [0.1 * (*sample.view as f32 - 3.0), 0.0, 0.01];
        Ok(LossValues { total, l1: sample.exposure.gain[0], d_gain, ..LossValues::default() })
    }

    fn backward(&self, cloud: &mut FakeCloud, sample: &Sample<'_, Self>) -> DeviceResult<()> {
        if sample.render.statistics {
            let statistics = &mut cloud.0.statistics;
            for i in 0..statistics.gradient.len() {
                statistics.gradient[i] += (i % 7) as f32;
                statistics.visible_count[i] += 1;
            }
        }
        Ok(())
    }

    fn gradients(&self, cloud: &FakeCloud) -> DeviceResult<SplatCloud> {
        Ok(cloud.0.first.clone())
    }

    fn adam(&self, cloud: &mut FakeCloud, rates: &Rates, step: u32) -> DeviceResult<()> {
        for (mean, first) in cloud.0.cloud.means.iter_mut().zip(&mut cloud.0.first.means) {
            first[0] = 0.9 * first[0] + 0.1 * libm::sinf(step as f32 + mean[1]);
            mean[0] += rates.means * first[0];
        }
        Ok(())
    }

    fn statistics(&self, cloud: &mut FakeCloud, reset: bool) -> DeviceResult<DensityStatistics> {
        let mut found = cloud.0.statistics.clone();
        found.observed_count =
            vec![std::mem::take(&mut *self.observed.lock().expect("one thread")); cloud.0.cloud.len()];
        if reset {
            cloud.0.statistics = DensityStatistics::empty(cloud.0.cloud.len());
        }
        Ok(found)
    }

    fn reshape(&self, cloud: &mut FakeCloud, plan: &DensityPlan) -> DeviceResult<()> {
        self.count("reshape");
        let origin = |i: usize| match i.checked_sub(plan.keep.len()) {
            None => (plan.keep[i] as usize, None),
            Some(birth) => (plan.births[birth].parent as usize, Some(&plan.births[birth])),
        };
        let count = plan.keep.len() + plan.births.len();
        let from: Vec<(usize, Option<&Birth>)> = (0..count).map(origin).collect();
        let state = &mut cloud.0;
        for (which, part) in [&mut state.cloud, &mut state.first, &mut state.second].into_iter().enumerate() {
            let basis = 3 * part.basis_count();
            let keeps = |birth: &Option<&Birth>| which == 0 || birth.is_none();
            let old = part.clone();
            part.means = from.iter().map(|(i, b)| if keeps(b) { old.means[*i] } else { [0.0; 3] }).collect();
            part.log_scales = from.iter().map(|(i, b)| if keeps(b) { old.log_scales[*i] } else { [0.0; 3] }).collect();
            part.rotations = from.iter().map(|(i, b)| if keeps(b) { old.rotations[*i] } else { [0.0; 4] }).collect();
            part.opacity_logits =
                from.iter().map(|(i, b)| if keeps(b) { old.opacity_logits[*i] } else { 0.0 }).collect();
            part.harmonics =
                from.iter().flat_map(|(i, _)| old.harmonics[i * basis..(i + 1) * basis].to_vec()).collect();
        }
        state.statistics = DensityStatistics::empty(count);
        Ok(())
    }
}

/// Looks straight down from `height` over `(x, y)`; the field of view is the same at every width.
pub(crate) fn camera_above(at: [f64; 2], height: f64, width: u32) -> ViewCamera {
    let half = f64::from(width) / 2.0;
    ViewCamera {
        pinhole: Pinhole { width, height: width, fx: 2.0 * half, fy: 2.0 * half, cx: half, cy: half },
        rotation: [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]],
        translation: [-at[0], at[1], height],
        near: 0.0,
    }
}

/// `n * n` Gaussians on the square of this side about the origin.
pub(crate) fn cloud_on_plane(n: usize, side: f32) -> SplatCloud {
    let mut cloud = SplatCloud { sh_degree: 1, ..SplatCloud::default() };
    let spacing = side / n as f32;
    for i in 0..n * n {
        let at = |k: usize| (k as f32 + 0.5) * spacing - side / 2.0;
        cloud.means.push([at(i % n), at(i / n), 0.0]);
        cloud.log_scales.push([libm::logf(spacing), libm::logf(spacing), libm::logf(0.1 * spacing)]);
        cloud.rotations.push([1.0, 0.0, 0.0, 0.0]);
        cloud.opacity_logits.push(0.0);
        cloud.harmonics.extend([0.1; 12]);
    }
    cloud
}

/// Views from above along a line.
pub(crate) struct FakeViews {
    count: usize,
    width: u32,
}

impl FakeViews {
    pub(crate) fn ring(count: usize, width: u32) -> Self {
        Self { count, width }
    }

    pub(crate) fn training_view(&self, index: usize) -> TrainingView {
        TrainingView {
            camera: self.camera(index),
            image: Image::filled(self.width, self.width, [index as u8; 3]),
            mask: None,
            inner_edges: None::<Map<bool>>,
        }
    }
}

impl ViewSource for FakeViews {
    fn len(&self) -> usize {
        self.count
    }

    fn camera(&self, index: usize) -> ViewCamera {
        camera_above([index as f64 * 0.1, 0.0], 5.0, self.width)
    }

    fn view(&self, index: usize) -> Result<Arc<TrainingView>> {
        Ok(Arc::new(self.training_view(index)))
    }
}

/// Each view's two neighbours in order.
pub(crate) fn ring_neighbors(count: usize) -> Vec<Vec<Neighbor>> {
    (0..count)
        .map(|i| [1, count - 1].map(|step| Neighbor { view: ((i + step) % count) as u32, score: 1.0 }).to_vec())
        .collect()
}
