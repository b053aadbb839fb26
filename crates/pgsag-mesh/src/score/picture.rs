//! Distances as colours: a picture says where a mesh is wrong, a number only how much.

use glam::DVec3;
use pgsag_scene::Mesh;
use rayon::prelude::*;

use super::judge::Known;
use super::options::Truth;
use super::surface::{Surface, Target};
use crate::error::MeshError;

/// Colour of a distance: green at 0 over yellow at half of `cap` to red at `cap` and beyond.
#[must_use]
pub fn distance_color(distance: f64, cap: f64) -> [u8; 3] {
    let share = (distance / cap).clamp(0.0, 1.0);
    let (red, green) = if share < 0.5 { (2.0 * share, 1.0) } else { (1.0, 2.0 - 2.0 * share) };
    [(40.0 + 200.0 * red) as u8, (40.0 + 180.0 * green) as u8, 40]
}

/// The mesh with every vertex coloured by its distance to the truth, red from `cap` (scene units) on.
///
/// # Errors
/// A truth without surface or points.
pub fn accuracy_map(mesh: &Mesh, truth: &Truth<'_>, cap: f64) -> Result<Mesh, MeshError> {
    let known = Known::new(truth)?;
    let colors = mesh
        .vertices
        .par_iter()
        .map(|v| {
            let hit = known.target().nearest_within(DVec3::from(*v), f64::MAX);
            distance_color(hit.map_or(cap, |hit| hit.distance), cap)
        })
        .collect();
    Ok(Mesh { colors, ..mesh.clone() })
}

/// One colour per truth point by its distance to the mesh's surface.
///
/// # Errors
/// A mesh without surface.
pub fn completeness_colors(mesh: &Mesh, points: &[[f64; 3]], cap: f64) -> Result<Vec<[u8; 3]>, MeshError> {
    let surface = Surface::new(mesh, "the mesh")?;
    Ok(points
        .par_iter()
        .map(|p| {
            let hit = surface.nearest_within(DVec3::from(*p), f64::MAX);
            distance_color(hit.map_or(cap, |hit| hit.distance), cap)
        })
        .collect())
}
