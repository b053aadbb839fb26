//! `images.bin` and `images.txt`: poses, names and features.

use std::fmt::Write;

use super::{Keypoint, ModelImage, NO_POINT, check_name, unit_quaternion};
use crate::error::{FileError, Place};
use crate::files::cursor::Cursor;
use crate::files::lines::{Line, is_blank, lines, text};
use crate::pose::RigidTransform;

/// Bytes of an image without name and features, and of a feature.
const IMAGE_BYTES: usize = 4 + 7 * 8 + 4 + 1 + 8;
const KEYPOINT_BYTES: usize = 24;

fn pose(quaternion: [f64; 4], translation: [f64; 3]) -> Result<RigidTransform, String> {
    let rotation = unit_quaternion(quaternion).ok_or("the rotation is not a quaternion")?;
    Ok(RigidTransform { rotation, translation: translation.into() })
}

/// Reads `images.bin`.
pub(super) fn parse_binary(file: &str, bytes: &[u8]) -> Result<Vec<ModelImage>, FileError> {
    let mut cursor = Cursor::new(file, bytes);
    let count = cursor.count(IMAGE_BYTES, "images")?;
    let mut images = Vec::with_capacity(count);
    for _ in 0..count {
        let start = Place::Byte(cursor.at());
        let damaged = |what: String| FileError::damaged(file, start.clone(), what);
        let id = cursor.u32()?;
        let mut numbers = [0.0; 7];
        for number in &mut numbers {
            *number = cursor.finite("a number of the pose")?;
        }
        let [w, x, y, z, translation @ ..] = numbers;
        let camera_from_world = pose([w, x, y, z], translation).map_err(damaged)?;
        let camera_id = cursor.u32()?;
        let name = std::str::from_utf8(cursor.zero_terminated()?).map_err(|_| {
            damaged(format!("the name of image {id} is not UTF-8; rename the photograph and export the model"))
        })?;
        check_name(name).map_err(damaged)?;
        let features = cursor.count(KEYPOINT_BYTES, "features")?;
        let mut keypoints = Vec::with_capacity(features);
        for _ in 0..features {
            keypoints.push(Keypoint { xy_px: [cursor.f64()?, cursor.f64()?], point_id: cursor.u64()? });
        }
        images.push(ModelImage { id, camera_id, name: name.into(), camera_from_world, keypoints });
    }
    cursor.finish()?;
    Ok(images)
}

/// Reads `images.txt`: two lines an image, the second with the features, possibly empty.
pub(super) fn parse_text(file: &str, bytes: &[u8]) -> Result<Vec<ModelImage>, FileError> {
    let mut images = Vec::new();
    let mut all = lines(file, text(file, bytes)?);
    while let Some(line) = all.find(|line| !is_blank(line)) {
        let mut words = line.words();
        let id: u32 = words.number("the image's number")?;
        let mut numbers = [0.0; 7];
        for number in &mut numbers {
            *number = words.finite("a number of the pose")?;
        }
        let [w, x, y, z, translation @ ..] = numbers;
        let camera_from_world = pose([w, x, y, z], translation).map_err(|what| line.error(what))?;
        let camera_id = words.number("the camera's number")?;
        let name = words.rest().to_owned();
        check_name(&name).map_err(|what| line.error(what))?;
        let keypoints = all.next().map_or(Ok(Vec::new()), |line| features(&line))?;
        images.push(ModelImage { id, camera_id, name, camera_from_world, keypoints });
    }
    Ok(images)
}

fn features(line: &Line<'_>) -> Result<Vec<Keypoint>, FileError> {
    let mut words = line.words();
    let mut keypoints = Vec::new();
    while !words.is_empty() {
        let xy_px = [words.number("x of a feature")?, words.number("y of a feature")?];
        let point: i64 = words.number("the point of a feature")?;
        keypoints.push(Keypoint { xy_px, point_id: u64::try_from(point).unwrap_or(NO_POINT) });
    }
    Ok(keypoints)
}

fn pose_numbers(pose: &RigidTransform) -> [f64; 7] {
    let (q, t) = (pose.rotation, pose.translation);
    [q.w, q.x, q.y, q.z, t.x, t.y, t.z]
}

/// Writes `images.bin`.
pub(super) fn write_binary(images: &[ModelImage]) -> Vec<u8> {
    let mut out = (images.len() as u64).to_le_bytes().to_vec();
    for image in images {
        out.extend(image.id.to_le_bytes());
        pose_numbers(&image.camera_from_world).iter().for_each(|value| out.extend(value.to_le_bytes()));
        out.extend(image.camera_id.to_le_bytes());
        out.extend(image.name.as_bytes());
        out.push(0);
        out.extend((image.keypoints.len() as u64).to_le_bytes());
        for keypoint in &image.keypoints {
            keypoint.xy_px.iter().for_each(|value| out.extend(value.to_le_bytes()));
            out.extend(keypoint.point_id.to_le_bytes());
        }
    }
    out
}

/// Writes `images.txt`.
pub(super) fn write_text(images: &[ModelImage]) -> String {
    let mut out = format!(
        "# Image list with two lines of data per image:\n#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n\
         #   POINTS2D[] as (X, Y, POINT3D_ID)\n# Number of images: {}\n",
        images.len()
    );
    for image in images {
        let _ = write!(out, "{}", image.id);
        for value in pose_numbers(&image.camera_from_world) {
            let _ = write!(out, " {value}");
        }
        let _ = writeln!(out, " {} {}", image.camera_id, image.name);
        for (i, keypoint) in image.keypoints.iter().enumerate() {
            let point = i64::try_from(keypoint.point_id).unwrap_or(-1);
            let gap = if i == 0 { "" } else { " " };
            let _ = write!(out, "{gap}{} {} {point}", keypoint.xy_px[0], keypoint.xy_px[1]);
        }
        out.push('\n');
    }
    out
}
