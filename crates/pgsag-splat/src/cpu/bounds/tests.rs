//! What a box lets pass holds everything that has tiles, and little more.

use pgsag_scene::{Pinhole, numbers::SplitMix64};

use super::*;
use crate::backend::{OptimizerState, ViewCamera};
use crate::cloud::{SplatCloud, curve_order};
use crate::cpu::cloud::CpuCloud;
use crate::lanes::SimdLevel;

fn camera(angle_rad: f64, distance: f64) -> ViewCamera {
    let (s, c) = (libm::sin(angle_rad), libm::cos(angle_rad));
    ViewCamera {
        pinhole: Pinhole { width: 96, height: 80, fx: 90.0, fy: 95.0, cx: 40.0, cy: 44.0 },
        rotation: [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]],
        translation: [0.1, -0.2, distance],
        near: 0.1,
    }
}

fn cloud(count: usize) -> SplatCloud {
    let mut stream = SplitMix64::new(9);
    let mut draw = |low: f64, high: f64| stream.range(low, high) as f32;
    let mut cloud = SplatCloud { sh_degree: 0, ..SplatCloud::default() };
    for _ in 0..count {
        cloud.means.push([draw(-6.0, 6.0), draw(-6.0, 6.0), draw(-0.3, 0.3)]);
        cloud.log_scales.push([draw(-4.0, -2.5), draw(-4.0, -2.5), -6.0]);
        cloud.rotations.push([0; 4].map(|_| draw(-1.0, 1.0)));
        cloud.opacity_logits.push(draw(-2.0, 4.0));
        cloud.harmonics.extend([0.5; 3]);
    }
    cloud.reordered(&curve_order(&cloud.means))
}

#[inline(always)]
fn bits<S: Carried>(simd: S, layout: &Layout, camera: &ViewCamera, boxes: &[Line], cut: f32) -> Vec<u16> {
    simd.carry();
    let lens = Lens::<Wide<S>>::new(camera);
    let sight = Sight::new(layout, &lens, camera.near, cut);
    boxes.chunks_exact(PLANES).map(|boxes| sight.seen(boxes)).collect()
}

/// A cloud whose boxes let everything pass.
fn open(mut cloud: CpuCloud) -> CpuCloud {
    for boxes in cloud.boxes.chunks_exact_mut(PLANES) {
        boxes[..3].fill(Line([-1e6; LANES]));
        boxes[3..6].fill(Line([1e6; LANES]));
    }
    cloud
}

#[test]
fn nothing_with_tiles_is_passed_over() {
    use crate::cpu::project::{Projection, project};
    for level in SimdLevel::available().into_iter().map(|level| level.detected().expect("it is available")) {
        let state = OptimizerState::fresh(cloud(5000));
        let (boxed, open) = (CpuCloud::new(level, &state), open(CpuCloud::new(level, &state)));
        let groups = boxed.touched.len();
        let (mut passed, mut touching) = (0, 0);
        for step in 0..24 {
            let camera = camera(f64::from(step) * 0.3, f64::from(step % 5) * 1.5);
            let middle = |x: u32, y: u32| step % 2 == 0 || (x.abs_diff(48) < 16 && y.abs_diff(40) < 16);
            let layout = Layout::new(96, 80, middle);
            let projection =
                Projection { camera: &camera, layout: &layout, sh_degree: 0, planes: false, color: true, cut: -8.0 };
            let find = |cloud: &CpuCloud| {
                let (mut records, mut found, mut bins) = (Vec::new(), Vec::new(), Default::default());
                project(level, cloud, &projection, &mut records, &mut found, &mut bins);
                bins.entries.iter().map(|entry| (entry.gaussian, entry.depth, entry.count)).collect::<Vec<_>>()
            };
            let expected = find(&open);
            assert_eq!(find(&boxed), expected);
            let mut with_tiles: Vec<u32> = expected.iter().map(|entry| entry.0 / LANES as u32).collect();
            with_tiles.dedup();
            touching += with_tiles.len();
            let bits = at_level!(level, simd => bits(simd, &layout, &camera, &boxed.boxes, -8.0));
            passed += (0..groups).filter(|group| bits[group / LANES] >> (group % LANES) & 1 == 1).count();
        }
        assert!(touching > 300, "{touching}");
        assert!(passed < 2 * touching, "{passed} groups are let pass, {touching} have tiles");
    }
}
