//! WGS 84: latitude, longitude and height to a local east-north-up frame and back.

use glam::{DMat3, DVec3};

/// Semi-major axis of WGS 84, metres.
const A: f64 = 6_378_137.0;
/// First eccentricity of WGS 84, squared.
const E2: f64 = 6.694_379_990_141_316e-3;

/// A frame tangent to the ellipsoid: x east, y north, z up, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalFrame {
    origin_ecef: DVec3,
    /// Columns are east, north and up in earth-centred axes.
    ecef_from_enu: DMat3,
}

impl LocalFrame {
    /// The frame at latitude (deg), longitude (deg), ellipsoidal height (m).
    #[must_use]
    pub fn at(lla: [f64; 3]) -> Self {
        let (lat, lon) = (lla[0].to_radians(), lla[1].to_radians());
        let (sin_lat, cos_lat) = (libm::sin(lat), libm::cos(lat));
        let (sin_lon, cos_lon) = (libm::sin(lon), libm::cos(lon));
        let east = DVec3::new(-sin_lon, cos_lon, 0.0);
        let north = DVec3::new(-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat);
        let up = DVec3::new(cos_lat * cos_lon, cos_lat * sin_lon, sin_lat);
        Self { origin_ecef: ecef_from_lla(lla), ecef_from_enu: DMat3::from_cols(east, north, up) }
    }

    /// East, north, up of a place.
    #[must_use]
    pub fn enu(&self, lla: [f64; 3]) -> DVec3 {
        self.ecef_from_enu.transpose() * (ecef_from_lla(lla) - self.origin_ecef)
    }

    /// Latitude (deg), longitude (deg), ellipsoidal height (m) of a point of the frame.
    #[must_use]
    pub fn lla(&self, enu: DVec3) -> [f64; 3] {
        lla_from_ecef(self.origin_ecef + self.ecef_from_enu * enu)
    }
}

/// Earth-centred coordinates, metres.
#[must_use]
pub fn ecef_from_lla([latitude_deg, longitude_deg, height]: [f64; 3]) -> DVec3 {
    let (lat, lon) = (latitude_deg.to_radians(), longitude_deg.to_radians());
    let (sin_lat, cos_lat) = (libm::sin(lat), libm::cos(lat));
    let n = A / (1.0 - E2 * sin_lat * sin_lat).sqrt();
    let across = (n + height) * cos_lat;
    DVec3::new(across * libm::cos(lon), across * libm::sin(lon), (n * (1.0 - E2) + height) * sin_lat)
}

/// Latitude (deg), longitude (deg), height (m) of earth-centred coordinates, by fixed-point iteration.
#[must_use]
pub fn lla_from_ecef(at: DVec3) -> [f64; 3] {
    let across = (at.x * at.x + at.y * at.y).sqrt();
    let longitude = libm::atan2(at.y, at.x);
    let mut lat = libm::atan2(at.z, across * (1.0 - E2));
    for _ in 0..10 {
        let sin_lat = libm::sin(lat);
        let n = A / (1.0 - E2 * sin_lat * sin_lat).sqrt();
        lat = libm::atan2(at.z + E2 * n * sin_lat, across);
    }
    let (sin_lat, cos_lat) = (libm::sin(lat), libm::cos(lat));
    let n = A / (1.0 - E2 * sin_lat * sin_lat).sqrt();
    let height = across * cos_lat + at.z * sin_lat - n * (1.0 - E2 * sin_lat * sin_lat);
    [lat.to_degrees(), longitude.to_degrees(), height]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_places() {
        assert!((ecef_from_lla([0.0, 0.0, 0.0]) - DVec3::new(A, 0.0, 0.0)).length() < 1e-6);
        assert!((ecef_from_lla([90.0, 0.0, 0.0]).z - 6_356_752.314_245).abs() < 1e-6);
        // A minute of arc along a meridian is a nautical mile, about.
        let frame = LocalFrame::at([45.0, 7.0, 100.0]);
        assert!((frame.enu([45.0 + 1.0 / 60.0, 7.0, 100.0]).y - 1852.2).abs() < 0.2);
        assert!((frame.enu([45.0, 7.0, 112.5]) - DVec3::Z * 12.5).length() < 1e-8);
    }

    #[test]
    fn there_and_back() {
        for lla in [[46.8, -92.0, 200.0], [-33.5, 151.2, -5.0], [89.9, 10.0, 3000.0], [0.0, 180.0, 0.0]] {
            let frame = LocalFrame::at([lla[0] - 0.01, lla[1] + 0.01, 0.0]);
            let back = frame.lla(frame.enu(lla));
            assert!((back[0] - lla[0]).abs() < 1e-10 && (back[2] - lla[2]).abs() < 1e-6, "{lla:?} {back:?}");
            let turn = (back[1] - lla[1]).rem_euclid(360.0);
            assert!(turn.min(360.0 - turn) < 1e-9);
        }
    }
}
