//! A small town with exact truth, photographed by a ray caster.
//! Houses under gabled and flat roofs, a row that shares walls, streets, gardens, trees and cars; sun, sky and shadow;
//! nadir and oblique views; sparse points as structure-from-motion leaves them.
//! A pure function of [`TownOptions`]: the same bytes on any machine and any number of threads.

mod bvh;
mod flight;
mod layout;
mod options;
mod photography;
mod solids;
mod survey;
mod texture;
mod truth;

#[cfg(test)]
mod tests;

use glam::DVec3;

pub use options::{LensDistortion, TownOptions};
pub use photography::Photograph;
pub use truth::{Roof, TownBuilding};

use crate::camera::undistort::pinhole_for;
use crate::frame::Frame;
use crate::numbers::SplitMix64;
use crate::pose::RigidTransform;
use crate::scene::{Scene, View};
use bvh::Bvh;
use layout::Layout;
use solids::Solids;

/// The town, its views, and all that is true about it.
pub struct Town {
    /// Poses and points as structure-from-motion would leave them; the pose noise is in them.
    pub scene: Scene,
    /// What it was made from.
    pub options: TownOptions,
    /// `[views]`, the poses the photographs are taken from, in the town's own frame (without `world_offset_m`).
    true_poses: Vec<RigidTransform>,
    /// `[views]`, factors on the light.
    exposures: Vec<f64>,
    layout: Layout,
    solids: Solids,
    bvh: Bvh,
    /// Unit vector towards the sun.
    sun: DVec3,
}

impl Town {
    /// Builds the town, places the views and surveys the points; photographs are taken on demand.
    #[must_use]
    pub fn generate(options: &TownOptions) -> Self {
        let layout = Layout::new(options);
        let solids = Solids::new(&layout);
        let corners: Vec<[DVec3; 3]> = (0..solids.faces.len()).map(|face| solids.corners(face)).collect();
        let (azimuth, elevation) = (options.sun_azimuth_rad, options.sun_elevation_rad);
        let flat = libm::cos(elevation);
        let sun = DVec3::new(flat * libm::cos(azimuth), flat * libm::sin(azimuth), libm::sin(elevation));
        let mut random = SplitMix64::new(options.seed ^ 0x000E_7905);
        let true_poses = flight::poses(options, &layout);
        let exposures = true_poses.iter().map(|_| libm::exp(options.exposure_spread * random.normal())).collect();
        let mut town = Self {
            scene: Scene { frame: frame(options), ..Scene::default() },
            options: options.clone(),
            true_poses,
            exposures,
            bvh: Bvh::new(&corners),
            layout,
            solids,
            sun,
        };
        town.scene.views = town.views();
        town.scene.points = town.survey();
        town
    }

    /// The true camera of a view, world frame. Panics where there is no such view.
    #[must_use]
    pub fn true_camera_from_world(&self, view_index: usize) -> RigidTransform {
        self.true_poses[view_index].with_origin(-self.offset())
    }

    fn offset(&self) -> DVec3 {
        DVec3::from_array(self.options.world_offset_m)
    }

    fn views(&self) -> Vec<View> {
        let lens = flight::camera(&self.options);
        let camera = pinhole_for(&lens);
        let suffix = if self.options.lossless { "png" } else { "jpg" };
        let digits = self.true_poses.len().saturating_sub(1).to_string().len().max(3);
        let deliver = |(k, pose): (usize, &RigidTransform)| View {
            name: format!("town_{k:0digits$}.{suffix}"),
            lens: lens.clone(),
            camera,
            camera_from_world: flight::disturbed(&self.options, pose, k).with_origin(-self.offset()),
        };
        self.true_poses.iter().enumerate().map(deliver).collect()
    }
}

fn frame(options: &TownOptions) -> Frame {
    Frame {
        metres_per_unit: Some(1.0),
        epsg: options.epsg,
        source: "synthetic town: exact metres".into(),
        ..Frame::default()
    }
}
