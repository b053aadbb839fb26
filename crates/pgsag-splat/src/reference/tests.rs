//! End to end: raster, loss, parameters, by differences.

use pgsag_scene::PixelClass;
use pgsag_scene::numbers::SplitMix64;

use std::ops::Range;

use super::cloud::{HARMONICS, OPACITY, WIDTH};
use super::*;
use crate::backend::{Birth, Exposure, LossWeights, Reading};
use crate::equations::blend;
use crate::losses::tests::{no_weights, training_view, turned_camera};
use crate::proof;

/// Nothing is cut and nothing stops, so that differences meet no step.
const OPEN: Limits = Limits { alpha_cut: 1.0 / 16_777_216.0, transmittance_stop: 0.0 };
const COLUMNS: u32 = 20;
const ROWS: u32 = 16;

/// Tilted discs about z = 4, wide enough to cover most pixels of the test cameras.
fn cloud(count: usize, seed: u64) -> SplatCloud {
    let mut random = SplitMix64::new(seed);
    let mut triple = |low: f64, high: f64| std::array::from_fn(|_| random.range(low, high) as f32);
    let means = (0..count).map(|_| {
        let [x, y, z]: [f32; 3] = triple(-1.0, 1.0);
        [1.3 * x, y, 4.0 + 0.25 * z]
    });
    let means: Vec<[f32; 3]> = means.collect();
    let log_scales = (0..count).map(|_| {
        let [x, y, z]: [f32; 3] = triple(-0.9, -0.2);
        [x, y, z - 2.5]
    });
    let log_scales: Vec<[f32; 3]> = log_scales.collect();
    let rotations = (0..count).map(|_| {
        let [x, y, z]: [f32; 3] = triple(-0.25, 0.25);
        [1.1, x, y, z]
    });
    let rotations: Vec<[f32; 4]> = rotations.collect();
    let opacity_logits = (0..count).map(|_| triple(-1.0, 2.0)[0]).collect();
    let harmonics = (0..count * 16).flat_map(|l| if l % 16 == 0 { triple(0.2, 1.0) } else { triple(-0.2, 0.2) });
    SplatCloud {
        sh_degree: 3,
        harmonics: harmonics.collect(),
        means,
        log_scales,
        rotations,
        opacity_logits,
        ..Default::default()
    }
}

/// A reference view and a neighbour, and what is compared.
struct Setting {
    views: [LossView; 2],
    options: RenderOptions,
    weights: LossWeights,
    /// Opacity of the reference render where Eq. 8 holds it constant.
    held_opacity: Option<Vec<f64>>,
}

const BACKEND: Reference = Reference { limits: OPEN };

impl Setting {
    fn new(weights: LossWeights) -> Self {
        let own = training_view(COLUMNS, ROWS, 3, true);
        let other = TrainingView { camera: turned_camera(COLUMNS, ROWS), ..training_view(COLUMNS, ROWS, 4, true) };
        let options =
            RenderOptions { sh_degree: 3, planes: true, gradient: true, free_pixels: true, ..RenderOptions::default() };
        Self { views: [own, other].map(|view| LossView::new(&view)), options, weights, held_opacity: None }
    }

    fn draw(&self, cloud: &Cloud, view: usize) -> Render {
        let view = &self.views[view];
        BACKEND.render(cloud, &view.camera, Some(view), &self.options).unwrap()
    }

    /// Value of the loss, and on demand the gradients in the cloud.
    fn run(&self, cloud: &mut Cloud, backward: bool) -> f64 {
        let [mut own, mut other] = [self.draw(cloud, 0), self.draw(cloud, 1)];
        if let Some(held) = &self.held_opacity {
            own.opacity.clone_from(held);
        }
        let mut sample = Sample {
            view: &self.views[0],
            render: &mut own,
            neighbor: Some((&self.views[1], &mut other)),
            exposure: Exposure { gain: [1.1, 0.9, 1.0], bias: [0.01, 0.0, -0.02] },
            weights: &self.weights,
            scene_scale: 4.0,
            seed: 3,
        };
        if backward {
            BACKEND.losses(cloud, &mut sample).unwrap();
            BACKEND.backward(cloud, &sample).unwrap();
        }
        terms(cloud, &sample).total
    }
}

fn upload(splats: SplatCloud) -> Cloud {
    BACKEND.upload(&OptimizerState::fresh(splats)).unwrap()
}

/// Compares the cloud's gradients with differences of `value`, each kind of parameter by its own measure.
fn prove(cloud: &mut Cloud, value: impl Fn(&mut Cloud) -> f64, kinds: &[Range<usize>]) {
    let gradients = cloud.gradients.clone();
    for kind in kinds {
        let places: Vec<(usize, usize)> =
            (0..cloud.rows.len()).flat_map(|i| kind.clone().map(move |place| (i, place))).collect();
        let numeric: Vec<f64> = places
            .iter()
            .map(|&(i, place)| {
                let centre = cloud.rows[i].0[place];
                let mut at = |by: f64| {
                    cloud.rows[i].0[place] = centre + by;
                    value(cloud)
                };
                let found = (8.0 * (at(STEP) - at(-STEP)) - (at(2.0 * STEP) - at(-2.0 * STEP))) / (12.0 * STEP);
                cloud.rows[i].0[place] = centre;
                found
            })
            .collect();
        let largest = numeric.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        assert!(largest > 0.0, "places {kind:?} have no gradient");
        for (&(i, place), numeric) in places.iter().zip(&numeric) {
            let formula = gradients[i].0[place];
            let error = (formula - numeric).abs() / largest;
            assert!(error < 1e-6, "Gaussian {i}, place {place}: {formula} by formula, {numeric} by differences");
        }
    }
}

const STEP: f64 = 2e-6;
const GEOMETRY: [Range<usize>; 4] = [0..3, 3..6, 6..10, 10..11];
/// Degree 0, then one function of every higher degree.
const COLORS: [Range<usize>; 4] = [
    HARMONICS..HARMONICS + 3,
    HARMONICS + 3..HARMONICS + 6,
    HARMONICS + 15..HARMONICS + 18,
    HARMONICS + 36..HARMONICS + 39,
];

fn prove_term(weights: LossWeights, hold_opacity: bool, colors: bool) {
    let mut cloud = upload(cloud(8, 21));
    let mut setting = Setting::new(weights);
    if hold_opacity {
        setting.held_opacity = Some(setting.draw(&cloud, 0).opacity);
    }
    assert!(setting.run(&mut cloud, true) > 0.0);
    let kinds = if colors { [&GEOMETRY[..], &COLORS].concat() } else { GEOMETRY.to_vec() };
    prove(&mut cloud, |cloud| setting.run(cloud, false), &kinds);
}

#[test]
fn photometric_reaches_every_parameter() {
    prove_term(LossWeights { l1: 0.8, dssim: 0.2, ..no_weights() }, false, true);
}

#[test]
fn boundary_normal_reaches_the_geometry() {
    prove_term(LossWeights { normal: 1.0, normal_image_gradient: true, ..no_weights() }, true, false);
    prove_term(LossWeights { normal: 1.0, reading: Reading::Paper, ..no_weights() }, true, false);
}

/// With a very wide gate the detached weights are 1 and all pixels take part, so differences see what the formula means.
const OPEN_GATE_PX: f32 = 1e9;

#[test]
fn geometric_reaches_the_geometry_through_both_renders() {
    prove_term(LossWeights { geometric: 1.0, geometric_gate_px: OPEN_GATE_PX, ..no_weights() }, false, false);
}

#[test]
fn ncc_reaches_the_geometry() {
    prove_term(LossWeights { ncc: 1.0, geometric_gate_px: OPEN_GATE_PX, ..no_weights() }, false, false);
}

#[test]
fn free_opacity_reaches_the_geometry() {
    prove_term(LossWeights { free_opacity: 1.0, ..no_weights() }, false, false);
}

#[test]
fn all_terms_together_reach_every_parameter() {
    let weights = LossWeights {
        flatness: 0.5,
        normal: 0.3,
        geometric: 0.1,
        ncc: 0.2,
        geometric_gate_px: OPEN_GATE_PX,
        l1: 0.8,
        dssim: 0.2,
        ..no_weights()
    };
    prove_term(weights, true, true);
}

#[test]
fn flatness_reaches_the_smallest_scale_alone() {
    let mut cloud = upload(cloud(8, 21));
    let setting = Setting::new(LossWeights { flatness: 100.0, ..no_weights() });
    setting.run(&mut cloud, true);
    prove(&mut cloud, |cloud| setting.run(cloud, false), &GEOMETRY[1..2]);
    for row in &cloud.gradients {
        assert_eq!(row.0[SCALES..SCALES + 3].iter().filter(|&&d| d != 0.0).count(), 1);
    }
}

/// The count of blended entries is a step function; what is differentiated is the sum of their sigmoids.
#[test]
fn load_surrogate_reaches_the_geometry() {
    let mut cloud = upload(cloud(8, 21));
    // Faint enough to feel the sigmoid.
    cloud.rows.iter_mut().for_each(|row| row.0[OPACITY] = -4.2);
    let mut setting = Setting::new(LossWeights { load: 0.41, l1: 1.0, ..no_weights() });
    setting.options.load = true;
    let mut render = setting.draw(&cloud, 0);
    let mut random = SplitMix64::new(9);
    let pull = proof::numbers(&mut random, render.load.len(), -1.0, 1.0);
    render.gradients.load.clone_from(&pull);
    let sums = raster::backward(&render, &OPEN);
    for (splat, sum) in render.splats.iter().zip(&sums) {
        assert_eq!(sum.signed, [0.0; 2], "the load term does not split Gaussians");
        splat.backward(&render.lens, &cloud.rows[splat.index], sum, &mut cloud.gradients[splat.index]);
    }
    let value = |cloud: &mut Cloud| {
        let render = setting.draw(cloud, 0);
        let load = |index: usize| -> f64 {
            let entries = raster::entries(&render.splats, &OPEN, index % render.width, index / render.width);
            entries.iter().map(|entry| blend::load(entry.alpha)).sum()
        };
        (0..pull.len()).filter(|&index| render.drawn[index]).map(|index| pull[index] * load(index)).sum()
    };
    prove(&mut cloud, value, &GEOMETRY);
}

/// A Gaussian that straddles the edge between drawn and masked pixels: masked ones are 0 and pull at nothing.
#[test]
fn a_gaussian_across_the_mask_edge_feels_the_drawn_side_alone() {
    let mut cloud = upload(cloud(1, 2));
    // In front of the first pixels of column 16, where a tile of 16 pixels ends: the left half is masked.
    cloud.rows[0].0[..SCALES].copy_from_slice(&[1.4, -0.1, 4.0]);
    let mut view = training_view(32, 16, 3, false);
    let mut mask = pgsag_scene::Mask::filled(32, 16, PixelClass::Inside);
    mask.classes.iter_mut().enumerate().filter(|(i, _)| i % 32 < 16).for_each(|(_, c)| *c = PixelClass::Occluded);
    view.mask = Some(mask);
    view.camera.pinhole.cx = 5.0;
    let mut setting = Setting::new(LossWeights { l1: 0.8, dssim: 0.2, ..no_weights() });
    setting.views[0] = LossView::new(&view);
    let render = setting.draw(&cloud, 0);
    let [u, _] = render.splats[0].screen;
    assert!((14.0..18.0).contains(&u), "{u}");
    for (index, &opacity) in render.opacity.iter().enumerate() {
        assert_eq!(opacity > 0.0, index % 32 >= 16, "{index}");
    }
    setting.run(&mut cloud, true);
    prove(&mut cloud, |cloud| setting.run(cloud, false), &[GEOMETRY.to_vec(), COLORS.to_vec()].concat());
}

/// Two equal smallest scales: the first axis is the normal and takes the gradient; nothing is halved or lost.
#[test]
fn a_tie_of_smallest_scales_goes_to_the_first() {
    let mut cloud = upload(cloud(3, 2));
    for row in &mut cloud.rows {
        row.0[SCALES..SCALES + 3].copy_from_slice(&[-3.0, -1.0, -3.0]);
    }
    let mut setting = Setting::new(LossWeights { flatness: 1.0, normal: 1.0, ..no_weights() });
    setting.held_opacity = Some(setting.draw(&cloud, 0).opacity);
    setting.run(&mut cloud, true);
    for row in &cloud.gradients {
        let pull = 1.0 / (4.0 * 3.0) * libm::exp(-3.0);
        assert!(row.0[SCALES] - row.0[SCALES + 2] > 0.5 * pull);
    }
    // Rotations do not change who wins, so differences may be taken across them.
    prove(&mut cloud, |cloud| setting.run(cloud, false), &[6..10, 0..3]);
}

#[test]
fn weights_and_transmittance_add_up_to_one() {
    let cloud = upload(cloud(8, 21));
    let setting = Setting::new(no_weights());
    let render = setting.draw(&cloud, 0);
    for index in (0..render.drawn.len()).filter(|&index| render.drawn[index]) {
        let entries = raster::entries(&render.splats, &OPEN, index % render.width, index / render.width);
        let transmittance: f64 = entries.iter().map(|entry| 1.0 - entry.alpha).product();
        assert!((render.opacity[index] + transmittance - 1.0).abs() < 1e-14);
    }
}

#[test]
fn blended_plane_of_one_gaussian_is_its_plane() {
    let cloud = upload(cloud(1, 6));
    let setting = Setting::new(no_weights());
    let render = setting.draw(&cloud, 0);
    let splat = &render.splats[0];
    let [_, _, _, x, y, z, distance, _] = splat.channels;
    assert!(distance > 0.0 && z < 0.0);
    for index in (0..render.drawn.len()).filter(|&index| render.opacity[index] > 1e-3) {
        let ray = render.lens.ray((index % render.width) as f64, (index / render.width) as f64);
        let depth = render.depth(index);
        let on_plane = x * ray[0] * depth + y * ray[1] * depth + z * depth + distance;
        assert!(on_plane.abs() < 1e-9, "{on_plane}");
    }
}

#[test]
fn observation_counts_renders_not_pixels() {
    let setting = Setting::new(no_weights());
    let mut cloud = upload(cloud(8, 21));
    for _ in 0..2 {
        let options = RenderOptions { observe: true, ..RenderOptions::default() };
        BACKEND.render(&cloud, &setting.views[0].camera, None, &options).unwrap();
    }
    let counts = BACKEND.statistics(&mut cloud, true).unwrap().observed_count;
    assert!(counts.iter().all(|&count| count == 0 || count == 2) && counts.contains(&2));
    assert_eq!(BACKEND.statistics(&mut cloud, false).unwrap().observed_count, vec![0; 8]);
}

#[test]
fn statistics_do_not_depend_on_the_crop() {
    let gather = |x0: u32, width: u32| {
        let full = training_view(60, 40, 3, false);
        let mut view = full.clone();
        view.camera.pinhole = full.camera.pinhole.cropped(x0, 0, width, 40);
        view.image = full.image.cropped(x0, 0, width, 40);
        let view = LossView::new(&view);
        let mut cloud = upload(small_cloud());
        let options = RenderOptions { statistics: true, gradient: true, ..RenderOptions::default() };
        let mut render = BACKEND.render(&cloud, &view.camera, Some(&view), &options).unwrap();
        let weights = LossWeights { l1: 1.0, ..no_weights() };
        let mut sample = Sample {
            view: &view,
            render: &mut render,
            neighbor: None,
            exposure: Exposure::NEUTRAL,
            weights: &weights,
            scene_scale: 4.0,
            seed: 0,
        };
        BACKEND.losses(&cloud, &mut sample).unwrap();
        BACKEND.backward(&mut cloud, &sample).unwrap();
        BACKEND.statistics(&mut cloud, true).unwrap()
    };
    let (full, crop) = (gather(0, 60), gather(12, 40));
    assert_eq!(full.visible_count, vec![1]);
    assert!((full.gradient[0] / crop.gradient[0] - 1.0).abs() < 1e-6);
    assert!((full.absolute_gradient[0] / crop.absolute_gradient[0] - 1.0).abs() < 1e-6);
    assert!(full.absolute_gradient[0] >= full.gradient[0]);
}

/// One Gaussian of a few pixels in the middle.
fn small_cloud() -> SplatCloud {
    let mut splats = cloud(1, 5);
    splats.means[0] = [0.1, 0.0, 4.0];
    splats.log_scales[0] = [-2.0, -2.2, -4.0];
    splats
}

#[test]
fn adam_moves_by_its_rate_at_first() {
    let mut cloud = upload(cloud(8, 21));
    let setting = Setting::new(LossWeights { l1: 1.0, ..no_weights() });
    setting.run(&mut cloud, true);
    let before = cloud.rows.clone();
    let rates = Rates {
        means: 1e-3,
        scales: 5e-3,
        rotations: 1e-3,
        opacity: 0.05,
        color: 2.5e-3,
        harmonics: 1e-4,
        sparse: false,
    };
    BACKEND.adam(&mut cloud, &rates, 1).unwrap();
    for i in 0..8 {
        let moved = cloud.rows[i].0[0] - before[i].0[0];
        assert!((moved + 1e-3 * cloud.gradients[i].0[0].signum()).abs() < 1e-8, "{moved}");
    }
    cloud.gradients[3].0[OPACITY] = f64::NAN;
    assert!(matches!(BACKEND.adam(&mut cloud, &rates, 2), Err(BackendError::NotFinite(_))));
}

#[test]
fn reshape_keeps_bears_and_caps() {
    let mut cloud = upload(cloud(4, 21));
    cloud.first.iter_mut().for_each(|row| row.0 = [1.0; WIDTH]);
    let parent = cloud.rows[2];
    let birth = Birth { parent: 2, offset: [0.5, 0.0, -0.5], log_scale_shift: -0.5, opacity_logit: None };
    let plan = DensityPlan { keep: vec![0, 3], births: vec![birth], opacity_ceiling: Some(0.01) };
    BACKEND.reshape(&mut cloud, &plan).unwrap();
    let state = BACKEND.download(&cloud).unwrap();
    assert_eq!(state.cloud.len(), 3);
    assert!((state.cloud.means[2][0] - (parent.0[0] + 0.5) as f32).abs() < 1e-6);
    assert!((state.cloud.log_scales[2][1] - (parent.0[SCALES + 1] - 0.5) as f32).abs() < 1e-6);
    assert!(state.cloud.opacity_logits.iter().all(|&logit| logit < -4.5));
    assert_eq!(state.first.means[1], [1.0; 3]);
    assert_eq!(state.first.means[2], [0.0; 3]);
    assert_eq!(state.first.opacity_logits, [0.0; 3]);
}
