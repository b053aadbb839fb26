//! Photographs by ray casting: exact instance and depth at pixel centres, colour from four samples per pixel.
//! Where a pixel and its eight neighbours lie on one flat surface in one light, the samples meet its plane without a walk
//! through the tree; elsewhere every sample is traced.

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

use super::Town;
use super::solids::{Material, Surface};
use super::texture::{albedo, hash};
use crate::image::Image;
use crate::maps::Map;

/// What a camera of the town records.
#[derive(Clone, Debug, PartialEq)]
pub struct Photograph {
    /// sRGB-like colour through the view's own lens.
    pub image: Image,
    /// Building number at every pixel centre; 0 = none.
    pub instances: Map<u16>,
    /// Depth along the optical axis of the true camera at every pixel centre, metres; 0 = sky.
    pub depth: Map<f32>,
}

/// A rotated grid: four samples of a pixel.
const SAMPLES: [[f64; 2]; 4] = [[0.375, 0.125], [0.875, 0.375], [0.125, 0.625], [0.625, 0.875]];
/// Surfaces are left by this much before a shadow ray starts, metres.
const LIFT: f64 = 1e-4;
/// No surface: the sky.
const SKY: u32 = u32::MAX;

/// What a ray meets.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct Sight {
    /// Surface index or [`SKY`].
    pub surface: u32,
    /// Ray parameter; depth along the optical axis for camera rays.
    pub t: f64,
    /// Normal at the place met, towards the outside.
    pub normal: DVec3,
    /// Whether the sun reaches it.
    pub lit: bool,
}

impl Sight {
    /// The surface, unless it is the sky.
    pub(super) fn surface_index(&self) -> Option<usize> {
        (self.surface != SKY).then_some(self.surface as usize)
    }
}

/// Where the rays of one view start and lead.
pub(super) struct Rays<'a> {
    town: &'a Town,
    view_index: usize,
    pub(super) center: DVec3,
    world_from_camera: DMat3,
    through_lens: bool,
}

impl<'a> Rays<'a> {
    pub(super) fn new(town: &'a Town, view_index: usize) -> Self {
        let pose = &town.true_poses[view_index];
        let through_lens = !town.scene.views[view_index].lens.model.is_pinhole();
        let world_from_camera = pose.rotation_matrix().transpose();
        Self { town, view_index, center: pose.origin_of_a(), world_from_camera, through_lens }
    }

    /// The ray through image coordinates, town frame, z = 1 along the optical axis.
    pub(super) fn direction(&self, x: f64, y: f64) -> DVec3 {
        let view = &self.town.scene.views[self.view_index];
        let ray = if self.through_lens {
            // Where a strong lens has no ray, the pinhole's stands in.
            view.lens.unproject(DVec2::new(x, y)).unwrap_or_else(|| view.camera.ray(x, y))
        } else {
            view.camera.ray(x, y)
        };
        self.world_from_camera * ray
    }
}

impl Town {
    /// The photograph of a view from its TRUE pose and through its lens. Panics where there is no such view.
    #[must_use]
    pub fn photograph(&self, view_index: usize) -> Photograph {
        let (width, height) = (self.options.width.max(1), self.options.height.max(1));
        let rays = Rays::new(self, view_index);
        let sights: Vec<Sight> = (0..height)
            .into_par_iter()
            .flat_map_iter(|y| {
                let rays = &rays;
                (0..width).map(move |x| self.sight(rays.center, rays.direction(f64::from(x) + 0.5, f64::from(y) + 0.5)))
            })
            .collect();
        let pixels = (0..height)
            .into_par_iter()
            .flat_map_iter(|y| {
                let (rays, sights) = (&rays, &sights);
                (0..width).map(move |x| self.pixel(rays, sights, x, y))
            })
            .collect();
        let building = |sight: &Sight| sight.surface_index().map_or(0, |s| self.solids.surfaces[s].building as u16);
        Photograph {
            image: Image { width, height, pixels },
            instances: Map { width, height, values: sights.iter().map(building).collect() },
            depth: Map { width, height, values: sights.iter().map(|sight| sight.t as f32).collect() },
        }
    }

    /// What a ray of the town frame meets first, and whether the sun shines there.
    pub(super) fn sight(&self, origin: DVec3, direction: DVec3) -> Sight {
        let mut surface = SKY;
        let mut reach = f64::INFINITY;
        if direction.z < 0.0 {
            let t = -origin.z / direction.z;
            let place = origin + direction * t;
            let half = self.solids.ground_half;
            if t > 0.0 && place.x.abs() < half.x && place.y.abs() < half.y {
                (surface, reach) = (0, t);
            }
        }
        let mut normal = DVec3::Z;
        if let Some((face, t)) = self.bvh.nearest(origin, direction, reach) {
            surface = self.solids.face_surfaces[face as usize];
            reach = t;
            normal = self.normal_of(face, surface);
        }
        if surface == SKY {
            return Sight { surface, t: 0.0, normal, lit: true };
        }
        let place = origin + direction * reach;
        let lit = normal.dot(self.sun) > 0.0 && !self.bvh.blocked(place + normal * LIFT, self.sun, f64::INFINITY);
        Sight { surface, t: reach, normal, lit }
    }

    fn normal_of(&self, face: u32, surface: u32) -> DVec3 {
        let surface = &self.solids.surfaces[surface as usize];
        if surface.material != Material::Crown {
            return surface.normal;
        }
        let [a, b, c] = self.solids.corners(face as usize);
        (b - a).cross(c - a).normalize()
    }

    fn pixel(&self, rays: &Rays<'_>, sights: &[Sight], x: u32, y: u32) -> [u8; 3] {
        let (width, height) = (self.options.width.max(1), self.options.height.max(1));
        let sight = &sights[(y * width + x) as usize];
        let alike = |other: &Sight| other.surface == sight.surface && other.lit == sight.lit;
        let even = match sight.surface_index() {
            None => false,
            Some(surface) => {
                self.solids.surfaces[surface].material != Material::Crown
                    && (y.saturating_sub(1)..=(y + 1).min(height - 1)).all(|row| {
                        let start = (row * width) as usize;
                        let columns = x.saturating_sub(1) as usize..=(x + 1).min(width - 1) as usize;
                        sights[start + columns.start()..=start + columns.end()].iter().all(alike)
                    })
            }
        };
        let mut sum = DVec3::ZERO;
        for [dx, dy] in SAMPLES {
            let direction = rays.direction(f64::from(x) + dx, f64::from(y) + dy);
            let sample = if even {
                let surface = &self.solids.surfaces[sight.surface as usize];
                let t = (surface.origin - rays.center).dot(sight.normal) / direction.dot(sight.normal);
                Sight { t, ..*sight }
            } else {
                self.sight(rays.center, direction)
            };
            sum += self.radiance(rays.center, direction, &sample);
        }
        let noise_seed = self.options.seed as u32 ^ (rays.view_index as u32).wrapping_mul(0x9E37);
        let linear = sum / SAMPLES.len() as f64 * self.exposures[rays.view_index];
        let encoded = encode(linear);
        let level = |channel: i32| {
            let noise = self.options.image_noise * bell(hash((y * width + x) as i32, channel, noise_seed));
            (encoded[channel as usize] + noise).round().clamp(0.0, 255.0) as u8
        };
        [level(0), level(1), level(2)]
    }

    /// Linear light that comes back along a ray, before the exposure.
    pub(super) fn radiance(&self, origin: DVec3, direction: DVec3, sight: &Sight) -> DVec3 {
        let Some(index) = sight.surface_index() else {
            return DVec3::new(0.62, 0.75, 0.95);
        };
        let surface = &self.solids.surfaces[index];
        let place = origin + direction * sight.t;
        let slant = direction.length();
        let facing = (direction.dot(sight.normal) / slant).abs().max(0.2);
        let focal_px = self.options.focal_ratio.max(0.05) * f64::from(self.options.width.max(1));
        let footprint = sight.t * slant / (focal_px * facing.sqrt());
        albedo(&self.layout, surface, place, footprint) * self.light(surface, sight, place)
    }

    /// Sun and sky on a white surface: Lambert, with a hemisphere of sky and some light from the ground.
    fn light(&self, surface: &Surface, sight: &Sight, place: DVec3) -> DVec3 {
        let mut normal = sight.normal;
        if surface.material == Material::Crown {
            normal = (normal + (place - surface.origin).normalize()).normalize();
        }
        let sun = if sight.lit { normal.dot(self.sun).max(0.0) } else { 0.0 };
        let sky = self.options.ambient * (0.6 + 0.4 * normal.z);
        DVec3::new(1.25, 1.18, 1.05) * sun + DVec3::new(0.86, 0.98, 1.16) * sky
    }
}

/// Linear light to grey levels of 255: the power 1 / 2.2 of the displays of old.
pub(super) fn encode(linear: DVec3) -> DVec3 {
    let level = |value: f64| 255.0 * f64::from(libm::powf(value.clamp(0.0, 1.0) as f32, 1.0 / 2.2));
    DVec3::new(level(linear.x), level(linear.y), level(linear.z))
}

/// Four uniform bytes added up: nearly normal, mean 0, deviation 1.
fn bell(bits: u32) -> f64 {
    let sum: u32 = bits.to_le_bytes().iter().map(|&byte| u32::from(byte)).sum();
    (f64::from(sum) - 510.0) / 147.8
}
