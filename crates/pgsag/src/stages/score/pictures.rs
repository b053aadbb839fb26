//! Where a surface is wrong: residuals on a photograph, and, where there is a truth, distances from it and to it.

use std::path::Path;

use anyhow::{Context as _, Result};
use glam::DVec3;
use pgsag_mesh::evidence::flow::Verdict;
use pgsag_mesh::render::{NO_FACE, Visibility, visibility};
use pgsag_mesh::score::{distance_color, distances_from_mesh, distances_from_truth};
use pgsag_scene::files::raster::encode_jpeg;
use pgsag_scene::{Image, Mesh, Pinhole, RigidTransform};
use serde::{Deserialize, Serialize};

use super::TruthFile;
use super::evidence::PatchView;
use crate::config::Config;
use crate::photographs::Photographs;
use crate::report::pictures::{NOTHING, QUALITY, small};
use crate::run::stage::Job;
use crate::stages::import::Imported;
use crate::stages::{view_file, write, write_json};

/// Residuals of so many pixels, and more, are red.
const CAP_PX: f64 = 1.0;
/// Distances of so many metres, and more, are red.
pub const CAP_M: f64 = 0.5;
/// Patches that match nothing.
const LOST: [u8; 3] = [200, 40, 200];

/// A picture that the report shows.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Picture {
    /// Index of the view.
    pub view: usize,
    /// What it shows.
    pub title: String,
    /// Its file in the stage's folder.
    pub file: String,
}

/// Draws into the job's folder.
pub(super) struct Easel<'a, 'j> {
    pub job: &'a Job<'j>,
    pub config: &'a Config,
    pub imported: &'a Imported,
    pub drawn: Vec<Picture>,
}

impl Easel<'_, '_> {
    fn keep(&mut self, view: usize, kind: &str, title: &str, image: &Image) -> Result<()> {
        let file = view_file(view, &format!("{kind}.jpg"));
        write(&self.job.output().join(&file), &encode_jpeg(image, QUALITY))?;
        self.drawn.push(Picture { view, title: title.to_owned(), file });
        Ok(())
    }

    /// Patches as squares on a dimmed photograph.
    pub(super) fn residuals(&mut self, shown: &[PatchView]) -> Result<()> {
        let photographs = Photographs::new(self.imported, self.config, self.job, 0);
        for of in shown {
            let camera = small(self.imported, of.view);
            let full = photographs.camera(of.view);
            let mut image = photographs.whole(of.view)?.resized(camera.width, camera.height);
            image.pixels.iter_mut().for_each(|rgb| {
                let grey = (u32::from(rgb[0]) + u32::from(rgb[1]) + u32::from(rgb[2])) / 6;
                *rgb = [grey as u8; 3];
            });
            let scale = f64::from(camera.width) / f64::from(full.width);
            for patch in &of.patches {
                let color = match patch.verdict {
                    Verdict::Plain => continue,
                    Verdict::Lost => LOST,
                    Verdict::Measured { residual_px, .. } => distance_color(residual_px.abs(), CAP_PX),
                };
                let half = 0.5 * f64::from(of.step_px);
                let pixels = |at: f64, side: u32| {
                    let low = ((at - half) * scale).round().max(0.0) as u32;
                    low..(((at + half) * scale).round() as u32).max(low + 1).min(side)
                };
                for y in pixels(patch.at_px[1], camera.height) {
                    for x in pixels(patch.at_px[0], camera.width) {
                        image.pixels[y as usize * camera.width as usize + x as usize] = color;
                    }
                }
            }
            self.keep(
                of.view,
                "residual",
                "residuals between photographs: green 0, red 1 px and more, violet lost",
                &image,
            )?;
        }
        Ok(())
    }

    /// The mesh by its distance from the truth, and the truth by its distance from the mesh.
    pub(super) fn distances(&mut self, views: &[usize], mesh: &Mesh, truth: &TruthFile) -> Result<()> {
        let cap = CAP_M / self.imported.scene.frame.metres_per_unit.unwrap_or(1.0);
        let to_truth = |places: &[DVec3]| Ok(distances_from_truth(&truth.as_truth(), places, cap)?);
        let to_mesh = |places: &[DVec3]| Ok(distances_from_mesh(mesh, places, cap));
        for view in views {
            self.job.check()?;
            let camera = small(self.imported, *view);
            let pose = self.imported.scene.views[*view].camera_from_world;
            let image = painted(mesh, &visibility(mesh, &camera, &pose), &camera, &pose, to_truth, cap)?;
            let title = format!("surface by its distance from the truth: green 0, red {CAP_M} m and more");
            self.keep(*view, "accuracy", &title, &image)?;
            let (TruthFile::Folder { scene, .. } | TruthFile::Mesh(scene)) = truth else { continue };
            // The rest of the truth hides what is behind it, and is not asked.
            let mut seen = visibility(scene, &camera, &pose);
            let is_asked = |face: u32| scene.buildings.get(face as usize).is_none_or(|building| *building != 0);
            seen.face
                .values
                .iter_mut()
                .filter(|face| **face != NO_FACE && !is_asked(**face))
                .for_each(|face| *face = NO_FACE);
            let image = painted(scene, &seen, &camera, &pose, to_mesh, cap)?;
            let title = format!("truth by its distance from the surface: green 0, red {CAP_M} m and more");
            self.keep(*view, "completeness", &title, &image)?;
        }
        Ok(())
    }
}

/// Every pixel that sees a face in the colour of the distance of what it sees.
fn painted(
    mesh: &Mesh,
    seen: &Visibility,
    camera: &Pinhole,
    pose: &RigidTransform,
    distances: impl Fn(&[DVec3]) -> Result<Vec<f64>>,
    cap: f64,
) -> Result<Image> {
    use rayon::prelude::*;
    let mut image = Image::filled(camera.width, camera.height, NOTHING);
    let world_from_camera = pose.inverse();
    let width = camera.width as usize;
    let asked: Vec<usize> = (0..image.pixels.len()).filter(|at| seen.face.values[*at] != NO_FACE).collect();
    let place = |at: &usize| {
        let ray = camera.ray((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
        world_from_camera.transform_point(ray * f64::from(seen.depth.values[*at]))
    };
    let places: Vec<DVec3> = asked.par_iter().map(place).collect();
    for (at, distance) in asked.into_iter().zip(distances(&places)?) {
        // Shaded a little, so that the shape is seen.
        let [a, b, c] = mesh.triangle(seen.face.values[at] as usize).map(DVec3::from);
        let normal = pose.rotation * (b - a).cross(c - a).normalize_or_zero();
        let light = 0.75 + 0.25 * normal.dot(DVec3::new(-0.45, -0.6, -0.66)).abs();
        image.pixels[at] = distance_color(distance, cap).map(|v| (f64::from(v) * light) as u8);
    }
    Ok(image)
}

/// Reads the list that a finished stage left.
///
/// # Errors
/// Where it is damaged.
pub fn read_pictures(folder: &Path) -> Result<Vec<Picture>> {
    crate::stages::read_json(&folder.join("pictures.json"))
}

/// Writes that list.
pub(super) fn write_pictures(job: &Job<'_>, drawn: &[Picture]) -> Result<()> {
    write_json(&job.output().join("pictures.json"), &drawn).context("pictures")
}
