//! Pictures of a few views: the photograph, what the Gaussians show, normals, depth, and the mesh from the same place.

use anyhow::Result;
use pgsag_group::{Group, GroupKind, GroupView};
use pgsag_mesh::render::{Paint, building_color, painted as painted_mesh, visibility};
use pgsag_scene::files::raster::encode_jpeg;
use pgsag_scene::{Image, Map, Mask, Mesh, Pinhole, PixelClass};
use pgsag_splat::backend::{Backend, OptimizerState};
use pgsag_splat::train::render_depth;
use serde::Serialize;

use crate::config::Config;
use crate::engine;
use crate::photographs::{Photographs, training_camera};
use crate::run::stage::Job;
use crate::stages::group::share_of;
use crate::stages::import::Imported;
use crate::stages::score::pictures::read_pictures;
use crate::stages::train::Trained;
use crate::stages::view_camera;

/// Views that are shown.
const SHOWN: usize = 3;
/// Longest side of a picture.
const LONGEST_PX: u32 = 420;
/// Quality of the pictures.
pub(crate) const QUALITY: u8 = 82;
/// Where there is nothing.
pub(crate) const NOTHING: [u8; 3] = [24, 26, 30];

/// One view.
#[derive(Clone, Debug, Serialize)]
pub struct Shown {
    /// Its image.
    pub name: String,
    /// Title and picture.
    pub pictures: Vec<(String, String)>,
}

/// What the Gaussians show of a view, all groups together.
struct Canvas {
    color: Map<[f32; 3]>,
    normal: Map<[f32; 3]>,
    depth: Map<f32>,
    /// Place of a group of buildings in the list and 1; 0: none.
    group: Map<u32>,
}

/// A few views that some group was trained on, far apart.
pub(crate) fn chosen(groups: &[Group], view_count: usize) -> Vec<usize> {
    let candidates: Vec<usize> = (0..view_count)
        .filter(|view| groups.iter().any(|group| group.views.iter().any(|seen| seen.view_index as usize == *view)))
        .collect();
    let count = SHOWN.min(candidates.len());
    (0..count).map(|k| candidates[(2 * k + 1) * candidates.len() / (2 * count)]).collect()
}

/// Draws the views, and shows beside them what the stage `score` has drawn of them.
///
/// # Errors
/// Where an artifact cannot be read.
pub fn shown(job: &Job<'_>, config: &Config, imported: &Imported, groups: &[Group], city: &Mesh) -> Result<Vec<Shown>> {
    let views = chosen(groups, imported.scene.views.len());
    let photographs = Photographs::new(imported, config, job, 0);
    let canvases = engine::run(&config.device, &config.simd, Draw { job, config, imported, groups, views: &views })?;
    let mut shown = Vec::new();
    for (view, canvas) in views.iter().zip(canvases) {
        job.check()?;
        let camera = small(imported, *view);
        let (width, height) = (camera.width, camera.height);
        let photograph = photographs.whole(*view)?.resized(width, height);
        let pose = &imported.scene.views[*view].camera_from_world;
        let seen = visibility(city, &camera, pose);
        let surface = |paint| painted_mesh(city, &seen, &camera, pose, paint, NOTHING);
        let groups = grouped(&photograph, &canvas.group);
        let pictures = [
            ("photograph", photograph),
            ("groups", groups),
            ("Gaussians", colored(&canvas.color)),
            ("normals", normals(&canvas.normal)),
            ("depth", depths(&canvas.depth)),
            ("surface", surface(Paint::Building)),
            ("surface in colour", surface(Paint::Color)),
            ("surface normals", surface(Paint::Normal)),
        ];
        let pictures = pictures.into_iter().map(|(title, image)| (title.to_owned(), data_uri(&image)));
        shown.push(Shown {
            name: imported.scene.views[*view].name.clone(),
            pictures: pictures.chain(scored(job, |of| of == *view)?).collect(),
        });
    }
    let others = scored(job, |of| !views.contains(&of))?;
    if !others.is_empty() {
        shown.push(Shown { name: "other images".into(), pictures: others });
    }
    Ok(shown)
}

/// Title and picture of what the stage `score` has drawn of views.
fn scored(job: &Job<'_>, keep: impl Fn(usize) -> bool) -> Result<Vec<(String, String)>> {
    let folder = job.input("score");
    let kept = read_pictures(&folder)?.into_iter().filter(|picture| keep(picture.view));
    kept.map(|picture| Ok((picture.title, jpeg_uri(&crate::stages::read(&folder.join(&picture.file))?.1)))).collect()
}

/// The camera of a picture.
pub(crate) fn small(imported: &Imported, view: usize) -> Pinhole {
    training_camera(&imported.scene.views[view].camera, LONGEST_PX)
}

struct Draw<'a, 'j> {
    job: &'a Job<'j>,
    config: &'a Config,
    imported: &'a Imported,
    groups: &'a [Group],
    views: &'a [usize],
}

impl engine::Work for Draw<'_, '_> {
    type Output = Vec<Canvas>;

    fn on<B: Backend>(self, backend: &B) -> Result<Vec<Canvas>> {
        let mut canvases: Vec<Canvas> = self
            .views
            .iter()
            .map(|view| {
                let Pinhole { width, height, .. } = small(self.imported, *view);
                Canvas {
                    color: Map::filled(width, height, NOTHING.map(|value| f32::from(value) / 255.0)),
                    normal: Map::filled(width, height, [0.0; 3]),
                    depth: Map::filled(width, height, 0.0),
                    group: Map::filled(width, height, 0),
                }
            })
            .collect();
        // Buildings come first in the list and last on the canvas.
        for (place, group) in self.groups.iter().enumerate().rev() {
            let number = if group.id.kind == GroupKind::Building { place as u32 + 1 } else { 0 };
            let trained: Trained = self.job.read_job("train", &group.id.to_string())?;
            let sh_degree = trained.summary.sh_degree;
            let on_device = backend.upload(&OptimizerState::fresh(trained.cloud))?;
            for (view, canvas) in self.views.iter().zip(&mut canvases) {
                self.job.check()?;
                let Some(seen) = group.views.iter().find(|seen| seen.view_index as usize == *view) else { continue };
                let camera = small(self.imported, *view);
                let window = [0, 0, camera.width, camera.height];
                let pose = view_camera(&self.imported.scene.views[*view], &camera, window, group.origin_world);
                let maps = render_depth(backend, &on_device, &pose, None, sh_degree)?;
                let mask = self.mask(group, seen, &camera)?;
                for at in 0..camera.pixel_count() {
                    if maps.opacity.values[at] > 0.5 && mask.as_ref().is_none_or(|mask| mask.classes[at].is_active()) {
                        canvas.color.values[at] = maps.color.values[at];
                        canvas.normal.values[at] = maps.normal.values[at];
                        canvas.depth.values[at] = maps.depth.values[at];
                        canvas.group.values[at] = number;
                    }
                }
            }
        }
        Ok(canvases)
    }
}

impl Draw<'_, '_> {
    /// The group's classes at the size of the picture.
    fn mask(&self, group: &Group, seen: &GroupView, camera: &Pinhole) -> Result<Option<Mask>> {
        let Some(share) = share_of(&self.job.input("group"), &group.id.to_string(), seen)? else { return Ok(None) };
        let full =
            training_camera(&self.imported.scene.views[seen.view_index as usize].camera, self.config.image_width);
        let mut classes = Map::filled(full.width, full.height, PixelClass::Occluded);
        let [x0, y0, width, height] = seen.window_px;
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            if !share.halo.at(x, y) {
                classes.set(x0 + x, y0 + y, share.mask.at(x, y));
            }
        }
        let resized = classes.resized_nearest(camera.width, camera.height);
        Ok(Some(Mask { width: resized.width, height: resized.height, classes: resized.values }))
    }
}

fn painted<T: Copy>(map: &Map<T>, paint: impl Fn(T) -> [u8; 3]) -> Image {
    Image { width: map.width, height: map.height, pixels: map.values.iter().map(|value| paint(*value)).collect() }
}

fn byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

fn colored(color: &Map<[f32; 3]>) -> Image {
    painted(color, |rgb| rgb.map(byte))
}

/// The photograph in the colours of the groups of buildings; the rest of it is darkened.
fn grouped(photograph: &Image, group: &Map<u32>) -> Image {
    let blend = |(rgb, group): (&[u8; 3], &u32)| {
        let color = if *group == 0 { NOTHING } else { building_color(*group) };
        std::array::from_fn(|k| ((u16::from(rgb[k]) + u16::from(color[k])) / 2) as u8)
    };
    let pixels = photograph.pixels.iter().zip(&group.values).map(blend).collect();
    Image { width: photograph.width, height: photograph.height, pixels }
}

/// Right is red, up is green, towards the camera is blue.
fn normals(normal: &Map<[f32; 3]>) -> Image {
    painted(normal, |n| {
        let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
        if length > 0.0 { [n[0], -n[1], -n[2]].map(|v| byte(0.5 + 0.5 * v / length)) } else { NOTHING }
    })
}

/// Near is bright; black is nothing. The nearest and farthest hundredth do not set the scale.
fn depths(depth: &Map<f32>) -> Image {
    let mut known: Vec<f64> = depth.values.iter().filter(|z| **z > 0.0).map(|z| f64::from(*z)).collect();
    let low = pgsag_scene::numbers::quantile(&mut known, 0.01).unwrap_or(0.0) as f32;
    let high = pgsag_scene::numbers::quantile(&mut known, 0.99).unwrap_or(1.0) as f32;
    painted(depth, |z| {
        if z <= 0.0 {
            return NOTHING;
        }
        let near = 1.0 - ((z - low) / (high - low).max(1e-6)).clamp(0.0, 1.0);
        [byte(0.15 + 0.85 * near), byte(0.2 + 0.6 * near * near), byte(0.35 - 0.2 * near)]
    })
}

/// A picture as it stands in a page.
#[must_use]
pub fn data_uri(image: &Image) -> String {
    jpeg_uri(&encode_jpeg(image, QUALITY))
}

fn jpeg_uri(bytes: &[u8]) -> String {
    format!("data:image/jpeg;base64,{}", base64(bytes))
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let word = chunk.iter().fold(0_u32, |word, byte| word << 8 | u32::from(*byte)) << (8 * (3 - chunk.len()));
        for digit in 0..4 {
            let known = digit <= chunk.len();
            out.push(if known { char::from(DIGITS[(word >> (18 - 6 * digit)) as usize & 63]) } else { '=' });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_the_rfc() {
        let cases =
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg=="), ("foobar", "Zm9vYmFy")];
        for (plain, coded) in cases {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn groups_have_colours_of_their_own_and_the_rest_is_dark() {
        let mut group = Map::filled(3, 1, 0);
        group.set(1, 0, 1);
        group.set(2, 0, 2);
        let image = grouped(&Image::filled(3, 1, [200; 3]), &group);
        assert!(image.at(0, 0).iter().all(|value| *value < 120), "{:?}", image.at(0, 0));
        assert!(image.at(1, 0) != image.at(2, 0) && image.at(1, 0).iter().any(|value| *value > 180));
    }

    #[test]
    fn a_normal_towards_the_camera_is_blue() {
        let mut normal = Map::filled(2, 1, [0.0; 3]);
        normal.set(1, 0, [0.0, 0.0, -0.5]);
        let image = normals(&normal);
        assert_eq!((image.at(0, 0), image.at(1, 0)), (NOTHING, [128, 128, 255]));
    }
}
