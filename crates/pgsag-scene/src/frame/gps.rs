//! Scale, up and place of a scene from the places where its photographs were taken.

use glam::DVec3;

use super::Frame;
use super::geodesy::LocalFrame;
use super::similarity::Similarity;
use crate::numbers::quantile;
use crate::scene::View;

/// How the camera centres fit the places that the photographs carry.
#[derive(Clone, Debug, PartialEq)]
pub struct GpsFit {
    /// To east-north-up metres about `origin_lla`.
    pub enu_from_world: Similarity,
    /// Latitude (deg), longitude (deg), height (m) of the local frame's origin.
    pub origin_lla: [f64; 3],
    /// Root mean square of the distances between centres and places that were used, metres.
    pub rms_m: f64,
    /// The largest of them.
    pub max_m: f64,
    /// Root mean square distance of the used places from their mean, metres.
    pub spread_m: f64,
    /// Photographs used, and photographs with a place.
    pub used: [usize; 2],
}

impl GpsFit {
    /// Fits the camera centres to places (latitude, longitude, height) where there are some, despite outliers; `None`
    /// with fewer than three, or where they lie on a line.
    #[must_use]
    pub fn new(views: &[View], places_lla: &[Option<[f64; 3]>]) -> Option<Self> {
        let known: Vec<(DVec3, [f64; 3])> =
            views.iter().zip(places_lla).filter_map(|(view, lla)| Some((view.center_world(), (*lla)?))).collect();
        if known.len() < 3 {
            return None;
        }
        let middle = |axis: usize| {
            let mut values: Vec<f64> = known.iter().map(|(_, lla)| lla[axis]).collect();
            quantile(&mut values, 0.5)
        };
        let origin_lla = [middle(0)?, middle(1)?, middle(2)?];
        let local = LocalFrame::at(origin_lla);
        let pairs: Vec<(DVec3, DVec3)> = known.iter().map(|(center, lla)| (*center, local.enu(*lla))).collect();
        let (enu_from_world, kept) = Similarity::robust(&pairs)?;
        let used: Vec<_> = pairs.iter().zip(&kept).filter(|(_, kept)| **kept).map(|(pair, _)| pair).collect();
        let misses = used.iter().map(|(a, b)| (enu_from_world.transform_point(*a) - *b).length_squared());
        let (sum, max) = misses.fold((0.0, 0.0f64), |(sum, max), miss| (sum + miss, max.max(miss)));
        let count = used.len() as f64;
        let mean = used.iter().map(|(_, b)| *b).sum::<DVec3>() / count;
        let spread_m = (used.iter().map(|(_, b)| (*b - mean).length_squared()).sum::<f64>() / count).sqrt();
        let (rms_m, max_m) = ((sum / count).sqrt(), max.sqrt());
        Some(Self { enu_from_world, origin_lla, rms_m, max_m, spread_m, used: [used.len(), known.len()] })
    }

    /// Whether the places say something: the misses are small against the spread, and most places agree.
    #[must_use]
    pub fn is_credible(&self) -> bool {
        self.rms_m < 0.1 * self.spread_m && 2 * self.used[0] > self.used[1]
    }

    /// Whether the model is in metres with z up already: the scale is 1 within 3 % and up within 3 degrees, which is
    /// what consumer receivers can tell.
    #[must_use]
    pub fn agrees_with_metres(&self) -> bool {
        /// Cosine of 3 degrees.
        const NEARLY_UPRIGHT: f64 = 0.998_629_5;
        let up = self.enu_from_world.rotation * DVec3::Z;
        (self.enu_from_world.scale - 1.0).abs() < 0.03 && up.z > NEARLY_UPRIGHT
    }

    /// Puts scale, up and place into a frame, where it does not know them yet.
    pub fn complete(&self, frame: &mut Frame) {
        let metric = self.agrees_with_metres();
        let scale = if metric { 1.0 } else { self.enu_from_world.scale };
        frame.metres_per_unit.get_or_insert(scale);
        if frame.origin_lla.is_none() {
            /// A local frame is flat; beyond this its height says nothing, metres.
            const FLAT_M: f64 = 2e4;
            let origin = self.enu_from_world.translation;
            frame.origin_lla = (origin.length() < FLAT_M).then(|| LocalFrame::at(self.origin_lla).lla(origin));
        }
        frame.up_world = if metric { DVec3::Z } else { self.enu_from_world.rotation.inverse() * DVec3::Z };
    }

    /// The fit in words.
    #[must_use]
    pub fn summary(&self) -> String {
        format!(
            "camera centres fit the GPS of {} of {} photographs with RMS {:.2} m (largest {:.2} m) over a spread of \
             {:.1} m",
            self.used[0], self.used[1], self.rms_m, self.max_m, self.spread_m
        )
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;
    use crate::camera::Pinhole;
    use crate::numbers::SplitMix64;
    use crate::pose::RigidTransform;

    fn scene(world_from_enu: &Similarity) -> (Vec<View>, Vec<Option<[f64; 3]>>) {
        let mut stream = SplitMix64::new(21);
        let local = LocalFrame::at([46.8, -92.0, 0.0]);
        let camera = Pinhole { width: 10, height: 10, fx: 10.0, fy: 10.0, cx: 5.0, cy: 5.0 };
        let mut one = |i: u32| {
            let enu = DVec3::new(f64::from(i % 6) * 20.0, f64::from(i / 6) * 25.0, 60.0);
            let seen = enu + DVec3::new(stream.normal(), stream.normal(), stream.normal()) * 0.3;
            let translation = -world_from_enu.transform_point(enu);
            let camera_from_world = RigidTransform { rotation: DQuat::IDENTITY, translation };
            let view = View { name: i.to_string(), lens: camera.into(), camera, camera_from_world };
            (view, (i % 5 != 4).then(|| local.lla(seen)))
        };
        (0..30).map(&mut one).unzip()
    }

    #[test]
    fn a_model_in_its_own_frame_learns_scale_up_and_place() {
        let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 2.0, 0.3, 0.5);
        let world_from_enu = Similarity { scale: 0.02, rotation, translation: DVec3::new(1.0, 2.0, 3.0) };
        let (views, places) = scene(&world_from_enu);
        let fit = GpsFit::new(&views, &places).unwrap();
        assert!(fit.is_credible() && !fit.agrees_with_metres());
        assert_eq!(fit.used[1], 24);
        assert!(fit.rms_m > 0.1 && fit.rms_m < 0.8, "{}", fit.rms_m);
        let mut frame = Frame::default();
        fit.complete(&mut frame);
        assert!((frame.metres_per_unit.unwrap() / 50.0 - 1.0).abs() < 0.01);
        assert!(frame.up_world.angle_between(rotation * DVec3::Z) < 0.02);
        let enu = LocalFrame::at([46.8, -92.0, 0.0]).enu(frame.origin_lla.unwrap());
        assert!((world_from_enu.transform_point(enu)).length() < 0.1, "{enu}");
    }

    #[test]
    fn a_model_in_metres_stays_as_it_is_even_far_away() {
        for translation in [DVec3::ZERO, DVec3::new(4.5e5, 5.1e6, 0.0)] {
            let (views, places) = scene(&Similarity { scale: 1.0, rotation: DQuat::IDENTITY, translation });
            let fit = GpsFit::new(&views, &places).unwrap();
            assert!(fit.is_credible() && fit.agrees_with_metres());
            let mut frame = Frame::default();
            fit.complete(&mut frame);
            assert_eq!((frame.metres_per_unit, frame.up_world), (Some(1.0), DVec3::Z));
            assert_eq!(frame.origin_lla.is_some(), translation == DVec3::ZERO);
        }
    }

    #[test]
    fn places_that_contradict_the_model_are_not_believed() {
        let identity = Similarity { scale: 1.0, rotation: DQuat::IDENTITY, translation: DVec3::ZERO };
        let (views, places) = scene(&identity);
        let places: Vec<_> = (0..30).map(|i| places[i * 7 % 30]).collect();
        assert!(GpsFit::new(&views, &places).is_none_or(|fit| !fit.is_credible()));
        assert_eq!(GpsFit::new(&views[..2], &places[..2]), None);
    }
}
