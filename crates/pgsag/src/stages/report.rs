//! `report`: what a person opens, gathered in one folder that is published whole as `RUN/result`.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result};
use glam::DVec3;
use pgsag_group::Group;
use pgsag_mesh::merge::split_by_building;
use pgsag_scene::{Frame, Mesh};
use serde_json::{Value, json};

use super::group::{Groups, finished_groups};
use super::import::Imported;
use super::merge::Building;
use super::mesh::read_surface;
use super::score::{Scored, read_evidence};
use super::vote::Votes;
use super::{config, read_json, write, write_json};
use crate::config::Config;
use crate::lengths::Lengths;
use crate::report;
use crate::run::Run;
use crate::run::artifact::{Artifact, files_below};
use crate::run::stage::{Cost, Job, JobPlan};

/// The folder; its content is for people and other programs, nothing of ours reads it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Published;

impl Artifact for Published {
    const FORMAT: &'static str = "pgsag-result";
    const VERSION: u32 = 1;

    fn read(_: &Path) -> Result<Self> {
        Ok(Self)
    }

    fn write(&self, _: &Path) -> Result<()> {
        Ok(())
    }
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let bytes = fs::metadata(run.stage_folder("merge").join("city.ply")).map_or(0, |found| found.len());
    let reads = run.stage("report").map_or(&[][..], |stage| stage.reads);
    // Measured: 1.8 to 2.1 times the city beyond what pictures need.
    let cost = Cost { memory_bytes: (176 << 20) + 24 * bytes / 10, disk_bytes: 2 * bytes, cpu_secs: 10.0 };
    Ok(JobPlan::whole(reads, cost))
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let config = config(job.run)?;
    let imported: Imported = job.read("import")?;
    let Groups { groups, masked, made, .. } = job.read("group")?;
    let groups = finished_groups(job.run, groups, "train")?;
    let names: Vec<String> = groups.iter().map(|group| group.id.to_string()).collect();
    link_files(job, &names)?;
    write_json(&job.output().join("georef.json"), &georef(&imported.scene.frame))?;
    // The city alone: its buildings are in it.
    let city = read_surface(&job.input("merge").join("city.ply"))?;
    let list: Vec<Building> = read_json(&job.input("merge").join("buildings.json"))?;
    let lengths = Lengths::of(&imported.scene);
    write_json(&job.output().join("buildings.geojson"), &footprints(&city, &list, &config, &lengths))?;
    let shown = report::pictures::shown(job, &config, &imported, &groups, &city)?;
    write_viewable(job, &city, &imported.scene.frame, &groups)?;
    let Scored(score) = job.read("score")?;
    let evidence = read_evidence(&job.input("score"))?;
    let face_count = city.faces.len();
    drop(city);
    let Votes { votes, .. } = job.read("vote")?;
    let content = report::Content {
        imported: &imported,
        buildings: &list,
        masked,
        face_count,
        shown,
        score,
        evidence,
        votes,
        grouped: &groups,
        made,
    };
    let page = report::page(job, &config, &content)?;
    write(&job.output().join("report.html"), page.as_bytes())
}

fn link_files(job: &Job<'_>, names: &[String]) -> Result<()> {
    let merge = job.input("merge");
    for file in files_below(&merge)?.iter().filter(|file| file.ends_with(".ply")) {
        link(&merge.join(file), &job.output().join(file))?;
    }
    for name in names {
        let to = job.output().join("gaussians").join(format!("{name}.ply"));
        link(&job.input("train").join(name).join("cloud.ply"), &to)?;
    }
    for name in ["score.json", "evidence.json"] {
        let file = job.input("score").join(name);
        if file.exists() {
            link(&file, &job.output().join(name))?;
        }
    }
    Ok(())
}

fn georef(frame: &Frame) -> Value {
    json!({
        "offset": frame.offset.to_array(), "epsg": frame.epsg, "vertical_datum": frame.vertical_datum,
        "origin_lla": frame.origin_lla, "metres_per_unit": frame.metres_per_unit,
        "up": frame.up_world.to_array(), "source": frame.source,
    })
}

/// Every building with its outline in scene coordinates; `georef.json` says where those lie on Earth.
fn footprints(city: &Mesh, list: &[Building], config: &Config, lengths: &Lengths) -> Value {
    let cell = lengths.units(config.buildings.plan_cell_m);
    let parts = split_by_building(city);
    let feature = |building: &Building| {
        let empty = Mesh::default();
        let mesh = parts.get(&building.building).unwrap_or(&empty);
        json!({"type": "Feature", "properties": building, "geometry": report::footprints::outline(mesh, cell)})
    };
    json!({"type": "FeatureCollection", "coordinates_are": "scene coordinates, see georef.json",
        "features": list.iter().map(feature).collect::<Vec<_>>()})
}

/// Buildings and background as two objects about the first group's origin.
fn write_viewable(job: &Job<'_>, city: &Mesh, frame: &Frame, groups: &[Group]) -> Result<()> {
    let path = &job.output().join("city.glb");
    let origin = groups.first().map_or(DVec3::ZERO, |group| DVec3::from_array(group.origin_world));
    let is_building = |face: usize| city.buildings.get(face).is_some_and(|building| *building != 0);
    let is_other = |face: usize| !is_building(face);
    let part = |name, keep| report::glb::Part { name, mesh: city, keep };
    let parts = [part("buildings", &is_building), part("surroundings", &is_other)];
    let encode = || {
        let mut out = std::io::BufWriter::new(fs::File::create(path)?);
        report::glb::encode(&mut out, &parts, origin, frame.up_world)?;
        std::io::Write::flush(&mut out)
    };
    match encode() {
        Err(error) if error.kind() == std::io::ErrorKind::FileTooLarge => {
            job.warn(format!("city.glb is left out: {error}; city.ply has everything"));
            fs::remove_file(path).with_context(|| format!("{}", path.display()))
        }
        done => done.with_context(|| format!("{}", path.display())),
    }
}

/// The same file under a second name, where the disk can do that.
fn link(from: &Path, to: &Path) -> Result<()> {
    if let Some(parent) = to.parent() {
        fs::create_dir_all(parent)?;
    }
    if fs::hard_link(from, to).is_err() {
        fs::copy(from, to).with_context(|| format!("{}", to.display()))?;
    }
    Ok(())
}
