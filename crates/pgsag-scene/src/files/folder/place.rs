//! The frame of a scene: what `georef.json`, other tools' files, GPS and the cameras say, in this order.

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;

use super::read_file;
use crate::error::FileError;
use crate::files::Note;
use crate::files::georef::{GeoReference, parse_geo_origin, parse_georef, parse_gps_list, parse_reference_lla};
use crate::files::photo::PhotoHeader;
use crate::frame::Frame;
use crate::frame::gps::GpsFit;
use crate::frame::up::{UpSource, up_from_cameras};
use crate::scene::View;

/// What is known before the photographs are asked.
struct Known {
    frame: Frame,
    up: bool,
    sources: Vec<String>,
}

/// The frame of the scene. `reference_lla` is the origin that the model itself names, if any.
pub(super) fn find(
    dir: &Path,
    views: &[View],
    headers: &[PhotoHeader],
    reference_lla: Option<[f64; 3]>,
    notes: &mut Vec<Note>,
) -> Result<Frame, FileError> {
    let mut known = Known { frame: Frame::default(), up: false, sources: Vec::new() };
    read_georef(dir, &mut known, notes)?;
    read_origins(dir, reference_lla, &mut known)?;
    use_gps(dir, views, headers, &mut known, notes)?;
    use_cameras(views, &mut known);
    if known.frame.metres_per_unit.is_none() {
        let text = "the scale is unknown: lengths are measured in median depths; a georef.json with metres_per_unit, \
                    photographs with GPS, or the setting metres_per_unit would tell it";
        notes.push(Note::new("scale-unknown", text));
        known.sources.push("scale unknown".into());
    }
    known.frame.source = known.sources.join("; ");
    Ok(known.frame)
}

fn read_georef(dir: &Path, known: &mut Known, notes: &mut Vec<Note>) -> Result<(), FileError> {
    let path = dir.join("georef.json");
    if !path.is_file() {
        return Ok(());
    }
    let (file, bytes) = read_file(&path)?;
    let georef: GeoReference = parse_georef(&file, &bytes)?;
    if !georef.unknown.is_empty() {
        let keys: Vec<&str> = georef.unknown.keys().map(String::as_str).collect();
        notes.push(Note::new(
            "georef-unknown-keys",
            format!("{file}: keys without a meaning here: {}", keys.join(", ")),
        ));
    }
    // Coordinates of a reference system have z up.
    let system_up = (georef.epsg.is_some() || georef.offset.is_some()).then_some(DVec3::Z);
    let up = georef.up.and_then(|up| DVec3::from(up).try_normalize()).or(system_up);
    let frame = &mut known.frame;
    frame.metres_per_unit = georef.metres_per_unit;
    frame.offset = georef.offset.map_or(DVec3::ZERO, DVec3::from);
    (frame.epsg, frame.vertical_datum, frame.origin_lla) = (georef.epsg, georef.vertical_datum, georef.origin_lla);
    frame.up_world = up.unwrap_or(frame.up_world);
    known.up = up.is_some();
    known.sources.push("georef.json".into());
    Ok(())
}

/// Origins of local east-north-up frames in metres.
fn read_origins(dir: &Path, reference_lla: Option<[f64; 3]>, known: &mut Known) -> Result<(), FileError> {
    let mut origin = reference_lla.map(|lla| (lla, "reference_lla of the reconstruction".to_owned()));
    for name in ["reference_lla.json", "opensfm/reference_lla.json"] {
        let path = dir.join(name);
        if origin.is_none() && path.is_file() {
            let (file, bytes) = read_file(&path)?;
            origin = parse_reference_lla(&file, &bytes)?.place().map(|lla| (lla, name.into()));
        }
    }
    let path = dir.join("geo_origin.json");
    if origin.is_none() && path.is_file() {
        let (file, bytes) = read_file(&path)?;
        let read = parse_geo_origin(&file, &bytes)?;
        if read.is_enu_metres() {
            origin = Some(([read.lat0, read.lon0, read.alt0], "geo_origin.json".into()));
        }
    }
    if let Some((lla, source)) = origin {
        known.frame.origin_lla.get_or_insert(lla);
        known.frame.metres_per_unit.get_or_insert(1.0);
        if !known.up {
            (known.frame.up_world, known.up) = (DVec3::Z, true);
        }
        known.sources.push(format!("{source} (east-north-up metres)"));
    }
    Ok(())
}

fn use_gps(
    dir: &Path,
    views: &[View],
    headers: &[PhotoHeader],
    known: &mut Known,
    notes: &mut Vec<Note>,
) -> Result<(), FileError> {
    let path = dir.join("gps.txt");
    let list = if path.is_file() {
        let (file, bytes) = read_file(&path)?;
        parse_gps_list(&file, &bytes)?
    } else {
        BTreeMap::new()
    };
    let places: Vec<Option<[f64; 3]>> = views
        .iter()
        .zip(headers)
        .map(|(view, header)| {
            let exif = header.gps.map(|gps| [gps.latitude_deg, gps.longitude_deg, gps.altitude_m]);
            list.get(&view.name).copied().or(exif)
        })
        .collect();
    let Some(fit) = GpsFit::new(views, &places) else {
        return Ok(());
    };
    let summary = fit.summary();
    if !fit.is_credible() {
        notes.push(Note::new("gps-contradicts", format!("{summary}: too far off to be used")));
        return Ok(());
    }
    check_scale(&fit, known, notes);
    let up = known.frame.up_world;
    fit.complete(&mut known.frame);
    if known.up {
        known.frame.up_world = up;
    }
    known.up = true;
    let metric = if fit.agrees_with_metres() { "; the model is in metres with z up already" } else { "" };
    notes.push(Note::new("gps-fit", format!("{summary}{metric}")));
    known.sources.push(format!("GPS ({summary}{metric})"));
    Ok(())
}

/// Warns where the scale that a file gives and that of the GPS differ by more than 10 %.
fn check_scale(fit: &GpsFit, known: &Known, notes: &mut Vec<Note>) {
    let scale = fit.enu_from_world.scale;
    if let Some(given) = known.frame.metres_per_unit.filter(|given| (scale / given - 1.0).abs() > 0.1) {
        let text = format!("the scale is given as {given:.4} metres per unit, but GPS says {scale:.4}");
        notes.push(Note::new("scale-contradicts", text));
    }
}

fn use_cameras(views: &[View], known: &mut Known) {
    if known.up {
        return;
    }
    let Some((up, source)) = up_from_cameras(views) else { return };
    known.frame.up_world = up;
    known.sources.push(match source {
        UpSource::RightAxes => "up from the cameras' right axes".into(),
        UpSource::CenterPlane => "up from the plane of the camera centres".into(),
        UpSource::MeanCamera => "up from the cameras' mean (rough)".into(),
    });
}
