//! Sparse points that the reconstruction never saw: how far each lies from the mesh, beside how well its own rays fix it.
//!
//! A point's covariance comes from the residuals of its track and the angles of its rays. What the points scatter more
//! about the mesh than their covariances say is the mesh's.

use glam::{DMat3, DVec2, DVec3};
use pgsag_scene::numbers::{SplitMix64, median};
use pgsag_scene::{Mesh, Scene, SparsePoint, View};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::error::MeshError;
use crate::score::{face_normal, nearest};

/// Least rays of a point that is asked.
const MIN_TRACK: usize = 3;
/// Points whose rays miss by more than this are false matches, pixels (root mean square per coordinate).
const MAX_ERROR_PX: f64 = 2.0;
/// A point's own residuals count against those of all as if they had this many more degrees of freedom: three rays tell
/// little of their noise.
const PRIOR_FREEDOM: f64 = 6.0;
/// Points that are farther from the mesh than so many of their standard deviations beyond `reach` see no mesh.
const MAX_SIGMAS: f64 = 6.0;

/// Which points are kept back.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WithheldOptions {
    /// Share of the sparse points that the reconstruction does not see; 0: none. 10 % is the usual size of a test set.
    pub share: f64,
    /// They are kept back in whole cubes of this side, so that no neighbour gives them away, ground sampling distances.
    pub block_gsd: f64,
    /// Which cubes.
    pub seed: u64,
}

impl Default for WithheldOptions {
    fn default() -> Self {
        Self { share: 0.1, block_gsd: 32.0, seed: 0 }
    }
}

/// Which points are kept back, one word per point. Cubes of side `block` (scene units) are drawn by their place alone.
#[must_use]
pub fn withheld(points: &[SparsePoint], block: f64, options: &WithheldOptions) -> Vec<bool> {
    let is_drawn = |point: &SparsePoint| {
        let cell = (point.position_world / block).floor().as_i64vec3();
        let key = [cell.x, cell.y, cell.z]
            .iter()
            .fold(options.seed, |key, axis| SplitMix64::new(key ^ *axis as u64).next_u64());
        SplitMix64::new(key).uniform() < options.share
    };
    let is_length = block > 0.0 && block.is_finite();
    points.iter().map(|point| is_length && options.share > 0.0 && is_drawn(point)).collect()
}

/// A point beside the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointEvidence {
    /// In the list that was given.
    pub index: u32,
    /// How far the mesh lies outside of the point, scene units.
    pub outside: f64,
    /// Standard deviation of the point in that direction, scene units.
    pub sigma: f64,
    /// Nearest face.
    pub face: u32,
}

/// What became of the points that were asked.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointWitness {
    /// Beside the mesh.
    pub near: Vec<PointEvidence>,
    /// Well fixed, but no mesh is there.
    pub without_mesh: u64,
    /// Too few rays, or false matches.
    pub unfit: u64,
    /// Noise of the rays, pixels per coordinate.
    pub noise_px: Option<f64>,
}

/// Asks the points of `asked` (indices into the scene's points). A point counts as beside the mesh within `reach` (scene
/// units) and six of its own standard deviations.
///
/// # Errors
/// A mesh without surface.
pub fn point_witness(mesh: &Mesh, scene: &Scene, asked: &[u32], reach: f64) -> Result<PointWitness, MeshError> {
    if mesh.faces.is_empty() {
        return Err(MeshError::Geometry { what: "the mesh has no surface".into(), cure: "give a mesh with faces" });
    }
    let fits: Vec<Option<Fix>> = asked.par_iter().map(|at| fix(&scene.points[*at as usize], &scene.views)).collect();
    let mut noises: Vec<f64> = fits.iter().flatten().map(|fit| fit.variance_px2.sqrt()).collect();
    let Some(noise_px) = median(&mut noises) else {
        return Ok(PointWitness { unfit: asked.len() as u64, ..PointWitness::default() });
    };
    let mut found = PointWitness { noise_px: Some(noise_px), ..PointWitness::default() };
    let noise = |fit: &Fix| {
        (fit.freedom * fit.variance_px2 + PRIOR_FREEDOM * noise_px * noise_px) / (fit.freedom + PRIOR_FREEDOM)
    };
    let is_sound = |fit: &Fix| fit.variance_px2 <= MAX_ERROR_PX * MAX_ERROR_PX;
    let places: Vec<DVec3> = asked.iter().map(|index| scene.points[*index as usize].position_world).collect();
    // The trace bounds the variance in any direction.
    let limit = |at: usize| {
        let sigma = |fit: &Fix| (noise(fit) * (0..3).map(|k| fit.cofactor.col(k)[k]).sum::<f64>()).sqrt();
        fits[at].as_ref().filter(|fit| is_sound(fit)).map_or(0.0, |fit| 1.001 * (reach + MAX_SIGMAS * sigma(fit)))
    };
    let hits = nearest(mesh, &places, 2.0 * reach, limit);
    for (((index, fit), place), hit) in asked.iter().zip(&fits).zip(places).zip(hits) {
        let Some(fit) = fit.as_ref().filter(|fit| is_sound(fit)) else {
            found.unfit += 1;
            continue;
        };
        let Some(hit) = hit else {
            found.without_mesh += 1;
            continue;
        };
        let toward = (place - hit.place).normalize_or(face_normal(mesh, hit.index));
        let sigma = (noise(fit) * toward.dot(fit.cofactor * toward)).sqrt();
        if hit.distance > reach + MAX_SIGMAS * sigma {
            found.without_mesh += 1;
            continue;
        }
        let outside = if hit.behind { hit.distance } else { -hit.distance };
        found.near.push(PointEvidence { index: *index, outside, sigma, face: hit.index });
    }
    Ok(found)
}

/// How well rays fix a point.
struct Fix {
    /// Covariance for rays of 1 px noise.
    cofactor: DMat3,
    /// Of the residuals per coordinate.
    variance_px2: f64,
    /// Observations more than unknowns.
    freedom: f64,
}

/// `None` where the rays do not fix it.
fn fix(point: &SparsePoint, views: &[View]) -> Option<Fix> {
    if point.track.len() < MIN_TRACK {
        return None;
    }
    let (mut information, mut squares) = (DMat3::ZERO, 0.0);
    for seen in &point.track {
        let view = views.get(seen.view_index as usize)?;
        let at = view.camera_from_world.transform_point(point.position_world);
        let residual = view.camera.project(at)? - DVec2::new(seen.xy_px[0].into(), seen.xy_px[1].into());
        squares += residual.length_squared();
        let world_from_camera = view.camera_from_world.rotation_matrix().transpose();
        let across = world_from_camera * DVec3::new(view.camera.fx / at.z, 0.0, -view.camera.fx * at.x / (at.z * at.z));
        let down = world_from_camera * DVec3::new(0.0, view.camera.fy / at.z, -view.camera.fy * at.y / (at.z * at.z));
        for row in [across, down] {
            information += DMat3::from_cols(row * row.x, row * row.y, row * row.z);
        }
    }
    let freedom = 2.0 * point.track.len() as f64 - 3.0;
    let cofactor = information.inverse();
    let is_fixed = cofactor.is_finite() && squares.is_finite();
    is_fixed.then_some(Fix { cofactor, variance_px2: squares / freedom, freedom })
}

#[cfg(test)]
mod tests;
