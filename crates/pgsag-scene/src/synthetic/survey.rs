//! What structure-from-motion leaves of the town: sparse points with tracks, noise and false matches.
//! Points are drawn where the surface has texture, seen by the views that really see them, observed in the true
//! cameras with pixel noise, and triangulated in the DELIVERED poses: pose noise ends up in the points as it does in
//! a bundle whose cameras were fixed.

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

use super::Town;
use super::photography::{Rays, encode};
use super::solids::Material;
use crate::camera::Pinhole;
use crate::numbers::SplitMix64;
use crate::points::{SparsePoint, TrackElement};
use crate::pose::RigidTransform;

/// Candidates drawn at once; fixed, so that the points do not depend on the threads.
const BATCH: u64 = 2048;
/// Candidates per wanted point before the survey gives up.
const PATIENCE: u64 = 60;
/// Views steeper than this see no feature: cosine of 75 degrees.
const MIN_COS_INCIDENCE: f64 = 0.258_819;
/// Two rays closer than this fix no point: cosine of 2 degrees.
const MAX_COS_PARALLAX: f64 = 0.999_391;
/// Features nearer to the border are not detected, pixels.
const BORDER_PX: f64 = 3.0;

/// A place that a view looks at.
struct Feature {
    place: DVec3,
    normal: DVec3,
    color: [u8; 3],
}

impl Town {
    /// The points, world frame. The views must be in place.
    pub(super) fn survey(&self) -> Vec<SparsePoint> {
        let wanted = self.options.point_count as usize;
        let mut points = Vec::with_capacity(wanted);
        let mut next = 0u64;
        while !self.true_poses.is_empty() && points.len() < wanted && next < wanted as u64 * PATIENCE {
            let batch: Vec<Option<SparsePoint>> =
                (next..next + BATCH).into_par_iter().map(|number| self.sparse_point(number)).collect();
            points.extend(batch.into_iter().flatten());
            next += BATCH;
        }
        points.truncate(wanted);
        points
    }

    fn sparse_point(&self, number: u64) -> Option<SparsePoint> {
        let mut random = SplitMix64::new(self.options.seed ^ number.wrapping_mul(0xD1B5_4A32_D192_ED03));
        let feature = self.feature(&mut random)?;
        let mut seen = Vec::new();
        for (view_index, pose) in self.true_poses.iter().enumerate() {
            let kept = random.uniform() < self.options.observation_share;
            let noise = DVec2::new(random.normal(), random.normal()) * self.options.point_noise_px;
            if kept && self.sees(view_index, feature.place, feature.normal, MIN_COS_INCIDENCE) {
                let camera = &self.scene.views[view_index].camera;
                let at = camera.project(pose.transform_point(feature.place))? + noise;
                seen.push((view_index as u32, at));
            }
        }
        if self.parallax_cos(&seen, feature.place) > MAX_COS_PARALLAX {
            return None;
        }
        let mut start = feature.place;
        if random.uniform() < self.options.outlier_share {
            start = self.false_match(&mut random, &mut seen, feature.place)?;
        }
        let start = start + self.offset();
        let track =
            seen.iter().map(|&(view_index, at)| TrackElement { view_index, xy_px: at.as_vec2().into() }).collect();
        let position_world = triangulate(&self.observers(&seen), start)?;
        let error_px = mean_error(&self.observers(&seen), position_world) as f32;
        Some(SparsePoint { position_world, color: feature.color, error_px, track })
    }

    /// A textured place under a random pixel of a random view.
    fn feature(&self, random: &mut SplitMix64) -> Option<Feature> {
        let view_index = random.below(self.true_poses.len());
        let rays = Rays::new(self, view_index);
        let lens = &self.scene.views[view_index].lens;
        let x = random.range(BORDER_PX, f64::from(lens.width) - BORDER_PX);
        let y = random.range(BORDER_PX, f64::from(lens.height) - BORDER_PX);
        let direction = rays.direction(x, y);
        let sight = self.sight(rays.center, direction);
        let surface = &self.solids.surfaces[sight.surface_index()?];
        let color = self.radiance(rays.center, direction, &sight);
        let place = rays.center + direction * sight.t;
        let contrast = |axis: DVec3| {
            let beside = place + axis * (1.5 * self.options.gsd_m);
            let other = self.radiance(rays.center, (beside - rays.center) / sight.t, &sight);
            (other.element_sum() / color.element_sum() - 1.0).abs()
        };
        let likely = if surface.material == Material::Crown { 0.3 } else { contrast(surface.u) + contrast(surface.v) };
        let encoded = encode(color * self.exposures[view_index]);
        let color = encoded.to_array().map(|level| level.round().clamp(0.0, 255.0) as u8);
        (random.uniform() < 1.5 * likely).then_some(Feature { place, normal: sight.normal, color })
    }

    /// Whether a view sees a place of the town frame, from its true pose: in the image, facing, and nothing before it.
    pub(super) fn sees(&self, view_index: usize, place: DVec3, normal: DVec3, min_cos: f64) -> bool {
        let pose = &self.true_poses[view_index];
        let camera = &self.scene.views[view_index].camera;
        let Some(at) = camera.project(pose.transform_point(place)) else { return false };
        let inside = at.x > BORDER_PX
            && at.y > BORDER_PX
            && at.x < f64::from(camera.width) - BORDER_PX
            && at.y < f64::from(camera.height) - BORDER_PX;
        let toward = pose.origin_of_a() - place;
        inside
            && toward.dot(normal) > min_cos * toward.length()
            && !self.bvh.blocked(place + normal * 1e-3, toward, 1.0)
    }

    /// Cosine of the widest angle between two of the rays that see a place; 1 for fewer than two.
    fn parallax_cos(&self, seen: &[(u32, DVec2)], place: DVec3) -> f64 {
        let rays: Vec<DVec3> = seen
            .iter()
            .map(|&(view_index, _)| (self.true_poses[view_index as usize].origin_of_a() - place).normalize())
            .collect();
        let pairs = rays.iter().enumerate().flat_map(|(k, a)| rays[k + 1..].iter().map(move |b| a.dot(*b)));
        pairs.fold(1.0, f64::min)
    }

    /// Two views that agree on a place along the ray of the first which is nowhere near the surface.
    fn false_match(&self, random: &mut SplitMix64, seen: &mut Vec<(u32, DVec2)>, place: DVec3) -> Option<DVec3> {
        let (first, second) = (seen.first()?.0 as usize, seen.last()?.0 as usize);
        let center = self.true_poses[first].origin_of_a();
        let factor = if random.uniform() < 0.5 { random.range(0.45, 0.85) } else { random.range(1.2, 1.9) };
        let wrong = center + (place - center) * factor;
        seen.clear();
        for view_index in [first, second] {
            let at = self.scene.views[view_index].camera.project(self.true_poses[view_index].transform_point(wrong))?;
            let noise = DVec2::new(random.normal(), random.normal()) * self.options.point_noise_px;
            seen.push((view_index as u32, at + noise));
        }
        let camera = &self.scene.views[second].camera;
        (first != second && camera.contains(seen[1].1)).then_some(wrong)
    }

    fn observers(&self, seen: &[(u32, DVec2)]) -> Vec<(Pinhole, RigidTransform, DVec2)> {
        let view = |k: u32| &self.scene.views[k as usize];
        seen.iter().map(|&(k, at)| (view(k).camera, view(k).camera_from_world, at)).collect()
    }
}

/// The place of least squared reprojection error by Gauss-Newton steps from `start`, world frame.
/// `None` where it runs away or behind a camera.
fn triangulate(observers: &[(Pinhole, RigidTransform, DVec2)], start: DVec3) -> Option<DVec3> {
    // About `start`: world coordinates may be millions of metres.
    let mut shift = DVec3::ZERO;
    for _ in 0..6 {
        let (mut normal_matrix, mut gradient) = (DMat3::ZERO, DVec3::ZERO);
        for (camera, pose, at) in observers {
            let pose = pose.with_origin(start);
            let p = pose.transform_point(shift);
            let residual = camera.project(p)? - *at;
            let rotation = pose.rotation_matrix().transpose();
            let jx = rotation * DVec3::new(camera.fx / p.z, 0.0, -camera.fx * p.x / (p.z * p.z));
            let jy = rotation * DVec3::new(0.0, camera.fy / p.z, -camera.fy * p.y / (p.z * p.z));
            normal_matrix += DMat3::from_cols(jx * jx.x, jx * jx.y, jx * jx.z);
            normal_matrix += DMat3::from_cols(jy * jy.x, jy * jy.y, jy * jy.z);
            gradient += jx * residual.x + jy * residual.y;
        }
        let step = normal_matrix.inverse() * gradient;
        shift -= step;
        if !shift.is_finite() || step.length() < 1e-9 {
            break;
        }
    }
    let sane = shift.is_finite() && observers.iter().all(|(_, pose, _)| pose.transform_point(start + shift).z > 0.0);
    sane.then_some(start + shift)
}

fn mean_error(observers: &[(Pinhole, RigidTransform, DVec2)], place: DVec3) -> f64 {
    let error = |(camera, pose, at): &(Pinhole, RigidTransform, DVec2)| {
        camera.project(pose.transform_point(place)).map_or(0.0, |seen| seen.distance(*at))
    };
    observers.iter().map(error).sum::<f64>() / observers.len().max(1) as f64
}
