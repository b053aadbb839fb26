//! Removing lens distortion: the target pinhole and the resampling of an image into it.
//!
//! The target is the one that COLMAP's `image_undistorter` makes with its default options (no blank pixels, scale
//! 0.2 to 2): a model undistorted by COLMAP and one undistorted here have the same cameras. Resampling is bilinear at
//! pixel centres; windows allow a crop to be made without the rest of the image.

use glam::DVec2;
use rayon::prelude::*;

use super::Pinhole;
use super::distortion::{Lens, LensCamera};
use crate::image::Image;
use crate::maps::Map;

/// Smallest change of size by undistortion (COLMAP's `min_scale`).
const MIN_SCALE: f64 = 0.2;
/// Largest change of size by undistortion (COLMAP's `max_scale`).
const MAX_SCALE: f64 = 2.0;

/// A window of an image, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Left column.
    pub x0: u32,
    /// Top row.
    pub y0: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Window {
    /// All of a camera's image.
    #[must_use]
    pub fn full(camera: &Pinhole) -> Self {
        Self { x0: 0, y0: 0, width: camera.width, height: camera.height }
    }
}

/// The pinhole that an image of `lens` is undistorted to: COLMAP's `UndistortCamera` with default options. The focal
/// lengths stay; the size is chosen so that no pixel along the border is blank.
#[must_use]
pub fn pinhole_for(lens: &LensCamera) -> Pinhole {
    let mut target = lens.without_distortion();
    if lens.model.is_pinhole() {
        return target;
    }
    let prepared = Lens::new(lens);
    let (width, height) = (f64::from(lens.width), f64::from(lens.height));
    let trace = |xy_px: DVec2| prepared.unproject(xy_px).and_then(|ray| target.project(ray));
    let column = |x: f64| extent((0..lens.height).filter_map(|y| Some(trace(DVec2::new(x, f64::from(y) + 0.5))?.x)));
    let row = |y: f64| extent((0..lens.width).filter_map(|x| Some(trace(DVec2::new(f64::from(x) + 0.5, y))?.y)));
    let (left, right) = (column(0.5), column(width - 0.5));
    let (top, bottom) = (row(0.5), row(height - 0.5));

    let max_scale_x = (target.cx / (target.cx - left.1)).max((width - 0.5 - target.cx) / (right.0 - target.cx));
    let max_scale_y = (target.cy / (target.cy - top.1)).max((height - 0.5 - target.cy) / (bottom.0 - target.cy));
    let grow = |scale: f64| if scale.is_finite() { (1.0 / scale).clamp(MIN_SCALE, MAX_SCALE) } else { 1.0 };
    target.width = (grow(max_scale_x) * width).max(1.0) as u32;
    target.height = (grow(max_scale_y) * height).max(1.0) as u32;
    target.cx = target.cx * f64::from(target.width) / width;
    target.cy = target.cy * f64::from(target.height) / height;
    target
}

/// Smallest and largest of some values.
fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)))
}

/// Where a pixel of the photograph lies in the undistorted image; `None` where the lens has no ray for it.
#[must_use]
pub fn undistort_point(xy_px: DVec2, lens: &LensCamera, target: &Pinhole) -> Option<DVec2> {
    if lens.model.is_pinhole() && lens.without_distortion() == *target {
        return Some(xy_px);
    }
    target.project(lens.unproject(xy_px)?)
}

/// Where a pixel of the undistorted image lies in the photograph; `None` where the lens does not see it.
#[must_use]
pub fn distort_point(xy_px: DVec2, lens: &LensCamera, target: &Pinhole) -> Option<DVec2> {
    if lens.model.is_pinhole() && lens.without_distortion() == *target {
        return Some(xy_px);
    }
    lens.project(target.ray(xy_px.x, xy_px.y))
}

/// The photograph resampled into `target`, bilinear; black where the photograph has nothing.
#[must_use]
pub fn undistort(image: &Image, lens: &LensCamera, target: &Pinhole) -> Image {
    undistort_window(image, lens, target, Window::full(target))
}

/// A window of [`undistort`], the same bytes as cropping the whole.
#[must_use]
pub fn undistort_window(image: &Image, lens: &LensCamera, target: &Pinhole, window: Window) -> Image {
    if lens.without_distortion() == *target && lens.model.is_pinhole() {
        return image.cropped(window.x0, window.y0, window.width, window.height);
    }
    let pixel = |at: DVec2| {
        let (corners, weights) = bilinear(at, image.width, image.height);
        let mut sum = [0.5f32; 3];
        for (corner, weight) in corners.into_iter().zip(weights) {
            let color = image.pixels[corner];
            (0..3).for_each(|c| sum[c] += weight * f32::from(color[c]));
        }
        sum.map(|value| value as u8)
    };
    let pixels = resample(lens, target, window, [0; 3], pixel);
    Image { width: window.width, height: window.height, pixels }
}

/// A building mask resampled into `target`: true where at least half of the bilinear weight is; false where the
/// photograph has nothing.
#[must_use]
pub fn undistort_mask(mask: &Map<bool>, lens: &LensCamera, target: &Pinhole) -> Map<bool> {
    undistort_mask_window(mask, lens, target, Window::full(target))
}

/// A window of [`undistort_mask`].
#[must_use]
pub fn undistort_mask_window(mask: &Map<bool>, lens: &LensCamera, target: &Pinhole, window: Window) -> Map<bool> {
    let pixel = |at: DVec2| {
        let (corners, weights) = bilinear(at, mask.width, mask.height);
        let inside = corners.into_iter().zip(weights).filter(|(corner, _)| mask.values[*corner]);
        inside.map(|(_, weight)| weight).sum::<f32>() >= 0.5
    };
    let values = resample(lens, target, window, false, pixel);
    Map { width: window.width, height: window.height, values }
}

/// A map of instance numbers resampled into `target` by the nearest pixel; 0 where the photograph has nothing.
#[must_use]
pub fn undistort_instances(instances: &Map<u16>, lens: &LensCamera, target: &Pinhole) -> Map<u16> {
    let pixel =
        |at: DVec2| instances.at((at.x as u32).min(instances.width - 1), (at.y as u32).min(instances.height - 1));
    let values = resample(lens, target, Window::full(target), 0, pixel);
    Map { width: target.width, height: target.height, values }
}

/// Where a window of the undistorted image has a pixel of the photograph behind it.
#[must_use]
pub fn validity(lens: &LensCamera, target: &Pinhole, window: Window) -> Map<bool> {
    let values = resample(lens, target, window, false, |_| true);
    Map { width: window.width, height: window.height, values }
}

/// Calls `pixel` with the place in the photograph behind every pixel of the window; `outside` where there is none.
fn resample<T: Copy + Send + Sync>(
    lens: &LensCamera,
    target: &Pinhole,
    window: Window,
    outside: T,
    pixel: impl Fn(DVec2) -> T + Sync,
) -> Vec<T> {
    let prepared = Lens::new(lens);
    let (width, height) = (f64::from(lens.width), f64::from(lens.height));
    let mut values = vec![outside; window.width as usize * window.height as usize];
    values.par_chunks_mut((window.width as usize).max(1)).enumerate().for_each(|(row, values)| {
        let y = f64::from(window.y0) + row as f64 + 0.5;
        for (column, value) in values.iter_mut().enumerate() {
            let x = f64::from(window.x0) + column as f64 + 0.5;
            let at = prepared.project(target.ray(x, y));
            if let Some(at) = at.filter(|at| at.x >= 0.0 && at.y >= 0.0 && at.x < width && at.y < height) {
                *value = pixel(at);
            }
        }
    });
    values
}

/// Indices and weights of the four pixels around image coordinates; beyond the outermost centres the border counts.
fn bilinear(at: DVec2, width: u32, height: u32) -> ([usize; 4], [f32; 4]) {
    let (last_x, last_y) = (width as usize - 1, height as usize - 1);
    let (x, y) = ((at.x - 0.5).max(0.0), (at.y - 0.5).max(0.0));
    let (x0, y0) = ((x as usize).min(last_x), (y as usize).min(last_y));
    let (x1, y1) = ((x0 + 1).min(last_x), (y0 + 1).min(last_y));
    let (tx, ty) = ((x - x0 as f64) as f32, (y - y0 as f64) as f32);
    let (top, bottom) = (y0 * width as usize, y1 * width as usize);
    let weights = [(1.0 - tx) * (1.0 - ty), tx * (1.0 - ty), (1.0 - tx) * ty, tx * ty];
    ([top + x0, top + x1, bottom + x0, bottom + x1], weights)
}

#[cfg(test)]
mod tests;
