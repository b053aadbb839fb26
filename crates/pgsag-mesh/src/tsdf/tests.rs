//! Volumes of views of known surfaces.

use glam::{DQuat, DVec3};
use pgsag_scene::{Image, Map, Pinhole, RigidTransform};

use super::*;
use crate::marching::extract;

/// A camera at `center` looking down (world z up), 80 degrees wide.
fn nadir(center: DVec3, size: u32) -> (Pinhole, RigidTransform) {
    let f = f64::from(size) * 0.6;
    let c = f64::from(size) * 0.5;
    let rotation = DQuat::from_rotation_x(std::f64::consts::PI);
    let camera = Pinhole { width: size, height: size, fx: f, fy: f, cx: c, cy: c };
    (camera, RigidTransform { rotation, translation: -(rotation * center) })
}

/// What a camera sees of the height field `height`, by marching along every ray.
fn view_of(center: DVec3, size: u32, color: Option<&Image>, height: impl Fn(f64, f64) -> f64) -> DepthView<'_> {
    let (camera, camera_from_world) = nadir(center, size);
    let back = camera_from_world.inverse();
    let mut depth = Map::filled(size, size, 0.0f32);
    for y in 0..size {
        for x in 0..size {
            let ray = back.rotation * camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let mut z = 0.0;
            for _ in 0..100 {
                let at = center + ray * z;
                z += (at.z - height(at.x, at.y)) * 0.7;
            }
            depth.set(x, y, z as f32);
        }
    }
    let weight = Map::filled(size, size, 1.0);
    DepthView { camera, camera_from_world, depth, weight, normal: None, color }
}

fn hills(x: f64, y: f64) -> f64 {
    0.3 * x + 0.2 * y
}

fn region() -> CellBox {
    CellBox { low: [-20; 3], high: [20; 3] }
}

fn lattice() -> Lattice {
    Lattice { origin: DVec3::ZERO, voxel: 0.1 }
}

fn three_views(image: &Image) -> Vec<DepthView<'_>> {
    [DVec3::new(0.0, 0.0, 5.0), DVec3::new(1.0, 0.0, 5.5), DVec3::new(0.0, -1.0, 6.0)]
        .map(|at| view_of(at, 120, Some(image), hills))
        .into()
}

#[test]
fn a_slope_comes_back_within_a_thousandth_of_a_voxel() {
    let image = Image::filled(120, 120, [10, 200, 77]);
    let mut volume = Volume::new(lattice(), region(), TsdfOptions::default()).unwrap();
    for view in three_views(&image) {
        volume.integrate(&view).unwrap();
    }
    let mesh = extract(&volume);
    assert!(mesh.faces.len() > 2000);
    for v in &mesh.vertices {
        assert!((v[2] - hills(v[0], v[1])).abs() < 1.1e-4, "{v:?}");
    }
    assert!(mesh.colors.iter().all(|c| *c == [10, 200, 77]));
    // Whole: 4 x 4 units of plan, less what leaves the cube's top and bottom (nothing here).
    let area: f64 = (0..mesh.faces.len())
        .map(|f| {
            let [a, b, c] = mesh.triangle(f).map(DVec3::from);
            0.5 * (b - a).cross(c - a).z
        })
        .sum();
    assert!((area - 16.0).abs() < 0.01, "{area}");
}

#[test]
fn cubes_agree_and_threads_change_nothing() {
    let image = Image::filled(120, 120, [1, 2, 3]);
    let views = three_views(&image);
    let build = |region: CellBox, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut volume = Volume::new(lattice(), region, TsdfOptions::default()).unwrap();
            views.iter().for_each(|view| volume.integrate(view).unwrap());
            extract(&volume)
        })
    };
    let whole = build(region(), 1);
    assert_eq!(whole, build(region(), 3));
    let tiles: Vec<_> = region().tiles(16).into_iter().map(|tile| build(tile, 2)).collect();
    assert!(tiles.len() > 8);
    let joined = crate::merge::merge(&tiles);
    assert_eq!(joined.faces.len(), whole.faces.len());
    assert_eq!(joined.vertices.len(), whole.vertices.len());
    let sorted = |mesh: &pgsag_scene::Mesh| {
        let mut bits: Vec<_> = mesh.vertices.iter().map(|v| v.map(f64::to_bits)).collect();
        bits.sort_unstable();
        bits
    };
    assert_eq!(sorted(&joined), sorted(&whole));
}

#[test]
fn memory_is_refused_before_it_is_taken() {
    let image = Image::filled(120, 120, [0; 3]);
    let views = three_views(&image);
    let mut estimate = Estimate::new(lattice(), region(), TsdfOptions::default()).unwrap();
    views.iter().for_each(|view| estimate.add(view).unwrap());
    let options = TsdfOptions { max_bytes: estimate.bytes(), ..TsdfOptions::default() };
    let mut volume = Volume::new(lattice(), region(), options).unwrap();
    views.iter().for_each(|view| volume.integrate(view).unwrap());
    assert_eq!(volume.memory_bytes(), estimate.bytes());
    let tight = TsdfOptions { max_bytes: estimate.bytes() / 2, ..options };
    let mut volume = Volume::new(lattice(), region(), tight).unwrap();
    let refused = views.iter().find_map(|view| volume.integrate(view).err()).unwrap();
    assert!(matches!(refused, MeshError::Memory { .. }));
    assert!(volume.memory_bytes() <= tight.max_bytes);
}

#[test]
fn free_space_removes_what_one_view_invented() {
    let flat = |_: f64, _: f64| 0.0;
    let mut ghost = view_of(DVec3::new(0.0, 0.0, 5.0), 120, None, flat);
    for y in 55..65 {
        for x in 55..65 {
            ghost.depth.set(x, y, 4.0);
        }
    }
    let vertices_above = |free_space_weight: f32| {
        let options = TsdfOptions { free_space_weight, ..TsdfOptions::default() };
        let mut volume = Volume::new(lattice(), region(), options).unwrap();
        volume.integrate(&ghost).unwrap();
        for at in [-0.6, -0.3, 0.3, 0.6, 0.9] {
            volume.integrate(&view_of(DVec3::new(at, at, 5.0), 120, None, flat)).unwrap();
        }
        extract(&volume).vertices.iter().filter(|v| v[2] > 0.5).count()
    };
    assert!(vertices_above(0.0) > 20);
    assert_eq!(vertices_above(0.5), 0);
}

#[test]
fn nothing_is_known_deeper_than_asked_for() {
    for behind in [2, 3] {
        let options = TsdfOptions { behind_voxels: behind as f32 + 0.01, ..TsdfOptions::default() };
        let mut volume = Volume::new(lattice(), region(), options).unwrap();
        volume.integrate(&view_of(DVec3::new(0.0, 0.0, 5.0), 120, None, |_, _| 0.0)).unwrap();
        let heights = volume.keys.iter().zip(&volume.blocks).flat_map(|(key, block)| {
            let known = block.weight.iter().enumerate().filter(|(_, weight)| **weight > 0.0);
            known.map(|(node, _)| key[2] * 8 + (node / 64) as i32)
        });
        assert_eq!(heights.min(), Some(-behind));
    }
}

/// What a camera sees of a roof (z = 1 where x < 0), its wall (x = 0) and the ground (z = 0).
fn eave_from(x: f64) -> DepthView<'static> {
    let mut view = view_of(DVec3::new(x, 0.0, 5.0), 240, None, |_, _| 0.0);
    let back = view.camera_from_world.inverse();
    for v in 0..240 {
        for u in 0..240 {
            let ray = back.rotation * view.camera.ray(f64::from(u) + 0.5, f64::from(v) + 0.5);
            let (roof, wall) = (-4.0 / ray.z, -x / ray.x);
            let depth = match x + ray.x * roof < 0.0 {
                true => roof,
                false if x > 0.0 && wall > roof && wall < -5.0 / ray.z => wall,
                false => -5.0 / ray.z,
            };
            view.depth.set(u, v, depth as f32);
        }
    }
    view
}

#[test]
fn what_is_said_from_behind_an_eave_rounds_it_less_the_less_it_weighs() {
    let views = [-3.5, -2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 3.5].map(eave_from);
    let farthest_out = |behind_weight: f32| {
        let options = TsdfOptions { behind_weight, ..TsdfOptions::default() };
        let region = CellBox { low: [-8, -8, -4], high: [12, 8, 14] };
        let mut volume = Volume::new(lattice(), region, options).unwrap();
        views.iter().for_each(|view| volume.reserve(view).unwrap());
        views.iter().for_each(|view| volume.integrate(view).unwrap());
        let mesh = extract(&volume);
        mesh.vertices.iter().filter(|v| v[2] > 0.4).map(|v| v[0]).fold(f64::NEG_INFINITY, f64::max)
    };
    let [flat, half, none] = [1.0, 0.5, 0.0].map(farthest_out);
    assert!(flat > half + 0.01 && half > none + 0.01, "{flat} {half} {none}");
    assert!(none > -0.05, "the roof ends where it does: {none}");
}

#[test]
fn wrong_sizes_are_refused() {
    let mut view = view_of(DVec3::new(0.0, 0.0, 5.0), 12, None, hills);
    view.weight = Map::filled(11, 12, 1.0);
    let mut volume = Volume::new(lattice(), region(), TsdfOptions::default()).unwrap();
    assert!(matches!(volume.integrate(&view), Err(MeshError::Size { what: "the weight map", .. })));
    assert!(Volume::new(Lattice { voxel: 0.0, ..lattice() }, region(), TsdfOptions::default()).is_err());
}

/// Four views of flat ground in which a square of half-width `hole` has no depth.
fn ground_with_hole(hole: f64) -> Vec<DepthView<'static>> {
    [(3.0, 0.0), (-3.0, 0.0), (0.0, 3.0), (0.0, -3.0)]
        .map(|(x, y)| {
            let mut view = view_of(DVec3::new(x, y, 5.0), 240, None, |_, _| 0.0);
            let back = view.camera_from_world.inverse();
            for y in 0..240 {
                for x in 0..240 {
                    let ray = view.camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
                    let at = back.transform_point(ray * f64::from(view.depth.at(x, y)));
                    if at.x.abs() < hole && at.y.abs() < hole {
                        view.depth.set(x, y, 0.0);
                    }
                }
            }
            view
        })
        .into()
}

fn closed_surface(region: CellBox, views: &[DepthView<'_>], rounds: u32) -> pgsag_scene::Mesh {
    let options = TsdfOptions { color: false, ..TsdfOptions::default() };
    let mut volume = Volume::new(lattice(), region, options).unwrap();
    volume.follow_gaps(rounds);
    views.iter().for_each(|view| volume.reserve(view).unwrap());
    views.iter().for_each(|view| volume.integrate(view).unwrap());
    for _ in 0..rounds {
        let Some(first) = volume.grow().unwrap() else { break };
        views.iter().for_each(|view| volume.integrate_into(first, view).unwrap());
    }
    crate::marching::extract_closed(&volume)
}

#[test]
fn a_gap_that_nobody_measured_is_closed_at_the_end_of_free_space() {
    let views = ground_with_hole(0.7);
    let region = CellBox { low: [-16; 3], high: [16; 3] };
    let area = |mesh: &pgsag_scene::Mesh| -> f64 {
        let normal = |face| {
            let [a, b, c] = mesh.triangle(face).map(DVec3::from);
            0.5 * (b - a).cross(c - a)
        };
        (0..mesh.faces.len()).map(|face| normal(face).z).sum()
    };
    let raw = closed_surface(region, &views, 3);
    let (mesh, gaps) = crate::gaps::close_gaps(raw.clone(), 4.0);
    assert!((area(&mesh) - 3.2 * 3.2).abs() < 0.01, "{}", area(&mesh));
    assert!(gaps.area > 1.4 * 1.4 - 0.3 && gaps.area < 2.8, "{gaps:?}");
    let highest = mesh.vertices.iter().map(|vertex| vertex[2].abs()).fold(0.0, f64::max);
    assert!(highest < 0.05, "taut, but {highest}");
    // Too wide to be closed: only the corners are rounded.
    let (mesh, gaps) = crate::gaps::close_gaps(raw.clone(), 0.8);
    assert!(gaps.area < 0.5 && area(&mesh) < 3.2 * 3.2 - 1.2, "{gaps:?}");
    // Without following the gap its blocks are missing and it has an open end.
    let (_, gaps) = crate::gaps::close_gaps(closed_surface(region, &views, 0), 4.0);
    assert!(gaps.area < 1.0, "{gaps:?}");
}

#[test]
fn cubes_follow_a_gap_alike() {
    let views = ground_with_hole(0.7);
    let region = CellBox { low: [-16; 3], high: [16; 3] };
    let whole = closed_surface(region, &views, 3);
    let parts: Vec<_> = region.tiles(8).into_iter().map(|cube| closed_surface(cube, &views, 3)).collect();
    let sewn = crate::merge::merge(&parts);
    let sorted = |mesh: &pgsag_scene::Mesh| {
        let place = |vertex: u32| mesh.vertices[vertex as usize].map(f64::to_bits);
        let mut faces: Vec<_> =
            mesh.faces.iter().zip(&mesh.closed).map(|(face, closed)| (face.map(place), *closed)).collect();
        faces.sort_unstable();
        faces
    };
    assert!(whole.closed.contains(&1) && whole.closed.contains(&0));
    assert!(sorted(&whole) == sorted(&sewn), "{} and {} faces", whole.faces.len(), sewn.faces.len());
}
