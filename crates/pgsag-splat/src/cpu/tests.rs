//! The backend against a naive loop in f64, and its promises: levels, threads and masks change nothing that counts.

use pgsag_scene::{Image, Mask, Pinhole, numbers::SplitMix64};

use super::*;
use crate::backend::{Exposure, LossWeights};
use crate::equations::{activation, algebra, covariance, harmonics, plane, projection};
use crate::losses::MapGradients;

const WIDTH: u32 = 45;
const HEIGHT: u32 = 37;

fn camera() -> ViewCamera {
    let (s, c) = (libm::sin(0.3), libm::cos(0.3));
    ViewCamera {
        pinhole: Pinhole { width: WIDTH, height: HEIGHT, fx: 50.0, fy: 52.0, cx: 21.0, cy: 19.5 },
        rotation: [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]],
        translation: [0.1, -0.2, 4.0],
        near: 0.1,
    }
}

fn cloud(count: usize, size: f64, seed: u64) -> SplatCloud {
    let mut stream = SplitMix64::new(seed);
    let mut draw = |low: f64, high: f64| stream.range(low, high) as f32;
    let log_size = libm::log(size);
    let mut cloud = SplatCloud { sh_degree: 2, ..SplatCloud::default() };
    for _ in 0..count {
        cloud.means.push([draw(-2.5, 2.5), draw(-1.6, 1.6), draw(-2.0, 2.0)]);
        cloud.log_scales.push(std::array::from_fn(|_| draw(log_size - 1.0, log_size + 0.5)));
        cloud.rotations.push(std::array::from_fn(|_| draw(-1.0, 1.0)));
        cloud.opacity_logits.push(draw(-2.0, 2.5));
        cloud.harmonics.extend((0..27).map(|k| if k < 3 { draw(-1.0, 2.0) } else { draw(-0.2, 0.2) }));
    }
    cloud
}

fn state(cloud: SplatCloud) -> OptimizerState {
    OptimizerState { cloud, ..OptimizerState::default() }
}

/// Parameters of one Gaussian in f64: mean, log scales, quaternion, logit, harmonics.
fn parameters(cloud: &SplatCloud) -> Vec<Vec<f64>> {
    let harmonics = 3 * cloud.basis_count();
    let one = |i: usize| {
        let geometry = cloud.means[i].iter().chain(&cloud.log_scales[i]).chain(&cloud.rotations[i]);
        let rest = cloud.opacity_logits[i..=i].iter().chain(&cloud.harmonics[i * harmonics..(i + 1) * harmonics]);
        geometry.chain(rest).map(|&value| f64::from(value)).collect()
    };
    (0..cloud.len()).map(one).collect()
}

/// Seven features, the depth and what alpha needs, of one Gaussian.
struct Splat {
    features: [f64; 8],
    depth: f64,
    center: [f64; 2],
    conic: [f64; 3],
    opacity: f64,
}

fn splat(lens: &Lens<f64>, p: &[f64]) -> Splat {
    let mean = [p[0], p[1], p[2]];
    let scales = activation::scales([p[3], p[4], p[5]]);
    let rotation = covariance::rotation(activation::unit_quaternion([p[6], p[7], p[8], p[9]]).0);
    let point = projection::to_camera(lens, mean);
    let sigma = covariance::covariance(&rotation, scales);
    let axis = plane::normal_axis(&rotation, scales, algebra::sub(lens.eye, mean));
    let normal = algebra::mat_vec(&lens.rotation, plane::normal(&rotation, axis));
    let held: Vec<[f64; 3]> = p[11..].chunks(3).map(|rgb| [rgb[0], rgb[1], rgb[2]]).collect();
    let [r, g, b] = harmonics::color(&held, harmonics::direction(mean, lens.eye).0, 2);
    Splat {
        features: [r, g, b, normal[0], normal[1], normal[2], plane::distance(normal, point), 1.0],
        depth: point[2],
        center: projection::screen(lens, point),
        conic: projection::conic(projection::screen_covariance(lens, point, &sigma)),
        opacity: activation::opacity(p[10]),
    }
}

/// Colour, normal, distance and opacity of every pixel, Gaussian by Gaussian.
fn naive(parameters: &[Vec<f64>], limits: Limits) -> Vec<[f64; 8]> {
    let lens = Lens::<f64>::new(&camera());
    let mut splats: Vec<Splat> = parameters.iter().map(|p| splat(&lens, p)).filter(|s| s.depth > 0.1).collect();
    splats.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    let pixel = |i: usize| {
        let (x, y) = (f64::from(i as u32 % WIDTH) + 0.5, f64::from(i as u32 / WIDTH) + 0.5);
        let (mut out, mut light) = ([0.0; 8], 1.0);
        for s in &splats {
            let (dx, dy) = (x - s.center[0], y - s.center[1]);
            let power = -0.5 * (s.conic[0] * dx * dx + s.conic[2] * dy * dy) - s.conic[1] * dx * dy;
            let alpha = (s.opacity * libm::exp(power)).min(0.99);
            if alpha < f64::from(limits.alpha_cut) {
                continue;
            }
            if light * (1.0 - alpha) < f64::from(limits.transmittance_stop) {
                break;
            }
            for (sum, feature) in out.iter_mut().zip(s.features) {
                *sum += alpha * light * feature;
            }
            light *= 1.0 - alpha;
        }
        out
    };
    (0..(WIDTH * HEIGHT) as usize).map(pixel).collect()
}

const ALL: RenderOptions = RenderOptions {
    sh_degree: 2,
    planes: true,
    load: true,
    gradient: true,
    statistics: true,
    observe: true,
    without_color: false,
    free_pixels: false,
};

fn channels(maps: &PlaneMaps) -> Vec<[f32; 8]> {
    let pixel = |i: usize| {
        let ([r, g, b], [x, y, z]) = (maps.color.values[i], maps.normal.values[i]);
        [r, g, b, x, y, z, maps.distance.values[i], maps.opacity.values[i]]
    };
    (0..maps.color.values.len()).map(pixel).collect()
}

fn levels() -> Vec<Cpu> {
    levels_with(Limits::default())
}

fn levels_with(limits: Limits) -> Vec<Cpu> {
    let cpu = |simd| Cpu::new(CpuOptions { simd, limits }).expect("an available level");
    SimdLevel::available().into_iter().map(cpu).collect()
}

#[test]
fn maps_are_those_of_the_naive_loop() {
    for (count, size, seed) in [(60, 0.3, 1), (2000, 0.12, 2)] {
        let cloud = cloud(count, size, seed);
        let expected = naive(&parameters(&cloud), Limits::default());
        for cpu in levels() {
            let device = cpu.upload(&state(cloud.clone())).unwrap();
            let render = cpu.render(&device, &camera(), None, &ALL).unwrap();
            let got = channels(&cpu.read(&render).unwrap());
            // A pixel on the edge of the alpha cut may fall on either side: count those.
            let far = |(a, b): (&[f32; 8], &[f64; 8])| {
                (0..8).any(|k| (f64::from(a[k]) - b[k]).abs() > 2e-4 * b[k].abs().max(1.0))
            };
            let outliers = got.iter().zip(&expected).filter(|&(a, b)| far((a, b))).count();
            assert!(outliers <= 3, "{outliers} of {} pixels differ with {cpu:?}", got.len());
        }
    }
}

#[test]
fn planes_without_colors_are_those_with_colors() {
    let cloud = cloud(2000, 0.12, 2);
    let whole = RenderOptions { planes: true, gradient: true, ..RenderOptions::default() };
    for cpu in levels() {
        let device = cpu.upload(&state(cloud.clone())).unwrap();
        let draw = |options| cpu.read(&cpu.render(&device, &camera(), None, &options).unwrap()).unwrap();
        let (expected, got) = (draw(whole), draw(RenderOptions { without_color: true, ..whole }));
        assert!(got.color.values.is_empty() && !expected.color.values.is_empty());
        assert_eq!(PlaneMaps { color: expected.color.clone(), ..got }, expected);
    }
}

#[test]
fn gradients_are_those_of_differences() {
    let limits = Limits { alpha_cut: 1e-9, transmittance_stop: 1e-9 };
    let cloud = cloud(25, 0.35, 3);
    let mut stream = SplitMix64::new(4);
    let upstream: Vec<[f64; 8]> =
        (0..WIDTH * HEIGHT).map(|_| std::array::from_fn(|_| stream.range(-1.0, 1.0))).collect();
    let loss = |parameters: &[Vec<f64>]| -> f64 {
        naive(parameters, limits).iter().zip(&upstream).map(|(a, b)| (0..8).map(|k| a[k] * b[k]).sum::<f64>()).sum()
    };
    let one = |at: usize| upstream.iter().map(|g| g[at] as f32).collect();
    let gradients = MapGradients {
        color: [one(0), one(1), one(2)],
        normal: [one(3), one(4), one(5)],
        distance: one(6),
        opacity: one(7),
        load: Vec::new(),
    };
    let base = parameters(&cloud);
    let mut expected = base.clone();
    for i in 0..base.len() {
        for k in 0..base[i].len() {
            let at = |step: f64| {
                let mut moved = base.clone();
                moved[i][k] += step;
                loss(&moved)
            };
            expected[i][k] = (at(1e-5) - at(-1e-5)) / 2e-5;
        }
    }
    for cpu in levels_with(limits) {
        let mut device = cpu.upload(&state(cloud.clone())).unwrap();
        let mut render = cpu.render(&device, &camera(), None, &RenderOptions { load: false, ..ALL }).unwrap();
        render.take_gradients(&mut gradients.clone());
        cpu.back(&mut device, &render, 1, false);
        let got = parameters(&cpu.gradients(&device).unwrap());
        for kind in [0..3, 3..6, 6..10, 10..11, 11..38] {
            let norm =
                expected.iter().flat_map(|row| &row[kind.clone()]).map(|value| value * value).sum::<f64>().sqrt();
            let difference = |(a, b): (&Vec<f64>, &Vec<f64>)| kind.clone().map(|k| (a[k] - b[k]).powi(2)).sum::<f64>();
            let error = got.iter().zip(&expected).map(difference).sum::<f64>().sqrt() / norm;
            assert!(error < 1e-3, "parameters {kind:?}: relative error {error} with {cpu:?}");
        }
    }
}

fn view_of(mask: Option<Mask>) -> TrainingView {
    let mut image = Image::filled(WIDTH, HEIGHT, [90, 110, 70]);
    for (i, pixel) in image.pixels.iter_mut().enumerate() {
        pixel[0] = (i * 7 % 180) as u8;
    }
    TrainingView { camera: camera(), image, mask, inner_edges: None }
}

const WEIGHTS: LossWeights = LossWeights {
    l1: 0.8,
    dssim: 0.2,
    flatness: 1.0,
    normal: 0.015,
    normal_boundary: 0.1,
    normal_image_gradient: true,
    geometric: 0.0,
    geometric_gate_px: 1.0,
    ncc: 0.0,
    ncc_patches: 0,
    load: 0.0,
    free_opacity: 0.0,
    reading: crate::backend::Reading::Code,
    mean_over_mask: true,
};

const RATES: Rates =
    Rates { means: 1e-3, scales: 5e-3, rotations: 1e-3, opacity: 0.02, color: 2e-3, harmonics: 1e-4, sparse: false };

fn train(cpu: &Cpu, cloud: SplatCloud, view: &TrainingView, steps: u32) -> OptimizerState {
    learn(cpu, &state(cloud), view, steps, &RATES)
}

fn learn(cpu: &Cpu, state: &OptimizerState, view: &TrainingView, steps: u32, rates: &Rates) -> OptimizerState {
    let mut device = cpu.upload(state).unwrap();
    let view = cpu.prepare(view).unwrap();
    for step in 1..=steps {
        let mut render = cpu.render(&device, &camera(), Some(&view), &RenderOptions { load: false, ..ALL }).unwrap();
        let mut sample = Sample {
            view: &view,
            render: &mut render,
            neighbor: None,
            exposure: Exposure::NEUTRAL,
            weights: &WEIGHTS,
            scene_scale: 4.0,
            seed: 1,
        };
        cpu.losses(&device, &mut sample).unwrap();
        cpu.backward(&mut device, &sample).unwrap();
        cpu.adam(&mut device, rates, step).unwrap();
    }
    cpu.download(&device).unwrap()
}

#[test]
fn conformance_at_every_level() {
    for simd in SimdLevel::available() {
        let report =
            crate::conformance::check(|limits| Cpu::new(CpuOptions { simd, limits }).expect("an available level"));
        assert!(report.passed(), "{simd:?}: {report:?}");
    }
}

#[test]
fn threads_change_no_bit() {
    for cpu in levels() {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| train(&cpu, cloud(20_000, 0.03, 5), &view_of(None), 3))
        };
        assert!(run(1) == run(3), "{cpu:?}");
    }
    let cpu = Cpu::new(CpuOptions::default()).unwrap();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| train(&cpu, cloud(300, 0.15, 6), &view_of(None), 20))
    };
    assert!(run(1) == run(2));
}

#[test]
fn a_sparse_step_leaves_the_unseen_alone_and_steps_the_seen_as_any() {
    let mut mask = Mask::filled(WIDTH, HEIGHT, PixelClass::Occluded);
    mask.classes.chunks_mut(WIDTH as usize).for_each(|row| row[..12].fill(PixelClass::Inside));
    let rows = |state: &OptimizerState| -> Vec<[Vec<f64>; 3]> {
        let [cloud, first, second] = [&state.cloud, &state.first, &state.second].map(parameters);
        cloud.into_iter().zip(first).zip(second).map(|((a, b), c)| [a, b, c]).collect()
    };
    for cpu in levels() {
        let before = train(&cpu, cloud(300, 0.1, 8), &view_of(None), 1);
        let after = |sparse| rows(&learn(&cpu, &before, &view_of(Some(mask.clone())), 1, &Rates { sparse, ..RATES }));
        let (sparse, dense, before) = (after(true), after(false), rows(&before));
        let (mut left, mut stepped, mut carried) = (0, 0, 0);
        for i in 0..before.len() {
            assert!(sparse[i] == before[i] || sparse[i] == dense[i], "Gaussian {i} with {cpu:?}");
            left += u32::from(sparse[i] == before[i]);
            stepped += u32::from(sparse[i] != before[i]);
            carried += u32::from(sparse[i] == before[i] && dense[i] != before[i]);
        }
        assert!(left > 50 && stepped > 30 && carried > 50, "{left}, {stepped}, {carried} with {cpu:?}");
    }
}

#[test]
fn levels_agree() {
    let limits = Limits { alpha_cut: 1e-6, ..Limits::default() };
    let run = |cpu: &Cpu| {
        let device = cpu.upload(&state(cloud(400, 0.2, 7))).unwrap();
        let render = cpu.render(&device, &camera(), None, &ALL).unwrap();
        // The first moments after one step are a tenth of the gradients.
        let moments = train(cpu, cloud(400, 0.2, 7), &view_of(None), 1).first;
        (channels(&cpu.read(&render).unwrap()), parameters(&moments))
    };
    let cpus = levels_with(limits);
    let first = run(&cpus[0]);
    for cpu in &cpus[1..] {
        let other = run(cpu);
        let maps = other.0.as_flattened().iter().zip(first.0.as_flattened());
        let worst = maps.map(|(a, b)| (a - b).abs() / b.abs().max(1.0)).fold(0.0, f32::max);
        assert!(worst < 1e-4, "maps of {cpu:?} differ by {worst}");
        let gradients = || other.1.iter().flatten().zip(first.1.iter().flatten());
        let difference: f64 = gradients().map(|(a, b)| (a - b).powi(2)).sum();
        let norm: f64 = gradients().map(|(_, b)| b * b).sum();
        assert!(difference.sqrt() < 1e-4 * norm.sqrt(), "gradients of {cpu:?}: {difference} of {norm}");
    }
}

#[test]
fn a_mask_changes_nothing_inside() {
    let mut mask = Mask::filled(WIDTH, HEIGHT, PixelClass::Free);
    for y in 5..20 {
        for x in 18..36 {
            mask.classes[(y * WIDTH + x) as usize] = if y < 8 { PixelClass::Boundary } else { PixelClass::Inside };
        }
    }
    mask.classes[0] = PixelClass::Occluded;
    for cpu in levels() {
        let device = cpu.upload(&state(cloud(800, 0.12, 8))).unwrap();
        let view = cpu.prepare(&view_of(Some(mask.clone()))).unwrap();
        let maps = |view: Option<&CpuView>, free_pixels| {
            let render = cpu.render(&device, &camera(), view, &RenderOptions { free_pixels, ..ALL }).unwrap();
            channels(&cpu.read(&render).unwrap())
        };
        let (whole, masked, free) = (maps(None, false), maps(Some(&view), false), maps(Some(&view), true));
        for (i, class) in mask.classes.iter().enumerate() {
            assert!(if class.is_active() { masked[i] == whole[i] } else { masked[i] == [0.0; 8] });
            assert!(if i == 0 { free[i] == [0.0; 8] } else { free[i] == whole[i] });
        }
    }
}

#[test]
fn a_level_that_is_missing_is_named() {
    let missing = if cfg!(target_arch = "aarch64") { SimdLevel::Avx512 } else { SimdLevel::Neon };
    let error = Cpu::new(CpuOptions { simd: missing, ..CpuOptions::default() }).unwrap_err();
    assert!(error.to_string().contains("Scalar"), "{error}");
}
