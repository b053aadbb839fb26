//! `fuse`: one depth map per image, from all groups that see it, with the group that each pixel belongs to.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::Result;
use pgsag_group::{Group, GroupKind};
use pgsag_mesh::fuse::{Border, DepthMap, MEETING_VOXELS, combine, merge_views};
use pgsag_scene::files::raster::{decode_instances, encode_instances_png};
use pgsag_scene::{Map, Pinhole, View};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::depth::{read_depth, write_depth};
use super::group::{Extent, Groups, finished_groups, share_of};
use super::import::Imported;
use super::refine::classes_of;
use super::{batch_file, batch_views, batches, config, read, read_json, view_file, write, write_json};
use crate::photographs::training_camera;
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan};

/// Pixels between two that are looked at for [`FusedView::cubes`].
const STRIDE: usize = 4;

/// A fused view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FusedView {
    /// Index of the view.
    pub view_index: usize,
    /// The cubes of [`Extent`] that its surface touches.
    pub cubes: BTreeSet<[i32; 3]>,
}

/// One batch of images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fused {
    /// Views with depth.
    pub views: Vec<FusedView>,
}

impl Artifact for Fused {
    const FORMAT: &'static str = "pgsag-fused";
    const VERSION: u32 = 1;

    fn read(folder: &Path) -> Result<Self> {
        read_json(&folder.join("fuse.json"))
    }

    fn write(&self, folder: &Path) -> Result<()> {
        write_json(&folder.join("fuse.json"), self)
    }
}

/// Every fused view of a run.
///
/// # Errors
/// Where a batch is damaged or not finished.
pub fn fused_views(run: &Run) -> Result<Vec<FusedView>> {
    let folder = run.stage_folder("fuse");
    let mut views = Vec::new();
    for batch in run.finished_jobs("fuse")? {
        views.extend(Fused::read(&folder.join(batch))?.views);
    }
    Ok(views)
}

/// Depth, confidence and group number of a fused view.
///
/// # Errors
/// Where a file is damaged.
pub fn read_fused(stage_folder: &Path, view_index: usize) -> Result<(Map<f32>, Map<f32>, Map<u16>)> {
    let folder = stage_folder.join(super::batch_name(view_index));
    let (depth, weight) = read_depth(&folder, view_index)?;
    let (file, bytes) = read(&batch_file(stage_folder, view_index, "group.png"))?;
    Ok((depth, weight, decode_instances(&file, &bytes)?))
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let imported = Imported::read(&run.stage_folder("import"))?;
    let width = config(run)?.image_width;
    let camera = |view: &View| training_camera(&view.camera, width).pixel_count() as u64;
    let pixels = imported.scene.views.iter().map(camera).max().unwrap_or(0);
    let threads = rayon::current_num_threads() as u64;
    Ok(batches(imported.scene.views.len(), &["import", "refine", "group", "depth"], |count| Cost {
        memory_bytes: (64 << 20) + 80 * pixels * threads,
        disk_bytes: count as u64 * pixels * 9,
        cpu_secs: count as f64 * pixels as f64 * 60e-9,
    }))
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let config = config(job.run)?;
    let imported: Imported = job.read("import")?;
    let Groups { groups, extent, .. } = job.read("group")?;
    let groups = finished_groups(job.run, groups, "depth")?;
    let views = batch_views(job, imported.scene.views.len());
    let fused = views
        .par_iter()
        .map(|&view_index| {
            job.check()?;
            let view = &imported.scene.views[view_index];
            let camera = training_camera(&view.camera, config.image_width);
            let overlap_px = if config.groups.collar_px > 0.0 { 0.0 } else { config.refine.overlap_px };
            let look = Look { job, groups: &groups, overlap_px, voxel: extent.gsd };
            let Some(canvas) = look.fuse_view(view_index, &camera)? else { return Ok(None) };
            write_depth(job.output(), view_index, &canvas.depth, &canvas.weight)?;
            write(&job.output().join(view_file(view_index, "group.png")), &encode_instances_png(&canvas.group))?;
            Ok(Some(FusedView { view_index, cubes: cubes(&canvas.depth, &camera, view, &extent) }))
        })
        .collect::<Result<Vec<_>>>()?;
    job.write(&Fused { views: fused.into_iter().flatten().collect() })
}

struct Canvas {
    depth: Map<f32>,
    weight: Map<f32>,
    group: Map<u16>,
}

/// A group's depths on the canvas of the whole image.
struct Layer {
    kind: GroupKind,
    number: u16,
    map: DepthMap,
}

/// What all views are fused with.
struct Look<'a, 'j> {
    job: &'a Job<'j>,
    groups: &'a [Group],
    overlap_px: f32,
    voxel: f64,
}

impl Look<'_, '_> {
    /// The building inside its mask, the mean where surfaces meet, else the nearer. A pixel belongs to the group whose
    /// depth is nearest to what came out, in a building's mask to a building if one is near.
    fn fuse_view(&self, view_index: usize, camera: &Pinhole) -> Result<Option<Canvas>> {
        let mut layers = Vec::new();
        for group in self.groups {
            layers.extend(layer(self.job, group, view_index, camera)?);
        }
        let of = |kind: GroupKind| {
            layers.iter().filter(move |layer| layer.kind == kind).map(|layer| &layer.map).collect::<Vec<_>>()
        };
        let voxel = self.voxel;
        let joined = |maps: Vec<&DepthMap>| if maps.is_empty() { Ok(None) } else { combine(&maps, voxel).map(Some) };
        let (buildings, background) = (joined(of(GroupKind::Building))?, joined(of(GroupKind::Background))?);
        let inside = match (&buildings, &background) {
            (Some(_), Some(_)) => classes_of(&self.job.input("refine"), view_index, GroupKind::Building)?,
            _ => None,
        };
        let fused = match (buildings, background) {
            (Some(buildings), Some(background)) => {
                let border = inside.as_ref().map(|classes| Border { classes, overlap_px: self.overlap_px });
                merge_views(&buildings, border.as_ref(), &background, voxel)?
            }
            (Some(one), None) | (None, Some(one)) => one,
            (None, None) => return Ok(None),
        };
        let mut group = Map::filled(camera.width, camera.height, 0);
        for (at, z) in fused.depth.values.iter().enumerate().filter(|(_, z)| **z > 0.0) {
            let is_inside = inside.as_ref().is_some_and(|mask| mask.classes[at].is_active());
            group.values[at] = owner(&layers, at, *z, if is_inside { (MEETING_VOXELS * voxel) as f32 } else { 0.0 });
        }
        Ok(Some(Canvas { depth: fused.depth, weight: fused.weight, group }))
    }
}

/// The group whose depth is nearest to `z`; that of a building within `reach` goes before.
fn owner(layers: &[Layer], at: usize, z: f32, reach: f32) -> u16 {
    let rank = |layer: &&Layer| {
        let off = (layer.map.depth.values[at] - z).abs();
        (layer.kind != GroupKind::Building || off >= reach, off)
    };
    let near = layers.iter().filter(|layer| layer.map.depth.values[at] > 0.0);
    let first = near.min_by(|a, b| {
        let (a, b) = (rank(a), rank(b));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    first.map_or(0, |layer| layer.number)
}

fn layer(job: &Job<'_>, group: &Group, view_index: usize, camera: &Pinhole) -> Result<Option<Layer>> {
    let Some(view) = group.views.iter().find(|view| view.view_index as usize == view_index) else { return Ok(None) };
    let name = group.id.to_string();
    let (depth, weight) = read_depth(&job.input("depth").join(&name), view_index)?;
    let share = share_of(&job.input("group"), &name, view)?;
    let mut map = DepthMap::empty(camera.width, camera.height);
    let [x0, y0, ..] = view.window_px;
    for y in 0..depth.height {
        for x in 0..depth.width {
            // What lies in the halo is another group's, which knows it better.
            if share.as_ref().is_some_and(|share| share.halo.at(x, y)) {
                continue;
            }
            map.depth.set(x0 + x, y0 + y, depth.at(x, y));
            map.weight.set(x0 + x, y0 + y, weight.at(x, y));
        }
    }
    let kind = group.id.kind;
    let number = if kind == GroupKind::Building { group.id.number as u16 } else { 0 };
    Ok(Some(Layer { kind, number, map }))
}

fn cubes(depth: &Map<f32>, camera: &Pinhole, view: &View, extent: &Extent) -> BTreeSet<[i32; 3]> {
    let world_from_camera = view.camera_from_world.inverse();
    let mut counts: BTreeMap<[i32; 3], u32> = BTreeMap::new();
    for y in (0..depth.height).step_by(STRIDE) {
        for x in (0..depth.width).step_by(STRIDE) {
            let z = f64::from(depth.at(x, y));
            if z > 0.0 {
                let ray = camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
                if let Some(cube) = extent.cube_of(world_from_camera.transform_point(ray * z)) {
                    *counts.entry(cube).or_default() += 1;
                }
            }
        }
    }
    counts.into_keys().collect()
}
