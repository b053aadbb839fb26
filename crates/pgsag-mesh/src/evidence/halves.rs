//! Two meshes of one place, made of different photographs: what they differ by, neither knows. Errors that are
//! independent and alike add up in the difference, so that each has its part of `1 / sqrt(2)`.

use glam::DVec3;
use pgsag_scene::Mesh;
use pgsag_scene::numbers::quantile;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::spread::spread;
use crate::error::MeshError;
use crate::score::{Sampler, Surface, Walk};

/// Faces judged together.
const CHUNK: usize = 2048;

/// What lies beside the rim of the other mesh, not over it, is alone: cosine between its way there and the normal.
const MIN_COS: f64 = 0.5;

/// How two meshes are compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalvesOptions {
    /// One sample per this length squared, scene units.
    pub spacing: f64,
    /// What is farther than this from the other mesh is surface that only one of them has, scene units.
    pub reach: f64,
    /// Of the samples.
    pub seed: u64,
}

/// From one mesh to the other. Lengths in scene units, already divided by `sqrt(2)`; `None` where there are no samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HalfSpread {
    /// Samples.
    pub count: u64,
    /// Share of them that has nothing of the other mesh below or above it within reach.
    pub alone: f64,
    /// Median with sign: positive = outside of the other mesh. Not divided.
    pub bias: Option<f64>,
    /// Robust standard deviation.
    pub sigma: Option<f64>,
    /// 68 % lie nearer.
    pub p68: Option<f64>,
    /// 90 % lie nearer.
    pub p90: Option<f64>,
    /// 95 % lie nearer.
    pub p95: Option<f64>,
}

impl HalfSpread {
    /// The same in another unit.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        let by = |value: Option<f64>| value.map(|value| value * factor);
        Self {
            bias: by(self.bias),
            sigma: by(self.sigma),
            p68: by(self.p68),
            p90: by(self.p90),
            p95: by(self.p95),
            ..self
        }
    }
}

/// From the first mesh to the second, and back.
///
/// # Errors
/// A mesh without surface; a spacing that is no length or gives too many samples.
pub fn halves(one: &Mesh, other: &Mesh, options: &HalvesOptions) -> Result<[HalfSpread; 2], MeshError> {
    for (name, value) in [("spacing", options.spacing), ("reach", options.reach)] {
        if !(value > 0.0 && value.is_finite()) {
            return Err(MeshError::Option { name, value, allowed: "greater than 0" });
        }
    }
    Ok([one_way(one, other, options)?, one_way(other, one, options)?])
}

fn one_way(from: &Mesh, to: &Mesh, options: &HalvesOptions) -> Result<HalfSpread, MeshError> {
    let surface = Surface::new(to, "the other mesh")?;
    let sampler = Sampler::new(from, options.spacing, options.seed)?;
    let parts: Vec<Vec<f64>> = (0..from.faces.len().div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut walk = Walk::default();
            let faces = chunk * CHUNK..from.faces.len().min((chunk + 1) * CHUNK);
            let mut distance = |point: DVec3| {
                let hit = walk.nearest(&surface, point)?;
                let over = (point - hit.place).dot(surface.normal(hit.index)).abs();
                // Where the meshes touch, rounding alone says which way the other lies.
                let is_over = over >= MIN_COS * hit.distance - 1e-6 * options.reach;
                Some(match (is_over, hit.behind) {
                    (false, _) => f64::INFINITY,
                    (true, true) => -hit.distance,
                    (true, false) => hit.distance,
                })
            };
            faces.flat_map(|face| sampler.of_face(face)).filter_map(&mut distance).collect()
        })
        .collect();
    let all = parts.concat();
    let near: Vec<[f64; 2]> = all.iter().filter(|d| d.abs() <= options.reach).map(|d| [*d, 0.0]).collect();
    let share = std::f64::consts::FRAC_1_SQRT_2;
    let found = spread(&near);
    let mut lengths: Vec<f64> = near.iter().map(|d| d[0].abs() * share).collect();
    Ok(HalfSpread {
        count: all.len() as u64,
        alone: (all.len() - near.len()) as f64 / all.len().max(1) as f64,
        bias: found.bias,
        sigma: found.sigma.map(|sigma| sigma * share),
        p68: quantile(&mut lengths, 0.68),
        p90: quantile(&mut lengths, 0.9),
        p95: quantile(&mut lengths, 0.95),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square metre at height `z`, facing up, of `side` metres.
    fn plate(z: f64, side: f64) -> Mesh {
        Mesh {
            vertices: vec![[0.0, 0.0, z], [side, 0.0, z], [side, side, z], [0.0, side, z]],
            faces: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    #[test]
    fn plates_differ_by_their_distance_and_what_only_one_has_is_told() {
        let options = HalvesOptions { spacing: 0.02, reach: 0.5, seed: 1 };
        let [there, back] = halves(&plate(0.1, 2.0), &plate(0.0, 1.0), &options).expect("judged");
        assert!((there.bias.expect("some") - 0.1).abs() < 1e-9, "{there:?}");
        assert!((back.bias.expect("some") + 0.1).abs() < 1e-9 && back.alone == 0.0);
        assert!((back.p68.expect("some") - 0.1 / 2f64.sqrt()).abs() < 1e-9);
        // Over the small plate, or steeply beside it, lie its own square, two strips and a quarter disc of the large one.
        let r = 0.1 * 3f64.sqrt();
        let near = (1.0 + 2.0 * r + 0.25 * std::f64::consts::PI * r * r) / 4.0;
        assert!((1.0 - there.alone - near).abs() < 0.01, "{} {near}", there.alone);
        assert_eq!(back.scaled(2.0).alone, back.alone);
        assert!(halves(&plate(0.0, 1.0), &plate(0.0, 1.0), &HalvesOptions { spacing: 0.0, ..options }).is_err());
    }

    #[test]
    fn independent_roughness_is_found_in_the_difference() {
        use pgsag_scene::numbers::SplitMix64;
        let rough = |seed: u64| {
            let mut random = SplitMix64::new(seed);
            let mut mesh = Mesh::default();
            for i in 0..60_u32 {
                for j in 0..60_u32 {
                    mesh.vertices.push([f64::from(i), f64::from(j), 0.05 * random.normal()]);
                    if i > 0 && j > 0 {
                        let [a, b, c, d] = [(i - 1) * 60 + j - 1, i * 60 + j - 1, i * 60 + j, (i - 1) * 60 + j];
                        mesh.faces.extend([[a, b, c], [a, c, d]]);
                    }
                }
            }
            mesh
        };
        let options = HalvesOptions { spacing: 0.5, reach: 1.0, seed: 1 };
        let [there, back] = halves(&rough(1), &rough(2), &options).expect("judged");
        // Heights are interpolated between corners, so that the root mean square inside of a face is half of theirs.
        for found in [there, back] {
            let sigma = found.sigma.expect("some");
            assert!((0.02..0.045).contains(&sigma), "{sigma}");
        }
        let [itself, _] = halves(&rough(1), &rough(1), &options).expect("judged");
        assert_eq!(itself.alone, 0.0);
        assert!(itself.p95.expect("some") < 1e-9);
    }
}
