//! Plates of known depth, seen by cameras side by side.

use glam::{DQuat, DVec3};
use pgsag_scene::{Mask, PixelClass};

use super::*;

const SIZE: u32 = 64;

/// A camera at `(x, y, 0)` looking along +z.
fn view(x: f64, y: f64, depth: impl Fn(f64, f64) -> f64) -> DepthView<'static> {
    let camera = Pinhole { width: SIZE, height: SIZE, fx: 64.0, fy: 64.0, cx: 32.0, cy: 32.0 };
    let camera_from_world = RigidTransform { rotation: DQuat::IDENTITY, translation: -DVec3::new(x, y, 0.0) };
    let mut map = Map::filled(SIZE, SIZE, 0.0);
    for v in 0..SIZE {
        for u in 0..SIZE {
            let ray = camera.ray(f64::from(u) + 0.5, f64::from(v) + 0.5);
            map.set(u, v, depth(x + 0.0 * ray.x, ray.x) as f32);
        }
    }
    let weight = Map::filled(SIZE, SIZE, 1.0);
    DepthView { camera, camera_from_world, depth: map, weight, normal: None, color: None }
}

/// A floor at 10 and a table at 8 over `x < 0`.
fn table(camera_x: f64, slope: f64) -> f64 {
    if camera_x + 8.0 * slope < 0.0 { 8.0 } else { 10.0 }
}

fn five() -> Vec<DepthView<'static>> {
    [(0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5)].map(|(x, y)| view(x, y, table)).into()
}

fn filtered(views: &[DepthView<'_>]) -> DepthMap {
    let others: Vec<&DepthView<'_>> = views[1..].iter().collect();
    filter(&views[0], &others, &FilterOptions::default()).unwrap()
}

#[test]
fn true_depths_are_kept() {
    let views = five();
    let map = filtered(&views);
    assert!(map.coverage() > 0.9, "{}", map.coverage());
    for (kept, given) in map.depth.values.iter().zip(&views[0].depth.values) {
        assert!(*kept == 0.0 || kept == given);
    }
    assert!(map.support.at(10, 32) >= 3);
}

#[test]
fn invented_depths_are_dropped() {
    let mut views = five();
    for v in 20..30 {
        for u in 40..50 {
            views[0].depth.set(u, v, 6.0); // in front of the floor
        }
        for u in 10..20 {
            views[0].depth.set(u, v, 9.0); // behind the table's top
        }
    }
    let map = filtered(&views);
    for v in 22..28 {
        assert!((42..48).all(|u| map.depth.at(u, v) == 0.0));
        assert!((12..18).all(|u| map.depth.at(u, v) == 0.0), "behind what all others see, and seen through");
    }
    assert!(map.depth.at(55, 25) > 0.0);
}

#[test]
fn what_one_view_alone_sees_survives_with_less_weight() {
    let mut views = five();
    for view in &mut views[1..] {
        for v in 0..SIZE {
            for u in 40..SIZE {
                view.depth.set(u, v, 0.0);
            }
        }
    }
    let map = filtered(&views);
    assert_eq!((map.support.at(60, 32), map.weight.at(60, 32)), (0, 0.25));
    assert_eq!(map.depth.at(60, 32), 10.0);
    assert_eq!(map.weight.at(10, 32), 1.0);
}

#[test]
fn agreement_grows_with_the_views_that_could_see() {
    let options = FilterOptions::default();
    let required: Vec<u32> = (0..8).map(|n| options.required(n)).collect();
    assert_eq!(required, [0, 1, 2, 2, 2, 2, 3, 3]);
}

#[test]
fn a_ramp_is_cut_and_a_clean_edge_is_not() {
    let mut views = five();
    let edge = (0..SIZE).find(|u| views[0].depth.at(*u, 32) == 10.0).unwrap();
    assert!(filtered(&views).depth.at(edge - 1, 32) > 0.0);
    for v in 0..SIZE {
        views[0].depth.set(edge, v, 9.0);
    }
    let alone = filter(&views[0], &[], &FilterOptions::default()).unwrap();
    assert_eq!(alone.depth.at(edge, 32), 0.0);
    assert_eq!((alone.depth.at(edge - 1, 32), alone.depth.at(edge + 1, 32)), (8.0, 10.0));
}

/// One row of four pixels.
fn row(depth: [f32; 4], support: u8) -> DepthMap {
    let mut map = DepthMap::empty(4, 1);
    for (x, z) in depth.into_iter().enumerate() {
        map.depth.values[x] = z;
        map.weight.values[x] = if z > 0.0 { 1.0 } else { 0.0 };
        map.support.values[x] = support;
    }
    map
}

#[test]
fn buildings_win_inside_their_masks_alone() {
    let building = row([10.0, 10.0, 10.0, 10.0], 1);
    let background = row([10.1, 12.0, 9.0, 0.0], 3);
    let whole = merge_views(&building, None, &background, 0.1).unwrap();
    assert_eq!(whole.depth.values, [10.05, 10.0, 10.0, 10.0]);
    let mut mask = Mask::filled(4, 1, PixelClass::Boundary);
    let merged = |mask: &Mask| {
        let border = Border { classes: mask, overlap_px: 4.0 };
        merge_views(&building, Some(&border), &background, 0.1).unwrap().depth.values
    };
    // Nearer, but with less support than the farther: the farther; then nearer with more support.
    assert_eq!(merged(&mask), [10.0, 12.0, 9.0, 10.0]);
    mask.classes.fill(PixelClass::Free);
    assert_eq!(merged(&mask), background.depth.values);
}

#[test]
fn at_the_foot_of_a_facade_one_surface_goes_over_into_the_other() {
    let mut mask = Mask::filled(8, 1, PixelClass::Inside);
    (0..2).for_each(|x| mask.classes[x] = PixelClass::Free);
    let map = |z: f32| {
        let mut map = DepthMap::empty(8, 1);
        map.depth.values.fill(z);
        map.weight.values.fill(1.0);
        map
    };
    let border = Border { classes: &mask, overlap_px: 4.0 };
    let found = merge_views(&map(10.0), Some(&border), &map(10.5), 0.1).unwrap().depth.values;
    assert_eq!((found[0], found[1]), (10.5, 10.5));
    assert!(found.windows(2).all(|pair| pair[0] >= pair[1]) && found[2] > 10.44, "{found:?}");
    assert!((found[4] - 10.25).abs() < 1e-5 && found[7] == 10.0, "{found:?}");
    // An eave over the ground is a step, and stays one.
    assert_eq!(merge_views(&map(10.0), Some(&border), &map(11.0), 0.1).unwrap().depth.values[2], 10.0);
}

#[test]
fn groups_are_combined_by_mean_or_by_nearness() {
    let one = row([10.0, 10.0, 0.0, 0.0], 2);
    let other = row([10.1, 5.0, 7.0, 0.0], 2);
    assert_eq!(combine(&[&one, &other], 0.1).unwrap().depth.values, [10.05, 5.0, 7.0, 0.0]);
    assert!(combine(&[], 0.1).is_err());
    assert!(combine(&[&one, &DepthMap::empty(3, 1)], 0.1).is_err());
}
