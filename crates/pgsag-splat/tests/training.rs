//! Training on the embedded backend: a tiny town is learnt, the same bytes come out however the run is cut or threaded.

use std::ops::ControlFlow;
use std::sync::Arc;

use pgsag_scene::numbers::median;
use pgsag_scene::synthetic::{Photograph, Town, TownOptions};
use pgsag_scene::{Image, Map};
use pgsag_splat::Backend;
use pgsag_splat::backend::{Exposure, LossWeights, OptimizerState, RenderOptions, Sample, TrainingView, ViewCamera};
use pgsag_splat::cpu::{Cpu, CpuOptions};
use pgsag_splat::train::density::{DensityInput, DensityOptions, plan_density};
use pgsag_splat::train::footprint::{footprints, locate};
use pgsag_splat::train::{
    Checkpoint, DepthOptions, InitialPoint, InitialiseOptions, NeighborOptions, TrainOptions, Trainer, ViewSource,
    evaluate_view, initialise, neighbors_of, render_depth, valid_depth,
};

struct TinyTown {
    town: Town,
    photographs: Vec<Photograph>,
}

impl TinyTown {
    fn new() -> Self {
        let options = TownOptions {
            house_count: 3,
            view_count: 9,
            width: 96,
            height: 72,
            gsd_m: 0.3,
            point_count: 1200,
            ..TownOptions::default()
        };
        let town = Town::generate(&options);
        let photographs = (0..town.scene.views.len()).map(|view| town.photograph(view)).collect();
        Self { town, photographs }
    }

    fn trainer<'a>(&'a self, backend: &'a Cpu) -> Trainer<'a, Cpu> {
        self.trainer_with(backend, options())
    }

    fn trainer_with<'a>(&'a self, backend: &'a Cpu, options: TrainOptions) -> Trainer<'a, Cpu> {
        let cloud = initialise(&self.points(), [0.0; 3], &InitialiseOptions::default()).expect("points");
        Trainer::new(backend, self, self.neighbors(), cloud, options, 5).expect("a trainable town")
    }

    fn points(&self) -> Vec<InitialPoint> {
        let points = self.town.scene.points.iter();
        points
            .map(|p| InitialPoint { position_world: p.position_world.to_array(), color: p.color, normal: None })
            .collect()
    }

    fn neighbors(&self) -> Vec<Vec<pgsag_splat::train::Neighbor>> {
        let all: Vec<u32> = (0..self.photographs.len() as u32).collect();
        neighbors_of(&self.town.scene, &all, &NeighborOptions::default())
    }

    /// PSNR of a view in decibels, and the median depth error there in ground sampling distances.
    fn quality(&self, backend: &Cpu, cloud: &<Cpu as Backend>::Cloud, index: usize) -> (f64, f64) {
        let view = self.view(index).expect("in memory");
        let psnr = evaluate_view(backend, cloud, &view, 0, true).expect("a render").psnr;
        let maps = render_depth(backend, cloud, &view.camera, None, 0).expect("a render");
        let depth = valid_depth(&maps, &view.camera, None, &DepthOptions::default()).depth;
        let truth: &Map<f32> = &self.photographs[index].depth;
        let pairs = depth.values.iter().zip(&truth.values).filter(|(a, b)| **a > 0.0 && **b > 0.0);
        let focal = view.camera.pinhole.focal_px();
        let mut errors: Vec<f64> = pairs.map(|(a, b)| f64::from(((a - b) / b).abs()) * focal).collect();
        (psnr, median(&mut errors).expect("some depth"))
    }
}

impl ViewSource for TinyTown {
    fn len(&self) -> usize {
        self.photographs.len()
    }

    fn camera(&self, index: usize) -> ViewCamera {
        let view = &self.town.scene.views[index];
        ViewCamera {
            pinhole: view.camera,
            rotation: view.camera_from_world.rotation_matrix().transpose().to_cols_array_2d(),
            translation: view.camera_from_world.translation.to_array(),
            near: 0.0,
        }
    }

    fn view(&self, index: usize) -> pgsag_splat::train::Result<Arc<TrainingView>> {
        let image = self.photographs[index].image.clone();
        Ok(Arc::new(TrainingView { camera: self.camera(index), image, mask: None, inner_edges: None }))
    }
}

fn options() -> TrainOptions {
    let mut options = TrainOptions { iterations: 300, ..TrainOptions::fast() };
    options.density.trim_interval = 100;
    options
}

fn on(_: &pgsag_splat::train::Progress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

#[test]
fn a_town_is_learnt() {
    let (town, backend) = (TinyTown::new(), Cpu::new(CpuOptions::default()).expect("some instructions"));
    let cloud = initialise(&town.points(), [0.0; 3], &InitialiseOptions::default()).expect("points");
    let before = backend.upload(&OptimizerState::fresh(cloud)).expect("small");
    let (psnr_before, error_before) = town.quality(&backend, &before, 4);
    let mut trainer = town.trainer(&backend);
    trainer.run(u32::MAX, &mut on).expect("finite");
    let (psnr, error) = town.quality(&backend, trainer.cloud(), 4);
    assert!(psnr > psnr_before + 4.0, "{psnr_before:.2} dB before, {psnr:.2} dB after");
    assert!(error < 2.5 && error < 0.25 * error_before, "{error_before:.3} gsd before, {error:.3} gsd after");
}

#[test]
fn cut_and_threaded_runs_give_the_same_bytes() {
    let (town, backend) = (TinyTown::new(), Cpu::new(CpuOptions::default()).expect("some instructions"));
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let straight = one.install(|| {
        let mut trainer = town.trainer(&backend);
        trainer.run(130, &mut on).expect("finite");
        trainer.checkpoint().expect("memory").to_bytes()
    });
    let three = rayon::ThreadPoolBuilder::new().num_threads(3).build().expect("threads");
    let cut = three.install(|| {
        let mut trainer = town.trainer(&backend);
        trainer.run(95, &mut on).expect("finite");
        let checkpoint = Checkpoint::from_bytes(&trainer.checkpoint().expect("memory").to_bytes()).expect("own bytes");
        let fresh = Cpu::new(CpuOptions::default()).expect("some instructions");
        let mut resumed =
            Trainer::resume(&fresh, &town, town.neighbors(), options(), &checkpoint).expect("the same options");
        resumed.run(130, &mut on).expect("finite");
        resumed.checkpoint().expect("memory").to_bytes()
    });
    assert!(straight == cut, "the bytes of a run depend on cuts or threads");
}

#[test]
fn fewer_are_born_where_views_must_agree() {
    let (town, backend) = (TinyTown::new(), Cpu::new(CpuOptions::default()).expect("some instructions"));
    let born = |agreement: f32| {
        let plain = options();
        let density = DensityOptions { from: 0.0, until: 1.0, interval: 20, agreement, ..plain.density };
        let mut trainer = town.trainer_with(&backend, TrainOptions { iterations: 60, density, ..plain });
        let mut most = 0;
        trainer
            .run(u32::MAX, &mut |progress| {
                most = progress.gaussians;
                ControlFlow::Continue(())
            })
            .expect("a step");
        most
    };
    let (all, half, whole) = (born(0.0), born(0.5), born(1.0));
    assert!(all > half && half > whole, "{all} {half} {whole}");
}

/// Parents of the births that one gathering over these views leads to.
fn multiplied(views: &[TrainingView]) -> Vec<u32> {
    let backend = Cpu::new(CpuOptions::default()).expect("some instructions");
    let opaque = InitialiseOptions { opacity: 0.7, ..InitialiseOptions::default() };
    let cloud = initialise(&TinyTown::new().points(), [0.0; 3], &opaque).expect("points");
    let mut on_device = backend.upload(&OptimizerState::fresh(cloud.clone())).expect("small");
    let weights = LossWeights { dssim: 0.0, flatness: 0.0, ..LossWeights::default() };
    let weights = LossWeights { normal: 0.0, geometric: 0.0, ncc: 0.0, ..weights };
    for view in views {
        let prepared = backend.prepare(view).expect("a view");
        let options = RenderOptions { gradient: true, statistics: true, ..RenderOptions::default() };
        let mut render = backend.render(&on_device, &view.camera, Some(&prepared), &options).expect("a render");
        let mut sample = Sample {
            view: &prepared,
            render: &mut render,
            neighbor: None,
            exposure: Exposure::NEUTRAL,
            weights: &weights,
            scene_scale: 1.0,
            seed: 0,
        };
        backend.losses(&on_device, &mut sample).expect("finite");
        backend.backward(&mut on_device, &sample).expect("finite");
    }
    let cameras: Vec<ViewCamera> = views.iter().map(|v| v.camera).collect();
    let input = DensityInput {
        cloud: &cloud,
        statistics: &backend.statistics(&mut on_device, true).expect("memory"),
        footprints: &footprints(&cloud.means, &cameras),
        cull: false,
        agreement: None,
        seed: 0,
        iteration: 0,
    };
    let options = DensityOptions {
        gradient: 5e-6,
        max_growth: 1.0,
        absolute_gradient: f32::INFINITY,
        ..DensityOptions::default()
    };
    let mut parents: Vec<u32> = plan_density(&input, &options).births.iter().map(|birth| birth.parent).collect();
    parents.dedup();
    parents
}

/// Every pixel `factor` by `factor` times.
fn enlarged(view: &TrainingView, factor: u32) -> TrainingView {
    let (width, height) = (view.image.width * factor, view.image.height * factor);
    let pixels = (0..width * height).map(|i| view.image.at(i % width / factor, i / width / factor)).collect();
    let camera = ViewCamera { pinhole: view.camera.pinhole.resized(width, height), ..view.camera };
    TrainingView { camera, image: Image { width, height, pixels }, mask: None, inner_edges: None }
}

fn differ_by_at_most_5_percent(a: &[u32], b: &[u32]) -> bool {
    let only_one = a.iter().filter(|i| !b.contains(i)).count() + b.iter().filter(|i| !a.contains(i)).count();
    a.len() > 50 && a.len().abs_diff(b.len()) * 20 <= a.len() && only_one * 10 <= a.len()
}

#[test]
fn scales_of_one_scene_multiply_alike() {
    let town = TinyTown::new();
    let views: Vec<TrainingView> = (0..9).map(|i| enlarged(&town.view(i).expect("in memory"), 2)).collect();
    let full = multiplied(&views);
    let scaled = multiplied(&views.iter().map(|v| enlarged(v, 2)).collect::<Vec<_>>());
    assert!(differ_by_at_most_5_percent(&full, &scaled), "{} and {}", full.len(), scaled.len());
}

#[test]
fn crops_of_one_scene_multiply_alike() {
    let town = TinyTown::new();
    let view = enlarged(&town.view(0).expect("in memory"), 2);
    let [x0, y0, width, height] = [32, 24, 128, 96];
    let crop = TrainingView {
        camera: ViewCamera { pinhole: view.camera.pinhole.cropped(x0, y0, width, height), ..view.camera },
        image: view.image.cropped(x0, y0, width, height),
        ..view.clone()
    };
    // Gaussians that do not reach over the border of the crop.
    let inner = ViewCamera { pinhole: view.camera.pinhole.cropped(x0 + 16, y0 + 16, 96, 64), ..view.camera };
    let cloud = initialise(&town.points(), [0.0; 3], &InitialiseOptions::default()).expect("points");
    let inside = |parents: Vec<u32>| -> Vec<u32> {
        parents.into_iter().filter(|i| locate(&inner, cloud.means[*i as usize]).is_some()).collect()
    };
    let (full, cropped) = (inside(multiplied(&[view])), inside(multiplied(&[crop])));
    assert!(differ_by_at_most_5_percent(&full, &cropped), "{} and {}", full.len(), cropped.len());
}
