//! CPU milliseconds of one training iteration, phase by phase, on one thread, and how they grow with Gaussians and
//! pixels, shrink with the mask, and what a neighbour costs; then wall milliseconds with one and two threads. The scene is synthetic: flat Gaussians about an undulating ground, sized so that the overlap per pixel stays
//! about the same whatever their number.
//!
//!     cargo run --release -p pgsag-splat --example iteration [level] [repeats]

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use pgsag_scene::{Image, Mask, Pinhole, PixelClass, numbers::SplitMix64};
use pgsag_splat::backend::{
    Backend, Exposure, LossWeights, OptimizerState, Rates, Reading, RenderOptions, Sample, TrainingView, ViewCamera,
};
use pgsag_splat::cloud::{SplatCloud, curve_order};
use pgsag_splat::cpu::{Cpu, CpuOptions, SimdLevel};

/// CPU time of this thread, milliseconds.
fn cpu_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(f64::NAN) * 1e-6
}

fn camera(width: u32, height: u32) -> ViewCamera {
    let focal = 0.9 * f64::from(width);
    ViewCamera {
        pinhole: Pinhole {
            width,
            height,
            fx: focal,
            fy: focal,
            cx: f64::from(width) / 2.0,
            cy: f64::from(height) / 2.0,
        },
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
        near: 0.1,
    }
}

/// `count` Gaussians over the view at about 10 units, each pixel under about 29 of them.
fn scene(count: usize) -> SplatCloud {
    let mut stream = SplitMix64::new(1);
    let (half_x, half_y) = (6.0, 4.5);
    let size = (29.0 * 4.0 * half_x * half_y / (28.0 * count as f64)).sqrt();
    let mut cloud = SplatCloud { sh_degree: 3, ..SplatCloud::default() };
    for _ in 0..count {
        let (x, y) = (stream.range(-half_x, half_x), stream.range(-half_y, half_y));
        let depth = 10.0 + 0.7 * libm::sin(x) * libm::cos(y) + 0.3 * stream.normal();
        cloud.means.push([x, y, depth].map(|value| value as f32));
        let log = |stream: &mut SplitMix64| (libm::log(size) - 0.25 + 0.5 * stream.normal()) as f32;
        cloud.log_scales.push([log(&mut stream), log(&mut stream), (libm::log(size) - 3.0) as f32]);
        cloud.rotations.push([1.0, 0.0, 0.0, 0.0].map(|w: f64| (w + 0.2 * stream.normal()) as f32));
        cloud.opacity_logits.push(stream.range(-3.0, 2.5) as f32);
        cloud.harmonics.extend((0..48).map(|k| if k < 3 { stream.normal() } else { 0.1 * stream.normal() } as f32));
    }
    // As the trainer keeps it.
    cloud.reordered(&curve_order(&cloud.means))
}

fn photograph(width: u32, height: u32) -> Image {
    let mut stream = SplitMix64::new(2);
    let mut image = Image::filled(width, height, [0; 3]);
    for (i, pixel) in image.pixels.iter_mut().enumerate() {
        let (x, y) = (i as u32 % width, i as u32 / width);
        *pixel = [x / 4 + y / 7, x / 9, y / 3].map(|value| (value % 200) as u8 + stream.below(50) as u8);
    }
    image
}

/// What an iteration has to do.
#[derive(Clone, Copy)]
struct Case {
    count: usize,
    size: (u32, u32),
    /// Eight channels and Eq. 8; else colour alone.
    planes: bool,
    /// With a neighbour, the geometric term and 25 600 patches.
    neighbor: bool,
    /// Whether a disc of 15 % of the image is all that is active.
    masked: bool,
}

const SMALL: (u32, u32) = (708, 522);
const PLAIN: Case = Case { count: 100_000, size: SMALL, planes: true, neighbor: false, masked: false };

fn weights(case: &Case) -> LossWeights {
    LossWeights {
        l1: 0.8,
        dssim: 0.2,
        flatness: 100.0,
        normal: if case.planes { 0.015 } else { 0.0 },
        normal_boundary: 0.1,
        normal_image_gradient: true,
        geometric: if case.neighbor { 0.03 } else { 0.0 },
        geometric_gate_px: 4.0,
        ncc: if case.neighbor { 0.15 } else { 0.0 },
        ncc_patches: 25_600,
        load: 0.0,
        free_opacity: 0.0,
        reading: Reading::Code,
        mean_over_mask: true,
    }
}

/// A disc in the middle, of 15 % of the image.
fn disc((width, height): (u32, u32)) -> Mask {
    let mut mask = Mask::filled(width, height, PixelClass::Occluded);
    let radius_squared = 0.15 * f64::from(width) * f64::from(height) / std::f64::consts::PI;
    for (i, class) in mask.classes.iter_mut().enumerate() {
        let x = f64::from(i as u32 % width) - 0.5 * f64::from(width);
        let y = f64::from(i as u32 / width) - 0.5 * f64::from(height);
        if x * x + y * y < radius_squared {
            *class = PixelClass::Inside;
        }
    }
    mask
}

const RATES: Rates = Rates { means: 1e-7, scales: 1e-7, rotations: 1e-7, opacity: 1e-7, color: 1e-7, harmonics: 1e-7 };

/// When the last phase ended, and what each took, CPU milliseconds.
type Spent = (f64, Vec<(&'static str, f64)>);

/// The backend, which records what every phase takes.
fn probed(simd: SimdLevel, phases: &Arc<Mutex<Spent>>) -> Cpu {
    let record = Arc::clone(phases);
    let probe = move |name| {
        if let Ok(mut phases) = record.lock() {
            let now = cpu_ms();
            let spent = now - phases.0;
            phases.1.push((name, spent));
            phases.0 = now;
        }
    };
    let cpu = Cpu::new(CpuOptions { simd, ..CpuOptions::default() }).expect("a level that this machine has");
    cpu.with_probe(Box::new(probe))
}

/// Mean milliseconds of each phase over some iterations, in order of phases; the mean wall milliseconds of an
/// iteration; blended entries per pixel.
fn measure(simd: SimdLevel, case: &Case, repeats: u32) -> (Vec<(String, f64)>, f64, f64) {
    let phases: Arc<Mutex<Spent>> = Arc::default();
    let cpu = probed(simd, &phases);
    let state = OptimizerState { cloud: scene(case.count), ..OptimizerState::default() };
    let mut cloud = cpu.upload(&state).expect("fits");
    let (width, height) = case.size;
    let camera = camera(width, height);
    let aside = ViewCamera { translation: [0.2, 0.0, 0.0], ..camera };
    let mask = case.masked.then(|| disc(case.size));
    let view = TrainingView { camera, image: photograph(width, height), mask, inner_edges: None };
    let other = cpu.prepare(&TrainingView { camera: aside, ..view.clone() }).expect("a view");
    let view = cpu.prepare(&view).expect("a view");
    let options = RenderOptions {
        sh_degree: 3,
        planes: case.planes,
        gradient: true,
        statistics: true,
        ..RenderOptions::default()
    };
    let beside = RenderOptions { planes: true, gradient: true, ..RenderOptions::default() };
    let counted = cpu.render(&cloud, &camera, None, &RenderOptions { load: true, ..options }).expect("a render");
    let load = cpu.read(&counted).expect("maps").load.values;
    let entries = load.iter().map(|&value| f64::from(value)).sum::<f64>() / load.len() as f64;
    drop(counted);
    let weights = weights(case);
    let mut means: BTreeMap<usize, (String, f64)> = BTreeMap::new();
    let mut began = Instant::now();
    for step in 1..=repeats {
        if let Ok(mut phases) = phases.lock() {
            *phases = (cpu_ms(), Vec::new());
        }
        let mut render = cpu.render(&cloud, &camera, Some(&view), &options).expect("a render");
        let mut neighbor = case.neighbor.then(|| cpu.render(&cloud, &aside, Some(&other), &beside).expect("a render"));
        let mut sample = Sample {
            view: &view,
            render: &mut render,
            neighbor: neighbor.as_mut().map(|render| (&other, render)),
            exposure: Exposure::NEUTRAL,
            weights: &weights,
            scene_scale: 10.0,
            seed: 0,
        };
        cpu.losses(&cloud, &mut sample).expect("losses");
        cpu.backward(&mut cloud, &sample).expect("gradients");
        cpu.adam(&mut cloud, &RATES, step).expect("a step");
        // The first iteration allocates.
        if step == 1 {
            began = Instant::now();
        } else if let Ok(phases) = phases.lock() {
            for (i, &(name, ms)) in phases.1.iter().enumerate() {
                let entry = means.entry(i).or_insert((name.to_owned(), 0.0));
                entry.1 += ms / f64::from(repeats - 1);
            }
        }
    }
    let wall_ms = began.elapsed().as_secs_f64() * 1e3 / f64::from(repeats - 1);
    (means.into_values().collect(), wall_ms, entries)
}

#[expect(clippy::print_stdout, reason = "the table is what this is for")]
fn main() {
    let simd = match std::env::args().nth(1).as_deref() {
        Some("avx512") => SimdLevel::Avx512,
        Some("avx2") => SimdLevel::Avx2,
        Some("neon") => SimdLevel::Neon,
        Some("scalar") => SimdLevel::Scalar,
        _ => SimdLevel::Auto,
    };
    let repeats = std::env::args().nth(2).and_then(|text| text.parse().ok()).unwrap_or(13);
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let (one, two) = (pool(1), pool(2));
    let cases = [
        Case { count: 20_000, planes: false, ..PLAIN },
        Case { count: 20_000, ..PLAIN },
        Case { planes: false, ..PLAIN },
        PLAIN,
        Case { masked: true, ..PLAIN },
        Case { neighbor: true, ..PLAIN },
        Case { count: 300_000, ..PLAIN },
        Case { count: 400_000, ..PLAIN },
        Case { size: (1416, 1044), ..PLAIN },
    ];
    for case in cases {
        let (phases, _, entries) = one.install(|| measure(simd, &case, repeats));
        let total: f64 = phases.iter().map(|(_, ms)| ms).sum();
        let list: Vec<String> = phases.iter().map(|(name, ms)| format!("{name} {ms:.1}")).collect();
        println!(
            "{} Gaussians, {}x{}, {} channels{}{}, {entries:.1} per pixel: {total:.1} CPU ms: {}",
            case.count,
            case.size.0,
            case.size.1,
            if case.planes { 8 } else { 3 },
            if case.masked { ", 15 % mask" } else { "" },
            if case.neighbor { ", with a neighbour" } else { "" },
            list.join(", ")
        );
    }
    let walls = [&one, &two].map(|pool| pool.install(|| measure(simd, &PLAIN, repeats).1));
    println!("wall ms of {} Gaussians: {:.1} with one thread, {:.1} with two", PLAIN.count, walls[0], walls[1]);
}
