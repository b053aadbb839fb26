//! Sparse points with the observations that made them.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// One observation of a sparse point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrackElement {
    /// Index into `Scene::views`.
    pub view_index: u32,
    /// Where the point was seen, in pixels of the view's undistorted image (pixel centre at + 0.5).
    pub xy_px: [f32; 2],
}

/// A point that structure-from-motion left behind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SparsePoint {
    /// World frame.
    pub position_world: DVec3,
    /// RGB.
    pub color: [u8; 3],
    /// Mean reprojection error, pixels; 0 where unknown.
    pub error_px: f32,
    /// Who saw it; empty where the source keeps no tracks.
    pub track: Vec<TrackElement>,
}
