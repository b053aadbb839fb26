//! What is measured on: flat Gaussians about an undulating ground, sized so that the overlap per pixel stays about the
//! same whatever their number; or a trained cloud with a photograph of its scene.

use std::path::{Path, PathBuf};

use pgsag_scene::files::{colmap, raster};
use pgsag_scene::{Image, Mask, Pinhole, PixelClass, View, numbers::SplitMix64};
use pgsag_splat::backend::{Backend, OptimizerState, RenderOptions, ViewCamera};
use pgsag_splat::cloud::{SplatCloud, curve_order};
use pgsag_splat::cpu::{Cpu, CpuOptions};

use crate::Failure;

/// A cloud, a view of it, and a second view of the same surface.
#[derive(Clone, Debug)]
pub(crate) struct Scene {
    pub(crate) cloud: SplatCloud,
    pub(crate) cameras: [ViewCamera; 2],
    pub(crate) photographs: [Image; 2],
    /// Typical depth, scene units.
    pub(crate) scale: f32,
}

impl Scene {
    /// A synthetic cloud, seen from the front and from 1.7 units (10 degrees) beside.
    pub(crate) fn synthetic(cloud: SplatCloud, (width, height): (u32, u32)) -> Self {
        let photograph = photograph(width, height);
        Self {
            cloud,
            cameras: [camera(width, height, 0.0), camera(width, height, 0.17)],
            photographs: [photograph.clone(), photograph],
            scale: 10.0,
        }
    }

    /// A cloud of a scene in COLMAP's layout, seen by the named image and by the one whose camera is nearest.
    pub(crate) fn trained(cloud: SplatCloud, folder: &Path, image: &str, shrink: u32) -> Result<Self, Failure> {
        let cloud = cloud.reordered(&curve_order(&cloud.means));
        let views = views(folder)?;
        let first = views.iter().find(|view| view.name == image);
        let first = first.ok_or_else(|| format!("{}: no image {image}", folder.display()))?;
        let far = |view: &&View| view.center_world().distance(first.center_world());
        let others = views.iter().filter(|view| view.name != first.name);
        let second = others.min_by(|a, b| far(a).total_cmp(&far(b))).ok_or("one image alone has no neighbour")?;
        let cameras = [first, second].map(|view| view_camera(view, shrink, cloud.origin_world));
        let open = |k: usize| photograph_of(&folder.join("images").join([first, second][k].name.as_str()), &cameras[k]);
        let mut depths: Vec<f32> = cloud.means.iter().map(|&mean| depth(&cameras[0], mean)).collect();
        depths.retain(|&depth| depth > 0.0);
        depths.sort_by(f32::total_cmp);
        let scale = *depths.get(depths.len() / 2).ok_or("no Gaussian lies before the camera")?;
        Ok(Self { photographs: [open(0)?, open(1)?], cameras, cloud, scale })
    }
}

fn depth(camera: &ViewCamera, mean: [f32; 3]) -> f32 {
    let row = camera.rotation[2];
    (0..3).map(|k| row[k] * f64::from(mean[k])).sum::<f64>() as f32 + camera.translation[2] as f32
}

fn views(folder: &Path) -> Result<Vec<View>, Failure> {
    let names = colmap::Encoding::Binary.file_names();
    let mut bytes = Vec::new();
    for name in names {
        let path: PathBuf = folder.join("sparse/0").join(name);
        bytes.push(std::fs::read(&path).map_err(|cause| format!("{}: {cause}", path.display()))?);
    }
    let files = [0, 1, 2].map(|k| (names[k], bytes[k].as_slice()));
    Ok(colmap::Model::decode(colmap::Encoding::Binary, files)?.into_scene([names[1], names[2]])?.views)
}

fn view_camera(view: &View, shrink: u32, origin: [f64; 3]) -> ViewCamera {
    let full = view.camera;
    let (width, height) = (full.width / shrink, full.height / shrink);
    let (x, y) = (f64::from(width) / f64::from(full.width), f64::from(height) / f64::from(full.height));
    let pinhole = Pinhole { width, height, fx: full.fx * x, fy: full.fy * y, cx: full.cx * x, cy: full.cy * y };
    let rotation = glam::DMat3::from_quat(view.camera_from_world.rotation);
    let moved = view.camera_from_world.translation + rotation * glam::DVec3::from_array(origin);
    let rows = rotation.transpose().to_cols_array_2d();
    ViewCamera { pinhole, rotation: rows, translation: moved.to_array(), near: 0.01 }
}

fn photograph_of(path: &Path, camera: &ViewCamera) -> Result<Image, Failure> {
    let bytes = std::fs::read(path).map_err(|cause| format!("{}: {cause}", path.display()))?;
    let image = raster::decode_image(&path.display().to_string(), &bytes)?;
    Ok(image.resized(camera.pinhole.width, camera.pinhole.height))
}

/// Looks at (0, 0, 10) from a distance of 10, `angle_rad` about the vertical axis beside the z axis.
fn camera(width: u32, height: u32, angle_rad: f64) -> ViewCamera {
    let focal = 0.9 * f64::from(width);
    let (sine, cosine) = (libm::sin(angle_rad), libm::cos(angle_rad));
    let pinhole =
        Pinhole { width, height, fx: focal, fy: focal, cx: f64::from(width) / 2.0, cy: f64::from(height) / 2.0 };
    ViewCamera {
        pinhole,
        rotation: [[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]],
        translation: [-10.0 * sine, 0.0, 10.0 - 10.0 * cosine],
        near: 0.1,
    }
}

/// Entries blended per pixel of the synthetic clouds.
const OVERLAP: f64 = 29.0;
/// Pixels of the image for which they are sized.
pub(crate) const SMALL: (u32, u32) = (708, 522);

/// `count` Gaussians over the view at about 10 units, of such a size that each pixel blends 29 of them.
pub(crate) fn synthetic_cloud(count: usize) -> Result<SplatCloud, Failure> {
    let mut size = (OVERLAP / (0.17 * count as f64)).sqrt();
    for _ in 0..4 {
        size *= (OVERLAP / overlap(cloud(count, size))?).sqrt();
    }
    // As the trainer keeps it.
    let cloud = cloud(count, size);
    Ok(cloud.reordered(&curve_order(&cloud.means)))
}

/// Entries blended per pixel of [`SMALL`].
fn overlap(cloud: SplatCloud) -> Result<f64, Failure> {
    let cpu = Cpu::new(CpuOptions::default())?;
    let cloud = cpu.upload(&OptimizerState::fresh(cloud))?;
    let options = RenderOptions { load: true, ..RenderOptions::default() };
    let load = cpu.read(&cpu.render(&cloud, &camera(SMALL.0, SMALL.1, 0.0), None, &options)?)?.load.values;
    Ok(load.iter().map(|&value| f64::from(value)).sum::<f64>() / load.len() as f64)
}

/// Standard deviations of about `size` in the plane, scene units.
fn cloud(count: usize, size: f64) -> SplatCloud {
    let mut stream = SplitMix64::new(1);
    let (half_x, half_y) = (6.0, 4.5);
    let mut cloud = SplatCloud { sh_degree: 3, ..SplatCloud::default() };
    for _ in 0..count {
        let (x, y) = (stream.range(-half_x, half_x), stream.range(-half_y, half_y));
        let depth = 10.0 + 0.7 * libm::sin(x) * libm::cos(y) + 0.3 * stream.normal();
        cloud.means.push([x, y, depth].map(|value| value as f32));
        let log = |stream: &mut SplitMix64| (libm::log(size) - 0.25 + 0.5 * stream.normal()) as f32;
        cloud.log_scales.push([log(&mut stream), log(&mut stream), (libm::log(size) - 3.0) as f32]);
        cloud.rotations.push([1.0, 0.0, 0.0, 0.0].map(|w: f64| (w + 0.2 * stream.normal()) as f32));
        cloud.opacity_logits.push(stream.range(-3.0, 2.5) as f32);
        cloud.harmonics.extend((0..48).map(|k| if k < 3 { stream.normal() } else { 0.1 * stream.normal() } as f32));
    }
    cloud
}

fn photograph(width: u32, height: u32) -> Image {
    let mut stream = SplitMix64::new(2);
    let mut image = Image::filled(width, height, [0; 3]);
    for (i, pixel) in image.pixels.iter_mut().enumerate() {
        let (x, y) = (i as u32 % width, i as u32 / width);
        *pixel = [x / 4 + y / 7, x / 9, y / 3].map(|value| (value % 200) as u8 + stream.below(50) as u8);
    }
    image
}

/// Inside an ellipse in the middle that covers this share of the pixels; outside it nothing is known.
pub(crate) fn ellipse(width: u32, height: u32, share: f64) -> Mask {
    let mut mask = Mask::filled(width, height, PixelClass::Occluded);
    let radius_squared = share / std::f64::consts::PI;
    for (i, class) in mask.classes.iter_mut().enumerate() {
        let x = f64::from(i as u32 % width) / f64::from(width) - 0.5;
        let y = f64::from(i as u32 / width) / f64::from(height) - 0.5;
        if x * x + y * y < radius_squared {
            *class = PixelClass::Inside;
        }
    }
    mask
}
