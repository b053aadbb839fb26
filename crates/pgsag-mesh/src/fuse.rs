//! Depth maps of single views: what they hold, how they are checked against one another, and how the maps of buildings
//! and background become one per image (paper 4.4; method 3.8, 8.4, 8.11).

use pgsag_scene::{Image, Map, Pinhole, RigidTransform};

use crate::error::MeshError;

mod filter;
mod merge;
mod support;

pub use filter::{FilterOptions, filter};
pub use merge::{Border, MEETING_VOXELS, combine, merge_views};
pub use support::{Points, SupportOptions, supported};

/// One posed depth map.
#[derive(Clone, Debug)]
pub struct DepthView<'a> {
    /// Of the size of the maps.
    pub camera: Pinhole,
    /// COLMAP axes.
    pub camera_from_world: RigidTransform,
    /// Depth along the optical axis, scene units; 0 where there is none.
    pub depth: Map<f32>,
    /// Confidence, 0 or more (accumulated opacity; 1 = a sure pixel); incidence and distance are weighed by us.
    pub weight: Map<f32>,
    /// Unit normals towards the camera, camera frame, where the renderer knows them; zero where it does not.
    pub normal: Option<Map<[f32; 3]>>,
    /// Colours of the surface, of the size of the maps.
    pub color: Option<&'a Image>,
}

impl DepthView<'_> {
    /// Whether all rasters have the size of the camera.
    ///
    /// # Errors
    /// One has not.
    pub fn check(&self) -> Result<(), MeshError> {
        let size = |what, width, height, count: usize| {
            let camera = &self.camera;
            if width == camera.width && height == camera.height && count == camera.pixel_count() {
                return Ok(());
            }
            let (found_width, found_height) = (width, height);
            Err(MeshError::Size { what, width: camera.width, height: camera.height, found_width, found_height })
        };
        size("the depth map", self.depth.width, self.depth.height, self.depth.values.len())?;
        size("the weight map", self.weight.width, self.weight.height, self.weight.values.len())?;
        if let Some(map) = &self.normal {
            size("the normal map", map.width, map.height, map.values.len())?;
        }
        self.color.map_or(Ok(()), |image| size("the image", image.width, image.height, image.pixels.len()))
    }
}

/// A checked depth map of one view. All rasters have the same size.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    /// Depth along the optical axis, scene units; 0 where there is none.
    pub depth: Map<f32>,
    /// Confidence; 0 where there is no depth.
    pub weight: Map<f32>,
    /// Unit normals, camera frame, where they are known; zero where not.
    pub normal: Option<Map<[f32; 3]>>,
    /// How many other views agree; 0 with a depth means that one view alone vouches for it.
    pub support: Map<u8>,
}

impl DepthMap {
    /// A map without a single depth.
    #[must_use]
    pub fn empty(width: u32, height: u32) -> Self {
        Self {
            depth: Map::filled(width, height, 0.0),
            weight: Map::filled(width, height, 0.0),
            normal: None,
            support: Map::filled(width, height, 0),
        }
    }

    /// The map with its pose and colours, ready for the volume.
    #[must_use]
    pub fn into_view(self, camera: Pinhole, camera_from_world: RigidTransform, color: Option<&Image>) -> DepthView<'_> {
        DepthView { camera, camera_from_world, depth: self.depth, weight: self.weight, normal: self.normal, color }
    }

    /// Share of the pixels with a depth.
    #[must_use]
    pub fn coverage(&self) -> f64 {
        let with = self.depth.values.iter().filter(|z| **z > 0.0).count();
        with as f64 / self.depth.values.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests;
