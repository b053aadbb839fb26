//! The scene's frame: what one unit is, which way is up, where on Earth it lies.

use glam::DVec3;
use serde::{Deserialize, Serialize};

pub mod eigen;
pub mod geodesy;
pub mod gps;
pub mod similarity;
pub mod up;

/// What is known of the world frame. Coordinates of every output are `Scene` coordinates; `offset` is what a
/// georeferenced reader adds to them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Metres per scene unit where it is known; `None` means lengths are measured in median depths, and it is said aloud.
    pub metres_per_unit: Option<f64>,
    /// Unit vector away from the ground, world frame.
    pub up_world: DVec3,
    /// Added to scene coordinates it gives coordinates in `epsg` (or in the local metric frame where that is unknown).
    pub offset: DVec3,
    /// Coordinate reference system of `offset + scene`, where known.
    pub epsg: Option<u32>,
    /// Vertical datum in the source's words, where known.
    pub vertical_datum: Option<String>,
    /// Latitude (deg), longitude (deg), ellipsoidal altitude (m) of the scene's origin, where known.
    pub origin_lla: Option<[f64; 3]>,
    /// Where the scale and position came from, in words for the report.
    pub source: String,
}

impl Default for Frame {
    fn default() -> Self {
        Self {
            metres_per_unit: None,
            up_world: DVec3::Z,
            offset: DVec3::ZERO,
            epsg: None,
            vertical_datum: None,
            origin_lla: None,
            source: "the model's own frame; scale unknown".into(),
        }
    }
}
