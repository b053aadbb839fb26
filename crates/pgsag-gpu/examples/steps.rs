//! Milliseconds of one training step on a graphics card, and of every kernel in it. Prints one line of JSON per case.
//!
//!     cargo run --release -p pgsag-gpu --example steps -- --help
//!
//! The scene is that of `cargo x bench`, so that processor and card compare; `pgsag-splat`'s example `iteration` writes it
//! for other programs (`--export-scene`).

#![expect(clippy::print_stdout, reason = "an example speaks to its terminal")]

#[path = "../../pgsag-splat/examples/iteration/scene.rs"]
#[expect(dead_code, reason = "trained clouds are not measured here")]
mod scene;

use std::time::Instant;

use pgsag_gpu::{Backward, DeviceChoice, Gpu, GpuCloud, GpuOptions, GpuView};
use pgsag_splat::backend::{
    Backend, Exposure, Limits, LossWeights, OptimizerState, Rates, RenderOptions, Sample, TrainingView,
};
use serde_json::json;

use scene::{Scene, ellipse, synthetic_cloud};

/// What went wrong, in words.
pub(crate) type Failure = Box<dyn std::error::Error>;

const USAGE: &str = "\
steps [OPTIONS]
  --gaussians LIST   default 300000,1000000,3000000
  --size WxH         default 1600x1200
  --masks LIST       shares of the pixels that take part, default 1,0.15
  --backward WAY     fastest, pixels or gaussians; default all three
  --rounds N         steps that are timed, after 30 that are not (default 50)
  --device N         position in `pgsag doctor`; default the best real card";

/// Steps before the clock runs: kernels are compiled, room is found, the ways back are raced.
const WARM: u32 = 30;
/// Steps of a profile: as many launches as have timestamps.
const PROFILED: u32 = 8;

struct Bench<'a> {
    gpu: &'a Gpu,
    scene: &'a Scene,
    cloud: GpuCloud,
    views: [GpuView; 2],
    step: u32,
}

impl<'a> Bench<'a> {
    fn new(gpu: &'a Gpu, scene: &'a Scene, share: f64) -> Result<Self, Failure> {
        let view = |k: usize| {
            let (camera, image) = (scene.cameras[k], scene.photographs[k].clone());
            let mask = (share < 1.0).then(|| ellipse(image.width, image.height, share));
            gpu.prepare(&TrainingView { camera, image, mask, inner_edges: None })
        };
        let views = [view(0)?, view(1)?];
        Ok(Self { gpu, scene, cloud: gpu.upload(&OptimizerState::fresh(scene.cloud.clone()))?, views, step: 0 })
    }

    /// One step of the published losses, two views, at preset `standard`'s 25 600 patches.
    fn run(&mut self) -> Result<(), Failure> {
        self.step += 1;
        let Self { gpu, scene, cloud, views, step } = self;
        let whole =
            RenderOptions { sh_degree: 3, planes: true, gradient: true, statistics: true, ..Default::default() };
        let beside = RenderOptions { planes: true, without_color: true, gradient: true, ..Default::default() };
        let mut render = gpu.render(cloud, &scene.cameras[0], Some(&views[0]), &whole)?;
        let mut second = gpu.render(cloud, &scene.cameras[1], Some(&views[1]), &beside)?;
        let weights = LossWeights { ncc_patches: 25_600, ..LossWeights::default() };
        let mut sample = Sample {
            view: &views[0],
            render: &mut render,
            neighbor: Some((&views[1], &mut second)),
            exposure: Exposure::NEUTRAL,
            weights: &weights,
            scene_scale: scene.scale,
            seed: u64::from(*step),
        };
        gpu.losses(cloud, &mut sample)?;
        gpu.backward(cloud, &sample)?;
        // So small that the scene stays what it is.
        let rate = 1e-9;
        let rates = Rates {
            means: rate,
            scales: rate,
            rotations: rate,
            opacity: rate,
            color: rate,
            harmonics: rate,
            sparse: false,
        };
        Ok(gpu.adam(cloud, &rates, *step)?)
    }

    /// Gaussians blended per pixel that is drawn.
    fn per_pixel(&self, share: f64) -> Result<f64, Failure> {
        let options = RenderOptions { load: true, ..RenderOptions::default() };
        let render = self.gpu.render(&self.cloud, &self.scene.cameras[0], Some(&self.views[0]), &options)?;
        let load = self.gpu.read(&render)?.load.values;
        Ok(load.iter().map(|&value| f64::from(value)).sum::<f64>() / (load.len() as f64 * share))
    }

    /// Milliseconds of each of so many steps, sorted.
    fn time(&mut self, rounds: u32) -> Result<Vec<f64>, Failure> {
        for _ in 0..WARM {
            self.run()?;
        }
        let mut spent = Vec::new();
        for _ in 0..rounds {
            self.gpu.wait()?;
            let started = Instant::now();
            self.run()?;
            self.gpu.wait()?;
            spent.push(started.elapsed().as_secs_f64() * 1e3);
        }
        spent.sort_by(f64::total_cmp);
        Ok(spent)
    }

    /// Launches and milliseconds per step, by kernel.
    fn kernels(&mut self) -> Result<serde_json::Value, Failure> {
        self.gpu.begin_profile()?;
        for _ in 0..PROFILED {
            self.run()?;
        }
        let share = |value: f64| value / f64::from(PROFILED);
        let row = |time: &pgsag_gpu::KernelTime| {
            let (launches, ms) = (share(f64::from(time.launches)), share(time.milliseconds));
            json!({ "kernel": time.name, "launches": launches, "ms": ms })
        };
        Ok(self.gpu.end_profile()?.iter().map(row).collect())
    }
}

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.iter().any(|word| word == "--help") {
        println!("{USAGE}");
        return Ok(());
    }
    let value = |name: &str, default: &str| {
        let at = arguments.iter().position(|word| word == name);
        at.and_then(|at| arguments.get(at + 1)).map_or(default.to_owned(), Clone::clone)
    };
    let device = match value("--device", "").as_str() {
        "" => DeviceChoice::Best,
        index => DeviceChoice::Index(index.parse()?),
    };
    let gpu = Gpu::new(&GpuOptions { device, ..GpuOptions::default() })?;
    let ways: Vec<Backward> = match value("--backward", "all").as_str() {
        "fastest" => vec![Backward::Fastest],
        "pixels" => vec![Backward::Pixels],
        "gaussians" => vec![Backward::Gaussians],
        _ => vec![Backward::Fastest, Backward::Pixels, Backward::Gaussians],
    };
    let size = value("--size", "1600x1200");
    let (width, height) = size.split_once('x').ok_or("--size is WIDTHxHEIGHT")?;
    let (width, height): (u32, u32) = (width.parse()?, height.parse()?);
    let rounds: u32 = value("--rounds", "50").parse()?;
    for count in value("--gaussians", "300000,1000000,3000000").split(',') {
        let scene = Scene::synthetic(synthetic_cloud(count.parse()?)?, (width, height));
        for share in value("--masks", "1,0.15").split(',') {
            let share: f64 = share.parse()?;
            for &way in &ways {
                let gpu = gpu.with(Limits::default(), way)?;
                let mut bench = Bench::new(&gpu, &scene, share)?;
                let spent = bench.time(rounds)?;
                let memory_mib = gpu.memory().1 >> 20;
                let line = json!({
                    "card": gpu.adapter().name, "driver": gpu.adapter().driver, "gaussians": scene.cloud.len(),
                    "width": width, "height": height, "mask": share, "backward": format!("{way:?}").to_lowercase(),
                    "per_pixel": bench.per_pixel(share)?, "min_ms": spent.first(), "median_ms": spent.get(spent.len() / 2),
                    "most_memory_mib": memory_mib, "kernels": bench.kernels()?,
                });
                println!("{line}");
            }
        }
    }
    Ok(())
}
