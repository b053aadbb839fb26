//! Distances as colours: a picture says where a mesh is wrong, a number only how much.

use glam::DVec3;
use pgsag_scene::Mesh;

use super::options::Truth;
use super::surface::{Cloud, Surface, Target};
use crate::error::MeshError;

/// Colour of a distance: green at 0 over yellow at half of `cap` to red at `cap` and beyond.
#[must_use]
pub fn distance_color(distance: f64, cap: f64) -> [u8; 3] {
    let share = (distance / cap).clamp(0.0, 1.0);
    let (red, green) = if share < 0.5 { (2.0 * share, 1.0) } else { (1.0, 2.0 - 2.0 * share) };
    [(40.0 + 200.0 * red) as u8, (40.0 + 180.0 * green) as u8, 40]
}

/// Answers how far places are from one surface or cloud.
pub struct Nearest(Box<dyn Target>);

impl Nearest {
    /// From the truth.
    ///
    /// # Errors
    /// A truth without surface or points.
    pub fn of_truth(truth: &Truth<'_>) -> Result<Self, MeshError> {
        Ok(Self(match truth {
            Truth::Mesh(mesh) | Truth::Folder { scene: mesh, .. } => Box::new(Surface::new(mesh, "the truth")?),
            Truth::Cloud(points) => Box::new(Cloud::new(points.to_vec(), "the truth")?),
        }))
    }

    /// From a mesh.
    ///
    /// # Errors
    /// A mesh without surface.
    pub fn of_mesh(mesh: &Mesh) -> Result<Self, MeshError> {
        Ok(Self(Box::new(Surface::new(mesh, "the mesh")?)))
    }

    /// Scene units; `cap` where nothing is nearer, which is found out sooner.
    #[must_use]
    pub fn distance(&self, place: DVec3, cap: f64) -> f64 {
        self.0.nearest_within(place, cap).map_or(cap, |hit| hit.distance.min(cap))
    }
}
