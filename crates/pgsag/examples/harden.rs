//! A judged scene made harder on purpose: what a survey suffers from, one knob each, the truth moved along.
//!
//! `harden SCENE OUT [--crop LEFT,TOP,RIGHT,BOTTOM] [--gain S] [--pose-noise-px P] [--offset X,Y,Z] [--every N]`: cuts pixels
//! off the sides (the principal point moves off the centre), multiplies each photograph by a gain of log-normal spread S,
//! turns each camera by P pixels per axis, moves the world by an offset in scene units, keeps every N-th view. Seeded,
//! so always the same; undistorted scenes only. OUT is scored with `--truth OUT/truth`.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail, ensure};
use glam::{DQuat, DVec3};
use pgsag_scene::files::colmap::{Encoding, Model};
use pgsag_scene::files::folder::{SceneFolder, open_scene};
use pgsag_scene::files::ply::{read_cloud, read_mesh, write_cloud, write_mesh};
use pgsag_scene::files::raster::{decode_mask, encode_jpeg, encode_mask_png, encode_png};
use pgsag_scene::numbers::SplitMix64;
use pgsag_scene::{Image, Map, RigidTransform, Scene};

/// High enough that it adds nothing to see.
const JPEG_QUALITY: u8 = 97;
const SEED: u64 = 11;

#[derive(Default)]
struct Knobs {
    crop_px: [u32; 4],
    gain_spread: f64,
    pose_noise_px: f64,
    offset_world: DVec3,
    every: usize,
}

impl Knobs {
    fn parse(words: &[String]) -> Result<Self> {
        let mut knobs = Self { every: 1, ..Self::default() };
        for pair in words.chunks(2) {
            let [name, value] = pair else { bail!("{} wants a value", pair[0]) };
            match name.as_str() {
                "--crop" => knobs.crop_px = list(value)?,
                "--gain" => knobs.gain_spread = value.parse()?,
                "--pose-noise-px" => knobs.pose_noise_px = value.parse()?,
                "--offset" => knobs.offset_world = DVec3::from(list::<f64, 3>(value)?),
                "--every" => knobs.every = value.parse()?,
                _ => bail!("no knob is called {name}; see the head of this example"),
            }
        }
        ensure!(knobs.every > 0, "--every counts from 1");
        Ok(knobs)
    }

    fn cropped(&self, image: &Image) -> Image {
        let [left, top, right, bottom] = self.crop_px;
        image.cropped(left, top, image.width - left - right, image.height - top - bottom)
    }
}

fn list<T: std::str::FromStr, const N: usize>(text: &str) -> Result<[T; N]> {
    let numbers: Vec<T> = text.split(',').filter_map(|word| word.trim().parse().ok()).collect();
    numbers.try_into().map_err(|_| anyhow::anyhow!("'{text}' should be {N} numbers with commas between them"))
}

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [from, to, rest @ ..] = words.as_slice() else { bail!("see the head of this example for its arguments") };
    let (from, to, knobs) = (PathBuf::from(from), PathBuf::from(to), Knobs::parse(rest)?);
    let folder = open_scene(&from)?;
    let kept: Vec<usize> = (0..folder.scene.views.len()).step_by(knobs.every).collect();
    let scene = hardened(&folder.scene, &kept, &knobs)?;
    for (name, bytes) in Model::from_scene(&scene).encode(Encoding::Binary) {
        write(&to.join("sparse/0").join(name), &bytes)?;
    }
    write_images(&folder, &kept, &knobs, &to)?;
    write_masks(&folder, &from, &kept, &knobs, &to)?;
    write_truth(&from.join("truth"), &to.join("truth"), knobs.offset_world)
}

/// The scene as the hardened survey's structure-from-motion would hand it over.
fn hardened(scene: &Scene, kept: &[usize], knobs: &Knobs) -> Result<Scene> {
    let mut scene = scene.clone();
    let [left, top, right, bottom] = knobs.crop_px;
    let mut stream = SplitMix64::new(SEED);
    for view in &mut scene.views {
        ensure!(view.lens.model.is_pinhole(), "{}: its lens distorts; undistort the scene first", view.name);
        let (width, height) = (view.camera.width, view.camera.height);
        ensure!(left + right < width && top + bottom < height, "{}: nothing is left of it", view.name);
        view.camera = view.camera.cropped(left, top, width - left - right, height - top - bottom);
        view.lens = view.camera.into();
        let turn = DVec3::new(stream.normal(), stream.normal(), stream.normal()) * knobs.pose_noise_px;
        let center_world = view.center_world() + knobs.offset_world;
        let half = turn / (2.0 * view.camera.focal_px());
        let small = DQuat::from_xyzw(half.x, half.y, half.z, 1.0).normalize();
        let rotation = (small * view.camera_from_world.rotation).normalize();
        view.camera_from_world = RigidTransform { rotation, translation: -(rotation * center_world) };
    }
    let place: BTreeMap<u32, u32> = (0..).zip(kept).map(|(new, &old)| (old as u32, new)).collect();
    let shift = [left as f32, top as f32];
    for point in &mut scene.points {
        point.position_world += knobs.offset_world;
        point.track.retain_mut(|seen| {
            let Some(&view_index) = place.get(&seen.view_index) else { return false };
            let camera = &scene.views[seen.view_index as usize].camera;
            let xy_px = [seen.xy_px[0] - shift[0], seen.xy_px[1] - shift[1]];
            (seen.view_index, seen.xy_px) = (view_index, xy_px);
            camera.contains(glam::DVec2::new(f64::from(xy_px[0]), f64::from(xy_px[1])))
        });
    }
    scene.points.retain(|point| point.track.len() > 1);
    scene.views = kept.iter().map(|&view| scene.views[view].clone()).collect();
    Ok(scene)
}

fn write_images(folder: &SceneFolder, kept: &[usize], knobs: &Knobs, to: &Path) -> Result<()> {
    let mut stream = SplitMix64::new(SEED + 1);
    let gains: Vec<f64> =
        (0..folder.scene.views.len()).map(|_| libm::exp(stream.normal() * knobs.gain_spread)).collect();
    for &view in kept {
        let mut image = knobs.cropped(&folder.read_image(view)?);
        for value in image.pixels.as_flattened_mut() {
            *value = (f64::from(*value) * gains[view]).round().min(255.0) as u8;
        }
        let name = Path::new(&folder.scene.views[view].name);
        let lossless = name.extension().is_some_and(|word| word.eq_ignore_ascii_case("png"));
        let bytes = if lossless { encode_png(&image) } else { encode_jpeg(&image, JPEG_QUALITY) };
        write(&to.join("images").join(name), &bytes)?;
    }
    Ok(())
}

/// The truth's masks, cropped alike, for runs with given masks: in `OUT/truth/masks` as the scene has them.
fn write_masks(folder: &SceneFolder, from: &Path, kept: &[usize], knobs: &Knobs, to: &Path) -> Result<()> {
    let [left, top, ..] = knobs.crop_px;
    for &view in kept {
        let name = Path::new("truth/masks").join(Path::new(&folder.scene.views[view].name).with_extension("png"));
        let Ok(bytes) = fs::read(from.join(&name)) else { continue };
        let whole = decode_mask(&name.display().to_string(), &bytes)?;
        let [width, height] = [whole.width - left - knobs.crop_px[2], whole.height - top - knobs.crop_px[3]];
        let mut mask = Map::filled(width, height, false);
        for y in 0..height {
            for x in 0..width {
                mask.set(x, y, whole.at(x + left, y + top));
            }
        }
        write(&to.join(&name), &encode_mask_png(&mask))?;
    }
    Ok(())
}

fn write_truth(from: &Path, to: &Path, offset_world: DVec3) -> Result<()> {
    let read = |name: &str| -> Result<(String, Vec<u8>)> {
        let path = from.join(name);
        Ok((path.display().to_string(), fs::read(&path).with_context(|| path.display().to_string())?))
    };
    let moved = |at: &mut [f64; 3]| *at = (DVec3::from(*at) + offset_world).into();
    let (name, bytes) = read("scene.ply")?;
    let mut mesh = read_mesh(&name, &bytes)?;
    mesh.vertices.iter_mut().for_each(moved);
    let mut out = Vec::new();
    write_mesh(&mut out, &mesh, &[])?;
    write(&to.join("scene.ply"), &out)?;
    let (name, bytes) = read("visible.ply")?;
    let mut cloud = read_cloud(&name, &bytes)?;
    cloud.positions.iter_mut().for_each(moved);
    out.clear();
    write_cloud(&mut out, &cloud, &[])?;
    write(&to.join("visible.ply"), &out)
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    path.parent().map_or(Ok(()), fs::create_dir_all)?;
    fs::write(path, bytes).with_context(|| path.display().to_string())
}
