//! `depth`: what a trained group says of the distance at every pixel of its views.

use std::path::Path;

use anyhow::Result;
use pgsag_group::{Group, GroupView};
use pgsag_mesh::DepthView;
use pgsag_mesh::fuse::{Points, filter, supported};
use pgsag_scene::{Map, Scene};
use pgsag_splat::backend::{Backend, OptimizerState};
use pgsag_splat::train::{neighbors_of, render_depth, valid_depth};
use serde::{Deserialize, Serialize};

use super::coarse::Coarse;
use super::group::{group_names, group_of};
use super::import::Imported;
use super::train::{GroupViews, Trained};
use super::{config, read_json, read_map, view_file, write_json, write_map};
use crate::config::Config;
use crate::engine;
use crate::photographs::{Photographs, training_camera};
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan};

/// The depth maps of a group, one file per view: depth (scene units, 0 = none) and confidence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DepthMaps {
    /// Which views, and which window of each.
    pub views: Vec<GroupView>,
}

impl Artifact for DepthMaps {
    const FORMAT: &'static str = "pgsag-depth";
    const VERSION: u32 = 1;

    fn read(folder: &Path) -> Result<Self> {
        read_json(&folder.join("depth.json"))
    }

    fn write(&self, folder: &Path) -> Result<()> {
        write_json(&folder.join("depth.json"), self)
    }
}

/// Depth and confidence of a view.
///
/// # Errors
/// Where the file is damaged.
pub fn read_depth(folder: &Path, view_index: usize) -> Result<(Map<f32>, Map<f32>)> {
    let both: Map<[f32; 2]> = read_map(&folder.join(view_file(view_index, "depth")))?;
    let (width, height) = (both.width, both.height);
    let depth = Map { width, height, values: both.values.iter().map(|pair| pair[0]).collect() };
    let weight = Map { width, height, values: both.values.iter().map(|pair| pair[1]).collect() };
    Ok((depth, weight))
}

/// Writes what [`read_depth`] reads.
pub(crate) fn write_depth(folder: &Path, view_index: usize, depth: &Map<f32>, weight: &Map<f32>) -> Result<()> {
    let pairs = depth.values.iter().zip(&weight.values).map(|(depth, weight)| [*depth, *weight]).collect();
    let both = Map { width: depth.width, height: depth.height, values: pairs };
    write_map(&folder.join(view_file(view_index, "depth")), &both)
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let folder = run.stage_folder("group");
    // A group that could not be trained is missing, and the rest goes on.
    let trained = run.finished_jobs("train")?;
    let coarse = std::fs::metadata(run.stage_folder("coarse").join("points.bin")).map_or(0, |found| found.len());
    let names = group_names(&folder)?.into_iter().filter(|name| trained.contains(name));
    let plan = |name: String| -> Result<JobPlan> {
        let group = group_of(&folder, &name)?;
        let window = |view: &GroupView| u64::from(view.window_px[2]) * u64::from(view.window_px[3]);
        let largest = group.views.iter().map(window).max().unwrap_or(0);
        let all: u64 = group.views.iter().map(window).sum();
        let cloud =
            std::fs::metadata(run.stage_folder("train").join(&name).join("cloud.ply")).map_or(0, |found| found.len());
        let cost = Cost {
            memory_bytes: (128 << 20) + 8 * cloud + 200 * largest + 2 * coarse,
            disk_bytes: 8 * all,
            cpu_secs: all as f64 * 0.5e-6 + 1.0,
        };
        let part = Some(name.clone());
        let inputs = vec![("import", None), ("coarse", None), ("group", part.clone()), ("train", part)];
        Ok(JobPlan { name, inputs, cost })
    };
    names.map(plan).collect()
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let config = config(job.run)?;
    let imported: Imported = job.read("import")?;
    let group = group_of(&job.input("group"), &job.name)?;
    let trained: Trained = job.read_job("train", &job.name)?;
    let photographs = Photographs::new(&imported, &config, job, 0);
    let views = GroupViews::new(&group, &imported.scene.views, &photographs, job);
    let coarse: Coarse = job.read("coarse")?;
    let points_world = Points::new(coarse.points.iter().map(|point| point.position_world).collect());
    drop(coarse);
    let support = Support { config: &config, scene: &imported.scene, points_world };
    let work = Render { job, config: &config, views, trained, support };
    engine::run(job.device(&config.device), &config.simd, work)?;
    confirm(job, &config, &imported, &group)?;
    job.write(&DepthMaps { views: group.views })
}

struct Render<'a, 'j> {
    job: &'a Job<'j>,
    config: &'a Config,
    views: GroupViews<'a>,
    trained: Trained,
    support: Support<'a>,
}

/// What tells open places from surfaces.
struct Support<'a> {
    config: &'a Config,
    scene: &'a Scene,
    points_world: Points,
}

impl Support<'_> {
    /// Takes the depth from pixels that are neither near points nor between them.
    fn apply(&self, view: &GroupView, depth: &mut Map<f32>) {
        let of_view = &self.scene.views[view.view_index as usize];
        let camera = training_camera(&of_view.camera, self.config.image_width);
        let kept = supported(&camera, &of_view.camera_from_world, &self.points_world, &self.config.support);
        let [x0, y0, width, height] = view.window_px;
        for y in 0..height {
            for x in 0..width {
                if !kept.at(x0 + x, y0 + y) {
                    depth.set(x, y, 0.0);
                }
            }
        }
    }
}

impl engine::Work for Render<'_, '_> {
    type Output = ();

    fn on<B: Backend>(self, backend: &B) -> Result<()> {
        let on_device = backend.upload(&OptimizerState::fresh(self.trained.cloud))?;
        let total = self.views.group.views.len() as u64;
        let raw = self.job.output().join(UNCONFIRMED);
        std::fs::create_dir(&raw)?;
        for (done, view) in self.views.group.views.iter().enumerate() {
            self.job.check()?;
            let index = view.view_index as usize;
            let camera = self.views.camera_of(index, view.window_px);
            let mask = self.views.mask_of(view)?;
            let maps = render_depth(backend, &on_device, &camera, None, self.trained.summary.sh_degree)?;
            let valid = valid_depth(&maps, &camera, mask.as_ref(), &self.config.depth);
            let mut depth = valid.depth;
            self.support.apply(view, &mut depth);
            let sure = depth.values.iter().zip(&maps.opacity.values);
            let weight = sure.map(|(depth, opacity)| if *depth > 0.0 { *opacity } else { 0.0 }).collect();
            write_depth(&raw, index, &depth, &Map { width: depth.width, height: depth.height, values: weight })?;
            self.job.advance(done as u64 + 1, total, "views");
        }
        Ok(())
    }
}

/// Where the depths of all views wait until their neighbours have confirmed them.
const UNCONFIRMED: &str = "unconfirmed";

/// Keeps the depths that other views confirm.
fn confirm(job: &Job<'_>, config: &Config, imported: &Imported, group: &Group) -> Result<()> {
    let indices: Vec<u32> = group.views.iter().map(|view| view.view_index).collect();
    let neighbors = neighbors_of(&imported.scene, &indices, &config.neighbors);
    let raw = job.output().join(UNCONFIRMED);
    let depth_view = |at: usize| -> Result<DepthView<'static>> {
        let GroupView { view_index, window_px: [x0, y0, width, height], .. } = group.views[at];
        let view = &imported.scene.views[view_index as usize];
        let camera = training_camera(&view.camera, config.image_width).cropped(x0, y0, width, height);
        let (depth, weight) = read_depth(&raw, view_index as usize)?;
        Ok(DepthView { camera, camera_from_world: view.camera_from_world, depth, weight, normal: None, color: None })
    };
    for (at, list) in neighbors.iter().enumerate() {
        job.check()?;
        let others = list.iter().map(|other| depth_view(other.view as usize)).collect::<Result<Vec<_>>>()?;
        let kept = filter(&depth_view(at)?, &others.iter().collect::<Vec<_>>(), &config.filter)?;
        write_depth(job.output(), group.views[at].view_index as usize, &kept.depth, &kept.weight)?;
    }
    std::fs::remove_dir_all(&raw)?;
    Ok(())
}
