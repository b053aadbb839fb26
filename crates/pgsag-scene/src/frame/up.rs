//! Which way is up, from the cameras alone.
//!
//! Cameras are seldom rolled, so up is perpendicular to their right axes, whether they look at the horizon or straight
//! down; where all right axes are parallel (strips flown with one heading), up is the normal of the plane of their
//! centres. The sign comes from the cameras: their own up, and against their viewing direction.

use glam::DVec3;

use super::eigen::symmetric_eigen;
use crate::scene::View;

/// Where an estimate of up comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UpSource {
    /// Perpendicular to the right axes of the cameras.
    RightAxes,
    /// Normal of the plane of the camera centres.
    CenterPlane,
    /// Mean of the cameras' own up.
    MeanCamera,
}

/// Unit vector away from the ground, world frame, and where it comes from; `None` without views.
#[must_use]
pub fn up_from_cameras(views: &[View]) -> Option<(DVec3, UpSource)> {
    let axes: Vec<[DVec3; 3]> = views
        .iter()
        .map(|view| {
            let world_from_camera = view.camera_from_world.rotation.inverse();
            [DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z].map(|axis| world_from_camera * axis)
        })
        .collect();
    let mean_camera: DVec3 = axes.iter().map(|[_, up, back]| *up + *back).sum();
    let found = right_axes(&axes).or_else(|| center_plane(views));
    let (up, source) = found.unwrap_or((mean_camera, UpSource::MeanCamera));
    let up = up.try_normalize()?;
    Some((if up.dot(mean_camera) < 0.0 { -up } else { up }, source))
}

fn scatter(vectors: impl Iterator<Item = (f64, DVec3)>) -> [[f64; 3]; 3] {
    let mut sum = [[0.0; 3]; 3];
    for (weight, vector) in vectors {
        let vector = vector.to_array();
        (0..3).for_each(|i| (0..3).for_each(|j| sum[i][j] += weight * vector[i] * vector[j]));
    }
    sum
}

/// Perpendicular to the right axes, reweighted so that a few rolled cameras do not count.
fn right_axes(axes: &[[DVec3; 3]]) -> Option<(DVec3, UpSource)> {
    /// Roll that is taken for level, radians.
    const LEVEL_RAD: f64 = 0.02;
    let mut up = DVec3::ZERO;
    for _ in 0..10 {
        let weighted = axes.iter().map(|[right, ..]| (LEVEL_RAD / (LEVEL_RAD + up.dot(*right).abs()), *right));
        let matrix = scatter(weighted);
        let total = matrix[0][0] + matrix[1][1] + matrix[2][2];
        let (values, vectors) = symmetric_eigen(matrix);
        let spread = values[1] > 0.05 * total && values[0] < 0.2 * values[1];
        up = if spread { DVec3::from(vectors[0]) } else { return None };
    }
    Some((up, UpSource::RightAxes))
}

/// Normal of the plane of the centres, where they lie in one and not on a line.
fn center_plane(views: &[View]) -> Option<(DVec3, UpSource)> {
    let centers: Vec<DVec3> = views.iter().map(View::center_world).collect();
    let mean = centers.iter().sum::<DVec3>() / centers.len() as f64;
    let matrix = scatter(centers.iter().map(|center| (1.0, *center - mean)));
    let total = matrix[0][0] + matrix[1][1] + matrix[2][2];
    let (values, vectors) = symmetric_eigen(matrix);
    let planar = values[1] > 0.01 * total && values[0] < 0.05 * values[1];
    planar.then(|| (DVec3::from(vectors[0]), UpSource::CenterPlane))
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DQuat};

    use super::*;
    use crate::camera::Pinhole;
    use crate::numbers::SplitMix64;
    use crate::pose::RigidTransform;

    /// A view from `center` with the given viewing direction, level or rolled, in a world whose up is z.
    fn view(center: DVec3, forward: DVec3, heading: DVec3, roll: f64) -> View {
        let forward = forward.normalize();
        let right = forward.cross(DVec3::Z).try_normalize().unwrap_or(heading);
        let down = forward.cross(right);
        let camera_from_world = DMat3::from_cols(right, down, forward).transpose();
        let rotation = DQuat::from_rotation_z(roll) * DQuat::from_mat3(&camera_from_world);
        let camera = Pinhole { width: 10, height: 10, fx: 10.0, fy: 10.0, cx: 5.0, cy: 5.0 };
        let camera_from_world = RigidTransform { rotation, translation: -(rotation * center) };
        View { name: String::new(), lens: camera.into(), camera, camera_from_world }
    }

    fn turned(views: &[View], world_from_new: DQuat, offset: DVec3) -> Vec<View> {
        let motion = RigidTransform { rotation: world_from_new, translation: offset };
        views.iter().map(|v| View { camera_from_world: v.camera_from_world * motion, ..v.clone() }).collect()
    }

    fn check(views: &[View], source: UpSource, tolerance: f64) {
        let motion = DQuat::from_euler(glam::EulerRot::XYZ, 2.5, 0.4, -1.0);
        let views = turned(views, motion, DVec3::new(4.5e5, 5.1e6, -30.0));
        let (up, from) = up_from_cameras(&views).unwrap();
        assert_eq!(from, source);
        let angle = up.angle_between(motion.inverse() * DVec3::Z);
        assert!(angle < tolerance, "{angle}");
    }

    #[test]
    fn an_orbit_with_a_rolled_camera() {
        let mut stream = SplitMix64::new(2);
        let mut views: Vec<View> = (0..40)
            .map(|i| {
                let (sin, cos) = libm::sincos(f64::from(i) * 0.17);
                let forward = DVec3::new(-cos, -sin, stream.range(-0.5, 0.3));
                view(DVec3::new(20.0 * cos, 20.0 * sin, 2.0), forward, DVec3::X, stream.normal() * 0.01)
            })
            .collect();
        check(&views, UpSource::RightAxes, 0.006);
        views[3] = view(DVec3::ZERO, DVec3::Y, DVec3::X, 1.57);
        check(&views, UpSource::RightAxes, 0.006);
    }

    #[test]
    fn strips_flown_with_one_heading() {
        let mut stream = SplitMix64::new(2);
        let views: Vec<View> = (0..40)
            .map(|i| {
                let center = DVec3::new(f64::from(i / 8) * 30.0, f64::from(i % 8) * 20.0, 80.0 + 0.2 * stream.normal());
                view(center, DVec3::NEG_Z, if i / 8 % 2 == 0 { DVec3::X } else { DVec3::NEG_X }, 0.0)
            })
            .collect();
        check(&views, UpSource::CenterPlane, 0.01);
    }

    #[test]
    fn a_single_line_of_photographs() {
        let views: Vec<View> = (0..5).map(|i| view(DVec3::X * f64::from(i), DVec3::Y, DVec3::X, 0.0)).collect();
        let (up, from) = up_from_cameras(&views).unwrap();
        assert_eq!(from, UpSource::MeanCamera);
        assert!(up.dot(DVec3::Z) > 0.6);
        assert_eq!(up_from_cameras(&[]), None);
    }
}
