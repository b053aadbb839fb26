//! Votes against hand counts.

use glam::{DQuat, DVec3};
use pgsag_scene::camera::distortion::{LensCamera, LensModel};
use pgsag_scene::{Map, Pinhole, RigidTransform, Scene, SparsePoint, TrackElement, View};

use super::*;

fn view(x: f64) -> View {
    let camera = Pinhole { width: 100, height: 80, fx: 100.0, fy: 100.0, cx: 50.0, cy: 40.0 };
    let params = vec![camera.fx, camera.fy, camera.cx, camera.cy];
    View {
        name: format!("{x}.jpg"),
        lens: LensCamera { model: LensModel::Pinhole, width: 100, height: 80, params },
        camera,
        camera_from_world: RigidTransform { rotation: DQuat::IDENTITY, translation: DVec3::new(-x, 0.0, 0.0) },
    }
}

fn scene(with_tracks: bool) -> Scene {
    let mut scene = Scene { views: vec![view(0.0), view(1.0), view(2.0)], ..Scene::default() };
    // Left of the images' middle, right of it, and hidden behind the first.
    for position in [DVec3::new(-1.0, 0.0, 10.0), DVec3::new(4.0, 0.0, 10.0), DVec3::new(-2.0, 0.0, 20.0)] {
        let mut point = SparsePoint { position_world: position, color: [0; 3], error_px: 0.0, track: vec![] };
        for (view_index, view) in scene.views.iter().enumerate().filter(|_| with_tracks) {
            let at = view.camera.project(view.camera_from_world.transform_point(position)).expect("in front");
            point.track.push(TrackElement { view_index: view_index as u32, xy_px: [at.x as f32, at.y as f32] });
        }
        scene.points.push(point);
    }
    scene
}

fn counted(
    scene: &Scene,
    mask_of: impl Fn(usize) -> Result<Option<Map<bool>>, ()> + Sync,
    options: &VoteOptions,
) -> Vec<Vote> {
    let surface = Surface::new(scene.points.iter().map(|point| point.position_world).collect());
    vote(scene, &surface, mask_of, options).expect("no error")
}

/// Building = the left half of the image.
fn left_half() -> Map<bool> {
    let mut mask = Map::filled(100, 80, false);
    for y in 0..80 {
        for x in 0..50 {
            mask.set(x, y, true);
        }
    }
    mask
}

#[test]
fn tracks_vote_and_unknown_masks_abstain() {
    let masks = [Some(left_half()), None, Some(left_half())];
    let votes = counted(&scene(true), |i| Ok(masks[i].clone()), &VoteOptions::default());
    assert_eq!(votes[0], Vote { inside: 2, outside: 0 });
    assert_eq!(votes[1], Vote { inside: 0, outside: 2 });
    assert!(votes[0].is_reliable(&VoteOptions::default()) && !votes[1].is_reliable(&VoteOptions::default()));
}

#[test]
fn hidden_point_does_not_vote_without_tracks() {
    let votes = counted(&scene(false), |_| Ok(Some(left_half())), &VoteOptions::default());
    assert_eq!(votes[0].inside, 3);
    assert!(votes[2].inside < 3, "the view straight behind the near point must not see the far one");
}

#[test]
fn edge_of_the_mask_abstains() {
    let mut scene = scene(true);
    for seen in &mut scene.points[1].track {
        seen.xy_px = [51.0, 40.0];
    }
    let votes = counted(&scene, |_| Ok(Some(left_half())), &VoteOptions::default());
    assert_eq!(votes[1], Vote::default());
}

#[test]
fn paper_counts_and_ratio_differ_as_documented() {
    let vote = Vote { inside: 5, outside: 4 };
    assert!(!vote.is_reliable(&VoteOptions::default()));
    assert!(vote.is_reliable(&VoteOptions { max_outside_count: Some(20), ..VoteOptions::default() }));
    assert!(!Vote { inside: 0, outside: 0 }.is_potential());
}

#[test]
fn mask_of_another_size_is_scaled() {
    let mut small = Map::filled(50, 40, false);
    for y in 0..40 {
        for x in 0..25 {
            small.set(x, y, true);
        }
    }
    let votes = counted(&scene(true), |_| Ok(Some(small.clone())), &VoteOptions::default());
    assert_eq!(votes[0].inside, 3);
    assert_eq!(votes[1].outside, 3);
}
