//! `points3D.bin` and `points3D.txt`.

use std::fmt::Write;

use glam::DVec3;

use super::ModelPoint;
use crate::error::FileError;
use crate::files::cursor::Cursor;
use crate::files::lines::{is_blank, lines, text};

/// Bytes of a point without track, and of an element of a track.
const POINT_BYTES: usize = 8 + 3 * 8 + 3 + 8 + 8;
const TRACK_BYTES: usize = 8;

/// Reads `points3D.bin`.
pub(super) fn parse_binary(file: &str, bytes: &[u8]) -> Result<Vec<ModelPoint>, FileError> {
    let mut cursor = Cursor::new(file, bytes);
    let count = cursor.count(POINT_BYTES, "points")?;
    let mut points = Vec::with_capacity(count);
    for _ in 0..count {
        let id = cursor.u64()?;
        let [x, y, z] = [cursor.finite("x")?, cursor.finite("y")?, cursor.finite("z")?];
        let color = cursor.slice(3)?;
        let color = [color[0], color[1], color[2]];
        let error_px = cursor.f64()?;
        let length = cursor.count(TRACK_BYTES, "track elements")?;
        let mut track = Vec::with_capacity(length);
        for _ in 0..length {
            track.push((cursor.u32()?, cursor.u32()?));
        }
        points.push(ModelPoint { id, position_world: DVec3::new(x, y, z), color, error_px, track });
    }
    cursor.finish()?;
    Ok(points)
}

/// Reads `points3D.txt`.
pub(super) fn parse_text(file: &str, bytes: &[u8]) -> Result<Vec<ModelPoint>, FileError> {
    let mut points = Vec::new();
    for line in lines(file, text(file, bytes)?).filter(|line| !is_blank(line)) {
        let mut words = line.words();
        let id = words.number("the point's number")?;
        let [x, y, z] = [words.finite("x")?, words.finite("y")?, words.finite("z")?];
        let color = [words.number("red")?, words.number("green")?, words.number("blue")?];
        let error_px = words.number("the error")?;
        let mut track = Vec::new();
        while !words.is_empty() {
            track.push((words.number("an image of the track")?, words.number("a feature of the track")?));
        }
        points.push(ModelPoint { id, position_world: DVec3::new(x, y, z), color, error_px, track });
    }
    Ok(points)
}

/// Writes `points3D.bin`.
pub(super) fn write_binary(points: &[ModelPoint]) -> Vec<u8> {
    let mut out = (points.len() as u64).to_le_bytes().to_vec();
    for point in points {
        out.extend(point.id.to_le_bytes());
        point.position_world.to_array().iter().for_each(|value| out.extend(value.to_le_bytes()));
        out.extend(point.color);
        out.extend(point.error_px.to_le_bytes());
        out.extend((point.track.len() as u64).to_le_bytes());
        for (image, feature) in &point.track {
            out.extend(image.to_le_bytes());
            out.extend(feature.to_le_bytes());
        }
    }
    out
}

/// Writes `points3D.txt`.
pub(super) fn write_text(points: &[ModelPoint]) -> String {
    let mut out = format!(
        "# 3D point list with one line of data per point:\n#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as \
         (IMAGE_ID, POINT2D_IDX)\n# Number of points: {}\n",
        points.len()
    );
    for point in points {
        let [x, y, z] = point.position_world.to_array();
        let [red, green, blue] = point.color;
        let _ = write!(out, "{} {x} {y} {z} {red} {green} {blue} {}", point.id, point.error_px);
        for (image, feature) in &point.track {
            let _ = write!(out, " {image} {feature}");
        }
        out.push('\n');
    }
    out
}
