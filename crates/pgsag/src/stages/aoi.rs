//! The area of interest: a GeoJSON polygon in scene coordinates, or everything.

use std::path::Path;

use anyhow::Result;
use glam::DVec3;
use pgsag_scene::Scene;
use serde_json::Value;

use super::{config, source_fingerprint};
use crate::config::Config;
use crate::error::UserError;
use crate::run::Run;

/// Rings of polygons in x and y; a point is inside where it is inside an odd number of rings.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Area {
    rings: Vec<Vec<[f64; 2]>>,
}

impl Area {
    /// The area of a run's settings.
    ///
    /// # Errors
    /// [`UserError`] where the file holds no polygon.
    pub fn of(config: &Config) -> Result<Self> {
        if config.aoi.is_empty() { Ok(Self::default()) } else { Self::read(Path::new(&config.aoi)) }
    }

    /// Reads a polygon, a multi-polygon, or features of them.
    ///
    /// # Errors
    /// [`UserError`] where the file holds none.
    pub fn read(path: &Path) -> Result<Self> {
        let bad = |cause: &str| UserError::at(path, cause, "give a GeoJSON polygon in scene coordinates");
        let text = std::fs::read_to_string(path).map_err(|_| bad("cannot be read"))?;
        let value: Value = serde_json::from_str(&text).map_err(|error| bad(&error.to_string()))?;
        let mut rings = Vec::new();
        collect(&value, &mut rings);
        if rings.is_empty() {
            return Err(bad("holds no polygon").into());
        }
        Ok(Self { rings })
    }

    /// The first ring.
    #[must_use]
    pub fn outline(&self) -> Vec<[f64; 2]> {
        self.rings.first().cloned().unwrap_or_default()
    }

    /// Whether there is no limit.
    #[must_use]
    pub fn is_everything(&self) -> bool {
        self.rings.is_empty()
    }

    /// Whether a point lies in it, in plan view.
    #[must_use]
    pub fn contains(&self, point_world: DVec3) -> bool {
        self.is_everything() || self.rings.iter().filter(|ring| is_inside(ring, point_world)).count() % 2 == 1
    }

    /// `[views]` Which views see a sparse point of it; all where points keep no tracks.
    #[must_use]
    pub fn views_seeing(&self, scene: &Scene) -> Vec<bool> {
        let is_untracked = scene.points.iter().all(|point| point.track.is_empty());
        let mut seen = vec![self.is_everything() || is_untracked; scene.views.len()];
        if seen.contains(&false) {
            for point in scene.points.iter().filter(|point| self.contains(point.position_world)) {
                point.track.iter().for_each(|element| seen[element.view_index as usize] = true);
            }
        }
        seen
    }
}

/// The polygon's file; another polygon is another answer, wherever it lies.
pub(crate) fn sources(run: &Run) -> Result<Vec<(String, String)>> {
    let aoi = config(run)?.aoi;
    Ok(if aoi.is_empty() {
        Vec::new()
    } else {
        vec![("area of interest".into(), source_fingerprint(Path::new(&aoi))?)]
    })
}

fn collect(value: &Value, rings: &mut Vec<Vec<[f64; 2]>>) {
    let ring = |value: &Value| -> Option<Vec<[f64; 2]>> {
        let at = |point: &Value| Some([point.get(0)?.as_f64()?, point.get(1)?.as_f64()?]);
        value.as_array()?.iter().map(at).collect::<Option<Vec<_>>>().filter(|ring| ring.len() >= 3)
    };
    let all = |value: Option<&Value>| value.and_then(Value::as_array).cloned().unwrap_or_default();
    let coordinates = all(value.get("coordinates"));
    match value.get("type").and_then(Value::as_str) {
        Some("Polygon") => rings.extend(coordinates.iter().filter_map(ring)),
        Some("MultiPolygon") => {
            rings.extend(coordinates.iter().filter_map(Value::as_array).flatten().filter_map(ring));
        }
        Some("Feature") => value.get("geometry").into_iter().for_each(|geometry| collect(geometry, rings)),
        Some("FeatureCollection") => all(value.get("features")).iter().for_each(|feature| collect(feature, rings)),
        Some("GeometryCollection") => all(value.get("geometries")).iter().for_each(|part| collect(part, rings)),
        _ => {}
    }
}

/// Even-odd rule; the closing corner may be repeated or not.
fn is_inside(ring: &[[f64; 2]], point: DVec3) -> bool {
    let mut inside = false;
    let mut previous = ring[ring.len() - 1];
    for &corner in ring {
        let crosses = (corner[1] > point.y) != (previous[1] > point.y);
        if crosses {
            let share = (point.y - corner[1]) / (previous[1] - corner[1]);
            if point.x < corner[0] + share * (previous[0] - corner[0]) {
                inside = !inside;
            }
        }
        previous = corner;
    }
    inside
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(text: &str) -> Result<Area> {
        let file = tempfile::NamedTempFile::new().expect("temporary file");
        std::fs::write(file.path(), text).expect("written");
        Area::read(file.path())
    }

    #[test]
    fn a_hole_is_outside_and_closing_does_not_matter() {
        let open = r#"{"type":"Feature","geometry":{"type":"Polygon","coordinates":
            [[[0,0],[4,0],[4,4],[0,4]],[[1,1],[2,1],[2,2],[1,2],[1,1]]]}}"#;
        let area = area(open).expect("a polygon");
        let at = |x, y| area.contains(DVec3::new(x, y, 100.0));
        assert!(at(3.0, 3.0) && at(0.5, 0.5));
        assert!(!at(1.5, 1.5) && !at(5.0, 1.0) && !at(-0.1, 2.0));
    }

    #[test]
    fn no_polygon_is_an_error_with_the_file() {
        let error = area(r#"{"type":"Point","coordinates":[1,2]}"#).expect_err("no polygon");
        assert!(error.to_string().contains("holds no polygon"));
        assert!(area("{").is_err());
        assert!(Area::default().contains(DVec3::ZERO));
    }
}
