//! Where the photographs are taken from: a nadir grid, and obliques from four sides whose axes meet the ground on a grid.
//! All views have the same distance to their aim, so the ground sampling distance there is the same.

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::layout::Layout;
use super::options::{LensDistortion, TownOptions};
use crate::camera::distortion::{LensCamera, LensModel};
use crate::numbers::SplitMix64;
use crate::pose::RigidTransform;

/// The camera of all views.
pub(super) fn camera(options: &TownOptions) -> LensCamera {
    let (width, height) = (options.width.max(1), options.height.max(1));
    let f = options.focal_ratio.max(0.05) * f64::from(width);
    let [dx, dy] = options.principal_point_offset_px;
    let (cx, cy) = (f64::from(width) / 2.0 + dx, f64::from(height) / 2.0 + dy);
    let (model, params) = match options.lens {
        None => (LensModel::Pinhole, vec![f, f, cx, cy]),
        Some(LensDistortion { k1, k2, p1, p2 }) => (LensModel::Opencv, vec![f, f, cx, cy, k1, k2, p1, p2]),
    };
    LensCamera { model, width, height, params }
}

/// An oblique image reaches farther beyond its aim than before it; aims are drawn back by this share of the distance, so
/// that the grid is about the middle of what is seen.
const DRAWN_BACK: f64 = 0.16;

/// The true poses, town frame.
pub(super) fn poses(options: &TownOptions, layout: &Layout) -> Vec<RigidTransform> {
    let mut random = SplitMix64::new(options.seed ^ 0xF11_9475);
    let count = options.view_count as usize;
    let nadir = ((count as f64 * options.nadir_share.clamp(0.0, 1.0)).round() as usize).min(count);
    let distance = options.gsd_m.max(1e-3) * options.focal_ratio.max(0.05) * f64::from(options.width.max(1));
    let mut poses = Vec::with_capacity(count);
    for (k, at) in grid(nadir, reach(layout.half, 0.23 * distance)).into_iter().enumerate() {
        let heading = if k % 2 == 0 { DVec2::Y } else { DVec2::NEG_Y };
        let tilt = random.range(-0.02, 0.02);
        poses.push(aimed(&mut random, at, heading, tilt, distance));
    }
    let oblique = count - nadir;
    for side in 0..4 {
        let share = oblique / 4 + usize::from(side < oblique % 4);
        let heading = [DVec2::Y, DVec2::NEG_X, DVec2::NEG_Y, DVec2::X][side];
        for at in grid(share, reach(layout.half, 0.35 * distance)) {
            let tilt = options.oblique_tilt_rad + random.range(-0.06, 0.06);
            poses.push(aimed(&mut random, at - heading * (DRAWN_BACK * distance), heading, tilt, distance));
        }
    }
    poses
}

/// How far from the middle the outermost aims go: to within `margin` of the border, which their images cover.
fn reach(half: DVec2, margin: f64) -> DVec2 {
    (half * 0.22).max(half - margin)
}

/// A camera that looks towards `heading` and meets the ground near `at`; a little off in every respect, as drones are.
fn aimed(random: &mut SplitMix64, at: DVec2, heading: DVec2, tilt: f64, distance: f64) -> RigidTransform {
    let yaw = random.range(-0.09, 0.09);
    let heading = DVec2::new(libm::cos(yaw), libm::sin(yaw)).rotate(heading);
    let jitter = DVec2::new(random.range(-0.02, 0.02), random.range(-0.02, 0.02)) * distance;
    let (sin, cos) = (libm::sin(tilt), libm::cos(tilt));
    let forward = (heading * sin).extend(-cos);
    let right = DVec3::new(heading.y, -heading.x, 0.0);
    let down = forward.cross(right);
    let center = (at + jitter).extend(0.0) - forward * (distance * random.range(0.97, 1.03));
    let rotation = DQuat::from_mat3(&DMat3::from_cols(right, down, forward).transpose()).normalize();
    RigidTransform { rotation, translation: -(rotation * center) }
}

/// `count` places spread over a rectangle of half size `half` from border to border, row by row; rows as even in number
/// as they can be.
fn grid(count: usize, half: DVec2) -> Vec<DVec2> {
    let aspect = if half.x > 0.0 { half.y / half.x } else { 1.0 };
    let rows = ((count as f64 * aspect).sqrt().round() as usize).clamp(1, count.max(1));
    let spread = |k: usize, n: usize| if n > 1 { 2.0 * k as f64 / (n - 1) as f64 - 1.0 } else { 0.0 };
    let mut places = Vec::with_capacity(count);
    for row in 0..rows {
        let columns = (row + 1) * count / rows - row * count / rows;
        places.extend((0..columns).map(|column| half * DVec2::new(spread(column, columns), spread(row, rows))));
    }
    places
}

/// The pose that structure-from-motion delivers: the true one with its centre and rotation disturbed.
pub(super) fn disturbed(options: &TownOptions, true_pose: &RigidTransform, view_index: usize) -> RigidTransform {
    let (position, rotation) = (options.pose_noise_position_m, options.pose_noise_rotation_rad);
    if position == 0.0 && rotation == 0.0 {
        return *true_pose;
    }
    let mut random = SplitMix64::new(options.seed ^ 0x9_05E0 ^ (view_index as u64) << 32);
    let mut normals = || DVec3::new(random.normal(), random.normal(), random.normal());
    let center = true_pose.origin_of_a() + normals() * position;
    // Half-angle quaternion of a small rotation, normalised: no platform transcendentals.
    let turn = normals() * (rotation / 2.0);
    let rotation = (DQuat::from_xyzw(turn.x, turn.y, turn.z, 1.0).normalize() * true_pose.rotation).normalize();
    RigidTransform { rotation, translation: -(rotation * center) }
}
