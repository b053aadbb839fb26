//! Where a scene lies: `georef.json`, OpenSfM's `reference_lla.json`, `geo_origin.json`, lists of GPS places.
//!
//! `georef.json` is ours, read beside a scene and written beside results. Every key may be absent:
//! `{"epsg": 28992, "offset": [x, y, z], "metres_per_unit": 1.0, "up": [0, 0, 1], "vertical_datum": "NAP",
//! "origin_lla": [latitude_deg, longitude_deg, height_m], "source": "words"}`.
//! `offset` is what is added to scene coordinates to give coordinates in `epsg`; `origin_lla` is the place of the
//! scene's origin; `up` need not be of unit length.

use std::collections::BTreeMap;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::json;
use super::lines::{is_blank, lines, text};
use crate::error::{FileError, Place};
use crate::frame::Frame;

/// What `georef.json` says.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct GeoReference {
    /// Coordinate reference system of `offset + scene`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub epsg: Option<u32>,
    /// Added to scene coordinates.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub offset: Option<[f64; 3]>,
    /// Metres per scene unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metres_per_unit: Option<f64>,
    /// Away from the ground, scene axes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub up: Option<[f64; 3]>,
    /// In the source's words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vertical_datum: Option<String>,
    /// Latitude (deg), longitude (deg), height (m) of the scene's origin.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub origin_lla: Option<[f64; 3]>,
    /// Where the numbers come from, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Keys that mean nothing here.
    #[serde(flatten)]
    pub unknown: BTreeMap<String, serde_json::Value>,
}

/// Reads `georef.json`.
///
/// # Errors
/// [`FileError`]: no JSON, a value of the wrong kind, a scale that is not positive, an up without direction.
pub fn parse_georef(file: &str, bytes: &[u8]) -> Result<GeoReference, FileError> {
    let georef: GeoReference = json::parse(file, bytes)?;
    let wrong = |key: &str, what: String| Err(FileError::damaged(file, Place::Part(key.into()), what));
    if let Some(scale) = georef.metres_per_unit.filter(|scale| !scale.is_finite() || *scale <= 0.0) {
        return wrong("metres_per_unit", format!("{scale} is not a scale"));
    }
    if let Some(up) = georef.up.filter(|up| DVec3::from(*up).try_normalize().is_none()) {
        return wrong("up", format!("{up:?} has no direction"));
    }
    if let Some(lla) = georef.origin_lla.filter(|lla| !is_on_earth(*lla)) {
        return wrong("origin_lla", format!("{lla:?} is not on Earth (latitude, longitude, height)"));
    }
    Ok(georef)
}

/// `georef.json` of a frame.
#[must_use]
pub fn write_georef(frame: &Frame) -> Vec<u8> {
    let georef = GeoReference {
        epsg: frame.epsg,
        offset: Some(frame.offset.into()),
        metres_per_unit: frame.metres_per_unit,
        up: Some(frame.up_world.into()),
        vertical_datum: frame.vertical_datum.clone(),
        origin_lla: frame.origin_lla,
        source: Some(frame.source.clone()),
        unknown: BTreeMap::new(),
    };
    let mut bytes = serde_json::to_vec_pretty(&georef).expect("numbers and words only");
    bytes.push(b'\n');
    bytes
}

/// Latitude within ±90, longitude within ±360, height within 100 km.
pub(crate) fn is_on_earth([latitude, longitude, height]: [f64; 3]) -> bool {
    latitude.abs() <= 90.0 && longitude.abs() <= 360.0 && height.abs() < 1e5
}

/// OpenSfM's reference: the place of the origin of a local east-north-up frame in metres.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct ReferenceLla {
    /// Degrees.
    pub latitude: f64,
    /// Degrees.
    pub longitude: f64,
    /// Metres.
    #[serde(default)]
    pub altitude: f64,
}

impl ReferenceLla {
    /// Latitude, longitude, height; `None` for OpenSfM's (0, 0, 0) of a scene without GPS, or a place not on Earth.
    #[must_use]
    pub fn place(&self) -> Option<[f64; 3]> {
        let lla = [self.latitude, self.longitude, self.altitude];
        (is_on_earth(lla) && lla != [0.0; 3]).then_some(lla)
    }
}

/// Reads `reference_lla.json`.
///
/// # Errors
/// [`FileError`]: no JSON, a number is missing.
pub fn parse_reference_lla(file: &str, bytes: &[u8]) -> Result<ReferenceLla, FileError> {
    json::parse(file, bytes)
}

/// `geo_origin.json`: the origin of a local frame, as small packaging scripts write it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct GeoOrigin {
    /// Degrees.
    #[serde(alias = "lat", alias = "latitude")]
    pub lat0: f64,
    /// Degrees.
    #[serde(alias = "lon", alias = "longitude")]
    pub lon0: f64,
    /// Metres.
    #[serde(default, alias = "alt", alias = "altitude")]
    pub alt0: f64,
    /// The frame in words.
    #[serde(default)]
    pub frame: String,
}

impl GeoOrigin {
    /// Whether the words say that the frame is east-north-up in metres.
    #[must_use]
    pub fn is_enu_metres(&self) -> bool {
        let words = self.frame.to_lowercase();
        words.contains("enu") && (words.contains("metre") || words.contains("meter"))
    }
}

/// Reads `geo_origin.json`.
///
/// # Errors
/// [`FileError`]: no JSON, a number is missing, a place that is not on Earth.
pub fn parse_geo_origin(file: &str, bytes: &[u8]) -> Result<GeoOrigin, FileError> {
    let origin: GeoOrigin = json::parse(file, bytes)?;
    if !is_on_earth([origin.lat0, origin.lon0, origin.alt0]) {
        return Err(FileError::damaged(file, Place::Whole, "the origin is not on Earth"));
    }
    Ok(origin)
}

/// Reads a list of places: `name latitude longitude altitude` a line, as COLMAP's `model_aligner` takes them.
///
/// # Errors
/// [`FileError`] with the line: a number is missing, a place is not on Earth.
pub fn parse_gps_list(file: &str, bytes: &[u8]) -> Result<BTreeMap<String, [f64; 3]>, FileError> {
    let mut places = BTreeMap::new();
    for line in lines(file, text(file, bytes)?).filter(|line| !is_blank(line)) {
        let mut words = line.words();
        let name = words.next_word().unwrap_or_default().to_owned();
        let lla = [words.finite("the latitude")?, words.finite("the longitude")?, words.finite("the altitude")?];
        if !is_on_earth(lla) {
            return Err(line.error(format!("{lla:?} is not on Earth (latitude, longitude, altitude)")));
        }
        places.insert(name, lla);
    }
    Ok(places)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_survives_its_file() {
        let frame = Frame {
            metres_per_unit: Some(0.1 + 0.2),
            up_world: DVec3::new(0.0, 0.6, -0.8),
            offset: DVec3::new(85_000.125, 446_700.0, 1e-3),
            epsg: Some(28992),
            vertical_datum: Some("NAP".into()),
            origin_lla: Some([52.0, 4.4, 43.0]),
            source: "a test".into(),
        };
        let georef = parse_georef("georef.json", &write_georef(&frame)).unwrap();
        assert_eq!(georef.offset, Some(frame.offset.into()));
        assert_eq!(georef.metres_per_unit, frame.metres_per_unit);
        assert_eq!((georef.epsg, georef.origin_lla), (frame.epsg, frame.origin_lla));
        assert!(georef.unknown.is_empty());
    }

    #[test]
    fn what_cannot_be_is_refused_with_its_key() {
        for (text, words) in [
            (r#"{"metres_per_unit": 0}"#, "georef.json, metres_per_unit: 0 is not a scale"),
            (r#"{"up": [0, 0, 0]}"#, "georef.json, up: [0.0, 0.0, 0.0] has no direction"),
            (r#"{"origin_lla": [95, 0, 0]}"#, "georef.json, origin_lla: [95.0, 0.0, 0.0] is not on Earth"),
            ("{\n\"offset\": [1, 2]}", "georef.json, line 2:"),
            ("", "georef.json, line 1:"),
        ] {
            let error = parse_georef("georef.json", text.as_bytes()).unwrap_err().to_string();
            assert!(error.starts_with(words), "{error}");
        }
        assert_eq!(parse_georef("g", br#"{"metre_per_unit": 2}"#).unwrap().unknown.len(), 1);
    }

    #[test]
    fn origins_and_lists_of_others() {
        let text = br#"{"lat0": 46.8, "lon0": -92.0, "alt0": 0.0, "frame": "local ENU, metres; z = EXIF altitude"}"#;
        let origin = parse_geo_origin("geo_origin.json", text).unwrap();
        assert!(origin.is_enu_metres());
        let list = parse_gps_list("gps.txt", b"# name\na.jpg 46.8 -92 198.3\n\n").unwrap();
        assert_eq!(list["a.jpg"], [46.8, -92.0, 198.3]);
        let error = parse_gps_list("gps.txt", b"a.jpg 46.8\n").unwrap_err().to_string();
        assert!(error.starts_with("gps.txt, line 1: the longitude is missing"), "{error}");
        let nowhere = parse_reference_lla("r", br#"{"latitude": 0, "longitude": 0, "altitude": 0}"#).unwrap();
        assert_eq!(nowhere.place(), None);
    }
}
