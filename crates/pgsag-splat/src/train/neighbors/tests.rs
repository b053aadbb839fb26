use super::*;
use pgsag_scene::camera::distortion::{LensCamera, LensModel};
use pgsag_scene::{Pinhole, RigidTransform, SparsePoint, TrackElement};

/// Nadir cameras 10 above a ground of points, at the given x.
fn strip(at: &[f64], with_tracks: bool) -> Scene {
    let camera = Pinhole { width: 100, height: 100, fx: 50.0, fy: 50.0, cx: 50.0, cy: 50.0 };
    let down = glam::DQuat::from_rotation_x(std::f64::consts::PI);
    let views: Vec<View> = at
        .iter()
        .enumerate()
        .map(|(i, x)| View {
            name: format!("{i}.png"),
            lens: LensCamera {
                model: LensModel::Pinhole,
                width: 100,
                height: 100,
                params: vec![50.0, 50.0, 50.0, 50.0],
            },
            camera,
            camera_from_world: RigidTransform { rotation: down, translation: -(down * DVec3::new(*x, 0.0, 10.0)) },
        })
        .collect();
    let mut points = Vec::new();
    for i in 0..4000 {
        let position_world = DVec3::new(f64::from(i % 200) * 0.25 - 10.0, f64::from(i / 200) * 0.5 - 5.0, 0.0);
        let track = views
            .iter()
            .enumerate()
            .filter(|(_, v)| {
                camera
                    .project(v.camera_from_world.transform_point(position_world))
                    .is_some_and(|at| camera.contains(at))
            })
            .map(|(i, _)| TrackElement { view_index: i as u32, xy_px: [0.0; 2] })
            .collect();
        let track = if with_tracks { track } else { Vec::new() };
        points.push(SparsePoint { position_world, color: [0; 3], error_px: 0.0, track });
    }
    Scene { views, points, ..Scene::default() }
}

#[test]
fn ten_degrees_beat_two_and_twenty() {
    // atan(0.35/10) = 2 deg, atan(1.76/10) = 10 deg, atan(3.6/10) = 20 deg.
    let scene = strip(&[0.0, 0.1, 1.76, 3.6, 40.0], true);
    let lists = neighbors_of(&scene, &[0, 1, 2, 3, 4], &NeighborOptions::default());
    assert_eq!(lists[0].iter().map(|n| n.view).collect::<Vec<_>>(), vec![2, 3]);
    assert!(lists[0][0].score > lists[0][1].score);
}

#[test]
fn positions_are_those_of_the_list() {
    let scene = strip(&[0.0, 40.0, 1.76], true);
    let lists = neighbors_of(&scene, &[2, 0], &NeighborOptions::default());
    assert_eq!((lists[0][0].view, lists[1][0].view), (1, 0));
}

#[test]
fn without_tracks_pose_decides() {
    let scene = strip(&[0.0, 1.0, 3.0, 400.0], false);
    let lists = neighbors_of(&scene, &[0, 1, 2, 3], &NeighborOptions { count: 2, ..NeighborOptions::default() });
    assert_eq!(lists[0].iter().map(|n| n.view).collect::<Vec<_>>(), vec![1, 2]);
    assert_eq!(lists[3].len(), 2, "no depth is known, so no distance is too far");
}

#[test]
fn resolutions_that_differ_too_much_do_not_pair() {
    let mut scene = strip(&[0.0, 1.76], true);
    scene.views[1].camera.fx = 500.0;
    scene.views[1].camera.fy = 500.0;
    assert!(shared_points(&scene, &[0, 1], &NeighborOptions::default()).is_empty());
}

#[test]
fn a_view_that_shares_little_is_content_with_less() {
    let scene = strip(&[0.0, 1.76], true);
    let shared = shared_points(&scene, &[0, 1], &NeighborOptions::default())[&(0, 1)].count;
    let found =
        |min_shared| neighbors_of(&scene, &[0, 1], &NeighborOptions { min_shared, ..NeighborOptions::default() });
    assert_eq!(found(shared), found(4 * shared));
    assert_ne!(found(shared)[0][0].score, found(8 * shared)[0][0].score, "by pose");
}
