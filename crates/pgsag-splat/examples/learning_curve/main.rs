//! Trains the synthetic town and prints how image quality and depth converge: the instrument by which schedules are
//! tuned. `cargo run --release -p pgsag-splat --example learning_curve -- --help`

#![expect(clippy::print_stdout, reason = "an example speaks to its terminal")]

mod scene;

use std::ops::ControlFlow;

use pgsag_scene::numbers::median;
use pgsag_splat::backend::{Backend, OptimizerState};
use pgsag_splat::cpu::{Cpu, CpuOptions};
use pgsag_splat::train::{
    DepthOptions, InitialiseOptions, NeighborOptions, TrainOptions, Trainer, evaluate_view, initialise, neighbors_of,
    render_depth, valid_depth,
};

use scene::{Arguments, TownViews};

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let Some(arguments) = Arguments::read()? else { return Ok(()) };
    let all = TownViews::new(&arguments);
    let (train, held_out) = all.split(8);
    let points = if arguments.stereo { all.stereo_points(&train.indices) } else { all.sparse_points() };
    let cloud = initialise(&points, all.origin(), &InitialiseOptions::default())?;
    let neighbors = neighbors_of(&all.town.scene, &train.indices, &NeighborOptions::default());
    println!(
        "{} views, {} held out, {} points, {} Gaussians, {:.1} neighbours per view, {:.1} s",
        train.indices.len(),
        held_out.indices.len(),
        points.len(),
        cloud.len(),
        neighbors.iter().map(Vec::len).sum::<usize>() as f64 / neighbors.len() as f64,
        cpu_seconds(),
    );
    println!("{HEADER}");
    let backend = Cpu::new(CpuOptions::default())?;
    let options = arguments.options.clone();
    report(&backend, &backend.upload(&OptimizerState::fresh(cloud.clone()))?, &held_out, 0, 0, cloud.len(), None)?;
    let mut trainer = Trainer::new(&backend, &train, neighbors, cloud, options.clone(), 1)?;
    let started = cpu_seconds();
    let mut gaussians = 0;
    while !trainer.is_done() {
        let until = trainer.iteration() + arguments.every;
        let mut sums = Sums::default();
        trainer.run(until, &mut |progress| {
            gaussians = progress.gaussians;
            sums.add(&progress.values);
            ControlFlow::Continue(())
        })?;
        let spent = (cpu_seconds() - started, sums);
        report(&backend, trainer.cloud(), &held_out, trainer.iteration(), trainer.sh_degree(), gaussians, Some(spent))?;
    }
    let _: &TrainOptions = &options;
    Ok(())
}

const HEADER: &str = "iteration  cpu s  gaussians   psnr   ssim | depth error, gsd: median    68%    90%  signed  <2gsd  valid | l1 dssim flat normal geo valid ncc";

/// Sums of the loss terms over the steps of one line.
#[derive(Default)]
struct Sums {
    terms: [f64; 7],
    counts: [f64; 7],
}

impl Sums {
    fn add(&mut self, values: &pgsag_splat::backend::LossValues) {
        let terms = [
            values.l1,
            values.dssim,
            values.flatness,
            values.normal,
            values.geometric,
            values.geometric_valid,
            values.ncc,
        ];
        for (k, term) in terms.into_iter().enumerate() {
            if term != 0.0 {
                self.terms[k] += f64::from(term);
                self.counts[k] += 1.0;
            }
        }
    }

    fn means(&self) -> String {
        (0..7).map(|k| format!("{:.5} ", self.terms[k] / self.counts[k].max(1.0))).collect()
    }
}

/// One line of the table: held-out views only.
fn report<B: Backend>(
    backend: &B,
    cloud: &B::Cloud,
    views: &TownViews,
    iteration: u32,
    sh_degree: u8,
    gaussians: usize,
    spent: Option<(f64, Sums)>,
) -> Result<(), Failure> {
    let (mut psnr, mut ssim) = (0.0, 0.0);
    let mut signed = Vec::new();
    let (mut valid, mut true_pixels) = (0.0, 0.0);
    for position in 0..views.indices.len() {
        let view = views.training_view(position);
        let metrics = evaluate_view(backend, cloud, &view, sh_degree, true)?;
        psnr += metrics.psnr;
        ssim += metrics.ssim;
        let maps = render_depth(backend, cloud, &view.camera, None, 0)?;
        let depth = valid_depth(&maps, &view.camera, None, &DepthOptions::default()).depth;
        for (found, truth) in depth.values.iter().zip(&views.photograph(position).depth.values) {
            true_pixels += f64::from(u8::from(*truth > 0.0));
            if *found > 0.0 && *truth > 0.0 {
                valid += 1.0;
                signed.push(f64::from((found - truth) / truth) * view.camera.pinhole.focal_px());
            }
        }
    }
    let count = views.indices.len() as f64;
    let mut errors: Vec<f64> = signed.iter().map(|e| e.abs()).collect();
    let at = |errors: &mut Vec<f64>, q| pgsag_scene::numbers::quantile(errors, q).unwrap_or(f64::NAN);
    let near = errors.iter().filter(|e| **e < 2.0).count() as f64 / errors.len().max(1) as f64;
    let (seconds, terms) = spent.map_or((0.0, String::new()), |(seconds, sums)| (seconds, sums.means()));
    println!(
        "{iteration:9} {seconds:6.1} {gaussians:10} {:6.2} {:6.4} | {:25.3} {:6.3} {:6.2} {:7.3} {:6.3} {:6.3} | {terms}",
        psnr / count,
        ssim / count,
        at(&mut errors, 0.5),
        at(&mut errors, 0.68),
        at(&mut errors, 0.9),
        median(&mut signed).unwrap_or(f64::NAN),
        near,
        valid / true_pixels,
    );
    Ok(())
}

/// Processor time of this process, seconds; 0 where the system does not tell.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks: f64 = after_name.split_whitespace().skip(11).take(2).filter_map(|t| t.parse::<f64>().ok()).sum();
    ticks / 100.0
}
