//! Cards: two side by side, and one that is too small.

use pgsag_gpu::{DeviceChoice, Gpu, GpuOptions, adapters};
use pgsag_scene::Pinhole;
use pgsag_splat::backend::{Backend, BackendError, OptimizerState, PlaneMaps, RenderOptions, ViewCamera};
use pgsag_splat::cloud::SplatCloud;

use crate::gpu;

pub(crate) fn camera(width: u32, height: u32) -> ViewCamera {
    let (cx, cy) = (0.5 * f64::from(width), 0.5 * f64::from(height));
    ViewCamera {
        pinhole: Pinhole { width, height, fx: 60.0, fy: 60.0, cx, cy },
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
        near: 0.1,
    }
}

/// Discs in a ring.
pub(crate) fn cloud(count: usize) -> SplatCloud {
    let angle = |i: usize| i as f32 * 0.7;
    SplatCloud {
        means: (0..count).map(|i| [libm::cosf(angle(i)), 0.7 * libm::sinf(angle(i)), 3.0 + 0.01 * i as f32]).collect(),
        log_scales: vec![[-1.8, -1.5, -4.0]; count],
        rotations: (0..count).map(|i| [1.0, 0.1 * libm::sinf(angle(i)), 0.2, 0.0]).collect(),
        opacity_logits: vec![0.5; count],
        harmonics: (0..3 * count).map(|i| libm::sinf(i as f32)).collect(),
        ..SplatCloud::default()
    }
}

fn draw(gpu: &Gpu, state: &OptimizerState) -> PlaneMaps {
    let options = RenderOptions { planes: true, ..RenderOptions::default() };
    let cloud = gpu.upload(state).expect("room for a small cloud");
    let render = gpu.render(&cloud, &camera(80, 50), None, &options).expect("a render");
    gpu.read(&render).expect("its maps")
}

#[test]
fn two_devices_work_side_by_side() {
    let Some(gpu) = gpu() else { return };
    let index = DeviceChoice::Index(gpu.adapter().index);
    let other = Gpu::new(&GpuOptions { device: index, ..GpuOptions::default() }).expect("a second device");
    let state = OptimizerState::fresh(cloud(60));
    let [a, b] = std::thread::scope(|scope| {
        [gpu, &other].map(|gpu| scope.spawn(|| draw(gpu, &state))).map(|thread| thread.join().expect("no panic"))
    });
    assert!(a.opacity.values.iter().any(|&value| value > 0.5));
    assert_eq!(a, b);
}

#[test]
fn threads_may_share_a_card() {
    let Some(gpu) = gpu() else { return };
    let state = OptimizerState::fresh(cloud(60));
    let alone = draw(gpu, &state);
    let draws = || (0..100).filter(|_| draw(gpu, &state) != alone).count();
    let wrong: usize = std::thread::scope(|scope| {
        let threads = [(); 4].map(|()| scope.spawn(draws));
        threads.into_iter().map(|thread| thread.join().expect("no panic")).sum()
    });
    assert_eq!(wrong, 0, "of 400 draws");
}

#[test]
fn a_cloud_that_does_not_fit_is_refused_with_the_number() {
    let Some(gpu) = gpu() else { return };
    let options = GpuOptions {
        device: DeviceChoice::Index(gpu.adapter().index),
        memory_limit: Some(1 << 20),
        ..GpuOptions::default()
    };
    let small = Gpu::new(&options).expect("a device");
    let refused = small.upload(&OptimizerState::fresh(cloud(20_000)));
    let Err(BackendError::TooLarge(message)) = refused else { panic!("{refused:?}") };
    assert!(message.contains("1 MiB allowed") && message.contains("parameters"), "{message}");
    // What was taken is given back, and what fits still works.
    assert!(small.memory().0 < 1 << 16, "{:?}", small.memory());
    assert!(small.upload(&OptimizerState::fresh(cloud(100))).is_ok());
}

#[test]
fn no_binding_may_grow_past_what_the_card_allows() {
    let Some(gpu) = gpu() else { return };
    let Some(adapter) = adapters().into_iter().nth(gpu.adapter().index) else { panic!("the adapter is listed") };
    assert_eq!(adapter.name, gpu.adapter().name);
    if adapter.largest_binding > 256 << 20 {
        return eprintln!("SKIPPED: {} allows {} bytes a binding", adapter.name, adapter.largest_binding);
    }
    let count = adapter.largest_binding as usize / 56 + 1;
    let empty = SplatCloud {
        means: vec![[0.0; 3]; count],
        log_scales: vec![[0.0; 3]; count],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
        opacity_logits: vec![0.0; count],
        harmonics: vec![0.0; 3 * count],
        ..SplatCloud::default()
    };
    let refused = gpu.upload(&OptimizerState { cloud: empty, ..OptimizerState::default() });
    let Err(BackendError::TooLarge(message)) = refused else { panic!("{refused:?}") };
    assert!(message.contains("holds at most 128 MiB"), "{message}");
}
