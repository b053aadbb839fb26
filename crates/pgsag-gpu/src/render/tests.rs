use pgsag_scene::Pinhole;
use pgsag_splat::SplatCloud;
use pgsag_splat::backend::{Backend, OptimizerState};

use super::*;
use crate::gpu::Gpu;
use crate::tests::device;

/// A wall of discs that fills the picture, several deep.
fn wall() -> OptimizerState {
    let place = |i: usize| [(i % 12) as f32 * 0.2 - 1.1, (i / 12 % 8) as f32 * 0.2 - 0.7, 2.0 + (i / 96) as f32 * 0.1];
    OptimizerState::fresh(SplatCloud {
        means: (0..288).map(place).collect(),
        log_scales: vec![[-1.7, -1.9, -5.0]; 288],
        rotations: vec![[1.0, 0.05, 0.1, 0.0]; 288],
        opacity_logits: vec![-0.5; 288],
        harmonics: (0..3 * 288).map(|i| (i % 7) as f32 * 0.1).collect(),
        ..SplatCloud::default()
    })
}

fn camera() -> ViewCamera {
    ViewCamera {
        pinhole: Pinhole { width: 75, height: 45, fx: 60.0, fy: 60.0, cx: 37.0, cy: 22.0 },
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
        near: 0.1,
    }
}

#[test]
fn a_render_that_lacked_room_is_drawn_again_and_counts_once() {
    if device().is_none() {
        return;
    }
    let gpu = Gpu::for_tests();
    let cloud = gpu.upload(&wall()).expect("memory");
    let options = RenderOptions { gradient: true, planes: true, load: true, observe: true, ..RenderOptions::default() };
    let whole = gpu.render(&cloud, &camera(), None, &RenderOptions { observe: false, ..options }).expect("a render");
    gpu.room.0.store(500, Relaxed);
    let mut short = gpu.render(&cloud, &camera(), None, &options).expect("a render");
    let sizes: Vec<u32> = gpu.device.read(&short.frame.counters.sizes, 0, 4).expect("sizes");
    assert_eq!((sizes[0], sizes[2]), (288, 500));
    assert!(sizes[3] > 500, "{sizes:?}");
    gpu.redraw(&mut short).expect("room");
    assert_eq!(gpu.read(&short).expect("maps"), gpu.read(&whole).expect("maps"));
    let observed = cloud.statistics_now().expect("statistics").observed_count;
    assert_eq!(observed.iter().max(), Some(&1));
    // What was needed is remembered.
    let next = gpu.render(&cloud, &camera(), None, &options).expect("a render");
    let sizes: Vec<u32> = gpu.device.read(&next.frame.counters.sizes, 12, 1).expect("sizes");
    assert_eq!(sizes, [0]);
}

#[test]
fn an_empty_cloud_and_an_empty_mask_draw_nothing() {
    if device().is_none() {
        return;
    }
    let gpu = Gpu::for_tests();
    let options = RenderOptions { planes: true, ..RenderOptions::default() };
    let empty = gpu.upload(&OptimizerState::default()).expect("memory");
    let nothing = gpu.render(&empty, &camera(), None, &options).and_then(|render| gpu.read(&render));
    assert!(nothing.expect("maps").opacity.values.iter().all(|&value| value == 0.0));
    let view = pgsag_splat::backend::TrainingView {
        camera: camera(),
        image: pgsag_scene::Image::filled(75, 45, [9; 3]),
        mask: Some(pgsag_scene::Mask::filled(75, 45, pgsag_scene::PixelClass::Occluded)),
        inner_edges: None,
    };
    let view = gpu.prepare(&view).expect("a view");
    let cloud = gpu.upload(&wall()).expect("memory");
    let hidden = gpu.render(&cloud, &camera(), Some(&view), &options).and_then(|render| gpu.read(&render));
    assert!(hidden.expect("maps").opacity.values.iter().all(|&value| value == 0.0));
}
