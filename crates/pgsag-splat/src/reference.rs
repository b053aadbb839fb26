//! The slow true one: f64, pixel by pixel, every Gaussian at every pixel, no tiles and no tricks.
//!
//! It defines what the other backends must do (`conformance`), and the proofs run through it. Rows run in parallel and
//! are added in order. For a few hundred Gaussians and small images only.

mod cloud;
mod project;
mod raster;
#[cfg(test)]
mod tests;

use pgsag_scene::Map;

use crate::backend::{
    Backend, BackendError, DensityPlan, DensityStatistics, Limits, LossValues, OptimizerState, PlaneMaps, Rates,
    RenderOptions, Result, Sample, TrainingView, ViewCamera,
};
use crate::cloud::SplatCloud;
use crate::equations::projection::Lens;
use crate::equations::{activation, adam, plane};
use crate::losses::{Evaluation, Inputs, LossView, MapGradients, RenderedMaps, evaluate, flatness};

pub use cloud::Cloud;
use cloud::{Row, SCALES};
use project::{Projected, ScreenGradient};

/// The f64 backend.
#[derive(Clone, Copy, Debug, Default)]
pub struct Reference {
    limits: Limits,
}

/// A render with all that its gradient needs.
#[derive(Clone, Debug)]
pub struct Render {
    lens: Lens<f64>,
    width: usize,
    height: usize,
    options: RenderOptions,
    /// Front to back.
    splats: Vec<Projected>,
    /// `[H * W]` pixels that are drawn.
    drawn: Vec<bool>,
    /// `[N]` Gaussians that cover a drawn pixel.
    visible: Vec<bool>,
    color: [Vec<f64>; 3],
    normal: [Vec<f64>; 3],
    distance: Vec<f64>,
    opacity: Vec<f64>,
    load: Vec<f64>,
    /// Of the total, as the last `losses` left it.
    gradients: MapGradients<f64>,
}

impl Reference {
    /// With other limits of blending than 3DGS's.
    #[must_use]
    pub fn new(limits: Limits) -> Self {
        Self { limits }
    }
}

impl Render {
    fn maps(&self) -> RenderedMaps<'_, f64> {
        let planes = self.options.planes;
        RenderedMaps {
            color: self.color.each_ref().map(|map| &map[..]),
            normal: self.normal.each_ref().map(|map| if planes { &map[..] } else { &[] }),
            distance: if planes { &self.distance } else { &[] },
            opacity: &self.opacity,
            load: if self.options.load { &self.load } else { &[] },
        }
    }

    fn depth(&self, index: usize) -> f64 {
        let ray = self.lens.ray((index % self.width) as f64, (index / self.width) as f64);
        plane::depth(self.distance[index], self.normal.each_ref().map(|map| map[index]), ray)
    }
}

impl Backend for Reference {
    type Cloud = Cloud;
    type View = LossView;
    type Render = Render;

    fn upload(&self, state: &OptimizerState) -> Result<Cloud> {
        Ok(Cloud::new(state))
    }

    fn download(&self, cloud: &Cloud) -> Result<OptimizerState> {
        Ok(OptimizerState {
            cloud: cloud.splats(&cloud.rows),
            first: cloud.splats(&cloud.first),
            second: cloud.splats(&cloud.second),
            statistics: cloud.statistics(),
        })
    }

    fn prepare(&self, view: &TrainingView) -> Result<LossView> {
        Ok(LossView::new(view))
    }

    fn render(
        &self,
        cloud: &Cloud,
        camera: &ViewCamera,
        mask: Option<&LossView>,
        options: &RenderOptions,
    ) -> Result<Render> {
        let lens = Lens::new(camera);
        let degree = options.sh_degree.min(cloud.sh_degree);
        let mut splats: Vec<Projected> = cloud
            .rows
            .iter()
            .enumerate()
            .filter_map(|(index, row)| Projected::new(&lens, camera.near, index, row, degree))
            .collect();
        splats.sort_by(|a, b| a.point[2].total_cmp(&b.point[2]).then(a.index.cmp(&b.index)));
        let (width, height) = (camera.pinhole.width as usize, camera.pinhole.height as usize);
        let drawn = (0..width * height).map(|index| mask.is_none_or(|view| is_drawn(view, index, options))).collect();
        let mut render = Render {
            lens,
            width,
            height,
            options: *options,
            splats,
            drawn,
            visible: vec![false; cloud.rows.len()],
            color: Default::default(),
            normal: Default::default(),
            distance: Vec::new(),
            opacity: Vec::new(),
            load: Vec::new(),
            gradients: MapGradients::default(),
        };
        raster::forward(&mut render, &self.limits, cloud);
        Ok(render)
    }

    fn read(&self, render: &Render) -> Result<PlaneMaps> {
        let planes = render.options.planes;
        let count = render.width * render.height;
        let depth: Vec<f64> = if planes { (0..count).map(|index| render.depth(index)).collect() } else { Vec::new() };
        let maps = render.maps();
        Ok(PlaneMaps {
            color: triples(render, maps.color),
            normal: triples(render, maps.normal),
            distance: numbers(render, maps.distance),
            opacity: numbers(render, maps.opacity),
            depth: numbers(render, &depth),
            load: numbers(render, maps.load),
        })
    }

    fn losses(&self, cloud: &Cloud, sample: &mut Sample<'_, Self>) -> Result<LossValues> {
        let found = terms(cloud, sample);
        sample.render.gradients = found.reference;
        if let Some((_, render)) = &mut sample.neighbor {
            render.gradients = found.neighbor;
        }
        if found.values.total.is_finite() { Ok(found.values) } else { Err(BackendError::NotFinite("the loss")) }
    }

    fn backward(&self, cloud: &mut Cloud, sample: &Sample<'_, Self>) -> Result<()> {
        cloud.gradients.iter_mut().for_each(|row| *row = Row::ZERO);
        let pixels = sample.view.mean_count(sample.weights.mean_over_mask) as f64;
        let renders = std::iter::once(&*sample.render).chain(sample.neighbor.iter().map(|(_, render)| &**render));
        for render in renders {
            let sums = raster::backward(render, &self.limits);
            for (splat, sum) in render.splats.iter().zip(&sums) {
                splat.backward(&render.lens, &cloud.rows[splat.index], sum, &mut cloud.gradients[splat.index]);
            }
            if render.options.statistics {
                gather(cloud, render, &sums, pixels);
            }
        }
        add_flatness(cloud, sample);
        Ok(())
    }

    fn gradients(&self, cloud: &Cloud) -> Result<SplatCloud> {
        Ok(cloud.splats(&cloud.gradients))
    }

    fn adam(&self, cloud: &mut Cloud, rates: &Rates, step: u32) -> Result<()> {
        let corrections = adam::corrections(step);
        let sparse = rates.sparse;
        let rates = cloud::rates(rates);
        let Cloud { rows, first, second, gradients, .. } = cloud;
        for (((row, first), second), gradient) in rows.iter_mut().zip(first).zip(second).zip(gradients) {
            if sparse && gradient.0.iter().all(|&value| value == 0.0) {
                continue;
            }
            for i in 0..cloud::WIDTH {
                let moved = adam::step(row.0[i], first.0[i], second.0[i], gradient.0[i], rates[i], corrections);
                [row.0[i], first.0[i], second.0[i]] = moved;
            }
            if !row.0.iter().all(|value| value.is_finite()) {
                return Err(BackendError::NotFinite("a parameter"));
            }
        }
        Ok(())
    }

    fn statistics(&self, cloud: &mut Cloud, reset: bool) -> Result<DensityStatistics> {
        let statistics = cloud.statistics();
        if reset {
            cloud.reset_statistics();
        }
        Ok(statistics)
    }

    fn reshape(&self, cloud: &mut Cloud, plan: &DensityPlan) -> Result<()> {
        cloud.reshape(plan);
        Ok(())
    }
}

/// All terms of a sample.
fn terms(cloud: &Cloud, sample: &Sample<'_, Reference>) -> Evaluation<f64> {
    let scale = f64::from(sample.scene_scale);
    let flatness = match sample.weights.flatness {
        0.0 => 0.0,
        _ => flatness::flatness(visible_scales(cloud, sample.render), scale),
    };
    evaluate(&Inputs {
        view: sample.view,
        maps: sample.render.maps(),
        neighbor: sample.neighbor.as_ref().map(|(view, render)| (*view, render.maps())),
        exposure: sample.exposure,
        weights: sample.weights,
        flatness,
        seed: sample.seed,
    })
}

/// Active pixels are drawn, free ones on demand.
fn is_drawn(view: &LossView, index: usize, options: &RenderOptions) -> bool {
    view.is_active(index) || (options.free_pixels && view.classes[index] == pgsag_scene::PixelClass::Free)
}

/// Scales of the Gaussians that a render shows.
fn visible_scales<'a>(cloud: &'a Cloud, render: &'a Render) -> impl Iterator<Item = [f64; 3]> + 'a {
    let shown = cloud.rows.iter().zip(&render.visible).filter(|(_, visible)| **visible);
    shown.map(|(row, _)| activation::scales(row.get(SCALES)))
}

/// The flattening term knows no pixel: its gradient goes straight to the scales.
fn add_flatness(cloud: &mut Cloud, sample: &Sample<'_, Reference>) {
    let weight = f64::from(sample.weights.flatness);
    let count = sample.render.visible.iter().filter(|&&visible| visible).count();
    if weight == 0.0 {
        return;
    }
    for (index, _) in sample.render.visible.iter().enumerate().filter(|(_, visible)| **visible) {
        let scales = activation::scales(cloud.rows[index].get(SCALES));
        let d = flatness::flatness_grad(scales, count, f64::from(sample.scene_scale), weight);
        cloud.gradients[index].add(SCALES, d);
    }
}

/// Adds a render's screen gradients to the density statistics.
fn gather(cloud: &mut Cloud, render: &Render, sums: &[ScreenGradient], mean_pixels: f64) {
    for (splat, sum) in render.splats.iter().zip(sums).filter(|(_, sum)| sum.pixels > 0.0) {
        let tally = &mut cloud.tallies[splat.index];
        let share = mean_pixels / sum.pixels;
        tally.gradient += libm::hypot(sum.signed[0], sum.signed[1]) * share;
        tally.absolute_gradient += libm::hypot(sum.absolute[0], sum.absolute[1]) * share;
        tally.visible_count += 1;
        tally.radius_px = tally.radius_px.max(splat.radius_px());
    }
}

fn triples(render: &Render, values: [&[f64]; 3]) -> Map<[f32; 3]> {
    map(render, (0..values[0].len()).map(|index| values.map(|map| map[index] as f32)).collect())
}

fn numbers(render: &Render, values: &[f64]) -> Map<f32> {
    map(render, values.iter().map(|&value| value as f32).collect())
}

/// A map of the render's size, or of none.
fn map<T>(render: &Render, values: Vec<T>) -> Map<T> {
    let (width, height) = if values.is_empty() { (0, 0) } else { (render.width as u32, render.height as u32) };
    Map { width, height, values }
}

/// Opacity logit that a ceiling on opacity allows.
fn ceiling_logit(opacity: f32) -> f64 {
    let opacity = f64::from(opacity).clamp(1e-6, 1.0 - 1e-6);
    libm::log(opacity / (1.0 - opacity))
}
