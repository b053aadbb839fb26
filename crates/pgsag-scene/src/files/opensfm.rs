//! OpenSfM and OpenDroneMap: `reconstruction.json`, with the observations of `tracks.csv` where there is one.
//!
//! Rotations are axis times angle, world to camera, in COLMAP's camera axes. Image coordinates and focal lengths are in
//! units of the longer side, about the image's middle. The world is east-north-up in metres about `reference_lla`
//! (OpenSfM documentation, "Reconstruction format", "Camera models").

use std::collections::BTreeMap;

use glam::{DQuat, DVec3};
use serde::Deserialize;

use super::Note;
use super::colmap::check_name;
use super::georef::ReferenceLla;
use super::json;
use super::lines::{lines, text};
use crate::camera::distortion::{LensCamera, LensModel};
use crate::camera::undistort::{pinhole_for, undistort_point};
use crate::error::{FileError, Place};
use crate::frame::Frame;
use crate::points::{SparsePoint, TrackElement};
use crate::pose::RigidTransform;
use crate::scene::{Scene, View};

#[derive(Deserialize)]
struct Reconstruction {
    #[serde(default)]
    cameras: BTreeMap<String, Camera>,
    #[serde(default)]
    shots: BTreeMap<String, Shot>,
    #[serde(default)]
    points: BTreeMap<String, Point>,
    reference_lla: Option<ReferenceLla>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Camera {
    projection_type: String,
    width: u32,
    height: u32,
    focal: Option<f64>,
    focal_x: Option<f64>,
    focal_y: Option<f64>,
    c_x: f64,
    c_y: f64,
    k1: f64,
    k2: f64,
    k3: f64,
    k4: f64,
    p1: f64,
    p2: f64,
}

#[derive(Deserialize)]
struct Shot {
    rotation: [f64; 3],
    translation: [f64; 3],
    camera: String,
}

#[derive(Deserialize)]
struct Point {
    #[serde(default)]
    color: [f64; 3],
    coordinates: [f64; 3],
}

/// A reconstruction as a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reconstructed {
    /// Views sorted by name; points sorted by their track's name; tracks empty until [`Self::add_tracks`].
    pub scene: Scene,
    /// Per point: the name of its track.
    pub point_names: Vec<String>,
    /// The origin of the local frame, where the reconstruction says it.
    pub reference_lla: Option<[f64; 3]>,
    /// What the owner should know.
    pub notes: Vec<Note>,
}

/// Reads `reconstruction.json`; of several reconstructions the one with the most photographs.
///
/// # Errors
/// [`FileError`]: no JSON, a camera that is missing or of an unknown kind, numbers that are no pose.
pub fn parse(file: &str, bytes: &[u8]) -> Result<Reconstructed, FileError> {
    let mut all: Vec<Reconstruction> = json::parse(file, bytes)?;
    let count = all.len();
    let largest = (0..count).rev().max_by_key(|&i| all[i].shots.len());
    let Some(source) = largest.map(|i| all.swap_remove(i)) else {
        return Err(FileError::damaged(file, Place::Whole, "the list of reconstructions is empty"));
    };
    let mut out = Reconstructed::default();
    if count > 1 {
        let text =
            format!("{file} holds {count} reconstructions; the one with {} photographs is used", source.shots.len());
        out.notes.push(Note::new("model-several", text));
    }
    let mut lenses = BTreeMap::new();
    for (name, camera) in &source.cameras {
        let lens = lens(file, name, camera)?;
        let target = pinhole_for(&lens);
        lenses.insert(name.as_str(), (lens, target));
    }
    for (name, shot) in &source.shots {
        let damaged = |what: String| FileError::damaged(file, Place::Part(format!("shots/{name}")), what);
        check_name(name).map_err(damaged)?;
        let camera = lenses.get(shot.camera.as_str());
        let (lens, camera) = camera.ok_or_else(|| damaged(format!("its camera '{}' is missing", shot.camera)))?;
        let camera_from_world = pose(shot).ok_or_else(|| damaged("the pose is not finite".into()))?;
        out.scene.views.push(View { name: name.clone(), lens: lens.clone(), camera: *camera, camera_from_world });
    }
    for (name, point) in source.points {
        let position_world = DVec3::from(point.coordinates);
        let color = point.color.map(|value| value.clamp(0.0, 255.0) as u8);
        out.scene.points.push(SparsePoint { position_world, color, error_px: 0.0, track: Vec::new() });
        out.point_names.push(name);
    }
    out.reference_lla = source.reference_lla.and_then(|reference| reference.place());
    out.scene.frame = Frame::default();
    Ok(out)
}

fn pose(shot: &Shot) -> Option<RigidTransform> {
    let axis = DVec3::from(shot.rotation);
    let (angle, translation) = (axis.length(), DVec3::from(shot.translation));
    // sin(angle / 2) / angle, and its limit.
    let scale = if angle > 1e-9 { libm::sin(angle / 2.0) / angle } else { 0.5 };
    let axis = axis * scale;
    let rotation = DQuat::from_xyzw(axis.x, axis.y, axis.z, libm::cos(angle / 2.0)).normalize();
    (rotation.is_finite() && translation.is_finite()).then_some(RigidTransform { rotation, translation })
}

fn lens(file: &str, name: &str, camera: &Camera) -> Result<LensCamera, FileError> {
    let place = || Place::Part(format!("cameras/{name}"));
    let missing = |what: &str| FileError::damaged(file, place(), format!("{what} is missing"));
    let size = f64::from(camera.width.max(camera.height));
    let focal_x = camera.focal_x.or(camera.focal).ok_or_else(|| missing("focal"))?;
    let focal_y = camera.focal_y.unwrap_or(focal_x);
    let (fx, fy) = (focal_x * size, focal_y * size);
    let cx = camera.c_x * size + f64::from(camera.width) / 2.0;
    let cy = camera.c_y * size + f64::from(camera.height) / 2.0;
    let Camera { k1, k2, k3, k4, p1, p2, .. } = *camera;
    let (model, params) = match camera.projection_type.as_str() {
        "perspective" => (LensModel::Radial, vec![fx, cx, cy, k1, k2]),
        "simple_radial" => (LensModel::Opencv, vec![fx, fy, cx, cy, k1, 0.0, 0.0, 0.0]),
        "radial" => (LensModel::Opencv, vec![fx, fy, cx, cy, k1, k2, 0.0, 0.0]),
        "brown" => (LensModel::FullOpencv, vec![fx, fy, cx, cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]),
        "fisheye" => (LensModel::RadialFisheye, vec![fx, cx, cy, k1, k2]),
        "fisheye_opencv" => (LensModel::OpencvFisheye, vec![fx, fy, cx, cy, k1, k2, k3, k4]),
        other => {
            let what = format!("the projection type '{other}'");
            let cure = "use perspective, simple_radial, radial, brown, fisheye or fisheye_opencv".into();
            return Err(FileError::Unsupported { file: file.into(), place: place(), what, cure });
        }
    };
    let lens = LensCamera { model, width: camera.width, height: camera.height, params };
    lens.check().map_err(|what| FileError::damaged(file, place(), what))?;
    let straight = [k1, k2, k3, k4, p1, p2].iter().all(|&k| k == 0.0) && !model.is_fisheye();
    Ok(if straight { lens.without_distortion().into() } else { lens })
}

impl Reconstructed {
    /// Adds the observations of `tracks.csv` (versions 0 to 2: image, track, feature, x, y, …, parted by tabs).
    ///
    /// # Errors
    /// [`FileError`] with the line: a column is missing or no number.
    pub fn add_tracks(&mut self, file: &str, bytes: &[u8]) -> Result<(), FileError> {
        let views: BTreeMap<String, usize> =
            self.scene.views.iter().enumerate().map(|(i, view)| (view.name.clone(), i)).collect();
        let points: BTreeMap<&str, usize> =
            self.point_names.iter().enumerate().map(|(i, name)| (name.as_str(), i)).collect();
        for line in lines(file, text(file, bytes)?) {
            if line.text.trim().is_empty() || line.text.starts_with("OPENSFM_TRACKS_VERSION") {
                continue;
            }
            let mut columns = line.text.split('\t');
            let (image, track) = (columns.next().unwrap_or_default(), columns.next().unwrap_or_default());
            let (Some(&view), Some(&point)) = (views.get(image), points.get(track)) else { continue };
            let mut columns = columns.skip(1);
            let mut number = || columns.next().and_then(|word| word.trim().parse::<f64>().ok());
            let (Some(x), Some(y)) = (number(), number()) else {
                return Err(line.error("x or y of the observation is missing"));
            };
            let View { lens, camera, .. } = &self.scene.views[view];
            let (width, height) = (f64::from(lens.width), f64::from(lens.height));
            let xy_px = glam::DVec2::new(x, y) * width.max(height) + glam::DVec2::new(width, height) / 2.0;
            if let Some(xy) = undistort_point(xy_px, lens, camera).filter(|xy| xy.is_finite()) {
                let seen = TrackElement { view_index: view as u32, xy_px: xy.as_vec2().into() };
                self.scene.points[point].track.push(seen);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
