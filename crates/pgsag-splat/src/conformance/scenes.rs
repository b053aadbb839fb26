//! Eight scenes of 40 Gaussians at 48 x 32 pixels: a wall that fills both views, and something awkward before it.

use pgsag_scene::numbers::SplitMix64;
use pgsag_scene::{Image, Map, Mask, Pinhole, PixelClass};

use crate::backend::{OptimizerState, TrainingView, ViewCamera};
use crate::cloud::SplatCloud;
use crate::equations::algebra::transpose_vec;
use crate::equations::projection::Lens;

/// Pixels.
pub(super) const WIDTH: u32 = 48;
/// Pixels.
pub(super) const HEIGHT: u32 = 32;
/// Gaussians.
pub(super) const COUNT: usize = 40;
/// Of which so many make the wall.
const WALL: usize = 20;
/// Depth of the wall, scene units.
const WALL_DEPTH: f64 = 6.0;
/// Gaussians nearer than this are not drawn.
const NEAR: f64 = 0.4;

/// A cloud, a view and its neighbour.
pub(super) struct Scene {
    pub(super) name: &'static str,
    pub(super) state: OptimizerState,
    pub(super) views: [TrainingView; 2],
}

/// One Gaussian before it is stored.
struct Splat {
    mean: [f64; 3],
    log_scales: [f64; 3],
    rotation: [f64; 4],
    logit: f64,
}

pub(super) fn all() -> Vec<Scene> {
    vec![random(), opaque_stack(), tilted(), off_screen(), near_plane(), masked(), tiny(), huge()]
}

/// Discs of all sorts.
pub(super) fn random() -> Scene {
    scene("random", 1, |r, _| Splat {
        mean: [r.range(-2.0, 2.0), r.range(-1.4, 1.4), r.range(3.5, 5.5)],
        log_scales: [r.range(-2.5, -0.7), r.range(-2.5, -0.7), r.range(-5.0, -3.0)],
        rotation: turn(r, 0.5),
        logit: r.range(-2.0, 2.0),
    })
}

/// Nearly opaque, one behind the other.
fn opaque_stack() -> Scene {
    scene("opaque stack", 2, |r, i| Splat {
        mean: [r.range(-0.3, 0.3), r.range(-0.3, 0.3), 3.0 + 0.12 * i as f64],
        log_scales: [r.range(-0.9, -0.4), r.range(-0.9, -0.4), -4.0],
        rotation: turn(r, 0.15),
        logit: r.range(2.0, 3.5),
    })
}

/// Thin and seen almost along their plane.
fn tilted() -> Scene {
    scene("thin and tilted", 3, |r, _| Splat {
        mean: [r.range(-1.8, 1.8), r.range(-1.2, 1.2), r.range(3.5, 5.5)],
        log_scales: [r.range(-1.5, -0.5), r.range(-2.5, -0.7), r.range(-7.0, -6.0)],
        rotation: turn(r, 1.1),
        logit: r.range(-1.0, 2.0),
    })
}

/// Centres beyond the clamp of the projection's Jacobian, edges in the picture.
fn off_screen() -> Scene {
    scene("off screen", 4, |r, i| Splat {
        mean: [if i % 2 == 0 { -1.0 } else { 1.0 } * r.range(2.6, 4.0), r.range(-2.4, 2.4), r.range(3.0, 4.5)],
        log_scales: [r.range(-0.2, 0.3), r.range(-0.5, 0.3), r.range(-3.0, -2.0)],
        rotation: turn(r, 0.4),
        logit: r.range(-1.0, 2.0),
    })
}

/// Behind the camera, before the near plane, and a little beyond it.
fn near_plane() -> Scene {
    scene("near plane", 5, |r, i| Splat {
        mean: [r.range(-0.4, 0.4), r.range(-0.3, 0.3), [-1.0, 0.2, 0.8, 1.2][i % 4] + r.range(0.0, 0.1)],
        log_scales: [r.range(-3.0, -2.0), r.range(-3.0, -2.0), r.range(-5.0, -4.0)],
        rotation: turn(r, 0.3),
        logit: r.range(-1.0, 1.0),
    })
}

/// All four classes, and known edges inside.
fn masked() -> Scene {
    let mut scene = Scene { name: "masked", ..random() };
    for (index, view) in scene.views.iter_mut().enumerate() {
        let mut mask = Mask::filled(WIDTH, HEIGHT, PixelClass::Free);
        let mut edges = Map::filled(WIDTH, HEIGHT, false);
        for y in 0..HEIGHT {
            for x in 0..WIDTH {
                let radius = libm::hypot(f64::from(x) - 25.0 + index as f64, 1.2 * (f64::from(y) - 15.0));
                let class = match radius {
                    r if r < 14.0 => PixelClass::Inside,
                    r if r < 16.5 => PixelClass::Boundary,
                    _ if x < 16 && y < 16 => PixelClass::Occluded,
                    _ => PixelClass::Free,
                };
                mask.classes[(y * WIDTH + x) as usize] = class;
                edges.set(x, y, (x + y) % 13 == 0);
            }
        }
        view.mask = Some(mask);
        view.inner_edges = Some(edges);
    }
    scene
}

/// Smaller than a pixel: what is seen of them is the low-pass filter.
fn tiny() -> Scene {
    scene("tiny", 7, |r, _| Splat {
        mean: [r.range(-1.8, 1.8), r.range(-1.2, 1.2), r.range(3.5, 5.5)],
        log_scales: [r.range(-6.0, -4.0), r.range(-6.0, -4.0), r.range(-8.0, -7.0)],
        rotation: turn(r, 0.6),
        logit: r.range(-1.0, 3.0),
    })
}

/// Larger than the picture.
fn huge() -> Scene {
    scene("huge", 8, |r, _| Splat {
        mean: [r.range(-2.0, 2.0), r.range(-2.0, 2.0), r.range(4.0, 5.5)],
        log_scales: [r.range(0.8, 1.5), r.range(0.8, 1.5), r.range(-3.0, -2.0)],
        rotation: turn(r, 0.1),
        logit: r.range(-3.0, -1.0),
    })
}

fn turn(r: &mut SplitMix64, most: f64) -> [f64; 4] {
    [1.2, r.range(-most, most), r.range(-most, most), r.range(-most, most)]
}

fn scene(name: &'static str, seed: u64, awkward: impl Fn(&mut SplitMix64, usize) -> Splat) -> Scene {
    let mut random = SplitMix64::new(seed);
    let mut cloud = SplatCloud { sh_degree: 3, ..SplatCloud::default() };
    for i in 0..COUNT {
        let splat = if i < WALL { wall(&mut random, i) } else { awkward(&mut random, i - WALL) };
        cloud.means.push(splat.mean.map(|value| value as f32));
        cloud.log_scales.push(splat.log_scales.map(|value| value as f32));
        cloud.rotations.push(splat.rotation.map(|value| value as f32));
        cloud.opacity_logits.push(splat.logit as f32);
        let color: Vec<f32> = (0..3).map(|_| random.range(-0.6, 1.0) as f32).collect();
        cloud.harmonics.extend(color);
        cloud.harmonics.extend((0..45).map(|_| random.range(-0.12, 0.12) as f32));
    }
    let views = [camera(0.0, [0.0; 3]), camera(0.12, [-0.6, 0.08, 0.05])].map(view);
    Scene { name, state: OptimizerState::fresh(cloud), views }
}

/// A bumpy wall behind everything, five by four.
fn wall(r: &mut SplitMix64, i: usize) -> Splat {
    let (column, row) = (i % 5, i / 5);
    Splat {
        mean: [1.5 * (column as f64 - 2.0), 1.3 * (row as f64 - 1.5), WALL_DEPTH + r.range(-0.15, 0.15)],
        log_scales: [r.range(-0.3, 0.0), r.range(-0.3, 0.0), r.range(-4.0, -3.0)],
        rotation: turn(r, 0.08),
        logit: r.range(1.5, 2.5),
    }
}

fn camera(yaw_rad: f64, translation: [f64; 3]) -> ViewCamera {
    let (sin, cos) = (libm::sin(yaw_rad), libm::cos(yaw_rad));
    ViewCamera {
        pinhole: Pinhole { width: WIDTH, height: HEIGHT, fx: 44.0, fy: 46.0, cx: 25.3, cy: 15.2 },
        rotation: [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]],
        translation,
        near: NEAR,
    }
}

/// A view whose photograph shows one texture on the wall's plane, so that patches correlate between views.
fn view(camera: ViewCamera) -> TrainingView {
    let lens = Lens::<f64>::new(&camera);
    let mut image = Image::filled(WIDTH, HEIGHT, [0; 3]);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let ray = transpose_vec(&lens.rotation, lens.ray(f64::from(x), f64::from(y)));
            let depth = (WALL_DEPTH - lens.eye[2]) / ray[2];
            let at = [lens.eye[0] + depth * ray[0], lens.eye[1] + depth * ray[1]];
            image.pixels[(y * WIDTH + x) as usize] = std::array::from_fn(|channel| texture(at, channel as f64));
        }
    }
    TrainingView { camera, image, mask: None, inner_edges: None }
}

fn texture([x, y]: [f64; 2], channel: f64) -> u8 {
    let wave = libm::sin(4.1 * x + channel) * libm::cos(3.3 * y) + 0.6 * libm::sin(6.7 * y - 2.9 * x + 0.5 * channel);
    (128.0 + 70.0 * wave) as u8
}
