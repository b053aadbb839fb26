//! Residual flow: a patch of photograph A, carried through the mesh into photograph B, should lie where B shows it. What
//! is missing along the epipolar line is an error of depth; it is found to a small part of a pixel.
//!
//! A patch is judged where both views see the same mesh, the mesh is smooth over it, the line crosses enough texture and
//! the photographs agree somewhere near. Photographs that were kept out of training are witnesses of their own; those
//! that were learnt from have been fitted, and show how well.

use glam::{DVec2, DVec3};
use pgsag_scene::{Image, Map, Mesh, Pinhole, RigidTransform};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::render::{NO_FACE, Visibility, visibility};

mod match_line;

use match_line::{Line, Match};

/// Where and how residuals are looked for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlowOptions {
    /// Patches are `2 radius + 1` pixels wide.
    pub patch_radius: u32,
    /// At most about so many patches per pair of photographs and direction.
    pub max_patches: u32,
    /// Residuals are looked for so far to both sides, pixels.
    pub search_px: f64,
    /// Patches that correlate less where they fit best match nothing.
    pub min_ncc: f64,
    /// Patches whose residual cannot be known better than this, by the texture along the line, are not judged; pixels.
    pub max_noise_px: f64,
    /// Noise of the photographs that this is worked out with, grey levels of 255.
    pub image_noise: f64,
}

impl Default for FlowOptions {
    fn default() -> Self {
        Self { patch_radius: 4, max_patches: 1500, search_px: 3.0, min_ncc: 0.7, max_noise_px: 0.25, image_noise: 3.0 }
    }
}

/// A photograph and what the mesh looks like from its place.
pub struct FlowView {
    camera: Pinhole,
    camera_from_world: RigidTransform,
    grey: Map<f32>,
    seen: Visibility,
}

impl FlowView {
    /// Renders the mesh once; `image` must be as large as `camera` says.
    #[must_use]
    pub fn new(mesh: &Mesh, camera: Pinhole, camera_from_world: RigidTransform, image: &Image) -> Self {
        let level = |rgb: &[u8; 3]| 0.299 * f32::from(rgb[0]) + 0.587 * f32::from(rgb[1]) + 0.114 * f32::from(rgb[2]);
        let grey = Map { width: image.width, height: image.height, values: image.pixels.iter().map(level).collect() };
        Self { camera, camera_from_world, grey, seen: visibility(mesh, &camera, &camera_from_world) }
    }
}

/// What became of a patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// Too little texture along the line.
    Plain,
    /// Texture, but nothing alike within reach.
    Lost,
    /// A residual.
    Measured {
        /// Along the epipolar line, positive towards where nearer surface lies, pixels of B.
        residual_px: f64,
        /// Standard deviation of that by what is left unexplained, pixels.
        noise_px: f64,
        /// How far the mesh lies outside of (in front of) the surface that the photographs show, along its normal,
        /// scene units.
        outside: f64,
        /// Standard deviation of that.
        noise: f64,
    },
}

/// A patch that both photographs see.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Its middle in A, pixels.
    pub at_px: [f64; 2],
    /// Its middle on the mesh, world frame.
    pub place_world: [f64; 3],
    /// Face in the middle.
    pub face: u32,
    /// What became of it.
    pub verdict: Verdict,
}

/// Faces nearer to grazing than this are not judged: cosine of 78 degrees.
const MIN_COS: f64 = 0.2;
/// A patch is smooth where it keeps within so many ground sampling distances of a plane.
const MAX_FOLD_GSD: f64 = 3.0;
/// Depths agree within so many ground sampling distances, where a surface is seen as steeply as it may be.
const HIDDEN_GSD: f64 = 6.0;
/// Least motion in B for a change of depth by its own length, pixels: below, the two views are one.
const MIN_PARALLAX_PX: f64 = 8.0;

/// Distance between the middles of patches, pixels.
#[must_use]
pub fn patch_step(camera: &Pinhole, options: &FlowOptions) -> u32 {
    let area = camera.pixel_count() as f64 / f64::from(options.max_patches.max(1));
    (area.sqrt().ceil() as u32).max(options.patch_radius).max(1)
}

/// The patches of A that B sees as well, row by row.
#[must_use]
pub fn residual_flow(a: &FlowView, b: &FlowView, options: &FlowOptions) -> Vec<Patch> {
    let (step, radius) = (patch_step(&a.camera, options), options.patch_radius);
    let places = |side: u32| (step / 2 + radius..side.saturating_sub(radius)).step_by(step as usize);
    let rows: Vec<u32> = places(a.camera.height).collect();
    let pair = Pair { a, b, b_from_a: b.camera_from_world * a.camera_from_world.inverse(), options };
    let found: Vec<Vec<Patch>> =
        rows.into_par_iter().map(|y| places(a.camera.width).filter_map(|x| pair.patch(x, y)).collect()).collect();
    found.concat()
}

struct Pair<'a> {
    a: &'a FlowView,
    b: &'a FlowView,
    b_from_a: RigidTransform,
    options: &'a FlowOptions,
}

/// The mesh over a patch: inverse depth is linear in the pixels of a plane.
struct Plane {
    /// Inverse depth in the middle, and its change per pixel to the right and down.
    inverse: [f64; 3],
}

impl Plane {
    fn at(&self, dx: f64, dy: f64) -> f64 {
        self.inverse[0] + self.inverse[1] * dx + self.inverse[2] * dy
    }

    /// The normal divided by the distance from the camera, which points away from it: `scaled . X = 1` on the plane.
    fn scaled_normal(&self, camera: &Pinhole, x: f64, y: f64) -> DVec3 {
        let [middle, right, down] = self.inverse;
        DVec3::new(right * camera.fx, down * camera.fy, middle + right * (camera.cx - x) + down * (camera.cy - y))
    }
}

impl Pair<'_> {
    /// `None` where geometry alone rules a comparison out.
    fn patch(&self, x: u32, y: u32) -> Option<Patch> {
        let face = self.a.seen.face.at(x, y);
        if face == NO_FACE {
            return None;
        }
        let plane = self.plane(x, y)?;
        let (cx, cy) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
        let camera = &self.a.camera;
        let normal = plane.scaled_normal(camera, cx, cy);
        let ray = camera.ray(cx, cy);
        if plane.at(0.0, 0.0) < MIN_COS * normal.length() * ray.length() {
            return None;
        }
        let line = self.line(&plane, cx, cy)?;
        let place = self.a.camera_from_world.inverse().transform_point(ray / plane.at(0.0, 0.0));
        let verdict = match line.best(&self.a.grey, &self.b.grey, self.options) {
            Match::Plain => Verdict::Plain,
            Match::Lost => Verdict::Lost,
            Match::Found { shift_px, noise_px } => {
                // A shift by a pixel is a relative change of depth by 1 / parallax; along the normal that is a share of
                // the plane's distance from the camera.
                let units_per_px = 1.0 / (line.parallax_px * normal.length());
                Verdict::Measured {
                    residual_px: shift_px,
                    noise_px,
                    outside: -shift_px * units_per_px,
                    noise: noise_px * units_per_px,
                }
            }
        };
        Some(Patch { at_px: [cx, cy], place_world: place.into(), face, verdict })
    }

    /// The plane through the mesh over a patch, if the mesh is one there.
    fn plane(&self, x: u32, y: u32) -> Option<Plane> {
        let radius = self.options.patch_radius;
        // Every second pixel tells a plane as well, where that is symmetric about the middle.
        let step = if radius.is_multiple_of(2) { 2 } else { 1 };
        let offsets = || (0..=2 * radius).step_by(step as usize).map(|d| f64::from(d) - f64::from(radius));
        let inverse = |dx: f64, dy: f64| {
            let depth = self.a.seen.depth.at((f64::from(x) + dx) as u32, (f64::from(y) + dy) as u32);
            (depth > 0.0).then(|| 1.0 / f64::from(depth))
        };
        let (mut sum, mut right, mut down, mut squares, mut count) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (dx, dy) in offsets().flat_map(|dy| offsets().map(move |dx| (dx, dy))) {
            let value = inverse(dx, dy)?;
            sum += value;
            right += value * dx;
            down += value * dy;
            squares += dx * dx;
            count += 1.0;
        }
        let squares: f64 = if squares > 0.0 { squares } else { 1.0 };
        let plane = Plane { inverse: [sum / count, right / squares, down / squares] };
        let bound = MAX_FOLD_GSD / self.a.camera.focal_px() * plane.inverse[0];
        let is_smooth = offsets()
            .flat_map(|dy| offsets().map(move |dx| (dx, dy)))
            .all(|(dx, dy)| inverse(dx, dy).is_some_and(|value| (value - plane.at(dx, dy)).abs() <= bound));
        is_smooth.then_some(plane)
    }

    /// Where the patch lies in B, and which way it goes there when its depth changes; `None` where B does not see it.
    fn line(&self, plane: &Plane, cx: f64, cy: f64) -> Option<Line> {
        let radius = f64::from(self.options.patch_radius);
        let camera = &self.b.camera;
        let in_b = |dx: f64, dy: f64, inverse: f64| {
            let point = self.b_from_a.transform_point(self.a.camera.ray(cx + dx, cy + dy) / inverse);
            camera.project(point).map(|at| (at, point.z))
        };
        let middle = plane.at(0.0, 0.0);
        let (near, far) = (in_b(0.0, 0.0, middle * 1.001)?.0, in_b(0.0, 0.0, middle * 0.999)?.0);
        let motion = (near - far) / 0.002;
        let parallax_px = motion.length();
        if parallax_px < MIN_PARALLAX_PX {
            return None;
        }
        let reach = self.options.search_px + 2.0;
        for (dx, dy) in [(0.0, 0.0), (-radius, -radius), (radius, -radius), (-radius, radius), (radius, radius)] {
            let (at, depth) = in_b(dx, dy, plane.at(dx, dy))?;
            let (width, height) = (f64::from(camera.width), f64::from(camera.height));
            if at.x < reach || at.y < reach || at.x > width - reach || at.y > height - reach {
                return None;
            }
            let seen = f64::from(self.b.seen.depth.at(at.x as u32, at.y as u32));
            if seen <= 0.0 || (depth - seen).abs() > HIDDEN_GSD * depth / camera.focal_px() {
                return None;
            }
        }
        let side = 2 * self.options.patch_radius + 1;
        let mut places = Vec::with_capacity((side * side) as usize);
        for (y, x) in (0..side).flat_map(|y| (0..side).map(move |x| (y, x))) {
            let (dx, dy) = (f64::from(x) - radius, f64::from(y) - radius);
            let inverse = plane.at(dx, dy);
            if inverse <= 0.0 {
                return None;
            }
            places.push((DVec2::new(cx + dx, cy + dy), in_b(dx, dy, inverse)?.0));
        }
        Some(Line { places, direction: motion / parallax_px, parallax_px })
    }
}

#[cfg(test)]
mod tests;
