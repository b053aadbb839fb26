//! A run goes from processor to card and back by its checkpoint, as if nothing had happened.

use std::sync::Arc;

use pgsag_scene::synthetic::{Photograph, Town, TownOptions};
use pgsag_splat::Backend;
use pgsag_splat::backend::{TrainingView, ViewCamera};
use pgsag_splat::cpu::{Cpu, CpuOptions};
use pgsag_splat::train::{
    Checkpoint, DepthOptions, InitialPoint, InitialiseOptions, Neighbor, NeighborOptions, TrainOptions, Trainer,
    ViewSource, initialise, neighbors_of, render_depth, valid_depth,
};

use crate::gpu;

/// Steps of the run, and where it is cut.
const STEPS: u32 = 16;
const CUT: u32 = 8;
/// How far the losses of two devices may drift apart in so many steps, as a share.
const DRIFT: f32 = 2e-3;

struct TinyTown {
    town: Town,
    photographs: Vec<Photograph>,
}

impl TinyTown {
    fn new(options: &TownOptions) -> Self {
        let town = Town::generate(options);
        let photographs = (0..town.scene.views.len()).map(|view| town.photograph(view)).collect();
        Self { town, photographs }
    }

    fn neighbors(&self) -> Vec<Vec<Neighbor>> {
        let all: Vec<u32> = (0..self.photographs.len() as u32).collect();
        neighbors_of(&self.town.scene, &all, &NeighborOptions::default())
    }

    fn beginning(&self, options: TrainOptions) -> Checkpoint {
        let points = self.town.scene.points.iter();
        let points: Vec<InitialPoint> = points
            .map(|p| InitialPoint { position_world: p.position_world.to_array(), color: p.color, normal: None })
            .collect();
        let cloud = initialise(&points, [0.0; 3], &InitialiseOptions::default()).expect("points");
        let cpu = Cpu::new(CpuOptions::default()).expect("some instructions");
        let trainer = Trainer::new(&cpu, self, self.neighbors(), cloud, options, 5).expect("a trainable town");
        trainer.checkpoint().expect("memory")
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

/// All terms from the first step on, multiplication between cut and end.
fn options() -> TrainOptions {
    let mut options = TrainOptions { iterations: STEPS, geometric_start: 0.0, ..TrainOptions::fast() };
    options.density.from = 0.0;
    options.density.until = 1.0;
    options.density.interval = 12;
    options
}

/// Goes on from a checkpoint until so many steps are done: the losses of the steps, and the next checkpoint.
fn go_on<B: Backend>(backend: &B, town: &TinyTown, from: &Checkpoint, until: u32) -> (Vec<f32>, Checkpoint) {
    // Through its bytes, as from a disk.
    let from = Checkpoint::from_bytes(&from.to_bytes()).expect("own bytes");
    let mut trainer = Trainer::resume(backend, town, town.neighbors(), options(), &from).expect("the same options");
    let mut losses = Vec::new();
    while trainer.iteration() < until {
        losses.push(trainer.step().expect("a step").values.total);
    }
    (losses, trainer.checkpoint().expect("memory"))
}

#[test]
fn a_run_goes_on_with_the_other_device() {
    let Some(gpu) = gpu() else { return };
    let cpu = Cpu::new(CpuOptions::default()).expect("some instructions");
    let town = TinyTown::new(&TownOptions {
        house_count: 2,
        view_count: 6,
        width: 64,
        height: 48,
        gsd_m: 0.4,
        point_count: 400,
        ..TownOptions::default()
    });
    let beginning = town.beginning(options());
    let (first, cut) = go_on(&cpu, &town, &beginning, CUT);
    let (second, end) = go_on(&cpu, &town, &cut, STEPS);
    let there = go_on(gpu, &town, &cut, STEPS);
    let (own, cut_on_card) = go_on(gpu, &town, &beginning, CUT);
    let back = go_on(&cpu, &town, &cut_on_card, STEPS);
    for (what, expected, found) in
        [("to the card", &second, &there.0), ("on the card", &first, &own), ("back", &second, &back.0)]
    {
        let drift = expected.iter().zip(found).map(|(a, b)| ((a - b) / a).abs()).fold(0.0, f32::max);
        eprintln!("{what}: losses are at most {drift:.1e} apart");
        assert!(drift < DRIFT, "{what}: {drift:.1e} apart\n{expected:?}\n{found:?}");
    }
    assert_eq!((there.1.iteration(), back.1.iteration()), (end.iteration(), end.iteration()));
}

/// Share of the rendered depths that are right, of the true depths that are found, and their harmonic mean.
fn score<B: Backend>(backend: &B, town: &TinyTown, cloud: &B::Cloud, sh_degree: u8) -> [f64; 3] {
    let (mut right, mut rendered, mut all) = (0.0, 0.0, 0.0);
    for (index, photograph) in town.photographs.iter().enumerate() {
        let camera = town.camera(index);
        let maps = render_depth(backend, cloud, &camera, None, sh_degree).expect("a render");
        let depth = valid_depth(&maps, &camera, None, &DepthOptions::default()).depth;
        for (found, truth) in depth.values.iter().zip(&photograph.depth.values) {
            rendered += f64::from(u8::from(*found > 0.0));
            all += f64::from(u8::from(*truth > 0.0));
            right += f64::from(u8::from(*found > 0.0 && *truth > 0.0 && (found - truth).abs() < THRESHOLD_M));
        }
    }
    let (precision, recall) = (right / f64::max(rendered, 1.0), right / f64::max(all, 1.0));
    [precision, recall, 2.0 * precision * recall / f64::max(precision + recall, f64::MIN_POSITIVE)]
}

/// Depths nearer than this to the truth are right: one and a half ground sampling distances of the town below.
const THRESHOLD_M: f32 = 0.45;

fn trained<B: Backend>(backend: &B, town: &TinyTown, from: &Checkpoint, options: TrainOptions) -> [f64; 3] {
    let mut trainer = Trainer::resume(backend, town, town.neighbors(), options, from).expect("the same options");
    while !trainer.is_done() {
        trainer.step().expect("a step");
    }
    score(backend, town, trainer.cloud(), trainer.sh_degree())
}

#[test]
#[ignore = "minutes on a software adapter"]
fn a_town_trained_on_the_card_is_as_good() {
    let Some(gpu) = gpu() else { return };
    let cpu = Cpu::new(CpuOptions::default()).expect("some instructions");
    let town = TinyTown::new(&TownOptions {
        house_count: 3,
        view_count: 9,
        width: 96,
        height: 72,
        gsd_m: 0.3,
        point_count: 1200,
        ..TownOptions::default()
    });
    let mut options = TrainOptions { iterations: 300, ..TrainOptions::fast() };
    options.density.trim_interval = 100;
    let beginning = town.beginning(options.clone());
    let on_cpu = trained(&cpu, &town, &beginning, options.clone());
    let on_card = trained(gpu, &town, &beginning, options);
    eprintln!(
        "precision, recall, F1 of depths within {THRESHOLD_M} m: processor {on_cpu:.3?}, {} {on_card:.3?}",
        gpu.adapter().name
    );
    assert!((on_cpu[2] - on_card[2]).abs() < 0.02);
}
