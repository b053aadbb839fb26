//! How memory and time of the volume grow with the area: blocks of boxes, photographed by exact depth maps from a grid
//! of nadir and oblique cameras, meshed whole and in cubes.
//!
//! `cargo run --release -p pgsag-mesh --example volume_growth`
#![expect(clippy::print_stdout, reason = "a report for a person")]

use std::time::Instant;

use glam::{DMat3, DQuat, DVec3};
use pgsag_mesh::render::visibility;
use pgsag_mesh::{CellBox, DepthView, Lattice, MeshError, TsdfOptions, Volume, marching, merge};
use pgsag_scene::{Map, Mesh, Pinhole, RigidTransform};

/// Side of one street block and its house, metres.
const PITCH: f64 = 25.0;
const HOUSE: f64 = 14.0;
const VOXEL: f64 = 0.2;

fn main() -> Result<(), MeshError> {
    println!("area_m2 views blocks MiB integrate_s faces extract_s cube_peak_MiB cubes_s");
    for (columns, rows) in [(4, 2), (4, 4), (8, 4)] {
        let town = town(columns, rows);
        let (width, depth) = (f64::from(columns) * PITCH, f64::from(rows) * PITCH);
        let views = views(&town, width, depth);
        let lattice = Lattice { origin: DVec3::ZERO, voxel: VOXEL };
        let region = lattice.cells_covering(DVec3::new(0.0, 0.0, -1.0), DVec3::new(width, depth, 16.0));
        let (volume, integrate) = integrated(lattice, region, &views)?;
        let start = Instant::now();
        let mesh = marching::extract(&volume);
        let extract = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let mut peak = 0;
        let mut parts = Vec::new();
        for cube in region.tiles(256) {
            let (volume, _) = integrated(lattice, cube, &views)?;
            peak = peak.max(volume.memory_bytes());
            parts.push(marching::extract(&volume));
        }
        assert_eq!(merge::merge(&parts).faces.len(), mesh.faces.len(), "cubes must make the same surface");
        println!(
            "{:7.0} {:5} {:6} {:4} {integrate:11.2} {:7} {extract:9.2} {:13} {:7.2}",
            width * depth,
            views.len(),
            volume.block_count(),
            volume.memory_bytes() >> 20,
            mesh.faces.len(),
            peak >> 20,
            start.elapsed().as_secs_f64(),
        );
    }
    Ok(())
}

fn integrated(lattice: Lattice, region: CellBox, views: &[DepthView<'_>]) -> Result<(Volume, f64), MeshError> {
    let mut volume = Volume::new(lattice, region, TsdfOptions { color: false, ..TsdfOptions::default() })?;
    let start = Instant::now();
    views.iter().try_for_each(|view| volume.integrate(view))?;
    Ok((volume, start.elapsed().as_secs_f64()))
}

/// Houses of different heights on flat ground.
fn town(columns: u32, rows: u32) -> Mesh {
    let (width, depth) = (f64::from(columns) * PITCH, f64::from(rows) * PITCH);
    let mut parts = vec![boxed(DVec3::new(-50.0, -50.0, -1.0), DVec3::new(width + 50.0, depth + 50.0, 0.0))];
    for row in 0..rows {
        for column in 0..columns {
            let low = DVec3::new(f64::from(column), f64::from(row), 0.0) * PITCH + DVec3::new(5.0, 5.0, 0.0);
            let height = 6.0 + f64::from((row * 3 + column * 5) % 7);
            parts.push(boxed(low, low + DVec3::new(HOUSE, HOUSE, height)));
        }
    }
    merge::merge(&parts)
}

fn boxed(low: DVec3, high: DVec3) -> Mesh {
    let corner = |c: usize| std::array::from_fn(|a| if c >> a & 1 == 1 { high[a] } else { low[a] });
    let quads: [[u32; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let faces = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
    Mesh { vertices: (0..8).map(corner).collect(), faces, ..Mesh::default() }
}

/// Five looks (down, and slanted from four sides) every 25 m, 60 m up.
fn views(town: &Mesh, width: f64, depth: f64) -> Vec<DepthView<'static>> {
    let camera = Pinhole { width: 400, height: 300, fx: 380.0, fy: 380.0, cx: 200.0, cy: 150.0 };
    let looks = [(0.0, 0.0), (0.7, 0.0), (-0.7, 0.0), (0.0, 0.7), (0.0, -0.7)];
    let mut views = Vec::new();
    for row in 0..=(depth / PITCH) as u32 {
        for column in 0..=(width / PITCH) as u32 {
            let above = DVec3::new(f64::from(column) * PITCH, f64::from(row) * PITCH, 0.0);
            for (x, y) in looks {
                let forward = DVec3::new(x, y, -1.0).normalize();
                let right = DVec3::new(1.0, 0.0, x).normalize();
                let down = forward.cross(right);
                let rotation = DQuat::from_mat3(&DMat3::from_cols(right, down, forward)).inverse().normalize();
                let center = above - forward * (60.0 / -forward.z);
                let camera_from_world = RigidTransform { rotation, translation: -(rotation * center) };
                let depth = visibility(town, &camera, &camera_from_world).depth;
                let weight = Map::filled(camera.width, camera.height, 1.0);
                views.push(DepthView { camera, camera_from_world, depth, weight, normal: None, color: None });
            }
        }
    }
    views
}
