//! A scene: views, sparse points, and the frame they live in.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::camera::Pinhole;
use crate::camera::distortion::LensCamera;
use crate::frame::Frame;
use crate::points::SparsePoint;
use crate::pose::RigidTransform;

/// One photograph and its undistorted camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Path of the image below `images/`, with `/` between folders, as the source model spells it.
    pub name: String,
    /// The camera as photographed, with its lens.
    pub lens: LensCamera,
    /// The camera after undistortion, at full size; equal to `lens` where that is a pinhole already.
    pub camera: Pinhole,
    /// COLMAP axes.
    pub camera_from_world: RigidTransform,
}

impl View {
    /// Camera centre in the world frame.
    #[must_use]
    pub fn center_world(&self) -> DVec3 {
        self.camera_from_world.origin_of_a()
    }
}

/// Everything that structure-from-motion and the user know about a place. f64 throughout.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    /// Sorted by name.
    pub views: Vec<View>,
    /// In the order of the source.
    pub points: Vec<SparsePoint>,
    /// Scale, up axis, place on Earth.
    pub frame: Frame,
}

impl Scene {
    /// Median over the views of the median depth of their tracked points, in scene units; `None` without points.
    #[must_use]
    pub fn median_depth(&self) -> Option<f64> {
        let mut depths = vec![Vec::new(); self.views.len()];
        for point in &self.points {
            for seen in &point.track {
                let view = &self.views[seen.view_index as usize];
                let z = view.camera_from_world.transform_point(point.position_world).z;
                if z > 0.0 {
                    depths[seen.view_index as usize].push(z);
                }
            }
        }
        let mut medians: Vec<f64> = depths.into_iter().filter_map(|mut d| crate::numbers::median(&mut d)).collect();
        crate::numbers::median(&mut medians)
    }
}
