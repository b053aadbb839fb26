//! What stages are expected to need before anything is known but cameras: for `pgsag plan` of a fresh scene. Once the
//! stages above have run, each stage's own estimate takes its place.

use pgsag_scene::Scene;
use pgsag_splat::train::density::bytes_per_gaussian;

use super::coarse::stereo_camera;
use super::group::budget;
use super::train::{BYTES_PER_PIXEL, MAX_GROWTH, MAX_GROWTH_FLOOR};
use crate::config::Config;
use crate::photographs::training_camera;
use crate::run::stage::Cost;

/// Images that see a place in a usual flight.
const OVERLAP: u64 = 10;

/// Sizes of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Forecast {
    views: u64,
    /// Pixels of the largest training image.
    pixels: u64,
    /// Pixels of the largest image that is matched by stereo.
    matched: u64,
    points: u64,
    gaussians: u64,
    /// Of the largest group: clusters that do not fit into memory are cut.
    largest_group: u64,
    gaussian_bytes: u64,
    iterations: u64,
}

impl Forecast {
    /// Of a scene under a configuration.
    #[must_use]
    pub fn new(scene: &Scene, config: &Config) -> Self {
        let largest = |longest_px: u32| {
            let sizes = scene.views.iter().map(|view| training_camera(&view.camera, longest_px).pixel_count() as u64);
            sizes.max().unwrap_or(0)
        };
        let (views, pixels) = (scene.views.len() as u64, largest(config.image_width));
        let matched = if config.coarse.stereo {
            scene.views.iter().map(|view| stereo_camera(&view.camera, config).pixel_count() as u64).max().unwrap_or(0)
        } else {
            0
        };
        let cell = config.coarse.cell_gsd;
        let sparse = scene.points.len() as u64;
        let by_stereo = ((views * pixels / OVERLAP) as f64 / (cell * cell)) as u64;
        let points = if config.coarse.stereo { by_stereo.max(sparse) } else { sparse };
        let gaussians = (8 * points + 20_000).min(config.train.density.max_gaussians as u64);
        let group_points =
            if config.masks == "none" { points } else { budget(scene, config).map_or(points, |most| most as u64) };
        let grown = config.train.gaussian_bound(group_points as usize) as u64;
        let largest_group = gaussians.min(MAX_GROWTH as u64 * group_points + MAX_GROWTH_FLOOR as u64).min(grown);
        let gaussian_bytes = bytes_per_gaussian(config.initialise.sh_degree);
        let iterations = u64::from(config.train.iterations);
        Self { views, pixels, matched, points, gaussians, largest_group, gaussian_bytes, iterations }
    }

    /// Of one stage, all its jobs together but for memory, which is that of its largest job; `None` for stages whose
    /// needs are small.
    #[must_use]
    pub fn cost(&self, stage: &str) -> Option<Cost> {
        let Self { views, pixels, matched, points, gaussians, largest_group, gaussian_bytes, iterations } = *self;
        let all = views * pixels;
        let (memory_bytes, disk_bytes, cpu_secs) = match stage {
            "coarse" => {
                (8 * pixels + 700 * matched + 200 * points, 34 * views * matched, 50e-6 * (views * matched) as f64)
            }
            "masks" | "refine" => (64 * pixels, all / 30, 100e-9 * all as f64),
            "train" => {
                let step = pixels as f64 * 1.2e-6 + gaussians as f64 * 0.1e-6;
                let held = largest_group * gaussian_bytes + BYTES_PER_PIXEL * pixels;
                (held + held * 2 / 3, 180 * gaussians / 4, iterations as f64 * step)
            }
            "depth" => (200 * largest_group + 200 * pixels, 8 * all, 1.5e-6 * all as f64),
            "fuse" => (160 * pixels, 9 * all, 60e-9 * all as f64),
            "mesh" => (80 * pixels + (1 << 30), 30 * all / OVERLAP, 2e-6 * all as f64),
            "merge" | "report" => (300 * all / OVERLAP, 60 * all / OVERLAP, 1e-6 * (all / OVERLAP) as f64),
            _ => return None,
        };
        Some(Cost { memory_bytes: memory_bytes + (128 << 20), disk_bytes, cpu_secs })
    }
}

#[cfg(test)]
mod tests {
    use pgsag_scene::synthetic::{Town, TownOptions};

    use super::*;

    #[test]
    fn twice_the_width_needs_four_times_the_pixels() {
        let options = TownOptions { view_count: 4, point_count: 50, ..TownOptions::default() };
        let scene = Town::generate(&options).scene;
        let cost = |image_width: u32| {
            let config = Config { image_width, ..Config::default() };
            Forecast::new(&scene, &config).cost("depth").expect("depth is large").disk_bytes
        };
        assert_eq!(cost(320), 4 * cost(160));
        assert_eq!(Forecast::new(&scene, &Config::default()).cost("vote"), None);
    }
}
