//! Points about a plane whose distance from it is known.

use glam::DQuat;
use pgsag_scene::points::TrackElement;
use pgsag_scene::{Pinhole, RigidTransform};

use super::*;
use crate::evidence::spread;

fn views() -> Vec<View> {
    let camera = Pinhole { width: 1000, height: 800, fx: 900.0, fy: 900.0, cx: 500.0, cy: 400.0 };
    (0..6)
        .map(|k| {
            // Looks down from 50 units.
            let rotation = DQuat::from_rotation_x(std::f64::consts::PI);
            let center = DVec3::new(8.0 * f64::from(k) - 20.0, 4.0 * f64::from(k % 2), 50.0);
            View {
                name: k.to_string(),
                lens: pgsag_scene::camera::distortion::LensCamera {
                    model: pgsag_scene::camera::distortion::LensModel::Pinhole,
                    width: camera.width,
                    height: camera.height,
                    params: vec![camera.fx, camera.fy, camera.cx, camera.cy],
                },
                camera,
                camera_from_world: RigidTransform { rotation, translation: -(rotation * center) },
            }
        })
        .collect()
}

/// A point seen by the first `rays` views whose pixels are off by `noise_px`, moved to where they meet best.
fn point(place: DVec3, rays: usize, noise_px: f64, views: &[View], random: &mut SplitMix64) -> SparsePoint {
    let mut track: Vec<TrackElement> = Vec::new();
    for (view_index, view) in views.iter().enumerate().take(rays) {
        let at = view.camera.project(view.camera_from_world.transform_point(place)).expect("before it");
        let xy = at + DVec2::new(random.normal(), random.normal()) * noise_px;
        track.push(TrackElement { view_index: view_index as u32, xy_px: [xy.x as f32, xy.y as f32] });
    }
    let mut position_world = place;
    for _ in 0..5 {
        let (mut information, mut gradient) = (DMat3::ZERO, DVec3::ZERO);
        for seen in &track {
            let view = &views[seen.view_index as usize];
            let at = |p: DVec3| view.camera.project(view.camera_from_world.transform_point(p)).expect("before it");
            let residual = at(position_world) - DVec2::new(seen.xy_px[0].into(), seen.xy_px[1].into());
            let slopes = [DVec3::X, DVec3::Y, DVec3::Z]
                .map(|axis| (at(position_world + axis * 1e-4) - at(position_world)) / 1e-4);
            for k in 0..2 {
                let row = DVec3::new(slopes[0][k], slopes[1][k], slopes[2][k]);
                information += DMat3::from_cols(row * row.x, row * row.y, row * row.z);
                gradient += row * residual[k];
            }
        }
        position_world -= information.inverse() * gradient;
    }
    SparsePoint { position_world, color: [0; 3], error_px: 0.0, track }
}

fn ground(z: f64) -> Mesh {
    Mesh {
        vertices: vec![[-30.0, -30.0, z], [30.0, -30.0, z], [30.0, 30.0, z], [-30.0, 30.0, z]],
        faces: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

#[test]
fn points_know_their_own_noise_and_the_mesh_gets_the_rest() {
    let (views, mut random) = (views(), SplitMix64::new(9));
    let points = (0..3000)
        .map(|k| {
            // The surface is rough by 0.05 about the mesh, which lies 0.1 above its mean.
            let place = DVec3::new(random.range(-15.0, 15.0), random.range(-8.0, 8.0), 0.05 * random.normal() - 0.1);
            point(place, [3, 6][k % 2], 0.5, &views, &mut random)
        })
        .collect();
    let scene = Scene { views, points, ..Scene::default() };
    let asked: Vec<u32> = (0..3000).collect();
    let found = point_witness(&ground(0.0), &scene, &asked, 1.0).expect("judged");
    assert!((found.noise_px.expect("some") - 0.5).abs() < 0.03, "{:?}", found.noise_px);
    let near: Vec<[f64; 2]> = found.near.iter().map(|one| [one.outside, one.sigma]).collect();
    assert!(near.len() > 2900, "{}", near.len());
    let all = spread(&near);
    assert!((all.bias.expect("some") - 0.1).abs() < 0.01, "{all:?}");
    assert!((all.net.expect("some") - 0.05).abs() < 0.015, "{all:?}");
    assert!(all.noise.expect("some") > 0.04, "three rays fix a point worse than the mesh: {all:?}");
}

#[test]
fn points_beside_no_mesh_and_false_matches_are_counted_apart() {
    let (views, mut random) = (views(), SplitMix64::new(2));
    let good = point(DVec3::new(1.0, 2.0, 0.02), 6, 0.3, &views, &mut random);
    let far = point(DVec3::new(1.0, 2.0, 9.0), 6, 0.3, &views, &mut random);
    let mut wrong = point(DVec3::new(3.0, 2.0, 0.0), 6, 0.3, &views, &mut random);
    wrong.track[2].xy_px[0] += 40.0;
    let short = point(DVec3::new(3.0, 1.0, 0.0), 2, 0.3, &views, &mut random);
    let scene = Scene { views, points: vec![good, far, wrong, short], ..Scene::default() };
    let found = point_witness(&ground(0.0), &scene, &[0, 1, 2, 3], 1.0).expect("judged");
    assert_eq!((found.near.len(), found.without_mesh, found.unfit), (1, 1, 2));
    assert_eq!(found.near[0].index, 0);
    assert!(found.near[0].outside < 0.0, "the mesh lies below the point");
}

#[test]
fn whole_cubes_are_kept_back() {
    let mut random = SplitMix64::new(1);
    let points: Vec<SparsePoint> = (0..20_000)
        .map(|_| SparsePoint {
            position_world: DVec3::new(random.range(-50.0, 50.0), random.range(-50.0, 50.0), random.range(0.0, 1.0)),
            color: [0; 3],
            error_px: 0.5,
            track: Vec::new(),
        })
        .collect();
    let options = WithheldOptions::default();
    let kept_back = withheld(&points, 2.0, &options);
    let share = kept_back.iter().filter(|is| **is).count() as f64 / points.len() as f64;
    assert!((0.07..0.13).contains(&share), "{share}");
    let cube = |point: &SparsePoint| (point.position_world / 2.0).floor().as_i64vec3().to_array();
    let words: std::collections::BTreeSet<_> = points.iter().map(cube).zip(&kept_back).collect();
    let cubes: std::collections::BTreeSet<_> = points.iter().map(cube).collect();
    assert_eq!(words.len(), cubes.len(), "no cube is cut");
    assert_ne!(withheld(&points, 2.0, &WithheldOptions { seed: 1, ..options }), kept_back);
    assert!(withheld(&points, 2.0, &WithheldOptions { share: 0.0, ..options }).iter().all(|is| !is));
}
