//! How well buildings and background meet: what is open along their border, and how large the steps across it are.
//!
//! The border runs along edges that a building face shares with a background face, and along open edges of building
//! faces that have background within two voxels: there the surfaces pass one another or leave a gap.

use std::collections::HashMap;

use glam::DVec3;
use pgsag_scene::Mesh;

use crate::components::sides;

/// Along the border of buildings and background. Lengths in scene units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seams {
    /// Length of the border.
    pub border: f64,
    /// Length of the open edges within two voxels of the border, over its length.
    pub open_share: f64,
    /// Share of the border at which the other surface begins within one voxel.
    pub close_share: f64,
}

/// How far from the border open edges belong to it, voxels.
const REACH_VOXELS: f64 = 2.0;

/// An edge with what lies on its two sides; the second is absent where it is open.
struct Edge {
    middle: DVec3,
    length: f64,
    is_building: [Option<bool>; 2],
}

impl Edge {
    fn is_open(&self) -> bool {
        self.is_building[1].is_none()
    }
}

/// Measures the border of a city whose faces know their building (0: background).
#[must_use]
pub fn seams(city: &Mesh, voxel: f64) -> Seams {
    let edges = edges(city);
    let ground = Near::new(REACH_VOXELS * voxel, background_vertices(city));
    // Every border edge with how far away the background begins.
    let border: Vec<(&Edge, f64)> = edges
        .iter()
        .filter_map(|edge| match edge.is_building {
            [Some(a), Some(b)] if a != b => Some((edge, 0.0)),
            [Some(true), None] => ground.distance(edge.middle).map(|gap| (edge, gap)),
            _ => None,
        })
        .collect();
    let along = Near::new(REACH_VOXELS * voxel, border.iter().map(|(edge, _)| edge.middle).collect());
    let open = edges.iter().filter(|edge| edge.is_open() && along.distance(edge.middle).is_some());
    let length: f64 = border.iter().map(|(edge, _)| edge.length).sum();
    let close: f64 = border.iter().filter(|(_, gap)| *gap <= voxel).map(|(edge, _)| edge.length).sum();
    let share = |part: f64| if length > 0.0 { part / length } else { 0.0 };
    Seams { border: length, open_share: share(open.map(|edge| edge.length).sum()), close_share: share(close) }
}

fn edges(city: &Mesh) -> Vec<Edge> {
    let is_building = |face: u32| city.buildings.get(face as usize).is_some_and(|building| *building != 0);
    let edge = |same: &[([u32; 2], u32)]| {
        let [a, b] = same[0].0.map(|vertex| DVec3::from(city.vertices[vertex as usize]));
        let is_building = [Some(is_building(same[0].1)), same.get(1).map(|side| is_building(side.1))];
        Edge { middle: 0.5 * (a + b), length: a.distance(b), is_building }
    };
    sides(city).chunk_by(|a, b| a.0 == b.0).map(edge).collect()
}

fn background_vertices(city: &Mesh) -> Vec<DVec3> {
    let mut is_ground = vec![false; city.vertices.len()];
    for (face, corners) in city.faces.iter().enumerate() {
        if city.buildings.get(face).is_none_or(|building| *building == 0) {
            corners.iter().for_each(|vertex| is_ground[*vertex as usize] = true);
        }
    }
    let all = city.vertices.iter().zip(is_ground).filter(|(_, is_ground)| *is_ground);
    all.map(|(vertex, _)| DVec3::from(*vertex)).collect()
}

/// Places by cell, so that what lies within a reach is found in 27 cells.
struct Near {
    reach: f64,
    places: Vec<DVec3>,
    cells: HashMap<[i64; 3], Vec<u32>>,
}

impl Near {
    fn new(reach: f64, places: Vec<DVec3>) -> Self {
        let mut cells: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
        for (at, place) in (0u32..).zip(&places) {
            cells.entry(Self::cell(*place, reach)).or_default().push(at);
        }
        Self { reach, places, cells }
    }

    fn cell(place: DVec3, reach: f64) -> [i64; 3] {
        (place / reach).floor().to_array().map(|v| v as i64)
    }

    /// To the nearest place within reach.
    fn distance(&self, from: DVec3) -> Option<f64> {
        let [x, y, z] = Self::cell(from, self.reach);
        let around = (0..27).map(|k| [x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1]);
        let near = around.filter_map(|cell| self.cells.get(&cell)).flatten();
        let distances = near.map(|at| self.places[*at as usize].distance(from));
        distances.min_by(f64::total_cmp).filter(|distance| *distance <= self.reach)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of squares of side 1 from x = 0 along y, and a second one from x = 1 + `gap`, lifted by `step`; they share
    /// their vertices where there is neither gap nor step.
    fn strips(gap: f64, step: f64) -> Mesh {
        let mut mesh = Mesh::default();
        let mut index: HashMap<[i64; 3], u32> = HashMap::new();
        let mut vertex = |mesh: &mut Mesh, at: [f64; 3]| {
            let key = at.map(|v| (v * 1000.0).round() as i64);
            *index.entry(key).or_insert_with(|| {
                mesh.vertices.push(at);
                mesh.vertices.len() as u32 - 1
            })
        };
        for (x, z, building) in [(0.0, 0.0, 0), (1.0 + gap, step, 7)] {
            for y in 0..40 {
                let y = f64::from(y);
                let corners = [[x, y, z], [x + 1.0, y, z], [x + 1.0, y + 1.0, z], [x, y + 1.0, z]];
                let [a, b, c, d] = corners.map(|at| vertex(&mut mesh, at));
                mesh.faces.extend([[a, b, c], [a, c, d]]);
                mesh.buildings.extend([building; 2]);
            }
        }
        mesh
    }

    #[test]
    fn surfaces_that_share_their_border_leave_nothing_open() {
        let found = seams(&strips(0.0, 0.0), 0.2);
        assert_eq!(found, Seams { border: 40.0, open_share: 0.0, close_share: 1.0 });
    }

    #[test]
    fn a_gap_of_a_voxel_and_a_half_is_open_and_not_close() {
        let found = seams(&strips(0.6, 0.0), 0.4);
        assert_eq!(found.border, 40.0);
        assert_eq!(found.close_share, 0.0);
        assert!(found.open_share > 1.9, "both lips: {found:?}");
        // Half a voxel is close, though open.
        assert_eq!(seams(&strips(0.0, 0.2), 0.55).close_share, 1.0);
    }

    #[test]
    fn surfaces_far_apart_have_no_border() {
        assert_eq!(seams(&strips(5.0, 0.0), 0.4), Seams::default());
    }
}
