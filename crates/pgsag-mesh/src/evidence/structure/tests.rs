//! A house whose roof is rough by a known amount and whose edges are as wide as they are made.

use std::collections::BTreeMap;

use glam::DVec3;
use pgsag_scene::Mesh;
use pgsag_scene::numbers::SplitMix64;

use super::*;

const GSD: f64 = 0.1;

/// Height over plan: a gabled roof of 8 by 6 units, eaves at 3, that falls to the ground within `skirt`.
fn height(x: f64, y: f64, skirt: f64) -> f64 {
    let out = (x.abs() - 4.0).max(y.abs() - 3.0);
    let roof = 3.0 + 0.5 * (3.0 - y.abs()).max(0.0);
    if out <= 0.0 { roof } else { (3.0 * (1.0 - out / skirt)).max(0.0) }
}

/// The height field over a lattice of one ground sampling distance, rough by `sigma`, with the house as building 1. Where
/// the skirt is `0` its foot stands under its head.
fn house(skirt: f64, sigma: f64) -> Mesh {
    let mut random = SplitMix64::new(3);
    let mut mesh = Mesh::default();
    let lines = |half: f64| {
        let mut lines: Vec<f64> = (-60..=60).map(|k| f64::from(k) * GSD).collect();
        // The walls stand between these lines and the ones beside them.
        lines.extend([-half - skirt.max(1e-6), half + skirt.max(1e-6)]);
        lines.sort_by(f64::total_cmp);
        lines
    };
    let (xs, ys) = (lines(4.0), lines(3.0));
    for y in &ys {
        for x in &xs {
            let z = height(*x, *y, skirt.max(1e-6)) + sigma * random.normal();
            mesh.vertices.push([*x, *y, z]);
        }
    }
    let width = xs.len() as u32;
    for j in 1..ys.len() {
        for i in 1..xs.len() {
            let (i32, j32) = (i as u32, j as u32);
            let [a, b] = [(j32 - 1) * width + i32 - 1, (j32 - 1) * width + i32];
            mesh.faces.extend([[a, b, b + width], [a, b + width, a + width]]);
            let (x, y) = (0.5 * (xs[i] + xs[i - 1]), 0.5 * (ys[j] + ys[j - 1]));
            let is_house = x.abs() < 4.0 + 0.5 * skirt && y.abs() < 3.0 + 0.5 * skirt;
            mesh.buildings.extend([u32::from(is_house); 2]);
        }
    }
    mesh
}

#[test]
fn a_roof_is_as_rough_as_it_was_made() {
    for sigma in [0.0, 0.02] {
        let found = planes(&house(0.0, sigma), DVec3::Z, GSD, &StructureOptions::default());
        let roofs: Vec<&Plane> = found.iter().filter(|plane| plane.level > 0.5 && plane.area > 10.0).collect();
        assert_eq!(roofs.len(), 2, "two slopes of a gable: {found:?}");
        for roof in roofs {
            assert!((roof.level - 1.0 / 1.25_f64.sqrt()).abs() < 0.02 && roof.building == 1, "{roof:?}");
            // Middles of faces are means of three corners.
            assert!((roof.rms - sigma / 3f64.sqrt()).abs() < 0.15 * sigma + 1e-3, "{sigma} {roof:?}");
        }
    }
    let mut bare = house(0.0, 0.0);
    bare.buildings.clear();
    let found = planes(&bare, DVec3::Z, GSD, &StructureOptions::default());
    assert!(
        found.iter().any(|plane| plane.level > 0.99 && plane.area > 50.0),
        "the ground counts where nothing is known"
    );
}

#[test]
fn an_edge_is_as_wide_as_it_was_made() {
    let width = |skirt: f64| {
        let found = edge_widths(&house(skirt, 0.0), DVec3::Z, GSD, &StructureOptions::default());
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].count > 50 && found[0].building == 1, "{found:?}");
        found[0].median / GSD
    };
    let (sharp, skirt, wide) = (width(0.0), width(0.2), width(0.4));
    assert!(sharp <= 1.0, "{sharp}");
    // Eight tenths of the fall, and no more than a cell more.
    assert!((1.4..=2.2).contains(&skirt), "{skirt}");
    assert!((3.0..=3.9).contains(&wide), "{wide}");
}

#[test]
fn houses_are_read_each_by_itself_and_low_ones_not_at_all() {
    let mut far = house(0.0, 0.0);
    far.vertices.iter_mut().for_each(|v| v[0] += 40.0);
    far.buildings.iter_mut().for_each(|building| *building *= 2);
    let both = crate::merge::merge(&[house(0.0, 0.0), far]);
    let found = edge_widths(&both, DVec3::Z, GSD, &StructureOptions::default());
    let by_number: BTreeMap<u32, f64> = found.iter().map(|one| (one.building, one.median)).collect();
    assert_eq!(by_number.keys().copied().collect::<Vec<_>>(), [1, 2]);
    let high = StructureOptions { min_drop_gsd: 80.0, ..StructureOptions::default() };
    assert!(edge_widths(&both, DVec3::Z, GSD, &high).is_empty());
}
