//! Distances as colours: a picture says where a mesh is wrong, a number only how much.

use glam::DVec3;
use pgsag_scene::Mesh;
use rayon::prelude::*;

use super::options::Truth;
use super::pieces::nearest;
use super::surface::{Cloud, Target};
use crate::error::MeshError;

/// Colour of a distance: green at 0 over yellow at half of `cap` to red at `cap` and beyond.
#[must_use]
pub fn distance_color(distance: f64, cap: f64) -> [u8; 3] {
    let share = (distance / cap).clamp(0.0, 1.0);
    let (red, green) = if share < 0.5 { (2.0 * share, 1.0) } else { (1.0, 2.0 - 2.0 * share) };
    [(40.0 + 200.0 * red) as u8, (40.0 + 180.0 * green) as u8, 40]
}

/// `[N]` how far places are from the truth, scene units; `cap` where nothing is nearer.
///
/// # Errors
/// A truth without surface or points.
pub fn distances_from_truth(truth: &Truth<'_>, places: &[DVec3], cap: f64) -> Result<Vec<f64>, MeshError> {
    match truth {
        Truth::Mesh(mesh) | Truth::Folder { scene: mesh, .. } => Ok(distances_from_mesh(mesh, places, cap)),
        Truth::Cloud(points) => {
            let cloud = Cloud::new(points.to_vec(), "the truth")?;
            let distance = |place: &DVec3| cloud.nearest_within(*place, cap).map_or(cap, |hit| hit.distance.min(cap));
            Ok(places.par_iter().map(distance).collect())
        }
    }
}

/// `[N]` how far places are from a mesh, scene units; `cap` where nothing is nearer.
#[must_use]
pub fn distances_from_mesh(mesh: &Mesh, places: &[DVec3], cap: f64) -> Vec<f64> {
    nearest(mesh, places, cap, |_| cap).into_iter().map(|hit| hit.map_or(cap, |hit| hit.distance.min(cap))).collect()
}
