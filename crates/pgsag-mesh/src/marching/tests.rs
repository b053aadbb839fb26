//! Area, volume, Euler number and closedness of surfaces of known fields.

use std::collections::HashMap;

use glam::DVec3;
use pgsag_scene::Mesh;
use pgsag_scene::numbers::SplitMix64;

use super::*;
use crate::tsdf::{CellBox, Lattice, TsdfOptions, volume_of_field};

fn sphere(radius: f64, region: CellBox) -> Volume {
    let lattice = Lattice { origin: DVec3::new(100.0, -50.0, 7.0), voxel: 0.1 };
    let center = lattice.origin + DVec3::new(0.013, 0.021, -0.034);
    volume_of_field(lattice, region, TsdfOptions::default(), |node| ((node - center).length() - radius) / 0.4)
}

fn cube(low: i32, high: i32) -> CellBox {
    CellBox { low: [low; 3], high: [high; 3] }
}

fn area_and_volume(mesh: &Mesh, about: DVec3) -> (f64, f64) {
    (0..mesh.faces.len()).fold((0.0, 0.0), |(area, volume), f| {
        let [a, b, c] = mesh.triangle(f).map(|p| DVec3::from(p) - about);
        (area + 0.5 * (b - a).cross(c - a).length(), volume + a.dot(b.cross(c)) / 6.0)
    })
}

/// How often each directed side occurs, minus how often its reverse does.
fn open_sides(mesh: &Mesh) -> usize {
    let mut balance: HashMap<(u32, u32), i32> = HashMap::new();
    for face in &mesh.faces {
        for k in 0..3 {
            let (a, b) = (face[k], face[(k + 1) % 3]);
            *balance.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
        }
    }
    balance.values().filter(|n| **n != 0).count()
}

fn euler(mesh: &Mesh) -> i64 {
    let mut sides: Vec<(u32, u32)> =
        mesh.faces.iter().flat_map(|f| (0..3).map(|k| (f[k].min(f[(k + 1) % 3]), f[k].max(f[(k + 1) % 3])))).collect();
    sides.sort_unstable();
    sides.dedup();
    mesh.vertices.len() as i64 - sides.len() as i64 + mesh.faces.len() as i64
}

#[test]
fn sphere_has_the_area_volume_and_euler_number_of_a_sphere() {
    let volume = sphere(1.0, cube(-15, 15));
    let mesh = extract(&volume);
    let (area, content) = area_and_volume(&mesh, volume.lattice.origin);
    let pi = std::f64::consts::PI;
    assert!((area / (4.0 * pi) - 1.0).abs() < 0.01, "area {area}");
    assert!((content / (4.0 / 3.0 * pi) - 1.0).abs() < 0.01, "volume {content}: its sign is the orientation");
    assert_eq!(open_sides(&mesh), 0);
    assert_eq!(euler(&mesh), 2);
    assert!(mesh.faces.iter().all(|f| f[0] != f[1] && f[1] != f[2] && f[0] != f[2]));
}

#[test]
fn random_fields_have_no_cracks_in_any_case() {
    let region = cube(-9, 12);
    let mut random = SplitMix64::new(3);
    let volume = volume_of_field(Lattice { origin: DVec3::ZERO, voxel: 1.0 }, region, TsdfOptions::default(), |node| {
        let low = region.low.map(f64::from).map(|v| v + 0.5);
        let high = region.high.map(f64::from).map(|v| v - 0.5);
        let hull = (0..3).any(|a| node[a] < low[a] || node[a] > high[a]);
        if hull { 1.0 } else { random.range(-1.0, 1.0) }
    });
    let mesh = extract(&volume);
    assert!(mesh.faces.len() > 10_000);
    assert_eq!(open_sides(&mesh), 0);
    let (_, content) = area_and_volume(&mesh, DVec3::ZERO);
    assert!(content > 0.0);
}

#[test]
fn every_side_of_a_random_surface_has_two_faces() {
    let mut random = SplitMix64::new(5);
    let volume =
        volume_of_field(Lattice { origin: DVec3::ZERO, voxel: 1.0 }, cube(0, 24), TsdfOptions::default(), |_| {
            random.range(-1.0, 1.0)
        });
    let mesh = extract(&volume);
    let mut sides: HashMap<(u32, u32), u32> = HashMap::new();
    for f in &mesh.faces {
        for k in 0..3 {
            *sides.entry((f[k].min(f[(k + 1) % 3]), f[k].max(f[(k + 1) % 3]))).or_default() += 1;
        }
    }
    assert_eq!(sides.values().filter(|n| **n > 2).count(), 0);
}

#[test]
fn cubes_share_their_vertices_bit_for_bit() {
    let whole = extract(&sphere(1.0, cube(-16, 16)));
    let parts: Vec<Mesh> = cube(-16, 16).tiles(16).into_iter().map(|tile| extract(&sphere(1.0, tile))).collect();
    assert_eq!(parts.len(), 8);
    assert_eq!(parts.iter().map(|part| part.faces.len()).sum::<usize>(), whole.faces.len());
    let joined = crate::merge::merge(&parts);
    assert_eq!(joined.vertices.len(), whole.vertices.len());
    assert_eq!(open_sides(&joined), 0);
    assert_eq!(euler(&joined), 2);
}

#[test]
fn unknown_corners_make_no_surface() {
    let mut volume = sphere(1.0, cube(-15, 15));
    for (key, block) in volume.keys.iter().zip(&mut volume.blocks) {
        if key[0] >= 0 {
            block.weight.fill(0.0);
        }
    }
    let mesh = extract(&volume);
    let limit = volume.lattice.origin.x;
    assert!(!mesh.faces.is_empty());
    assert!(mesh.vertices.iter().all(|v| v[0] <= limit));
}
