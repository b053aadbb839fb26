//! `group`: what each worker trains on. Without masks one group of everything; with masks one group per cluster of
//! buildings (`divide`), blocks of background, and of each its share of every view (`survey`). Paper 4.1.

use std::path::Path;

use anyhow::{Result, ensure};
use glam::DVec3;
use pgsag_group::group::{origin_of, share_steps};
use pgsag_group::territory::Share;
use pgsag_group::{Group, GroupId, GroupKind, GroupView};
use pgsag_scene::numbers::{median, quantile};
use pgsag_scene::{Map, Mask, PixelClass, Scene};
use serde::{Deserialize, Serialize};

use super::aoi::Area;
use super::coarse::Coarse;
use super::import::Imported;
use super::masks::{MaskState, states};
use super::vote::Votes;
use super::{config, read, read_json, view_file, write, write_json};
use crate::config::Config;
use crate::error::UserError;
use crate::photographs::training_camera;
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan};

mod divide;
mod survey;

pub(crate) use divide::budget;

/// A group with fewer points than this cannot begin.
const MIN_POINTS: usize = 4;

/// How buildings are grouped.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GroupingOptions {
    /// Radius of a neighbourhood in plan view, metres; 0: eight distances between points, within the two bounds below.
    pub eps_m: f64,
    /// Least radius that density may lead to, metres.
    pub min_eps_m: f64,
    /// Largest radius that density may lead to, metres.
    pub max_eps_m: f64,
    /// How far a part of a cut cluster sees into the others, metres.
    pub halo_m: f64,
    /// How far around its buildings a group is trained on the ground, pixels at the median distance; 0: not at all.
    pub collar_px: f64,
    /// Clusters of fewer points, or of fewer than lie on 25 m², join one within two radii, or the background.
    pub min_points: usize,
    /// Clusters of more points are cut; 0: as many as training fits into `--memory-limit` twice.
    pub max_points: usize,
    /// Share of a group's points that a view must see to belong to it.
    pub min_seen_share: f32,
    /// Views of a group at most: those that see most of it, most squarely and most finely.
    pub max_views: usize,
    /// Each group takes as many steps as give its points the looks of one run on the whole scene; false: all take all.
    pub equal_looks: bool,
}

impl Default for GroupingOptions {
    fn default() -> Self {
        Self {
            eps_m: 0.0,
            min_eps_m: 2.0,
            max_eps_m: 8.0,
            halo_m: 12.0,
            collar_px: 12.0,
            min_points: 200,
            max_points: 0,
            min_seen_share: 0.02,
            max_views: 300,
            equal_looks: true,
        }
    }
}

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
    /// How building groups came about.
    pub made: Made,
}

/// What became of the clusters of building points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Made {
    /// Clusters of density.
    pub clusters: usize,
    /// Tiny ones that joined another.
    pub merged: usize,
    /// Cuts through clusters that were too large for a worker.
    pub cuts: usize,
    /// Building points that lie apart from all clusters and went to the background.
    pub apart: usize,
}

/// `groups.json`.
#[derive(Serialize, Deserialize)]
struct Index {
    names: Vec<String>,
    masked: bool,
    #[serde(default)]
    made: Made,
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
    const VERSION: u32 = 2;

    fn read(folder: &Path) -> Result<Self> {
        let Index { names, masked, made } = read_json(&folder.join("groups.json"))?;
        let groups = names.iter().map(|name| group_of(folder, name)).collect::<Result<_>>()?;
        Ok(Self { groups, extent: read_json(&folder.join("extent.json"))?, masked, made })
    }

    fn write(&self, folder: &Path) -> Result<()> {
        let names: Vec<String> = self.groups.iter().map(|group| group.id.to_string()).collect();
        let index = Index { names: names.clone(), masked: self.masked, made: self.made };
        write_json(&folder.join("groups.json"), &index)?;
        write_json(&folder.join("extent.json"), &self.extent)?;
        for (group, name) in self.groups.iter().zip(names) {
            std::fs::create_dir_all(folder.join(&name))?;
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

/// The groups whose job of a stage is finished; the others failed twice.
///
/// # Errors
/// Where the stage is not finished.
pub fn finished_groups(run: &Run, groups: Vec<Group>, stage: &str) -> Result<Vec<Group>> {
    let finished = run.finished_jobs(stage)?;
    Ok(groups.into_iter().filter(|group| finished.contains(&group.id.to_string())).collect())
}

/// Marks halo pixels in a share's raster, above the class …
const HALO_BIT: u16 = 4;
/// … and inner edges.
const EDGE_BIT: u16 = 8;

/// A group's share of a view: window, classes, halo; `None` where the group takes the whole view.
///
/// # Errors
/// Where the raster is damaged.
pub fn share_of(stage_folder: &Path, name: &str, view: &GroupView) -> Result<Option<Share>> {
    let path = stage_folder.join(name).join(view_file(view.view_index as usize, "mask.png"));
    if !path.exists() {
        return Ok(None);
    }
    let (file, bytes) = read(&path)?;
    let map = pgsag_scene::files::raster::decode_instances(&file, &bytes)?;
    let [_, _, width, height] = view.window_px;
    ensure!((map.width, map.height) == (width, height), "{file}: damaged; delete its folder");
    let class = |value: &u16| match value & 3 {
        0 => PixelClass::Free,
        1 => PixelClass::Occluded,
        2 => PixelClass::Boundary,
        _ => PixelClass::Inside,
    };
    let mask = Mask { width, height, classes: map.values.iter().map(class).collect() };
    let marked = |bit: u16| Map { width, height, values: map.values.iter().map(|value| value & bit != 0).collect() };
    Ok(Some(Share { window_px: view.window_px, mask, halo: marked(HALO_BIT), inner_edges: marked(EDGE_BIT) }))
}

/// Writes what [`share_of`] reads.
fn write_share(folder: &Path, view_index: usize, share: &Share) -> Result<()> {
    let marks = share.halo.values.iter().zip(&share.inner_edges.values);
    let value = |(class, (halo, edge)): (&PixelClass, (&bool, &bool))| {
        *class as u16 | if *halo { HALO_BIT } else { 0 } | if *edge { EDGE_BIT } else { 0 }
    };
    let values = share.mask.classes.iter().zip(marks).map(value).collect();
    let map = Map { width: share.mask.width, height: share.mask.height, values };
    write(&folder.join(view_file(view_index, "mask.png")), &pgsag_scene::files::raster::encode_instances_png(&map))
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let imported = Imported::read(&run.stage_folder("import"))?;
    let pixels = imported.scene.views.iter().map(|view| view.camera.pixel_count() as u64).max().unwrap_or(0);
    let points = std::fs::metadata(run.stage_folder("vote").join("votes.bin")).map_or(0, |found| found.len() / 9);
    let threads = rayon::current_num_threads() as u64;
    let views = imported.scene.views.len() as f64;
    let cost = Cost {
        memory_bytes: (64 << 20) + 64 * pixels * threads + 800 * points,
        disk_bytes: 20 * points + views as u64 * pixels / 16,
        cpu_secs: views * (pixels as f64 * 200e-9 + points as f64 * 60e-9),
    };
    Ok(JobPlan::whole(&["import", "coarse", "masks", "vote", "refine"], cost))
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let config = config(job.run)?;
    let imported: Imported = job.read("import")?;
    let area = Area::of(&config)?;
    // The coarse points keep no tracks, the sparse ones do.
    let used = area.views_seeing(&imported.scene);
    let Coarse { points, normals, .. } = job.read("coarse")?;
    let scene = Scene { points, ..imported.scene };
    let states = states(job, scene.views.len())?;
    let masked = states.iter().any(|state| *state != MaskState::Unknown);
    let within = |index: &u32| area.contains(scene.points[*index as usize].position_world);
    let points: Vec<u32> = (0..scene.points.len() as u32).filter(within).collect();
    let mut made = Made::default();
    let mut groups = if masked {
        let Votes { labels, .. } = job.read("vote")?;
        let division = divide::divide(job, &scene, &points, &labels, &config)?;
        made = division.made;
        let patrol =
            survey::Patrol { job, config: &config, scene: &scene, normals: &normals, states: &states, used: &used };
        patrol.groups(&division, &labels)?
    } else {
        whole_scene(&scene, points, &used, &config).into_iter().collect()
    };
    if groups.is_empty() {
        return Err(UserError::new(
            config.scene,
            format!("no group has {MIN_POINTS} points and 2 images"),
            "check the masks and the area of interest with `pgsag doctor`",
        )
        .into());
    }
    if config.groups.equal_looks {
        let is_learnt_from = |view: &usize| used[*view] && !config.is_held_out(*view);
        share_steps(&mut groups, (0..used.len()).filter(is_learnt_from).count());
    }
    if groups.iter().any(|group| group.id.kind == GroupKind::Building) {
        let blocks = groups.iter_mut().filter(|group| group.id.kind == GroupKind::Background);
        blocks.for_each(|block| block.steps_share *= config.blocks.steps_share);
    }
    for group in &groups {
        job.say(&described(group));
    }
    let extent = extent(&scene, &groups, &config);
    let Some(extent) = extent else {
        return Err(UserError::new(config.scene, "no point lies in front of a camera", "check poses and points").into());
    };
    job.write(&Groups { groups, extent, masked, made })
}

fn described(group: &Group) -> String {
    let middle = |of: fn(&GroupView) -> f32| {
        median(&mut group.views.iter().map(|view| f64::from(of(view))).collect::<Vec<_>>()).unwrap_or(0.0)
    };
    let halo = group.points.len() - group.core_count;
    let halo = if halo > 0 { format!(" and {halo} around") } else { String::new() };
    let seen = middle(|view| view.seen_share);
    let seen = if seen > 0.0 { format!(", each seeing {:.0} % of it", 100.0 * seen) } else { String::new() };
    let steps = match group.steps_share {
        share if share < 0.995 => format!(", {:.0} % of the steps", 100.0 * share),
        _ => String::new(),
    };
    format!("{}: {} points{halo}, {} images{seen}{steps}", group.id, group.core_count, group.views.len())
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
            distances.extend(samplings(scene, view.view_index as usize, &group.points, config));
        }
    }
    Some(Extent { low: low - margin, high: high + margin, gsd: median(&mut distances)? })
}

/// Ground sampling distances of a view at some of `points`, scene units per pixel of the training image.
fn samplings(scene: &Scene, view: usize, points: &[u32], config: &Config) -> Vec<f64> {
    let view = &scene.views[view];
    let focal_px = training_camera(&view.camera, config.image_width).focal_px();
    // A few hundred points tell the median as well as all.
    let some = points.iter().step_by(points.len().div_ceil(300).max(1));
    let seen = some.map(|index| view.camera_from_world.transform_point(scene.points[*index as usize].position_world));
    let is_in = |at: &DVec3| view.camera.project(*at).is_some_and(|px| view.camera.contains(px));
    seen.filter(is_in).map(|at| at.z / focal_px).collect()
}

/// Everything, in every view.
fn whole_scene(scene: &Scene, points: Vec<u32>, used: &[bool], config: &Config) -> Option<Group> {
    let all = (0..scene.views.len()).filter(|view| used[*view]).map(|view| whole_view(scene, view, config));
    let (held_out, views): (Vec<_>, Vec<_>) = all.partition(|view| config.is_held_out(view.view_index as usize));
    let id = GroupId { kind: GroupKind::Building, number: 1 };
    let core_count = points.len();
    let origin_world = origin_of(scene, &points);
    let group = Group { id, origin_world, views, held_out, points, core_count, steps_share: 1.0 };
    is_trainable(core_count, group.views.len()).then_some(group)
}

/// Whether training can begin at all.
fn is_trainable(point_count: usize, view_count: usize) -> bool {
    point_count >= MIN_POINTS && view_count >= 2
}

fn whole_view(scene: &Scene, view: usize, config: &Config) -> GroupView {
    let camera = training_camera(&scene.views[view].camera, config.image_width);
    GroupView {
        view_index: view as u32,
        window_px: [0, 0, camera.width, camera.height],
        active_count: camera.pixel_count() as u64,
        seen_share: 0.0,
        gsd: 0.0,
        incidence_deg: 0.0,
        azimuth_deg: 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let (width, height) = (4, 2);
        let classes = [PixelClass::Free, PixelClass::Occluded, PixelClass::Boundary, PixelClass::Inside].repeat(2);
        let marks = |at: &[usize]| {
            let mut map = Map::filled(width, height, false);
            at.iter().for_each(|at| map.values[*at] = true);
            map
        };
        let share = Share {
            window_px: [5, 6, width, height],
            mask: Mask { width, height, classes },
            halo: marks(&[2, 3, 7]),
            inner_edges: marks(&[3, 6]),
        };
        std::fs::create_dir(folder.path().join("g001")).expect("a folder");
        write_share(&folder.path().join("g001"), 17, &share).expect("written");
        let view = GroupView {
            view_index: 17,
            window_px: share.window_px,
            active_count: 4,
            seen_share: 1.0,
            gsd: 0.1,
            incidence_deg: 0.0,
            azimuth_deg: 0.0,
        };
        assert_eq!(share_of(folder.path(), "g001", &view).expect("sound"), Some(share));
        assert_eq!(share_of(folder.path(), "g002", &view).expect("absent"), None);
    }
}
