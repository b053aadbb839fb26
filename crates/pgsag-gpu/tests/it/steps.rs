//! Whole steps: the same twice, and sparse ones.

use pgsag_gpu::{Backward, Gpu};
use pgsag_scene::Image;
use pgsag_splat::SplatCloud;
use pgsag_splat::backend::{
    Backend, Exposure, Limits, LossWeights, OptimizerState, Rates, RenderOptions, Sample, TrainingView,
};

use crate::device::{camera, cloud};
use crate::gpu;

const RATES: Rates =
    Rates { means: 1e-3, scales: 5e-3, rotations: 2e-3, opacity: 0.05, color: 2.5e-3, harmonics: 1e-4, sparse: false };

/// Three steps towards a grey photograph; the state after them, and the last gradients.
fn train(gpu: &Gpu, state: &OptimizerState, rates: &Rates) -> (OptimizerState, SplatCloud) {
    let view = TrainingView {
        camera: camera(80, 50),
        image: Image::filled(80, 50, [90, 120, 150]),
        mask: None,
        inner_edges: None,
    };
    let options = RenderOptions { planes: true, gradient: true, statistics: true, ..RenderOptions::default() };
    let weights = LossWeights { geometric: 0.0, ncc: 0.0, ..LossWeights::default() };
    let mut cloud = gpu.upload(state).expect("memory");
    let prepared = gpu.prepare(&view).expect("memory");
    for step in 1..=3 {
        let mut render = gpu.render(&cloud, &view.camera, Some(&prepared), &options).expect("a render");
        let mut sample = Sample {
            view: &prepared,
            render: &mut render,
            neighbor: None,
            exposure: Exposure::NEUTRAL,
            weights: &weights,
            scene_scale: 3.0,
            seed: 1,
        };
        gpu.losses(&cloud, &mut sample).expect("losses");
        gpu.backward(&mut cloud, &sample).expect("gradients");
        gpu.adam(&mut cloud, rates, step).expect("a step");
    }
    (gpu.download(&cloud).expect("a state"), gpu.gradients(&cloud).expect("gradients"))
}

#[test]
fn by_gaussians_the_same_steps_give_the_same_bytes() {
    let Some(gpu) = gpu() else { return };
    if gpu.adapter().subgroup.0 != gpu.adapter().subgroup.1 {
        return eprintln!("SKIPPED: subgroups of {:?}", gpu.adapter().subgroup);
    }
    let gpu = gpu.with(Limits::default(), Backward::Gaussians).expect("memory");
    let state = OptimizerState::fresh(cloud(90));
    let first = train(&gpu, &state, &RATES);
    assert_ne!(first.0.cloud, state.cloud);
    assert_eq!(train(&gpu, &state, &RATES), first);
}

#[test]
fn a_sparse_step_leaves_what_is_not_seen_as_it_is() {
    let Some(gpu) = gpu() else { return };
    let mut cloud = cloud(90);
    // Behind the camera.
    cloud.means[7] = [0.0, 0.0, -4.0];
    let mut state = OptimizerState::fresh(cloud);
    state.first.means[7] = [0.5; 3];
    state.second.means[7] = [0.25; 3];
    let (sparse, gradients) = train(gpu, &state, &Rates { sparse: true, ..RATES });
    assert_eq!(gradients.means[7], [0.0; 3]);
    assert_eq!(sparse.cloud.means[7], state.cloud.means[7]);
    assert_eq!(sparse.first.means[7], [0.5; 3]);
    assert_ne!(sparse.cloud.means[8], state.cloud.means[8]);
    assert_eq!(sparse.statistics.visible_count[7], 0);
    assert_eq!(sparse.statistics.visible_count[8], 3);
    let (exact, _) = train(gpu, &state, &RATES);
    assert_ne!(exact.cloud.means[7], state.cloud.means[7]);
}
