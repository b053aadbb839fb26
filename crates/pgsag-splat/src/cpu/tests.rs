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

fn splat(lens: &projection::Lens<f64>, p: &[f64]) -> Splat {
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
    let lens = projection::Lens::<f64>::new(&camera());
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
fn gradients_are_those_of_differences() {
    let limits = Limits { alpha_cut: 1e-9, transmittance_stop: 1e-9 };
    let cloud = cloud(25, 0.35, 3);
    let mut stream = SplitMix64::new(4);
    let upstream: Vec<[f64; 8]> =
        (0..WIDTH * HEIGHT).map(|_| std::array::from_fn(|_| stream.range(-1.0, 1.0))).collect();
    let loss = |parameters: &[Vec<f64>]| -> f64 {
        naive(parameters, limits).iter().zip(&upstream).map(|(a, b)| (0..8).map(|k| a[k] * b[k]).sum::<f64>()).sum()
    };
    let three = |at: usize| upstream.iter().map(|g| std::array::from_fn(|k| g[at + k] as f32)).collect();
    let gradients = MapGradients {
        color: three(0),
        normal: three(3),
        distance: upstream.iter().map(|g| g[6] as f32).collect(),
        opacity: upstream.iter().map(|g| g[7] as f32).collect(),
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
        take_gradients(&mut render, &gradients);
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
