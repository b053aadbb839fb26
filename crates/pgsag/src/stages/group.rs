//! `group`: what each worker trains on. Without masks one group of everything; with masks one of all buildings and one
//! of the background.

use std::path::Path;

use anyhow::Result;
use glam::DVec3;
use pgsag_group::group::{background_points, building_points, origin_of, window_of};
use pgsag_group::{Group, GroupId, GroupKind, GroupView};
use pgsag_scene::Scene;
use pgsag_scene::numbers::{median, quantile};
use serde::{Deserialize, Serialize};

use super::aoi::Area;
use super::coarse::Coarse;
use super::import::Imported;
use super::masks::{MaskState, states};
use super::refine::classes_of;
use super::vote::Votes;
use super::{config, read_json, write_json};
use crate::config::Config;
use crate::error::UserError;
use crate::photographs::training_camera;
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan};

/// Pixels around a group's mask that come along: SSIM reaches 5, patches of the multi-view terms 3.
const MARGIN_PX: u32 = 16;
/// A group with fewer points than this cannot begin.
const MIN_POINTS: usize = 4;

/// Side of the cubes by which surface is looked up, in local ground sampling distances.
const CUBE_GSD: f64 = 256.0;
/// Share of the points that may lie outside of the extent on each side of each axis: outliers of the sparse model.
const OUTLIER_SHARE: f64 = 0.02;

/// Where surface may be, and how fine it is seen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Extent {
    /// Lowest corner, world frame.
    pub low: DVec3,
    /// Highest corner, world frame.
    pub high: DVec3,
    /// Median ground sampling distance of the training images at the points, scene units.
    pub gsd: f64,
}

impl Extent {
    /// Side of a cube, scene units.
    #[must_use]
    pub fn cube_side(&self) -> f64 {
        CUBE_GSD * self.gsd
    }

    /// The cube of a point; `None` outside of the extent.
    #[must_use]
    pub fn cube_of(&self, point_world: DVec3) -> Option<[i32; 3]> {
        let is_inside = point_world.cmpge(self.low).all() && point_world.cmple(self.high).all();
        is_inside.then(|| ((point_world - self.low) / self.cube_side()).floor().as_ivec3().to_array())
    }

    /// Lowest and highest corner of a cube, world frame.
    #[must_use]
    pub fn cube_box(&self, cube: [i32; 3]) -> (DVec3, DVec3) {
        let low = self.low + self.cube_side() * glam::IVec3::from_array(cube).as_dvec3();
        (low, low + DVec3::splat(self.cube_side()))
    }
}

/// All groups; each is a folder of its own, so that a worker depends on nothing else.
#[derive(Clone, Debug, PartialEq)]
pub struct Groups {
    /// Buildings before background.
    pub groups: Vec<Group>,
    /// Of all of them.
    pub extent: Extent,
    /// Whether masks say what a building is.
    pub masked: bool,
}

/// `groups.json`.
#[derive(Serialize, Deserialize)]
struct Index {
    names: Vec<String>,
    masked: bool,
}

/// The names of all groups of a finished stage.
///
/// # Errors
/// Where it is damaged.
pub fn group_names(stage_folder: &Path) -> Result<Vec<String>> {
    read_json::<Index>(&stage_folder.join("groups.json")).map(|index| index.names)
}

impl Artifact for Groups {
    const FORMAT: &'static str = "pgsag-groups";
    const VERSION: u32 = 1;

    fn read(folder: &Path) -> Result<Self> {
        let Index { names, masked } = read_json(&folder.join("groups.json"))?;
        let groups = names.iter().map(|name| group_of(folder, name)).collect::<Result<_>>()?;
        Ok(Self { groups, extent: read_json(&folder.join("extent.json"))?, masked })
    }

    fn write(&self, folder: &Path) -> Result<()> {
        let names: Vec<String> = self.groups.iter().map(|group| group.id.to_string()).collect();
        let index = Index { names: names.clone(), masked: self.masked };
        write_json(&folder.join("groups.json"), &index)?;
        write_json(&folder.join("extent.json"), &self.extent)?;
        for (group, name) in self.groups.iter().zip(names) {
            std::fs::create_dir(folder.join(&name))?;
            write_json(&folder.join(name).join("group.json"), group)?;
        }
        Ok(())
    }
}

/// One group of a finished stage.
///
/// # Errors
/// Where it is damaged.
pub fn group_of(stage_folder: &Path, name: &str) -> Result<Group> {
    read_json(&stage_folder.join(name).join("group.json"))
}

/// Whether a view is kept out of training.
#[must_use]
pub fn is_held_out(view_index: usize, holdout: u32) -> bool {
    holdout > 1 && view_index.is_multiple_of(holdout as usize)
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let imported = Imported::read(&run.stage_folder("import"))?;
    let pixels = imported.scene.views.iter().map(|view| view.camera.pixel_count() as u64).max().unwrap_or(0);
    let points = imported.scene.points.len() as u64;
    let cost = Cost {
        memory_bytes: (64 << 20) + 8 * pixels + 500 * points,
        disk_bytes: 20 * points,
        cpu_secs: imported.scene.views.len() as f64 * pixels as f64 * 10e-9,
    };
    Ok(JobPlan::whole(&["import", "coarse", "masks", "vote", "refine"], cost))
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let config = config(job.run)?;
    let imported: Imported = job.read("import")?;
    let area = Area::of(&config)?;
    // The coarse points keep no tracks, the sparse ones do.
    let seen = area.views_seeing(&imported.scene);
    let is_used = |view: usize| seen[view] && !is_held_out(view, config.holdout);
    let scene = &job.read::<Coarse>("coarse")?.scene(imported);
    let states = states(job, scene.views.len())?;
    let votes: Votes = job.read("vote")?;
    let inside = |points: Vec<u32>| -> Vec<u32> {
        let within = |index: &u32| area.contains(scene.points[*index as usize].position_world);
        points.into_iter().filter(within).collect()
    };
    let mut groups = Vec::new();
    let masked = states.iter().any(|state| *state != MaskState::Unknown);
    if !masked {
        let points = inside((0..scene.points.len() as u32).collect());
        groups.extend(whole_scene(scene, points, &is_used, &config));
    } else {
        let buildings = inside(building_points(&votes.0, &config.vote));
        let background = inside(background_points(&votes.0, &config.vote));
        groups.extend(masked_group(job, scene, buildings, GroupKind::Building, &states, &is_used, &config)?);
        groups.extend(masked_group(job, scene, background, GroupKind::Background, &states, &is_used, &config)?);
    }
    if groups.is_empty() {
        return Err(UserError::new(
            config.scene,
            format!("no group has {MIN_POINTS} points and 2 images"),
            "check the masks and the area of interest with `pgsag doctor`",
        )
        .into());
    }
    for group in &groups {
        job.say(&format!("{}: {} points, {} images", group.id, group.points.len(), group.views.len()));
    }
    let extent = extent(scene, &groups, &config);
    let Some(extent) = extent else {
        return Err(UserError::new(config.scene, "no point lies in front of a camera", "check poses and points").into());
    };
    job.write(&Groups { groups, extent, masked })
}

/// The box of nearly all points, half as large again, and the ground sampling distance there.
fn extent(scene: &Scene, groups: &[Group], config: &Config) -> Option<Extent> {
    let positions: Vec<DVec3> = groups
        .iter()
        .flat_map(|group| &group.points)
        .map(|index| scene.points[*index as usize].position_world)
        .collect();
    let bound = |q: f64| {
        let axis = |a: usize| quantile(&mut positions.iter().map(|p| p[a]).collect::<Vec<_>>(), q);
        Some(DVec3::new(axis(0)?, axis(1)?, axis(2)?))
    };
    let (low, high) = (bound(OUTLIER_SHARE)?, bound(1.0 - OUTLIER_SHARE)?);
    let margin = DVec3::splat(0.25 * (high - low).max_element());
    let mut distances = Vec::new();
    for group in groups {
        for view in &group.views {
            let view = &scene.views[view.view_index as usize];
            let focal_px = training_camera(&view.camera, config.image_width).focal_px();
            // A few hundred points tell the median as well as all.
            for index in group.points.iter().step_by(group.points.len().div_ceil(300)) {
                let seen = view.camera_from_world.transform_point(scene.points[*index as usize].position_world);
                if view.camera.project(seen).is_some_and(|at| view.camera.contains(at)) {
                    distances.push(seen.z / focal_px);
                }
            }
        }
    }
    Some(Extent { low: low - margin, high: high + margin, gsd: median(&mut distances)? })
}

/// Everything, in every view that is not held out.
fn whole_scene(scene: &Scene, points: Vec<u32>, is_used: &dyn Fn(usize) -> bool, config: &Config) -> Option<Group> {
    let views: Vec<GroupView> =
        (0..scene.views.len()).filter(|view| is_used(*view)).map(|view| whole_view(scene, view, config)).collect();
    group(scene, GroupKind::Building, points, views)
}

fn whole_view(scene: &Scene, view: usize, config: &Config) -> GroupView {
    let camera = training_camera(&scene.views[view].camera, config.image_width);
    GroupView {
        view_index: view as u32,
        window_px: [0, 0, camera.width, camera.height],
        active_count: camera.pixel_count() as u64,
    }
}

fn masked_group(
    job: &Job<'_>,
    scene: &Scene,
    points: Vec<u32>,
    kind: GroupKind,
    states: &[MaskState],
    is_used: &dyn Fn(usize) -> bool,
    config: &Config,
) -> Result<Option<Group>> {
    let classes = job.input("refine");
    let mut views = Vec::new();
    for (view, state) in states.iter().enumerate() {
        job.check()?;
        if !is_used(view) {
            continue;
        }
        match (state, kind) {
            (MaskState::Unknown, GroupKind::Background) => views.push(whole_view(scene, view, config)),
            (MaskState::Unknown, GroupKind::Building) => {}
            _ => {
                let Some(mask) = classes_of(&classes, view, kind)? else { continue };
                let window = window_of(&mask, MARGIN_PX);
                let active_count = mask.active_count() as u64;
                views.extend(window.map(|window_px| GroupView { view_index: view as u32, window_px, active_count }));
            }
        }
    }
    let group = group(scene, kind, points, views);
    if group.is_none() {
        job.warn(match kind {
            GroupKind::Building => "the masks leave no building to reconstruct",
            GroupKind::Background => "the masks leave no background to reconstruct",
        });
    }
    Ok(group)
}

fn group(scene: &Scene, kind: GroupKind, points: Vec<u32>, views: Vec<GroupView>) -> Option<Group> {
    (points.len() >= MIN_POINTS && views.len() >= 2).then(|| Group {
        id: GroupId { kind, number: 1 },
        origin_world: origin_of(scene, &points),
        views,
        points,
    })
}
