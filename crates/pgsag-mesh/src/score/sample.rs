//! Area-uniform points on a mesh: systematic over the faces in their order, a low-discrepancy sequence inside each, so
//! that every part of the surface gets its share and the same seed gives the same points on any number of threads.

use glam::DVec3;
use pgsag_scene::Mesh;
use pgsag_scene::numbers::SplitMix64;

use crate::error::MeshError;

/// More samples than this are a wrong unit, not a wish.
const MAX_SAMPLES: f64 = 2e9;

/// How many points each face gets.
pub(crate) struct Sampler<'a> {
    mesh: &'a Mesh,
    counts: Vec<u32>,
    seed: u64,
}

impl<'a> Sampler<'a> {
    /// One point per `spacing` squared, scene units.
    pub(crate) fn new(mesh: &'a Mesh, spacing: f64, seed: u64) -> Result<Self, MeshError> {
        let areas: Vec<f64> = (0..mesh.faces.len()).map(|f| area(mesh, f)).collect();
        let total: f64 = areas.iter().sum();
        let per_point = spacing * spacing;
        if !total.is_finite() || total / per_point > MAX_SAMPLES {
            return Err(MeshError::Geometry {
                what: format!("{total:.3e} square units of surface need too many samples {spacing} apart"),
                cure: "check the unit of the mesh, or give a larger spacing",
            });
        }
        let mut sum = SplitMix64::new(seed).uniform();
        let counts = areas
            .iter()
            .map(|area| {
                sum += area / per_point;
                let count = sum.floor();
                sum -= count;
                count as u32
            })
            .collect();
        Ok(Self { mesh, counts, seed })
    }

    /// All points together.
    pub(crate) fn total(&self) -> u64 {
        self.counts.iter().map(|n| u64::from(*n)).sum()
    }

    /// The points of one face.
    pub(crate) fn of_face(&self, face: usize) -> impl Iterator<Item = DVec3> + use<> {
        let [a, b, c] = self.mesh.triangle(face).map(DVec3::from);
        let count = self.counts[face];
        let start = self.seed ^ (face as u64 + 1).wrapping_mul(0xD134_2543_DE82_EF95);
        let mut random = SplitMix64::new(start);
        let (shift_u, shift_v) = if count > 0 { (random.uniform(), random.uniform()) } else { (0.0, 0.0) };
        (0..count).map(move |i| {
            // Roberts' R2 sequence, folded onto the triangle.
            let u = (shift_u + f64::from(i) * 0.754_877_666_246_692_7).fract();
            let v = (shift_v + f64::from(i) * 0.569_840_290_998_053_2).fract();
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            a + (b - a) * u + (c - a) * v
        })
    }

    /// All points, in the order of the faces.
    pub(crate) fn points(&self) -> Vec<[f64; 3]> {
        (0..self.counts.len()).flat_map(|face| self.of_face(face)).map(Into::into).collect()
    }
}

/// Area of a face; 0 where it is not finite.
pub(crate) fn area(mesh: &Mesh, face: usize) -> f64 {
    let [a, b, c] = mesh.triangle(face).map(DVec3::from);
    let area = 0.5 * (b - a).cross(c - a).length();
    if area.is_finite() { area } else { 0.0 }
}
