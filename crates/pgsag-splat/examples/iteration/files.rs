//! The same cloud, cameras and photographs as files, so that another program can be measured on them: the PLY layout
//! that all splat programs read, and a scene in COLMAP's layout.

use std::path::Path;

use glam::{DMat3, DQuat, DVec3};
use pgsag_scene::camera::distortion::{LensCamera, LensModel};
use pgsag_scene::files::ply::{FloatTable, origin_world, read_floats, write_floats};
use pgsag_scene::files::{colmap, raster};
use pgsag_scene::{RigidTransform, SparsePoint, View};
use pgsag_splat::backend::ViewCamera;
use pgsag_splat::cloud::SplatCloud;

use crate::Failure;
use crate::scene::Scene;

fn names(basis_count: usize) -> Vec<String> {
    let words = |list: &[&str]| list.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    let mut names = words(&["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]);
    names.extend((0..3 * (basis_count - 1)).map(|k| format!("f_rest_{k}")));
    names.extend(words(&["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]));
    names
}

/// Writes a cloud, in world coordinates.
pub(crate) fn write_ply(path: &Path, cloud: &SplatCloud) -> Result<(), Failure> {
    let basis_count = cloud.basis_count();
    let mut values = Vec::new();
    for i in 0..cloud.len() {
        let harmonics = &cloud.harmonics[3 * basis_count * i..3 * basis_count * (i + 1)];
        values.extend((0..3).map(|k| (f64::from(cloud.means[i][k]) + cloud.origin_world[k]) as f32));
        values.extend([0.0; 3]);
        values.extend(&harmonics[..3]);
        values.extend((0..3).flat_map(|channel| harmonics[3 + channel..].iter().step_by(3).copied()));
        values.push(cloud.opacity_logits[i]);
        values.extend(cloud.log_scales[i]);
        values.extend(cloud.rotations[i]);
    }
    let table = FloatTable { names: names(basis_count), values, comments: vec!["origin_world 0 0 0".into()] };
    let mut bytes = Vec::new();
    write_floats(&mut bytes, &table)?;
    std::fs::write(path, bytes).map_err(|cause| format!("{}: {cause}", path.display()).into())
}

/// Reads a cloud in that layout, ours or another program's.
pub(crate) fn read_ply(path: &Path) -> Result<SplatCloud, Failure> {
    let bytes = std::fs::read(path).map_err(|cause| format!("{}: {cause}", path.display()))?;
    let table = read_floats(&path.display().to_string(), &bytes)?;
    let width = table.names.len();
    let degree = (0..=3u8).find(|degree| table.names == names((usize::from(*degree) + 1).pow(2)));
    let sh_degree = degree.ok_or_else(|| format!("{}: is not laid out as a cloud of Gaussians", path.display()))?;
    let origin = origin_world(&table.comments).unwrap_or_default();
    let mut cloud = SplatCloud { sh_degree, origin_world: origin, ..SplatCloud::default() };
    let rest = cloud.basis_count() - 1;
    for row in table.values.chunks_exact(width) {
        let three = |at: usize| [row[at], row[at + 1], row[at + 2]];
        let at = 9 + 3 * rest;
        cloud.means.push(three(0));
        cloud.harmonics.extend(three(6));
        cloud.harmonics.extend((0..rest).flat_map(|k| (0..3).map(move |channel| row[9 + channel * rest + k])));
        cloud.opacity_logits.push(row[at]);
        cloud.log_scales.push(three(at + 1));
        cloud.rotations.push([row[at + 4], row[at + 5], row[at + 6], row[at + 7]]);
    }
    Ok(cloud)
}

fn view(name: &str, camera: &ViewCamera, origin: [f64; 3]) -> View {
    let pinhole = camera.pinhole;
    let params = vec![pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy];
    let rotation = DMat3::from_cols_array_2d(&camera.rotation).transpose();
    let translation = DVec3::from_array(camera.translation) - rotation * DVec3::from_array(origin);
    View {
        name: name.into(),
        lens: LensCamera { model: LensModel::Pinhole, width: pinhole.width, height: pinhole.height, params },
        camera: pinhole,
        camera_from_world: RigidTransform { rotation: DQuat::from_mat3(&rotation), translation },
    }
}

/// Writes `splats.ply`, `images/` and `sparse/0/`, some of the Gaussians' centres as sparse points.
pub(crate) fn write_scene(folder: &Path, scene: &Scene) -> Result<(), Failure> {
    let (images, sparse) = (folder.join("images"), folder.join("sparse/0"));
    std::fs::create_dir_all(&images)?;
    std::fs::create_dir_all(&sparse)?;
    write_ply(&folder.join("splats.ply"), &scene.cloud)?;
    let names = ["first.png", "second.png"];
    let origin = scene.cloud.origin_world;
    let mut model = pgsag_scene::Scene::default();
    for k in 0..2 {
        std::fs::write(images.join(names[k]), raster::encode_png(&scene.photographs[k]))?;
        model.views.push(view(names[k], &scene.cameras[k], origin));
    }
    let step = scene.cloud.len().div_ceil(500).max(1);
    model.points.extend(scene.cloud.means.iter().step_by(step).map(|mean| SparsePoint {
        position_world: DVec3::from_array(mean.map(f64::from)) + DVec3::from_array(origin),
        color: [128; 3],
        error_px: 1.0,
        track: Vec::new(),
    }));
    for (name, bytes) in colmap::Model::from_scene(&model).encode(colmap::Encoding::Binary) {
        std::fs::write(sparse.join(name), bytes)?;
    }
    Ok(())
}
