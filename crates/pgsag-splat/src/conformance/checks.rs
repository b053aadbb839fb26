//! What is compared, scene by scene.

use super::compare::Report;
use super::scenes::Scene;
use crate::backend::{
    Backend, Birth, DensityPlan, Exposure, LossValues, LossWeights, OptimizerState, PlaneMaps, Rates, Reading,
    RenderOptions, Result, Sample,
};
use crate::cloud::SplatCloud;
use crate::equations::adam as equation;
use crate::reference::Reference;

/// Most relative error of a vector; f32 leaves 5e-5 in the terms that difference depth maps.
const TOLERANCE: f64 = 1e-4;
/// Where only the last rounding may differ.
const ROUNDING: f64 = 1e-6;

const NO_WEIGHTS: LossWeights = LossWeights {
    l1: 0.0,
    dssim: 0.0,
    flatness: 0.0,
    normal: 0.0,
    normal_boundary: 0.1,
    normal_image_gradient: false,
    geometric: 0.0,
    // Wide: a pixel at the gate would count on one side only.
    geometric_gate_px: 1000.0,
    ncc: 0.0,
    ncc_patches: 300,
    load: 0.0,
    free_opacity: 0.0,
    reading: Reading::Code,
    mean_over_mask: true,
};

/// Every term alone, then all together.
fn weightings() -> Vec<(&'static str, LossWeights)> {
    let all = LossWeights {
        l1: 0.8,
        dssim: 0.2,
        flatness: 1.0,
        normal: 0.015,
        normal_image_gradient: true,
        geometric: 0.03,
        ncc: 0.15,
        load: 0.41,
        free_opacity: 0.1,
        ..NO_WEIGHTS
    };
    vec![
        ("L1", LossWeights { l1: 1.0, ..NO_WEIGHTS }),
        ("SSIM", LossWeights { dssim: 1.0, ..NO_WEIGHTS }),
        ("SSIM over the frame", LossWeights { dssim: 1.0, mean_over_mask: false, ..NO_WEIGHTS }),
        ("flatness", LossWeights { flatness: 1.0, ..NO_WEIGHTS }),
        ("normal", LossWeights { normal: 1.0, normal_image_gradient: true, ..NO_WEIGHTS }),
        ("normal as printed", LossWeights { normal: 1.0, reading: Reading::Paper, ..NO_WEIGHTS }),
        ("geometric", LossWeights { geometric: 1.0, ..NO_WEIGHTS }),
        ("NCC", LossWeights { ncc: 1.0, ..NO_WEIGHTS }),
        ("load", LossWeights { l1: 1.0, load: 0.41, ..NO_WEIGHTS }),
        ("load as printed", LossWeights { l1: 1.0, load: 0.41, reading: Reading::Paper, ..NO_WEIGHTS }),
        ("free opacity", LossWeights { free_opacity: 1.0, ..NO_WEIGHTS }),
        ("all terms", all),
    ]
}

const EVERYTHING: RenderOptions = RenderOptions {
    sh_degree: 3,
    planes: true,
    load: true,
    gradient: true,
    statistics: true,
    observe: true,
    without_color: false,
    free_pixels: true,
};

const EXPOSURE: Exposure = Exposure { gain: [1.05, 0.95, 1.0], bias: [0.01, -0.02, 0.0] };

/// What one step of a backend leaves.
struct Step<B: Backend> {
    cloud: B::Cloud,
    values: LossValues,
    gradients: SplatCloud,
}

/// Renders both views, evaluates, and goes back.
fn step<B: Backend>(backend: &B, state: &OptimizerState, scene: &Scene, weights: &LossWeights) -> Result<Step<B>> {
    let mut cloud = backend.upload(state)?;
    let views = [backend.prepare(&scene.views[0])?, backend.prepare(&scene.views[1])?];
    let mut render = backend.render(&cloud, &scene.views[0].camera, Some(&views[0]), &EVERYTHING)?;
    let beside =
        RenderOptions { sh_degree: 3, planes: true, without_color: true, gradient: true, ..RenderOptions::default() };
    let mut other = backend.render(&cloud, &scene.views[1].camera, Some(&views[1]), &beside)?;
    let mut sample = Sample {
        view: &views[0],
        render: &mut render,
        neighbor: Some((&views[1], &mut other)),
        exposure: EXPOSURE,
        weights,
        scene_scale: 5.0,
        seed: 17,
    };
    let values = backend.losses(&cloud, &mut sample)?;
    backend.backward(&mut cloud, &sample)?;
    let gradients = backend.gradients(&cloud)?;
    Ok(Step { cloud, values, gradients })
}

/// Every map with the usual limits, drawn with and without the mask.
pub(super) fn maps<B: Backend>(backend: &B, reference: &Reference, scene: &Scene, report: &mut Report) {
    for (name, use_mask, options) in [
        ("", true, EVERYTHING),
        (" without a view", false, EVERYTHING),
        (" of active pixels", true, RenderOptions { free_pixels: false, sh_degree: 1, ..EVERYTHING }),
    ] {
        let name = format!("{}{name}", scene.name);
        let found = report.take(&name, draw(backend, scene, use_mask, &options));
        let expected = report.take(&name, draw(reference, scene, use_mask, &options));
        if let (Some(found), Some(expected)) = (found, expected) {
            compare_maps(&name, &found, &expected, report);
        }
    }
    let plain = report.take(scene.name, draw(backend, scene, true, &RenderOptions::default()));
    let is_empty = |maps: &PlaneMaps| maps.normal.values.is_empty() && maps.load.values.is_empty();
    report.expect(plain.is_some_and(|maps| is_empty(&maps)), || format!("{}: maps nobody asked for", scene.name));
}

fn draw<B: Backend>(backend: &B, scene: &Scene, use_mask: bool, options: &RenderOptions) -> Result<PlaneMaps> {
    let cloud = backend.upload(&scene.state)?;
    let view = backend.prepare(&scene.views[0])?;
    backend.read(&backend.render(&cloud, &scene.views[0].camera, use_mask.then_some(&view), options)?)
}

fn compare_maps(name: &str, found: &PlaneMaps, expected: &PlaneMaps, report: &mut Report) {
    let mut compare = |map: &str, a: &[f32], b: &[f32]| {
        report.compare(format!("{name}: {map}"), &wide(a), &wide(b), TOLERANCE);
    };
    compare("color", found.color.values.as_flattened(), expected.color.values.as_flattened());
    compare("normal", found.normal.values.as_flattened(), expected.normal.values.as_flattened());
    compare("distance", &found.distance.values, &expected.distance.values);
    compare("opacity", &found.opacity.values, &expected.opacity.values);
    compare("depth", &found.depth.values, &expected.depth.values);
    compare("load", &found.load.values, &expected.load.values);
    let holes = expected.opacity.values.iter().zip(&found.opacity.values).filter(|(b, a)| **b == 0.0 && **a != 0.0);
    let count = holes.count();
    report.expect(count == 0, || format!("{name}: {count} pixels shown that are masked or empty"));
}

/// Values and gradients of every term.
pub(super) fn terms<B: Backend>(backend: &B, reference: &Reference, scene: &Scene, report: &mut Report) {
    for (term, weights) in weightings() {
        let name = format!("{}: {term}", scene.name);
        let found = report.take(&name, step(backend, &scene.state, scene, &weights));
        let expected = report.take(&name, step(reference, &scene.state, scene, &weights));
        let (Some(found), Some(expected)) = (found, expected) else { continue };
        for ((value, a), (_, b)) in scalars(&found.values).into_iter().zip(scalars(&expected.values)) {
            report.compare(format!("{name}: {value}"), &a, &b, TOLERANCE);
        }
        compare_clouds(&format!("{name}: gradient of"), &found.gradients, &expected.gradients, TOLERANCE, report);
    }
}

fn scalars(values: &LossValues) -> Vec<(&'static str, Vec<f64>)> {
    vec![
        ("total", wide(&[values.total])),
        ("L1", wide(&[values.l1])),
        ("1 − SSIM", wide(&[values.dssim])),
        ("L_s", wide(&[values.flatness])),
        ("L_ban", wide(&[values.normal])),
        ("L_mvgeo", wide(&[values.geometric])),
        ("share of valid pixels", wide(&[values.geometric_valid])),
        ("L_mvrgb", wide(&[values.ncc])),
        ("σ of the load", wide(&[values.load])),
        ("free opacity", wide(&[values.free_opacity])),
        ("gradient of gain", wide(&values.d_gain)),
        ("gradient of bias", wide(&values.d_bias)),
    ]
}

fn compare_clouds(name: &str, found: &SplatCloud, expected: &SplatCloud, tolerance: f64, report: &mut Report) {
    let mut compare = |kind: &str, a: &[f32], b: &[f32]| {
        report.compare(format!("{name} {kind}"), &wide(a), &wide(b), tolerance);
    };
    compare("means", found.means.as_flattened(), expected.means.as_flattened());
    compare("scales", found.log_scales.as_flattened(), expected.log_scales.as_flattened());
    compare("rotations", found.rotations.as_flattened(), expected.rotations.as_flattened());
    compare("opacities", &found.opacity_logits, &expected.opacity_logits);
    compare("harmonics", &found.harmonics, &expected.harmonics);
}

/// Two steps of statistics, the load term on: it must not count.
pub(super) fn statistics<B: Backend>(backend: &B, reference: &Reference, scene: &Scene, report: &mut Report) {
    let weights = LossWeights { l1: 0.8, dssim: 0.2, load: 0.41, ..NO_WEIGHTS };
    let name = scene.name;
    let found = report.take(name, twice(backend, scene, &weights));
    let expected = report.take(name, twice(reference, scene, &weights));
    let (Some([found, cleared]), Some([expected, _])) = (found, expected) else { return };
    let mut compare = |kind: &str, a: &[f64], b: &[f64]| report.compare(format!("{name}: {kind}"), a, b, TOLERANCE);
    compare("screen gradient", &wide(&found.gradient), &wide(&expected.gradient));
    compare("absolute screen gradient", &wide(&found.absolute_gradient), &wide(&expected.absolute_gradient));
    compare("radius", &wide(&found.radius_px), &wide(&expected.radius_px));
    report.expect(found.visible_count == expected.visible_count, || format!("{name}: visible counts differ"));
    report.expect(found.observed_count == expected.observed_count, || format!("{name}: observed counts differ"));
    let zero =
        cleared.gradient.iter().all(|&value| value == 0.0) && cleared.visible_count.iter().all(|&count| count == 0);
    report.expect(zero, || format!("{name}: statistics survive their reset"));
}

/// Statistics of two steps, and after their reset.
fn twice<B: Backend>(
    backend: &B,
    scene: &Scene,
    weights: &LossWeights,
) -> Result<[crate::backend::DensityStatistics; 2]> {
    let first = step(backend, &scene.state, scene, weights)?;
    // Downloaded and uploaded again in between, as by a checkpoint.
    let mut second = step(backend, &backend.download(&first.cloud)?, scene, weights)?;
    Ok([backend.statistics(&mut second.cloud, true)?, backend.statistics(&mut second.cloud, false)?])
}

/// What goes up comes down, to the bit.
pub(super) fn round_trip<B: Backend>(backend: &B, scene: &Scene, report: &mut Report) {
    let mut state = scene.state.clone();
    state.first.means[3] = [0.25, -1.5, 3.0];
    state.second.opacity_logits[5] = 0.125;
    state.statistics.visible_count[7] = 9;
    state.statistics.observed_count[8] = 4;
    let back = backend.upload(&state).and_then(|cloud| backend.download(&cloud));
    let back = report.take("round trip", back);
    report.expect(back.as_ref() == Some(&state), || "upload and download change the cloud".into());
}

/// Three Adam steps against the equation, with the backend's own gradients.
pub(super) fn adam<B: Backend>(backend: &B, scene: &Scene, report: &mut Report) {
    let rates = Rates {
        means: 1e-3,
        scales: 5e-3,
        rotations: 2e-3,
        opacity: 0.05,
        color: 2.5e-3,
        harmonics: 1e-4,
        sparse: false,
    };
    let weights = LossWeights { l1: 0.8, dssim: 0.2, ..NO_WEIGHTS };
    let mut state = scene.state.clone();
    for count in 1..=3 {
        let stepped = step(backend, &state, scene, &weights).and_then(|mut step| {
            backend.adam(&mut step.cloud, &rates, count)?;
            Ok((backend.download(&step.cloud)?, step.gradients))
        });
        let Some((found, gradients)) = report.take("Adam", stepped) else { return };
        let expected = adam_by_hand(&state, &gradients, &rates, count);
        for (part, a, b) in [("cloud", &found.cloud, &expected.cloud), ("first moment", &found.first, &expected.first)]
        {
            compare_clouds(&format!("Adam step {count}: {part}"), a, b, ROUNDING, report);
        }
        compare_clouds(&format!("Adam step {count}: second moment"), &found.second, &expected.second, ROUNDING, report);
        state = found;
    }
}

/// `equations::adam` over a whole state.
fn adam_by_hand(state: &OptimizerState, gradients: &SplatCloud, rates: &Rates, count: u32) -> OptimizerState {
    let mut out = state.clone();
    let corrections = equation::corrections(count);
    let basis = 3 * state.cloud.basis_count();
    let OptimizerState { cloud, first, second, .. } = &mut out;
    let run = |x: &mut [f32], m: &mut [f32], v: &mut [f32], g: &[f32], rate: &dyn Fn(usize) -> f32| {
        for i in 0..x.len() {
            let [at, moment, square, slope] = [x[i], m[i], v[i], g[i]].map(f64::from);
            let moved = equation::step(at, moment, square, slope, f64::from(rate(i)), corrections);
            [x[i], m[i], v[i]] = moved.map(|value| value as f32);
        }
    };
    macro_rules! flat {
        ($field:ident, $rate:expr) => {
            run(
                cloud.$field.as_flattened_mut(),
                first.$field.as_flattened_mut(),
                second.$field.as_flattened_mut(),
                gradients.$field.as_flattened(),
                &|_| $rate,
            );
        };
    }
    flat!(means, rates.means);
    flat!(log_scales, rates.scales);
    flat!(rotations, rates.rotations);
    let opacity = &gradients.opacity_logits;
    run(&mut cloud.opacity_logits, &mut first.opacity_logits, &mut second.opacity_logits, opacity, &|_| rates.opacity);
    let rate = |i: usize| if i % basis < 3 { rates.color } else { rates.harmonics };
    run(&mut cloud.harmonics, &mut first.harmonics, &mut second.harmonics, &gradients.harmonics, &rate);
    out
}

/// Clone, split, prune and an opacity ceiling.
pub(super) fn reshape<B: Backend>(backend: &B, reference: &Reference, scene: &Scene, report: &mut Report) {
    let birth = |parent: u32, logit| Birth {
        parent,
        offset: [0.1, -0.2, 0.05 * parent as f32],
        log_scale_shift: -0.47,
        opacity_logit: logit,
    };
    let births = vec![birth(3, None), birth(7, Some(-1.0)), birth(7, Some(6.0))];
    let keep: Vec<u32> = (0..40).filter(|i| i % 3 != 0).collect();
    for opacity_ceiling in [None, Some(0.3)] {
        let plan = DensityPlan { keep: keep.clone(), births: births.clone(), opacity_ceiling };
        let mut state = scene.state.clone();
        state.first.opacity_logits.fill(0.5);
        state.second.means.fill([0.25; 3]);
        state.statistics.visible_count.fill(2);
        let found = report.take("reshape", reshaped(backend, &state, &plan));
        let expected = report.take("reshape", reshaped(reference, &state, &plan));
        let (Some(found), Some(expected)) = (found, expected) else { return };
        compare_clouds("reshaped", &found.cloud, &expected.cloud, ROUNDING, report);
        let same = found.first == expected.first && found.second == expected.second;
        report.expect(same, || "reshape: moments are not those of the Gaussians they belong to".into());
        report.expect(found.statistics == expected.statistics, || "reshape: statistics are not reset".into());
    }
}

fn reshaped<B: Backend>(backend: &B, state: &OptimizerState, plan: &DensityPlan) -> Result<OptimizerState> {
    let mut cloud = backend.upload(state)?;
    backend.reshape(&mut cloud, plan)?;
    backend.download(&cloud)
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&value| f64::from(value)).collect()
}
