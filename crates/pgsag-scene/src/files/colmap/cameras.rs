//! `cameras.bin` and `cameras.txt`.

use std::collections::BTreeMap;
use std::fmt::Write;

use crate::camera::distortion::{LensCamera, LensModel};
use crate::error::{FileError, Place};
use crate::files::cursor::Cursor;
use crate::files::lines::{is_blank, lines, text};

/// Models that COLMAP has added since number 10, with the count of their parameters.
const NEWER: [(&str, usize); 7] = [
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
];

/// The model of that name and the count of parameters in the file; fisheyes without distortion are read as the
/// distorted ones with zeros.
fn model_named(file: &str, place: Place, name: &str) -> Result<(LensModel, usize), FileError> {
    if let Some(model) = LensModel::from_name(name) {
        return Ok((model, model.parameter_count()));
    }
    match name {
        "SIMPLE_FISHEYE" => Ok((LensModel::SimpleRadialFisheye, 3)),
        "FISHEYE" => Ok((LensModel::OpencvFisheye, 4)),
        _ => Err(unsupported(file, place, format!("the camera model {name}"))),
    }
}

fn model_numbered(file: &str, place: Place, number: i32) -> Result<(LensModel, usize), FileError> {
    if let Some(model) = LensModel::from_number(number) {
        return Ok((model, model.parameter_count()));
    }
    let newer = usize::try_from(number).ok().and_then(|i| NEWER.get(i.checked_sub(11)?));
    match newer {
        Some((name, _)) => model_named(file, place, name),
        None => Err(unsupported(file, place, format!("camera model number {number}"))),
    }
}

fn unsupported(file: &str, place: Place, what: String) -> FileError {
    let cure = "undistort with COLMAP's image_undistorter, or calibrate with one of the models SIMPLE_PINHOLE … \
                THIN_PRISM_FISHEYE (0 to 10)";
    FileError::Unsupported { file: file.into(), place, what, cure: cure.into() }
}

/// A checked camera whose missing parameters are zeros.
fn camera(model: LensModel, sides: [u64; 2], mut params: Vec<f64>) -> Result<LensCamera, String> {
    params.resize(model.parameter_count(), 0.0);
    let [width, height] = sides.map(|side| u32::try_from(side).unwrap_or(u32::MAX));
    let camera = LensCamera { model, width, height, params };
    camera.check().map(|()| camera)
}

/// Reads `cameras.bin`.
pub(super) fn parse_binary(file: &str, bytes: &[u8]) -> Result<BTreeMap<u32, LensCamera>, FileError> {
    let mut cursor = Cursor::new(file, bytes);
    let count = cursor.count(24, "cameras")?;
    let mut cameras = BTreeMap::new();
    for _ in 0..count {
        let start = Place::Byte(cursor.at());
        let id = cursor.u32()?;
        let (model, in_file) = model_numbered(file, start.clone(), cursor.i32()?)?;
        let sides = [cursor.u64()?, cursor.u64()?];
        let params = (0..in_file).map(|_| cursor.f64()).collect::<Result<Vec<_>, _>>()?;
        let camera = camera(model, sides, params).map_err(|what| FileError::damaged(file, start.clone(), what))?;
        if cameras.insert(id, camera).is_some() {
            return Err(FileError::damaged(file, start, format!("camera {id} stands twice")));
        }
    }
    cursor.finish()?;
    Ok(cameras)
}

/// Reads `cameras.txt`.
pub(super) fn parse_text(file: &str, bytes: &[u8]) -> Result<BTreeMap<u32, LensCamera>, FileError> {
    let mut cameras = BTreeMap::new();
    for line in lines(file, text(file, bytes)?).filter(|line| !is_blank(line)) {
        let mut words = line.words();
        let id: u32 = words.number("the camera's number")?;
        let name = words.next_word().ok_or_else(|| line.error("the camera model is missing"))?;
        let (model, in_file) = model_named(file, line.place(), name)?;
        let sides = [words.number("the width")?, words.number("the height")?];
        let params = (0..in_file).map(|_| words.number("a parameter")).collect::<Result<Vec<_>, _>>()?;
        if !words.is_empty() {
            return Err(line.error(format!("more parameters than the {in_file} of {name}")));
        }
        let camera = camera(model, sides, params).map_err(|what| line.error(what))?;
        if cameras.insert(id, camera).is_some() {
            return Err(line.error(format!("camera {id} stands twice")));
        }
    }
    Ok(cameras)
}

/// Writes `cameras.bin`.
pub(super) fn write_binary(cameras: &BTreeMap<u32, LensCamera>) -> Vec<u8> {
    let mut out = (cameras.len() as u64).to_le_bytes().to_vec();
    for (id, camera) in cameras {
        out.extend(id.to_le_bytes());
        out.extend(camera.model.number().to_le_bytes());
        out.extend(u64::from(camera.width).to_le_bytes());
        out.extend(u64::from(camera.height).to_le_bytes());
        camera.params.iter().for_each(|value| out.extend(value.to_le_bytes()));
    }
    out
}

/// Writes `cameras.txt`.
pub(super) fn write_text(cameras: &BTreeMap<u32, LensCamera>) -> String {
    let mut out = format!(
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n\
         # Number of cameras: {}\n",
        cameras.len()
    );
    for (id, camera) in cameras {
        let _ = write!(out, "{id} {} {} {}", camera.model.name(), camera.width, camera.height);
        for value in &camera.params {
            let _ = write!(out, " {value}");
        }
        out.push('\n');
    }
    out
}
