//! The knobs of `pgsag town` on the command line: one option per field of `TownOptions`, angles in degrees.
//! What is left out has the value of the demo; views, points, trees and cars grow with the town.

use pgsag_scene::synthetic::{LensDistortion, TownOptions};

use super::FolderOptions;

/// What the town looks like, who photographs it and how well structure-from-motion works.
#[derive(clap::Args, Clone, Debug, PartialEq)]
pub struct TownArgs {
    /// Seed of every random choice
    #[arg(long, default_value_t = 1, value_name = "S")]
    pub seed: u64,
    /// Houses, row houses included
    #[arg(long, default_value_t = 6, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=2000))]
    pub houses: u32,
    /// Houses of a row that share walls; 0 = no rows
    #[arg(long, default_value_t = 3, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=6))]
    pub row_houses: u32,
    /// Share of the detached houses under flat roofs, 0 to 1
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub flat_roofs: Option<f64>,
    /// Largest turn of a house against its street, degrees
    #[arg(long, value_name = "DEG", value_parser = tilt)]
    pub house_yaw_deg: Option<f64>,
    /// Trees [default: 3 for each parcel]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=10_000))]
    pub trees: Option<u32>,
    /// Parked cars [default: 1 for each parcel]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1000))]
    pub cars: Option<u32>,
    /// Photographs [default: 24, and 10 for each parcel beyond four]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=20_000))]
    pub views: Option<u32>,
    /// Image width, pixels
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..=16_384))]
    pub width: Option<u32>,
    /// Image height, pixels
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..=16_384))]
    pub height: Option<u32>,
    /// Ground sampling distance, metres; with the image size it sets the height of flight
    #[arg(long, value_name = "M", value_parser = positive)]
    pub gsd: Option<f64>,
    /// Focal length divided by the image width
    #[arg(long, value_name = "RATIO", value_parser = positive)]
    pub focal_ratio: Option<f64>,
    /// Share of the views that look straight down, 0 to 1
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub nadir_share: Option<f64>,
    /// Angle of the oblique views from the plumb line, degrees
    #[arg(long, value_name = "DEG", value_parser = tilt)]
    pub oblique_tilt_deg: Option<f64>,
    /// Principal point minus image centre, pixels: X Y
    #[arg(long, num_args = 2, value_names = ["X", "Y"], allow_negative_numbers = true, value_parser = finite)]
    pub principal_point_offset: Option<Vec<f64>>,
    /// Photograph through a lens: K1 K2 P1 P2 of COLMAP's OPENCV model
    #[arg(long, num_args = 4, value_names = ["K1", "K2", "P1", "P2"], allow_negative_numbers = true, value_parser = finite)]
    pub lens: Option<Vec<f64>>,
    /// Spread of the exposure: standard deviation of its logarithm
    #[arg(long, value_name = "SIGMA", value_parser = not_negative)]
    pub exposure_spread: Option<f64>,
    /// Image noise: standard deviation, grey levels of 255
    #[arg(long, value_name = "LEVELS", value_parser = not_negative)]
    pub image_noise: Option<f64>,
    /// Azimuth of the sun, degrees from east towards north
    #[arg(long, value_name = "DEG", allow_negative_numbers = true, value_parser = finite)]
    pub sun_azimuth_deg: Option<f64>,
    /// Height of the sun above the horizon, degrees
    #[arg(long, value_name = "DEG", value_parser = elevation)]
    pub sun_elevation_deg: Option<f64>,
    /// Light of the sky relative to the sun's
    #[arg(long, value_name = "RATIO", value_parser = not_negative)]
    pub ambient: Option<f64>,
    /// Error of the delivered camera centres: standard deviation per axis, metres
    #[arg(long, value_name = "M", value_parser = not_negative)]
    pub pose_noise: Option<f64>,
    /// Error of the delivered rotations: standard deviation per axis, degrees
    #[arg(long, value_name = "DEG", value_parser = not_negative)]
    pub pose_noise_deg: Option<f64>,
    /// Sparse points [default: 875 for each parcel, at least 3500]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=10_000_000))]
    pub points: Option<u32>,
    /// Noise of the observations: standard deviation per axis, pixels
    #[arg(long, value_name = "PX", value_parser = not_negative)]
    pub point_noise: Option<f64>,
    /// Share of the views that could see a point and have observed it, 0 to 1
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub observation_share: Option<f64>,
    /// Share of false points far from any surface, 0 to 1
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub outlier_share: Option<f64>,
    /// Added to all coordinates, metres (imitates a national grid): X Y Z
    #[arg(long, num_args = 3, value_names = ["X", "Y", "Z"], allow_negative_numbers = true, value_parser = finite)]
    pub world_offset: Option<Vec<f64>>,
    /// Coordinate reference system to state
    #[arg(long, value_name = "EPSG")]
    pub epsg: Option<u32>,
    /// Lossless photographs (PNG instead of JPEG)
    #[arg(long)]
    pub png: bool,
    /// Also hand out the exact masks in SCENE/masks
    #[arg(long)]
    pub exact_masks: bool,
    /// Leave out truth/depth
    #[arg(long)]
    pub no_depth: bool,
    /// One visible truth point per square of this side, metres
    #[arg(long, default_value_t = 0.15, value_name = "M", value_parser = spacing)]
    pub visible_spacing: f64,
}

impl TownArgs {
    /// What [`pgsag_scene::synthetic::Town::generate`] is asked for.
    #[must_use]
    pub fn town_options(&self) -> TownOptions {
        let base = TownOptions::for_houses(self.houses, self.row_houses);
        let radians = |degrees: Option<f64>, otherwise: f64| degrees.map_or(otherwise, f64::to_radians);
        let array = |values: &Option<Vec<f64>>| values.clone().unwrap_or_default();
        TownOptions {
            seed: self.seed,
            flat_roof_share: self.flat_roofs.unwrap_or(base.flat_roof_share),
            house_yaw_rad: radians(self.house_yaw_deg, base.house_yaw_rad),
            tree_count: self.trees.unwrap_or(base.tree_count),
            car_count: self.cars.unwrap_or(base.car_count),
            view_count: self.views.unwrap_or(base.view_count),
            width: self.width.unwrap_or(base.width),
            height: self.height.unwrap_or(base.height),
            gsd_m: self.gsd.unwrap_or(base.gsd_m),
            focal_ratio: self.focal_ratio.unwrap_or(base.focal_ratio),
            nadir_share: self.nadir_share.unwrap_or(base.nadir_share),
            oblique_tilt_rad: radians(self.oblique_tilt_deg, base.oblique_tilt_rad),
            principal_point_offset_px: array(&self.principal_point_offset)
                .try_into()
                .unwrap_or(base.principal_point_offset_px),
            lens: <[f64; 4]>::try_from(array(&self.lens)).ok().map(|[k1, k2, p1, p2]| LensDistortion {
                k1,
                k2,
                p1,
                p2,
            }),
            exposure_spread: self.exposure_spread.unwrap_or(base.exposure_spread),
            image_noise: self.image_noise.unwrap_or(base.image_noise),
            sun_azimuth_rad: radians(self.sun_azimuth_deg, base.sun_azimuth_rad),
            sun_elevation_rad: radians(self.sun_elevation_deg, base.sun_elevation_rad),
            ambient: self.ambient.unwrap_or(base.ambient),
            pose_noise_position_m: self.pose_noise.unwrap_or(base.pose_noise_position_m),
            pose_noise_rotation_rad: radians(self.pose_noise_deg, base.pose_noise_rotation_rad),
            point_count: self.points.unwrap_or(base.point_count),
            point_noise_px: self.point_noise.unwrap_or(base.point_noise_px),
            observation_share: self.observation_share.unwrap_or(base.observation_share),
            outlier_share: self.outlier_share.unwrap_or(base.outlier_share),
            world_offset_m: array(&self.world_offset).try_into().unwrap_or(base.world_offset_m),
            epsg: self.epsg,
            lossless: self.png,
            ..base
        }
    }

    /// What [`super::write_town_with`] is asked for.
    #[must_use]
    pub fn folder_options(&self) -> FolderOptions {
        FolderOptions { masks: self.exact_masks, depth: !self.no_depth, visible_spacing_m: self.visible_spacing }
    }
}

/// A number inside a closed interval, or a sentence about it.
fn within(text: &str, low: f64, high: f64, what: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    if value >= low && value <= high { Ok(value) } else { Err(format!("{what}, between {low} and {high}")) }
}

fn share(text: &str) -> Result<f64, String> {
    within(text, 0.0, 1.0, "a share is needed")
}

fn positive(text: &str) -> Result<f64, String> {
    within(text, 1e-3, 1e3, "a length or ratio is needed")
}

fn spacing(text: &str) -> Result<f64, String> {
    within(text, 0.01, 100.0, "a length in metres is needed")
}

fn not_negative(text: &str) -> Result<f64, String> {
    within(text, 0.0, 1e3, "a number is needed")
}

fn finite(text: &str) -> Result<f64, String> {
    within(text, -1e9, 1e9, "a number is needed")
}

fn tilt(text: &str) -> Result<f64, String> {
    within(text, 0.0, 80.0, "an angle in degrees is needed")
}

fn elevation(text: &str) -> Result<f64, String> {
    within(text, 5.0, 90.0, "an angle in degrees is needed")
}
