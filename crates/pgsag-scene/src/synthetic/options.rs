//! Every knob of the synthetic town. The defaults are the fixed knobs of `pgsag demo`.
//! Lengths are metres (the town's frame is metric), angles radians, image quantities pixels.

use serde::{Deserialize, Serialize};

/// Lens distortion in the terms of COLMAP's OPENCV model (dimensionless).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LensDistortion {
    /// Radial, second order.
    pub k1: f64,
    /// Radial, fourth order.
    pub k2: f64,
    /// Tangential.
    pub p1: f64,
    /// Tangential.
    pub p2: f64,
}

/// What the town looks like, who photographs it and how well structure-from-motion works.
/// Equal options give equal bytes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TownOptions {
    /// Seeds every random choice.
    pub seed: u64,
    /// Houses, row houses included. Their numbers are `1..=house_count`.
    pub house_count: u32,
    /// Houses of each row group that share walls (a number of its own each); below 2 there are no rows.
    pub row_house_count: u32,
    /// Share of the detached houses under flat roofs, 0 to 1.
    pub flat_roof_share: f64,
    /// Houses are turned by up to this against the streets, radians.
    pub house_yaw_rad: f64,
    /// Trees (fewer where there is no room).
    pub tree_count: u32,
    /// Parked cars.
    pub car_count: u32,
    /// Photographs.
    pub view_count: u32,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Ground sampling distance below a nadir view and at the aim of an oblique one, metres.
    pub gsd_m: f64,
    /// Focal length / image width.
    pub focal_ratio: f64,
    /// Share of the views that look straight down; the others look from four sides in turn.
    pub nadir_share: f64,
    /// Angle between the axis of an oblique view and the plumb line, radians.
    pub oblique_tilt_rad: f64,
    /// Principal point minus image centre, pixels.
    pub principal_point_offset_px: [f64; 2],
    /// Photographs are taken through this lens; `None` = a pinhole.
    pub lens: Option<LensDistortion>,
    /// Standard deviation of the logarithm of the exposure from view to view.
    pub exposure_spread: f64,
    /// Standard deviation of the image noise, grey levels of 255.
    pub image_noise: f64,
    /// Where the sun stands, radians from +x towards +y.
    pub sun_azimuth_rad: f64,
    /// Height of the sun above the horizon, radians.
    pub sun_elevation_rad: f64,
    /// Light of the sky relative to the sun's.
    pub ambient: f64,
    /// Standard deviation per axis of the error of the delivered camera centres, metres.
    pub pose_noise_position_m: f64,
    /// Standard deviation per axis of the error of the delivered rotations, radians.
    pub pose_noise_rotation_rad: f64,
    /// Sparse points.
    pub point_count: u32,
    /// Standard deviation per axis of the observations, pixels.
    pub point_noise_px: f64,
    /// How many of the views that could see a point have observed it, 0 to 1.
    pub observation_share: f64,
    /// Share of the sparse points that are false matches far from any surface.
    pub outlier_share: f64,
    /// Added to every coordinate handed out, metres (large values imitate a national grid).
    pub world_offset_m: [f64; 3],
    /// Coordinate reference system to state in the frame.
    pub epsg: Option<u32>,
    /// Lossless photographs: names end in `.png` instead of `.jpg`.
    pub lossless: bool,
}

impl Default for TownOptions {
    fn default() -> Self {
        Self {
            seed: 1,
            house_count: 6,
            row_house_count: 3,
            flat_roof_share: 0.4,
            house_yaw_rad: 0.12,
            tree_count: 12,
            car_count: 4,
            view_count: 24,
            width: 320,
            height: 240,
            gsd_m: 0.13,
            focal_ratio: 1.0,
            nadir_share: 0.25,
            oblique_tilt_rad: 0.72,
            principal_point_offset_px: [0.0, 0.0],
            lens: None,
            exposure_spread: 0.04,
            image_noise: 1.5,
            sun_azimuth_rad: -2.2,
            sun_elevation_rad: 0.9,
            ambient: 0.45,
            pose_noise_position_m: 0.0,
            pose_noise_rotation_rad: 0.0,
            point_count: 3500,
            point_noise_px: 0.4,
            observation_share: 0.6,
            outlier_share: 0.025,
            world_offset_m: [0.0; 3],
            epsg: None,
            lossless: false,
        }
    }
}

impl TownOptions {
    /// The defaults for a town of another size: more views, points, trees and cars with more parcels than the demo's four.
    #[must_use]
    pub fn for_houses(house_count: u32, row_house_count: u32) -> Self {
        let mut options = Self { house_count, row_house_count, ..Self::default() };
        let parcels = super::layout::house_groups(&options).len() as u32;
        let factor = parcels.max(4);
        options.view_count = 24 + 10 * (factor - 4);
        options.point_count = 875 * factor;
        options.tree_count = 3 * factor;
        options.car_count = factor;
        options
    }
}
