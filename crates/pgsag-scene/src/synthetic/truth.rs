//! The exact truth of the town: its triangles, its buildings, and the parts of them that the views can see.

use glam::DVec3;
use rayon::prelude::*;

use super::Town;
use super::texture::hash;
use crate::mesh::Mesh;
use crate::numbers::SplitMix64;

/// Views flatter than this on a surface do not count as seeing it: cosine of 85 degrees.
const MIN_COS_SEEN: f64 = 0.087_156;

/// What covers a building.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Roof {
    /// Two slopes and a ridge.
    Gabled,
    /// Flat, with boxes on it.
    Flat,
}

/// A true building.
#[derive(Clone, Debug, PartialEq)]
pub struct TownBuilding {
    /// As in the instance maps and on the faces.
    pub number: u32,
    /// What covers it.
    pub roof: Roof,
    /// Whether it shares a wall with a neighbour.
    pub in_row: bool,
    /// Corners in plan, counter-clockwise, world frame.
    pub footprint_world: [[f64; 2]; 4],
    /// Height of the ground, world frame.
    pub ground_z: f64,
    /// Height of the top of the walls, world frame.
    pub eaves_z: f64,
    /// Height of the ridge or the flat roof without what stands on it, world frame.
    pub roof_z: f64,
}

impl Town {
    /// The buildings in the order of their numbers.
    #[must_use]
    pub fn buildings(&self) -> Vec<TownBuilding> {
        let offset = self.offset();
        let buildings = self.layout.houses.iter().map(|house| TownBuilding {
            number: house.number,
            roof: if house.rise > 0.0 { Roof::Gabled } else { Roof::Flat },
            in_row: house.in_row,
            footprint_world: house.corners().map(|corner| (corner + offset.truncate()).to_array()),
            ground_z: offset.z,
            eaves_z: offset.z + house.eaves,
            roof_z: offset.z + house.eaves + house.rise,
        });
        buildings.collect()
    }

    /// All true triangles, world frame, `buildings` per face (0 = ground, trees, cars). Every building is made of closed
    /// solids that reach a little below the ground.
    #[must_use]
    pub fn truth_mesh(&self) -> Mesh {
        let solids = &self.solids;
        let half = solids.ground_half;
        let ground = [(-half.x, -half.y), (half.x, -half.y), (half.x, half.y), (-half.x, half.y)];
        let ground = ground.map(|(x, y)| DVec3::new(x, y, 0.0));
        let first = solids.vertices.len() as u32;
        let vertices = solids.vertices.iter().chain(&ground).map(|vertex| (*vertex + self.offset()).to_array());
        let mut faces = solids.faces.clone();
        let mut buildings: Vec<u32> = (0..faces.len()).map(|face| solids.surface_of(face as u32).building).collect();
        faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        buildings.extend([0, 0]);
        Mesh { vertices: vertices.collect(), faces, buildings, ..Mesh::default() }
    }

    /// Points spread over the buildings, one per `spacing_m`² of what at least two cameras see from their true poses;
    /// world frame, with the building's number.
    #[must_use]
    pub fn visible_points(&self, spacing_m: f64) -> (Vec<[f64; 3]>, Vec<u32>) {
        let faces: Vec<Vec<([f64; 3], u32)>> =
            (0..self.solids.faces.len()).into_par_iter().map(|face| self.visible_on(face, spacing_m)).collect();
        faces.into_iter().flatten().unzip()
    }

    fn visible_on(&self, face: usize, spacing_m: f64) -> Vec<([f64; 3], u32)> {
        let building = self.solids.surface_of(face as u32).building;
        let [a, b, c] = self.solids.corners(face);
        let cross = (b - a).cross(c - a);
        let mut random = SplitMix64::new(self.options.seed ^ u64::from(hash(face as i32, 0, 47)) << 20);
        let expected = cross.length() / 2.0 / (spacing_m * spacing_m).max(1e-6);
        let count = if building == 0 { 0 } else { (expected + random.uniform()).floor() as usize };
        let normal = cross.normalize();
        let mut points = Vec::new();
        for _ in 0..count {
            // Uniform on the triangle (Osada et al. 2002).
            let (root, share) = (random.uniform().sqrt(), random.uniform());
            let place = a * (1.0 - root) + b * (root * (1.0 - share)) + c * (root * share);
            if place.z > 0.0 && self.seen_by(place, normal, 2) {
                points.push(((place + self.offset()).to_array(), building));
            }
        }
        points
    }

    /// Whether at least `wanted` views see a place.
    fn seen_by(&self, place: DVec3, normal: DVec3, wanted: usize) -> bool {
        let views = 0..self.true_poses.len();
        views.filter(|&view| self.sees(view, place, normal, MIN_COS_SEEN)).take(wanted).count() == wanted
    }
}
