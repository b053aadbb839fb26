//! `merge`: the surfaces of all cubes become one city; its buildings are told apart.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Result, bail};
use glam::DVec3;
use pgsag_mesh::components::{ComponentOptions, drop_small, keep_faces};
use pgsag_mesh::gaps::close_gaps;
use pgsag_mesh::holes::close_holes;
use pgsag_mesh::identity::{Ground, RoofRules, given_pieces, on_ground, roof_pieces};
use pgsag_mesh::merge::{Merger, split_by_building};
use pgsag_mesh::render::visibility;
use pgsag_mesh::settle::settle;
use pgsag_scene::numbers::{median, quantile};
use pgsag_scene::{Mesh, Scene};
use serde::{Deserialize, Serialize};

use super::aoi::Area;
use super::group::Groups;
use super::import::Imported;
use super::mesh::{Surface, lattice_of, read_surface, write_surface};
use super::{config, read_json, write_json};
use crate::config::Config;
use crate::error::UserError;
use crate::lengths::Lengths;
use crate::photographs::training_camera;
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan};

/// What is a surface and what is a building.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BuildingOptions {
    /// Connected pieces of less surface are dropped as crumbs.
    pub min_piece_m2: f64,
    /// Connected pieces of fewer faces are dropped as crumbs.
    pub min_piece_faces: usize,
    /// Holes of the surface with a rim of at most this length are closed, metres; 0: none. A window's is 4 to 6 m.
    pub max_hole_rim_m: f64,
    /// Buildings part in plan view where a gap is wider than about two of these, or 1.2 where roofs are told apart from above.
    pub plan_cell_m: f64,
    /// Roofs that touch are of two buildings where their heights differ by more than this, metres, and by more than one
    /// sample of the volume; 0: only gaps part.
    pub height_step_m: f64,
    /// Roofs that touch are of two buildings also where their hues differ by more than this: |Δ ln(red / green)| +
    /// |Δ ln(blue / green)|, which light and shade do not change; 0: colours part nothing.
    pub hue_step: f64,
    /// Building surface less than this above the ground nearby is ground, metres, where no walls or roofs stand over it: what
    /// masks draw past walls; 0: it stays.
    pub ground_height_m: f64,
    /// Building surface of less than this is no building of its own and counts as background.
    pub min_building_m2: f64,
}

/// Cells of the relief of roofs, in those of a plan without.
const RELIEF_SHARE: f64 = 0.6;
/// Distance from a plane that roofs keep to, samples of the volume.
const FLAT_VOXELS: f64 = 0.2;
/// Side of a block in which the level of the ground is looked for, metres.
const GROUND_BLOCK_M: f64 = 2.0;

impl Default for BuildingOptions {
    fn default() -> Self {
        Self {
            min_piece_m2: 2.0,
            min_piece_faces: 50,
            max_hole_rim_m: 6.0,
            plan_cell_m: 0.5,
            height_step_m: 0.1,
            hue_step: 0.12,
            ground_height_m: 0.5,
            min_building_m2: 10.0,
        }
    }
}

/// What is known of a building.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Building {
    /// Its number in the meshes.
    pub building: u32,
    /// The group that trained most of it.
    pub group: u32,
    /// Triangles.
    pub faces: usize,
    /// Surface, square metres (of scenes of unknown scale: as [`Lengths`] says).
    pub area_m2: f64,
    /// From its lowest to its highest vertex along the up axis, metres.
    pub height_m: f64,
    /// Images in which some of it is seen.
    pub views: usize,
    /// Share of its surface that at least three images see.
    pub quality: f64,
    /// Share of its surface that no photograph measured and that only closes gaps.
    pub closed_share: f64,
}

/// The city and its buildings.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Merged {
    /// Everything.
    pub city: Mesh,
    /// Building surface only; everything where no masks say what a building is.
    pub buildings: Mesh,
    /// By number; empty where no masks say what a building is.
    pub list: Vec<Building>,
}

impl Artifact for Merged {
    const FORMAT: &'static str = "pgsag-city";
    const VERSION: u32 = 1;

    fn read(folder: &Path) -> Result<Self> {
        Ok(Self {
            city: read_surface(&folder.join("city.ply"))?,
            buildings: read_surface(&folder.join("buildings.ply"))?,
            list: read_json(&folder.join("buildings.json"))?,
        })
    }

    fn write(&self, folder: &Path) -> Result<()> {
        write_surface(&folder.join("city.ply"), &self.city, &[])?;
        write_surface(&folder.join("buildings.ply"), &self.buildings, &[])?;
        std::fs::create_dir(folder.join("buildings"))?;
        for (number, mesh) in split_by_building(&self.buildings) {
            write_surface(&folder.join("buildings").join(building_file(number)), &mesh, &[])?;
        }
        write_json(&folder.join("buildings.json"), &self.list)
    }
}

/// The file of one building.
#[must_use]
pub fn building_file(number: u32) -> String {
    format!("b{number:03}.ply")
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let folder = run.stage_folder("mesh");
    let size = |name: &String| std::fs::metadata(folder.join(name).join("surface.ply")).map_or(0, |found| found.len());
    let bytes: u64 = run.finished_jobs("mesh")?.iter().map(size).sum();
    // Closing gaps and telling buildings apart: measured 2.3 times the files on scenes of 40 to 600 MiB.
    let cost =
        Cost { memory_bytes: (96 << 20) + 26 * bytes / 10, disk_bytes: 3 * bytes, cpu_secs: bytes as f64 * 50e-9 };
    Ok(JobPlan::whole(&["import", "group", "mesh"], cost))
}

/// Parts of the work as they take time in a city of 6.8 million faces: reading 1, tidying 2, telling apart 4, the rest 6.
const PARTS: u64 = 13;

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let config = config(job.run)?;
    let imported: Imported = job.read("import")?;
    let groups: Groups = job.read("group")?;
    let lengths = Lengths::of(&imported.scene);
    if let Some(words) = lengths.assumption() {
        job.warn(words);
    }
    let cubes = job.run.finished_jobs("mesh")?;
    let mut merger = Merger::default();
    for name in &cubes {
        merger.add(&job.read_job::<Surface>("mesh", name)?.0);
    }
    job.advance(1, PARTS, "parts");
    let mut city = merger.finish();
    let area = Area::of(&config)?;
    if !area.is_everything() {
        let center = |face: usize| city.triangle(face).iter().map(|p| DVec3::from_array(*p)).sum::<DVec3>() / 3.0;
        city = keep_faces(&city, |face| area.contains(center(face)));
    }
    let options = &config.buildings;
    let crumb = lengths.square_units(options.min_piece_m2);
    let mut city = tidy(job, city, &config, &lengths);
    job.advance(3, PARTS, "parts");
    if city.faces.is_empty() {
        return Err(UserError::new(
            &config.scene,
            "no surface was found",
            "check the scene with `pgsag doctor`; train longer with --iterations",
        )
        .into());
    }
    if !groups.masked {
        job.warn("no masks: buildings are not separated, buildings.ply holds the whole surface");
        let city = unmasked(&city, crumb);
        return job.write(&Merged { buildings: city.clone(), city, list: Vec::new() });
    }
    let up = imported.scene.frame.up_world;
    let voxel = lattice_of(&groups.extent, &config, imported.scene.frame.metres_per_unit).voxel;
    let is_parted = options.height_step_m > 0.0 && looks_down(&city, &imported.scene, up);
    if options.height_step_m > 0.0 && !is_parted {
        job.say("the cameras stand below the roofs: gaps alone part buildings, not the heights of roofs");
    }
    let (rules, ground) = rules(options, &lengths, voxel, is_parted);
    tell_apart(&mut city, up, &rules, ground.as_ref(), crumb)?;
    job.advance(7, PARTS, "parts");
    let parts = split_by_building(&city);
    let mut list: Vec<Building> = parts.iter().map(|(n, mesh)| described(*n, mesh, up, &lengths)).collect();
    let samples: Vec<Vec<DVec3>> = parts.values().map(sample_centers).collect();
    drop(parts);
    sightings(&city, &samples, &imported.scene, &mut list);
    job.say(&format!("{} buildings, {} faces", list.len(), city.faces.len()));
    if list.is_empty() {
        job.warn("no building surface was found inside the masks");
    }
    let buildings = keep_faces(&city, |face| city.buildings[face] != 0);
    job.write(&Merged { city, buildings, list })
}

/// The options in scene units, where the volume is sampled every `voxel`; roofs are told apart by height where `is_parted`.
fn rules(options: &BuildingOptions, lengths: &Lengths, voxel: f64, is_parted: bool) -> (RoofRules, Option<Ground>) {
    let rules = RoofRules {
        cell: lengths.units(options.plan_cell_m * if is_parted { RELIEF_SHARE } else { 1.0 }).max(1.5 * voxel),
        step: if is_parted { lengths.units(options.height_step_m).max(voxel) } else { f64::INFINITY },
        flat: FLAT_VOXELS * voxel,
        hue_step: if options.hue_step > 0.0 { options.hue_step } else { f64::INFINITY },
        min_area: lengths.square_units(options.min_building_m2),
    };
    let ground = (options.ground_height_m > 0.0).then(|| Ground {
        cell: voxel,
        height: lengths.units(options.ground_height_m).max(voxel),
        block: lengths.units(GROUND_BLOCK_M).max(8.0 * voxel),
    });
    (rules, ground)
}

/// Without crumbs, narrow gaps and small holes.
fn tidy(job: &Job<'_>, city: Mesh, config: &Config, lengths: &Lengths) -> Mesh {
    let options = &config.buildings;
    let crumbs =
        ComponentOptions { min_area: lengths.square_units(options.min_piece_m2), min_faces: options.min_piece_faces };
    let (city, dropped) = drop_small(city, &crumbs);
    if !dropped.is_empty() {
        job.say(&format!("{} crumbs of surface were dropped", dropped.len()));
    }
    let (mut city, gaps) = close_gaps(city, lengths.units(config.surface.max_gap_m));
    if gaps.faces > 0 {
        let area = lengths.square_metres(gaps.area);
        job.say(&format!("gaps were closed with {area:.1} m² of surface that no photograph shows"));
    }
    let closed = close_holes(&mut city, lengths.units(options.max_hole_rim_m));
    if closed.holes > 0 {
        let area = lengths.square_metres(closed.area);
        job.say(&format!("{} holes were closed with {area:.1} m² of surface", closed.holes));
    }
    city
}

/// A city without masks, one group and no building: what was measured, and what closes gaps of less than `crumb`, scene
/// units squared. Wider ones cannot be left to the ground, and are not claimed for a building.
fn unmasked(city: &Mesh, crumb: f64) -> Mesh {
    let measured: Vec<u32> = (0..city.faces.len()).map(|face| u32::from(city.is_measured(face))).collect();
    let kept = settle(city, &measured, crumb);
    let mut city = keep_faces(city, |face| kept[face] != 0);
    city.buildings = vec![0; city.faces.len()];
    city.groups = vec![1; city.faces.len()];
    city
}

/// Share of building surface that must lie below the cameras for its highest parts to be roofs.
const BELOW_CAMERAS_SHARE: f64 = 0.9;

/// Whether most cameras look down on the buildings; from the ground the highest surface is where the view of a facade
/// happens to end, and its steps mean nothing.
fn looks_down(city: &Mesh, scene: &Scene, up: DVec3) -> bool {
    let of_building = (0..city.faces.len()).filter(|face| city.groups.get(*face).is_some_and(|group| *group != 0));
    let mut surface: Vec<f64> = of_building.map(|face| DVec3::from_array(city.triangle(face)[0]).dot(up)).collect();
    let mut cameras: Vec<f64> = scene.views.iter().map(|view| view.center_world().dot(up)).collect();
    match (quantile(&mut surface, BELOW_CAMERAS_SHARE), median(&mut cameras)) {
        (Some(high), Some(camera)) => camera > high,
        _ => true,
    }
}

/// Labels without speckles of less than `crumb`, scene units squared, and buildings by number: as given in instance masks,
/// else roof by roof. What lies on the ground leaves the buildings; then roofs are told apart once more, since strips of
/// ground and crumbs had joined what they lay beside.
fn tell_apart(city: &mut Mesh, up: DVec3, rules: &RoofRules, ground: Option<&Ground>, crumb: f64) -> Result<()> {
    city.groups = settle(city, &city.groups, crumb);
    if city.groups.len() != city.faces.len() {
        bail!("faces without groups");
    }
    let is_given = city.buildings.iter().any(|number| *number != 0);
    let is_building = |face: usize| city.groups[face] != 0;
    let numbers = match is_given {
        true => given_pieces(city, up, rules, &city.buildings, is_building)?,
        false => by_size(city, &roof_pieces(city, up, rules, is_building)?, rules.min_area),
    };
    city.buildings = settle(city, &numbers, crumb);
    if let Some(ground) = ground {
        let is_ground = on_ground(city, up, ground, |face| city.buildings[face] != 0)?;
        if !is_given {
            let is_building = |face: usize| city.buildings[face] != 0 && !is_ground[face];
            let numbers = by_size(city, &roof_pieces(city, up, rules, is_building)?, rules.min_area);
            city.buildings = settle(city, &numbers, crumb);
        }
        // Strips of ground are speckles to whoever settles labels, and must not come back.
        city.buildings.iter_mut().zip(is_ground).filter(|(_, ground)| *ground).for_each(|(number, _)| *number = 0);
    }
    match_groups(city);
    Ok(())
}

/// Pieces numbered from 1, the largest surface first; those of less than `min_area` are 0.
fn by_size(city: &Mesh, pieces: &[u32], min_area: f64) -> Vec<u32> {
    let mut areas: BTreeMap<u32, f64> = BTreeMap::new();
    for (face, piece) in pieces.iter().enumerate().filter(|(_, piece)| **piece != 0) {
        *areas.entry(*piece).or_default() += face_area(city, face);
    }
    let mut order: Vec<(u32, f64)> = areas.into_iter().filter(|(_, area)| *area >= min_area).collect();
    order.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let number: BTreeMap<u32, u32> = order.iter().zip(1..).map(|((piece, _), number)| (*piece, number)).collect();
    pieces.iter().map(|piece| number.get(piece).copied().unwrap_or(0)).collect()
}

/// What is no building belongs to no group of buildings either; what is one but was of no group goes to the group of most
/// of that building.
fn match_groups(city: &mut Mesh) {
    let mut counts: BTreeMap<u32, BTreeMap<u32, usize>> = BTreeMap::new();
    for (group, building) in city.groups.iter().zip(&city.buildings).filter(|(group, _)| **group != 0) {
        *counts.entry(*building).or_default().entry(*group).or_default() += 1;
    }
    let most = |groups: &BTreeMap<u32, usize>| {
        groups.iter().max_by_key(|(group, count)| (**count, u32::MAX - **group)).map_or(0, |(group, _)| *group)
    };
    let group_of: BTreeMap<u32, u32> = counts.iter().map(|(building, groups)| (*building, most(groups))).collect();
    for (group, building) in city.groups.iter_mut().zip(&city.buildings) {
        if *building == 0 {
            *group = 0;
        } else if *group == 0 {
            *group = group_of.get(building).copied().unwrap_or(0);
        }
    }
}

fn face_area(mesh: &Mesh, face: usize) -> f64 {
    let [a, b, c] = mesh.triangle(face).map(DVec3::from_array);
    0.5 * (b - a).cross(c - a).length()
}

fn described(building: u32, mesh: &Mesh, up: DVec3, lengths: &Lengths) -> Building {
    let heights = || mesh.vertices.iter().map(|vertex| DVec3::from_array(*vertex).dot(up));
    let span = heights().fold(f64::NEG_INFINITY, f64::max) - heights().fold(f64::INFINITY, f64::min);
    let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
    for group in &mesh.groups {
        *counts.entry(*group).or_default() += 1;
    }
    let group = counts.iter().max_by_key(|(group, count)| (**count, u32::MAX - **group)).map_or(0, |(group, _)| *group);
    let area: f64 = (0..mesh.faces.len()).map(|face| face_area(mesh, face)).sum();
    let closed = (0..mesh.faces.len()).filter(|face| !mesh.is_measured(*face)).map(|face| face_area(mesh, face));
    Building {
        building,
        group,
        faces: mesh.faces.len(),
        area_m2: lengths.square_metres(area),
        height_m: lengths.metres(span),
        views: 0,
        quality: 0.0,
        closed_share: closed.sum::<f64>() / area.max(f64::MIN_POSITIVE),
    }
}

/// Images that are asked who they see; more tell little more.
const MAX_ASKED: usize = 200;
/// Longest side of the images that are asked.
const ASKED_PX: u32 = 400;
/// Faces of a building that are looked for.
const MAX_FACES: usize = 2000;

/// Counts the images that see each building, by samples of its surface, and the share of its surface that three or more see.
fn sightings(city: &Mesh, samples: &[Vec<DVec3>], scene: &Scene, list: &mut [Building]) {
    let mut counts: Vec<Vec<u32>> = samples.iter().map(|centers| vec![0; centers.len()]).collect();
    let step = scene.views.len().div_ceil(MAX_ASKED).max(1);
    for view in scene.views.iter().step_by(step) {
        let camera = training_camera(&view.camera, ASKED_PX);
        let seen = visibility(city, &camera, &view.camera_from_world);
        for (building, (centers, counts)) in samples.iter().zip(&mut counts).enumerate() {
            let mut any = false;
            for (center, count) in centers.iter().zip(counts) {
                let at = view.camera_from_world.transform_point(*center);
                let Some(px) = camera.project(at).filter(|px| camera.contains(*px)) else { continue };
                let depth = f64::from(seen.depth.at(px.x as u32, px.y as u32));
                // Two pixels of the small image beside each other may lie this far apart on a steep wall.
                if depth > 0.0 && at.z <= depth + 4.0 * at.z / camera.focal_px() {
                    *count += 1;
                    any = true;
                }
            }
            list[building].views += usize::from(any);
        }
    }
    for (building, counts) in list.iter_mut().zip(&counts) {
        building.quality = counts.iter().filter(|count| **count >= 3).count() as f64 / counts.len().max(1) as f64;
    }
}

fn sample_centers(mesh: &Mesh) -> Vec<DVec3> {
    let step = mesh.faces.len().div_ceil(MAX_FACES).max(1);
    let center = |face: usize| mesh.triangle(face).iter().map(|p| DVec3::from_array(*p)).sum::<DVec3>() / 3.0;
    (0..mesh.faces.len()).step_by(step).map(center).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn squares(at: &[(f64, u32)]) -> Mesh {
        let mut mesh = Mesh::default();
        for (x, group) in at {
            let first = mesh.vertices.len() as u32;
            mesh.vertices.extend([[*x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x + 1.0, 1.0, 0.0], [*x, 1.0, 0.0]]);
            mesh.faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            mesh.groups.extend([*group, *group]);
        }
        mesh
    }

    #[test]
    fn the_largest_building_is_number_one_and_crumbs_are_background() {
        let mut city = squares(&[(0.0, 1), (10.0, 1), (11.0, 1), (20.0, 0)]);
        let rules =
            |min_area: f64| RoofRules { cell: 0.5, step: f64::INFINITY, flat: 0.0, hue_step: f64::INFINITY, min_area };
        tell_apart(&mut city, DVec3::Z, &rules(0.5), None, 0.0).expect("numbered");
        assert_eq!(city.buildings, [2, 2, 1, 1, 1, 1, 0, 0]);
        tell_apart(&mut city, DVec3::Z, &rules(1.5), None, 0.0).expect("numbered");
        assert_eq!(city.buildings, [0, 0, 1, 1, 1, 1, 0, 0]);
        assert_eq!(city.groups, [0, 0, 1, 1, 1, 1, 0, 0]);
    }

    #[test]
    fn ground_between_two_houses_does_not_join_them() {
        // Along x: a house, ground that the masks took for a building, a house; beside them ground that they did not take.
        let mut city = Mesh::default();
        for (x, y) in (0..24).flat_map(|x| (0..8).map(move |y| (x, y))) {
            let is_roof = y >= 4 && !(9..15).contains(&x);
            let mut square = squares(&[(f64::from(x), u32::from(y >= 4))]);
            square.vertices.iter_mut().for_each(|v| *v = [v[0], v[1] + f64::from(y), if is_roof { 3.0 } else { 0.1 }]);
            let first = city.vertices.len() as u32;
            city.vertices.extend(square.vertices);
            city.faces.extend(square.faces.iter().map(|face| face.map(|corner| corner + first)));
            city.groups.extend(square.groups);
        }
        let rules = RoofRules { cell: 1.0, step: f64::INFINITY, flat: 0.0, hue_step: f64::INFINITY, min_area: 4.0 };
        let ground = Ground { cell: 0.5, height: 0.5, block: 4.0 };
        let numbers = |ground: Option<&Ground>| -> Vec<u32> {
            let mut city = city.clone();
            tell_apart(&mut city, DVec3::Z, &rules, ground, 0.0).expect("told apart");
            [3, 12, 21].map(|x| city.buildings[2 * (8 * x + 6)]).into()
        };
        assert_eq!(numbers(None), [1, 1, 1]);
        let [west, middle, east] = numbers(Some(&ground))[..] else { panic!("three") };
        assert!(middle == 0 && west != east && west * east == 2, "{west} {middle} {east}");
    }

    #[test]
    fn roofs_are_seen_from_above_alone() {
        use pgsag_scene::synthetic::{Town, TownOptions};
        let scene = Town::generate(&TownOptions { view_count: 8, point_count: 100, ..TownOptions::default() }).scene;
        let up = scene.frame.up_world;
        let mut city = squares(&[(0.0, 1), (1.0, 1), (2.0, 0)]);
        assert!(looks_down(&city, &scene, up));
        let lift = 1000.0 * up;
        city.vertices.iter_mut().for_each(|vertex| *vertex = (DVec3::from_array(*vertex) + lift).to_array());
        assert!(!looks_down(&city, &scene, up));
        assert!(looks_down(&Mesh::default(), &scene, up));
    }

    #[test]
    fn given_numbers_stay_and_what_nobody_numbered_gets_the_next() {
        let mut city = squares(&[(0.0, 1), (1.0, 1), (2.0, 1), (10.0, 2), (20.0, 0)]);
        city.buildings = vec![7, 0, 7, 4, 4, 4, 0, 0, 9, 9];
        let rules = RoofRules { cell: 0.5, step: f64::INFINITY, flat: 0.0, hue_step: f64::INFINITY, min_area: 0.4 };
        tell_apart(&mut city, DVec3::Z, &rules, None, 0.0).expect("numbered");
        assert_eq!(city.buildings, [7, 7, 7, 4, 4, 4, 8, 8, 0, 0]);
        assert_eq!(city.groups, [1, 1, 1, 1, 1, 1, 2, 2, 0, 0]);
    }

    #[test]
    fn what_became_building_takes_the_group_of_its_building() {
        let mut city = squares(&[(0.0, 2), (1.0, 2), (2.0, 0), (3.0, 5)]);
        city.buildings = vec![1, 1, 1, 1, 1, 1, 0, 0];
        match_groups(&mut city);
        assert_eq!(city.groups, [2, 2, 2, 2, 2, 2, 0, 0]);
    }

    #[test]
    fn without_masks_wide_gaps_stay_open() {
        let mut city = squares(&[(0.0, 0), (10.0, 0)]);
        // The second square closes a gap, and so does a quarter of a square beside the first.
        city.vertices.push([1.5, 0.5, 0.0]);
        city.faces.push([1, 2, 8]);
        city.groups.push(0);
        city.closed = vec![0, 0, 1, 1, 1];
        let kept = unmasked(&city, 0.9);
        assert_eq!((kept.closed, kept.groups, kept.buildings), (vec![0, 0, 1], vec![1; 3], vec![0; 3]));
        assert_eq!(unmasked(&city, 0.1).closed, [0, 0]);
    }

    #[test]
    fn a_description_is_in_metres() {
        let lengths = Lengths::known(0.5);
        let mut square = squares(&[(0.0, 2)]);
        square.closed = vec![0, 1];
        let found = described(3, &square, DVec3::X, &lengths);
        assert_eq!(found.closed_share, 0.5);
        assert_eq!((found.building, found.group, found.faces), (3, 2, 2));
        assert!((found.area_m2 - 0.25).abs() < 1e-12 && (found.height_m - 0.5).abs() < 1e-12);
    }
}
