//! COLMAP's sparse models, binary and text: reading, writing, and the way to and from a [`Scene`].
//!
//! Three files make a model: cameras, images, points3D (format: COLMAP's documentation, "Output format"; code:
//! `scene/reconstruction_io_*.cc`, BSD). `rigs` and `frames` of newer versions repeat what these three say and are not
//! read. Image coordinates in a model are those of the photograph, with its lens; those of a scene are undistorted.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DQuat, DVec3};

use crate::camera::distortion::LensCamera;
use crate::camera::undistort::{distort_point, pinhole_for, undistort_point};
use crate::error::{FileError, Place};
use crate::frame::Frame;
use crate::points::{SparsePoint, TrackElement};
use crate::pose::RigidTransform;
use crate::scene::{Scene, View};

mod cameras;
mod images;
mod points;

/// Binary or text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// `.bin`, little-endian.
    Binary,
    /// `.txt`.
    Text,
}

impl Encoding {
    /// Names of the three files: cameras, images, points3D.
    #[must_use]
    pub fn file_names(self) -> [&'static str; 3] {
        match self {
            Self::Binary => ["cameras.bin", "images.bin", "points3D.bin"],
            Self::Text => ["cameras.txt", "images.txt", "points3D.txt"],
        }
    }
}

/// COLMAP's mark of an image point that belongs to no 3D point.
pub const NO_POINT: u64 = u64::MAX;

/// A feature in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Pixels of the photograph (pixel centre at + 0.5).
    pub xy_px: [f64; 2],
    /// The 3D point, or [`NO_POINT`].
    pub point_id: u64,
}

/// A registered image.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelImage {
    /// COLMAP's number.
    pub id: u32,
    /// Number of its camera.
    pub camera_id: u32,
    /// Path below `images/`.
    pub name: String,
    /// World to camera.
    pub camera_from_world: RigidTransform,
    /// All features.
    pub keypoints: Vec<Keypoint>,
}

/// A 3D point.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelPoint {
    /// COLMAP's number.
    pub id: u64,
    /// World frame.
    pub position_world: DVec3,
    /// RGB.
    pub color: [u8; 3],
    /// Mean reprojection error, pixels.
    pub error_px: f64,
    /// Pairs of image number and index into that image's features.
    pub track: Vec<(u32, u32)>,
}

/// The three files of a model, as they stand.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Model {
    /// Cameras by their numbers.
    pub cameras: BTreeMap<u32, LensCamera>,
    /// In the order of the file.
    pub images: Vec<ModelImage>,
    /// In the order of the file.
    pub points: Vec<ModelPoint>,
}

impl Model {
    /// Reads the three files; `files` holds names (for errors) and bytes of cameras, images and points3D.
    ///
    /// # Errors
    /// [`FileError`] with file, place and cure.
    pub fn decode(encoding: Encoding, files: [(&str, &[u8]); 3]) -> Result<Self, FileError> {
        let [(cameras, cameras_bytes), (images, images_bytes), (points, points_bytes)] = files;
        match encoding {
            Encoding::Binary => Ok(Self {
                cameras: cameras::parse_binary(cameras, cameras_bytes)?,
                images: images::parse_binary(images, images_bytes)?,
                points: points::parse_binary(points, points_bytes)?,
            }),
            Encoding::Text => Ok(Self {
                cameras: cameras::parse_text(cameras, cameras_bytes)?,
                images: images::parse_text(images, images_bytes)?,
                points: points::parse_text(points, points_bytes)?,
            }),
        }
    }

    /// The three files: their names and bytes.
    #[must_use]
    pub fn encode(&self, encoding: Encoding) -> [(&'static str, Vec<u8>); 3] {
        let [cameras, images, points] = encoding.file_names();
        match encoding {
            Encoding::Binary => [
                (cameras, cameras::write_binary(&self.cameras)),
                (images, images::write_binary(&self.images)),
                (points, points::write_binary(&self.points)),
            ],
            Encoding::Text => [
                (cameras, cameras::write_text(&self.cameras).into_bytes()),
                (images, images::write_text(&self.images).into_bytes()),
                (points, points::write_text(&self.points).into_bytes()),
            ],
        }
    }

    /// The scene that the model describes: views sorted by name, cameras undistorted, observations carried into the
    /// undistorted images. An observation that its lens has no ray for is left out. `files` are the names of the
    /// images and points3D files, for errors.
    ///
    /// # Errors
    /// An image without its camera, two images of one name, a track that leads nowhere.
    pub fn into_scene(mut self, files: [&str; 2]) -> Result<Scene, FileError> {
        self.check_images(files[0])?;
        self.images.sort_by(|a, b| a.name.cmp(&b.name));
        let targets: BTreeMap<u32, _> = self.cameras.iter().map(|(&id, lens)| (id, pinhole_for(lens))).collect();
        let views = self.images.iter().map(|image| View {
            name: image.name.clone(),
            lens: self.cameras[&image.camera_id].clone(),
            camera: targets[&image.camera_id],
            camera_from_world: image.camera_from_world,
        });
        let views: Vec<View> = views.collect();
        let index_of: BTreeMap<u32, usize> = self.images.iter().enumerate().map(|(i, image)| (image.id, i)).collect();
        let mut points = Vec::with_capacity(self.points.len());
        for point in &self.points {
            let mut track = Vec::with_capacity(point.track.len());
            for &(image_id, keypoint) in &point.track {
                let index = index_of.get(&image_id).copied();
                let seen = index.and_then(|i| Some((i, self.images[i].keypoints.get(keypoint as usize)?)));
                let (index, seen) = seen.ok_or_else(|| {
                    let what = format!("its track leads to feature {keypoint} of image {image_id}, which is not there");
                    FileError::damaged(files[1], Place::Part(format!("point {}", point.id)), what)
                })?;
                let view = &views[index];
                let xy = undistort_point(seen.xy_px.into(), &view.lens, &view.camera);
                if let Some(xy) = xy.filter(|xy| xy.is_finite()) {
                    track.push(TrackElement { view_index: index as u32, xy_px: xy.as_vec2().into() });
                }
            }
            points.push(SparsePoint {
                position_world: point.position_world,
                color: point.color,
                error_px: if point.error_px.is_finite() { point.error_px.max(0.0) as f32 } else { 0.0 },
                track,
            });
        }
        Ok(Scene { views, points, frame: Frame::default() })
    }

    fn check_images(&self, file: &str) -> Result<(), FileError> {
        let (mut ids, mut names) = (BTreeSet::new(), BTreeSet::new());
        for image in &self.images {
            let error = |what: String| Err(FileError::damaged(file, Place::Part(format!("image {}", image.id)), what));
            if !self.cameras.contains_key(&image.camera_id) {
                return error(format!("its camera {} is not in the cameras file", image.camera_id));
            }
            if !ids.insert(image.id) {
                return error("the number is used twice".into());
            }
            if !names.insert(image.name.as_str()) {
                return error(format!("the name {} is used twice", image.name));
            }
        }
        Ok(())
    }

    /// A model of a scene: one camera for every different lens, images numbered from 1 in the order of the views, one
    /// feature per observation.
    #[must_use]
    pub fn from_scene(scene: &Scene) -> Self {
        let mut model = Self::default();
        for (id, view) in (1..).zip(&scene.views) {
            let known = model.cameras.iter().find(|(_, lens)| **lens == view.lens).map(|(&id, _)| id);
            let camera_id = known.unwrap_or(model.cameras.len() as u32 + 1);
            model.cameras.entry(camera_id).or_insert_with(|| view.lens.clone());
            let (name, camera_from_world) = (view.name.clone(), view.camera_from_world);
            model.images.push(ModelImage { id, camera_id, name, camera_from_world, keypoints: Vec::new() });
        }
        for (id, point) in (1..).zip(&scene.points) {
            let mut track = Vec::with_capacity(point.track.len());
            for seen in &point.track {
                let view = &scene.views[seen.view_index as usize];
                let xy_px = glam::Vec2::from(seen.xy_px).as_dvec2();
                if let Some(xy_px) = distort_point(xy_px, &view.lens, &view.camera) {
                    let image = &mut model.images[seen.view_index as usize];
                    track.push((image.id, image.keypoints.len() as u32));
                    image.keypoints.push(Keypoint { xy_px: xy_px.into(), point_id: id });
                }
            }
            let (position_world, color) = (point.position_world, point.color);
            let error_px = f64::from(point.error_px);
            model.points.push(ModelPoint { id, position_world, color, error_px, track });
        }
        model
    }
}

/// A unit quaternion from w x y z; `None` where it has no direction.
pub(crate) fn unit_quaternion([w, x, y, z]: [f64; 4]) -> Option<DQuat> {
    let quaternion = DQuat::from_xyzw(x, y, z, w);
    let length = quaternion.length();
    (length.is_finite() && length > 1e-6).then(|| quaternion * (1.0 / length))
}

/// Refuses names that lead out of the image folder.
pub(crate) fn check_name(name: &str) -> Result<(), String> {
    if name.is_empty() {
        return Err("the image has no name".into());
    }
    let outside = name.starts_with(['/', '\\']) || name.split(['/', '\\']).any(|part| part == "..");
    let drive = name.as_bytes().get(1) == Some(&b':');
    if outside || drive || name.contains('\0') {
        return Err(format!("the image name '{name}' leads out of the image folder"));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
