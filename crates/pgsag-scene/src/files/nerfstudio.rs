//! nerfstudio's `transforms.json` (and the Blender layout it grew from).
//!
//! `transform_matrix` is camera to world with OpenGL's axes (x right, y up, z backwards); ours are COLMAP's. Intrinsics
//! stand at the top or with each frame. Where `applied_transform` says how the world was turned after
//! structure-from-motion, it is undone, for cameras and points alike, so that results lie in the world of the source.

use glam::{DMat3, DQuat, DVec3};
use serde::Deserialize;

use super::colmap::check_name;
use super::json;
use crate::camera::distortion::{LensCamera, LensModel};
use crate::camera::undistort::pinhole_for;
use crate::error::{FileError, Place};
use crate::frame::Frame;
use crate::pose::RigidTransform;
use crate::scene::{Scene, View};

#[derive(Clone, Default, Deserialize)]
#[serde(default)]
struct Intrinsics {
    camera_model: Option<String>,
    w: Option<f64>,
    h: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
}

#[derive(Deserialize)]
struct Document {
    #[serde(flatten)]
    intrinsics: Intrinsics,
    frames: Vec<FrameEntry>,
    applied_transform: Option<Vec<[f64; 4]>>,
    ply_file_path: Option<String>,
}

#[derive(Deserialize)]
struct FrameEntry {
    file_path: String,
    mask_path: Option<String>,
    transform_matrix: Vec<[f64; 4]>,
    #[serde(flatten)]
    intrinsics: Intrinsics,
}

/// A turn, a scale and a shift that nerfstudio applied to the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AppliedTransform {
    linear: DMat3,
    shift: DVec3,
    scale: f64,
}

impl AppliedTransform {
    const IDENTITY: Self = Self { linear: DMat3::IDENTITY, shift: DVec3::ZERO, scale: 1.0 };

    /// Carries a point of the file's world back to the world of the source.
    #[must_use]
    pub fn undo(&self, point: DVec3) -> DVec3 {
        self.linear.inverse() * (point - self.shift)
    }
}

/// A document as views; points are in another file.
#[derive(Clone, Debug, PartialEq)]
pub struct Transforms {
    /// Views sorted by name; no points.
    pub scene: Scene,
    /// Per view: path of the photograph, relative to the document.
    pub image_files: Vec<String>,
    /// Per view: path of the mask, relative to the document.
    pub mask_files: Vec<Option<String>>,
    /// Path of a PLY file with points, relative to the document.
    pub points_file: Option<String>,
    /// What was applied to cameras and points, and is undone in `scene`.
    pub applied: AppliedTransform,
}

/// Reads `transforms.json`. `image_size` tells width and height of a photograph by its path, where the document does
/// not.
///
/// # Errors
/// [`FileError`]: no JSON, a matrix that is no pose, intrinsics that are missing or of an unknown kind.
pub fn parse(
    file: &str,
    bytes: &[u8],
    image_size: &mut dyn FnMut(&str) -> Option<(u32, u32)>,
) -> Result<Transforms, FileError> {
    let document: Document = json::parse(file, bytes)?;
    let applied = match &document.applied_transform {
        None => AppliedTransform::IDENTITY,
        Some(rows) => applied_transform(rows)
            .ok_or_else(|| FileError::damaged(file, Place::Part("applied_transform".into()), "not a similarity"))?,
    };
    let mut entries = Vec::with_capacity(document.frames.len());
    for entry in document.frames {
        let damaged = |what: String| FileError::damaged(file, Place::Part(format!("frame {}", entry.file_path)), what);
        let path = entry.file_path.trim_start_matches("./").to_owned();
        let name = path.strip_prefix("images/").unwrap_or(&path).to_owned();
        check_name(&path).map_err(damaged)?;
        entry.mask_path.as_deref().map_or(Ok(()), check_name).map_err(damaged)?;
        let camera_from_world = pose(&entry.transform_matrix, &applied)
            .ok_or_else(|| damaged("transform_matrix is not a rotation and a shift".into()))?;
        let intrinsics = entry.intrinsics.over(&document.intrinsics);
        let lens = lens(file, &path, &intrinsics, image_size)?;
        let camera = pinhole_for(&lens);
        let mask = entry.mask_path.map(|mask| mask.trim_start_matches("./").to_owned());
        entries.push((View { name, lens, camera, camera_from_world }, path, mask));
    }
    entries.sort_by(|(a, ..), (b, ..)| a.name.cmp(&b.name));
    if let Some(pair) = entries.windows(2).find(|pair| pair[0].0.name == pair[1].0.name) {
        return Err(FileError::damaged(file, Place::Whole, format!("two frames are named {}", pair[0].0.name)));
    }
    if let Some(points) = &document.ply_file_path {
        check_name(points).map_err(|what| FileError::damaged(file, Place::Part("ply_file_path".into()), what))?;
    }
    let mut out = Transforms {
        scene: Scene { frame: Frame::default(), ..Scene::default() },
        image_files: Vec::with_capacity(entries.len()),
        mask_files: Vec::with_capacity(entries.len()),
        points_file: document.ply_file_path,
        applied,
    };
    for (view, image, mask) in entries {
        out.scene.views.push(view);
        out.image_files.push(image);
        out.mask_files.push(mask);
    }
    Ok(out)
}

impl Intrinsics {
    /// These, and where they are silent the others.
    fn over(self, other: &Self) -> Self {
        Self {
            camera_model: self.camera_model.or_else(|| other.camera_model.clone()),
            w: self.w.or(other.w),
            h: self.h.or(other.h),
            fl_x: self.fl_x.or(other.fl_x),
            fl_y: self.fl_y.or(other.fl_y),
            cx: self.cx.or(other.cx),
            cy: self.cy.or(other.cy),
            k1: self.k1.or(other.k1),
            k2: self.k2.or(other.k2),
            k3: self.k3.or(other.k3),
            k4: self.k4.or(other.k4),
            p1: self.p1.or(other.p1),
            p2: self.p2.or(other.p2),
            camera_angle_x: self.camera_angle_x.or(other.camera_angle_x),
            camera_angle_y: self.camera_angle_y.or(other.camera_angle_y),
        }
    }
}

fn matrix(rows: &[[f64; 4]]) -> Option<(DMat3, DVec3)> {
    let [x, y, z] = [rows.first()?, rows.get(1)?, rows.get(2)?];
    let linear = DMat3::from_cols_array_2d(&[[x[0], x[1], x[2]], [y[0], y[1], y[2]], [z[0], z[1], z[2]]]).transpose();
    let shift = DVec3::new(x[3], y[3], z[3]);
    (linear.is_finite() && shift.is_finite()).then_some((linear, shift))
}

/// Scale of a matrix that is a scaled rotation, to `tolerance`.
fn scale_of(linear: &DMat3, tolerance: f64) -> Option<f64> {
    let scale = libm::cbrt(linear.determinant());
    let off = (*linear * (1.0 / scale)).transpose() * (*linear * (1.0 / scale)) - DMat3::IDENTITY;
    let worst = off.to_cols_array().iter().fold(0.0f64, |worst, value| worst.max(value.abs()));
    (scale.is_finite() && scale > 1e-12 && worst < tolerance).then_some(scale)
}

fn applied_transform(rows: &[[f64; 4]]) -> Option<AppliedTransform> {
    let (linear, shift) = matrix(rows)?;
    Some(AppliedTransform { linear, shift, scale: scale_of(&linear, 1e-3)? })
}

/// World to camera with COLMAP's axes.
fn pose(rows: &[[f64; 4]], applied: &AppliedTransform) -> Option<RigidTransform> {
    let (linear, center) = matrix(rows)?;
    // Files written with few digits are rotations only nearly.
    let scale = scale_of(&linear, 1e-2)?;
    let world_from_opengl = (applied.linear * (1.0 / applied.scale)).transpose() * (linear * (1.0 / scale));
    let world_from_camera = world_from_opengl * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let rotation = DQuat::from_mat3(&world_from_camera).normalize().inverse();
    let center = applied.undo(center);
    (rotation.is_finite() && center.is_finite()).then(|| RigidTransform { rotation, translation: -(rotation * center) })
}

fn lens(
    file: &str,
    path: &str,
    given: &Intrinsics,
    image_size: &mut dyn FnMut(&str) -> Option<(u32, u32)>,
) -> Result<LensCamera, FileError> {
    let place = || Place::Part(format!("frame {path}"));
    let damaged = |what: &str| FileError::damaged(file, place(), what);
    let size = match (given.w, given.h) {
        (Some(w), Some(h)) => (w as u32, h as u32),
        _ => image_size(path).ok_or_else(|| damaged("w and h are missing"))?,
    };
    let (w, h) = (f64::from(size.0), f64::from(size.1));
    let from_angle = |angle: Option<f64>, side: f64| angle.map(|angle| 0.5 * side / libm::tan(0.5 * angle));
    let fl_x = given.fl_x.or_else(|| from_angle(given.camera_angle_x, w));
    let fl_y = given.fl_y.or_else(|| from_angle(given.camera_angle_y, h));
    let fx = fl_x.or(fl_y).ok_or_else(|| damaged("fl_x is missing"))?;
    let fy = fl_y.unwrap_or(fx);
    let (cx, cy) = (given.cx.unwrap_or(w / 2.0), given.cy.unwrap_or(h / 2.0));
    let [k1, k2, k3, k4, p1, p2] =
        [given.k1, given.k2, given.k3, given.k4, given.p1, given.p2].map(|k| k.unwrap_or(0.0));
    let unsupported = |what: String| FileError::Unsupported {
        file: file.into(),
        place: place(),
        what,
        cure: "use PINHOLE, OPENCV or OPENCV_FISHEYE".into(),
    };
    let distorted = [k1, k2, k3, k4, p1, p2].iter().any(|&k| k != 0.0);
    let name = given.camera_model.as_deref().unwrap_or("OPENCV");
    let (model, params) = match name {
        "OPENCV_FISHEYE" => (LensModel::OpencvFisheye, vec![fx, fy, cx, cy, k1, k2, k3, k4]),
        "PINHOLE" | "SIMPLE_PINHOLE" => (LensModel::Pinhole, vec![fx, fy, cx, cy]),
        "OPENCV" | "SIMPLE_RADIAL" | "RADIAL" | "PERSPECTIVE" if !distorted => {
            (LensModel::Pinhole, vec![fx, fy, cx, cy])
        }
        "OPENCV" | "SIMPLE_RADIAL" | "RADIAL" | "PERSPECTIVE" if k4 == 0.0 => {
            (LensModel::FullOpencv, vec![fx, fy, cx, cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0])
        }
        "OPENCV" | "SIMPLE_RADIAL" | "RADIAL" | "PERSPECTIVE" => {
            return Err(unsupported("a fourth radial coefficient of a perspective camera".into()));
        }
        other => return Err(unsupported(format!("the camera model {other}"))),
    };
    let lens = LensCamera { model, width: size.0, height: size.1, params };
    lens.check().map_err(|what| damaged(&what))?;
    Ok(lens)
}

#[cfg(test)]
mod tests;
