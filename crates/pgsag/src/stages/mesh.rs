//! `mesh`: fused depth maps to surface, one cube of the city at a time inside bounded memory.

use std::cell::Cell;
use std::path::Path;

use anyhow::{Context as _, Result};
use glam::DVec3;
use pgsag_mesh::gaps::drop_wide;
use pgsag_mesh::{CellBox, DepthView, Lattice, MeshError, TsdfOptions, Volume, marching};
use pgsag_scene::files::ply::{read_mesh_from, write_mesh};
use pgsag_scene::{Map, Mesh};
use serde::{Deserialize, Serialize};

use super::config;
use super::fuse::{FusedView, fused_views, read_fused};
use super::group::{Extent, Groups};
use super::import::Imported;
use super::masks::instances_of;
use crate::config::Config;
use crate::lengths::Lengths;
use crate::photographs::{Photographs, training_camera};
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan};

/// How surface is taken from depth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceOptions {
    /// Distance between samples of the volume, in median local ground sampling distances of the training images.
    pub voxel_gsd: f64,
    /// The same in metres; 0: `voxel_gsd` decides.
    pub voxel_m: f64,
    /// Gaps of the surface up to this width are closed where no photograph sees past them, metres; 0: none.
    pub max_gap_m: f64,
    /// Side of a cube, voxels.
    pub tile_voxels: u32,
    /// The volume itself.
    pub tsdf: TsdfOptions,
}

impl Default for SurfaceOptions {
    fn default() -> Self {
        Self { voxel_gsd: 1.0, voxel_m: 0.0, max_gap_m: 8.0, tile_voxels: 1024, tsdf: TsdfOptions::default() }
    }
}

/// The surface of a cube.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface(pub Mesh);

impl Artifact for Surface {
    const FORMAT: &'static str = "pgsag-surface";
    const VERSION: u32 = 1;

    fn read(folder: &Path) -> Result<Self> {
        read_surface(&folder.join("surface.ply")).map(Self)
    }

    fn write(&self, folder: &Path) -> Result<()> {
        write_surface(&folder.join("surface.ply"), &self.0, &[])
    }
}

/// Reads a mesh file.
///
/// # Errors
/// Where it is damaged.
pub fn read_surface(path: &Path) -> Result<Mesh> {
    let mut file = std::fs::File::open(path).with_context(|| format!("{}", path.display()))?;
    let length = file.metadata().with_context(|| format!("{}", path.display()))?.len();
    Ok(read_mesh_from(&path.display().to_string(), &mut file, length)?)
}

/// Writes a mesh file.
///
/// # Errors
/// Where it cannot be written.
pub fn write_surface(path: &Path, mesh: &Mesh, comments: &[String]) -> Result<()> {
    let file = std::fs::File::create(path).with_context(|| format!("{}", path.display()))?;
    let mut out = std::io::BufWriter::new(file);
    write_mesh(&mut out, mesh, comments).with_context(|| format!("{}", path.display()))?;
    std::io::Write::flush(&mut out).with_context(|| format!("{}", path.display()))
}

/// The lattice that all cubes of a run share.
#[must_use]
pub fn lattice_of(extent: &Extent, config: &Config, metres_per_unit: Option<f64>) -> Lattice {
    let options = &config.surface;
    let voxel = match metres_per_unit {
        Some(scale) if options.voxel_m > 0.0 => options.voxel_m / scale,
        _ => options.voxel_gsd * extent.gsd,
    };
    Lattice { origin: extent.low, voxel }
}

/// A cube and the views that see surface in it.
struct Tile {
    name: String,
    region: CellBox,
    views: Vec<usize>,
}

/// The cubes with surface, in the order of the lattice.
fn tiles(extent: &Extent, lattice: &Lattice, config: &Config, views: &[FusedView]) -> Vec<Tile> {
    let everything = lattice.cells_covering(extent.low, extent.high);
    // Surface reaches this far beyond the pixels that made it.
    let reach = DVec3::splat((f64::from(config.surface.tsdf.front_voxels) + 8.0) * lattice.voxel);
    let touches = |region: &CellBox, view: &FusedView| {
        let (low, high) = (lattice.node(region.low) - reach, lattice.node(region.high) + reach);
        view.cubes.iter().any(|cube| {
            let (from, to) = extent.cube_box(*cube);
            from.cmple(high).all() && to.cmpge(low).all()
        })
    };
    let all = everything.tiles(config.surface.tile_voxels);
    let seen = all.into_iter().filter_map(|region| {
        let views: Vec<usize> =
            views.iter().filter(|view| touches(&region, view)).map(|view| view.view_index).collect();
        (!views.is_empty()).then_some((region, views))
    });
    seen.enumerate().map(|(number, (region, views))| Tile { name: format!("t{number:04}"), region, views }).collect()
}

fn tiles_of(run: &Run, config: &Config, imported: &Imported) -> Result<(Lattice, Vec<Tile>)> {
    let extent = Groups::read(&run.stage_folder("group"))?.extent;
    let lattice = lattice_of(&extent, config, imported.scene.frame.metres_per_unit);
    Ok((lattice, tiles(&extent, &lattice, config, &fused_views(run)?)))
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let config = config(run)?;
    let imported = Imported::read(&run.stage_folder("import"))?;
    let (_, tiles) = tiles_of(run, &config, &imported)?;
    let camera = |view: &pgsag_scene::View| training_camera(&view.camera, config.image_width).pixel_count() as u64;
    let pixels = imported.scene.views.iter().map(camera).max().unwrap_or(0);
    // A surface with facades crosses a cube about twice; each crossing is three blocks thick.
    let blocks = |region: &CellBox| {
        let side = |a: usize| u64::from(region.low[a].abs_diff(region.high[a])).div_ceil(8) + 1;
        6 * (side(0) * side(1)).max(side(1) * side(2)).max(side(2) * side(0))
    };
    let plan = |tile: Tile| JobPlan {
        cost: Cost {
            memory_bytes: (64 << 20) + 80 * pixels + (8256 * blocks(&tile.region)).min(config.surface.tsdf.max_bytes),
            disk_bytes: 8000 * blocks(&tile.region) / 6,
            cpu_secs: tile.views.len() as f64 * pixels as f64 * 2e-6,
        },
        name: tile.name,
        inputs: vec![("import", None), ("masks", None), ("group", Some("extent".into())), ("fuse", None)],
    };
    Ok(tiles.into_iter().map(plan).collect())
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let config = config(job.run)?;
    let imported: Imported = job.read("import")?;
    let (lattice, tiles) = tiles_of(job.run, &config, &imported)?;
    let tile = tiles.into_iter().find(|tile| tile.name == job.name).context("the cube is not there any more")?;
    let photographs = Photographs::new(&imported, &config, job, job.memory_bytes / 8);
    let scale = imported.scene.frame.metres_per_unit;
    job.measure("voxel", lattice.voxel);
    if job.name == "t0000" {
        let unit = if scale.is_some() { "scene units of known scale" } else { "scene units of unknown scale" };
        job.say(&format!("the volume is sampled every {:.4} {unit}", lattice.voxel));
    }
    let extent = Groups::read(&job.run.stage_folder("group"))?.extent;
    let everything = lattice.cells_covering(extent.low, extent.high);
    let cube = Cube { job, config: &config, imported: &imported, photographs: &photographs, lattice, everything };
    let mesh = cube.surface(tile.region, &tile.views)?;
    job.write(&Surface(mesh))
}

struct Cube<'a, 'j> {
    job: &'a Job<'j>,
    config: &'a Config,
    imported: &'a Imported,
    photographs: &'a Photographs,
    lattice: Lattice,
    /// All cubes together.
    everything: CellBox,
}

impl Cube<'_, '_> {
    /// The surface in a box, in halves where the volume would not fit.
    fn surface(&self, region: CellBox, views: &[usize]) -> Result<Mesh> {
        let max_bytes = self.config.surface.tsdf.max_bytes.min(self.job.memory_bytes / 2);
        let options = TsdfOptions { max_bytes, ..self.config.surface.tsdf };
        match self.volume(region, views, options) {
            Err(error) if matches!(error.downcast_ref(), Some(MeshError::Memory { .. })) => {
                let Some(halves) = halves(&region) else { return Err(error) };
                self.job.say("the cube is halved to fit into memory");
                let parts = halves.iter().map(|half| self.surface(*half, views)).collect::<Result<Vec<_>>>()?;
                Ok(pgsag_mesh::merge::merge(&parts))
            }
            other => other,
        }
    }

    fn volume(&self, region: CellBox, views: &[usize], options: TsdfOptions) -> Result<Mesh> {
        let rounds = self.gap_rounds();
        let mut volume = Volume::new(self.lattice, region, options)?;
        volume.follow_gaps(rounds);
        let total = u64::from(rounds + 3) * views.len() as u64;
        let told = Cell::new(0);
        let tell = || {
            self.job.advance(told.replace(told.get() + 1), total, "views");
            self.job.check()
        };
        for view in views {
            tell()?;
            let (depth, weight, _) = read_fused(&self.job.input("fuse"), *view)?;
            volume.reserve(&self.depth_view(*view, depth, weight, None))?;
        }
        for view in views {
            tell()?;
            let (depth, weight, _) = read_fused(&self.job.input("fuse"), *view)?;
            let image = self.photographs.whole(*view)?;
            volume.integrate(&self.depth_view(*view, depth, weight, Some(&image)))?;
        }
        for _ in 0..rounds {
            let Some(first) = volume.grow()? else { break };
            for view in views {
                tell()?;
                let (depth, weight, _) = read_fused(&self.job.input("fuse"), *view)?;
                volume.integrate_into(first, &self.depth_view(*view, depth, weight, None))?;
            }
        }
        let mut mesh = if rounds > 0 { marching::extract_closed(&volume) } else { marching::extract(&volume) };
        drop(volume);
        if rounds > 0 {
            mesh = drop_wide(mesh, self.gap_width(), |center| self.inset(region, center));
        }
        told.set(u64::from(rounds + 2) * views.len() as u64);
        let (mut ballot, mut identity) = (Ballot::new(&mesh), None::<Ballot>);
        for view in views {
            tell()?;
            let (depth, weight, group) = read_fused(&self.job.input("fuse"), *view)?;
            let tolerance = 3.0 * self.lattice.voxel;
            let seen = self.depth_view(*view, depth, weight, None);
            ballot.count(&seen, &group, tolerance);
            if let Some(numbers) = instances_of(&self.job.input("masks"), *view)? {
                identity.get_or_insert_with(|| Ballot::new(&mesh)).count(&seen, &numbers, tolerance);
            }
        }
        mesh.groups = ballot.winners();
        mesh.buildings = identity.map_or_else(Vec::new, |ballot| ballot.winners());
        Ok(mesh)
    }

    /// The widest gap that is closed, scene units.
    fn gap_width(&self) -> f64 {
        Lengths::of(&self.imported.scene).units(self.config.surface.max_gap_m)
    }

    /// How far a place inside `region` is from where another cube goes on, scene units.
    fn inset(&self, region: CellBox, at: DVec3) -> f64 {
        let at = self.lattice.to_voxels(at).to_array();
        let sides = (0..3).flat_map(|a| {
            let below = (region.low[a] > self.everything.low[a]).then(|| at[a] - f64::from(region.low[a]));
            let above = (region.high[a] < self.everything.high[a]).then(|| f64::from(region.high[a]) - at[a]);
            [below, above]
        });
        self.lattice.voxel * sides.flatten().fold(f64::INFINITY, f64::min)
    }

    /// How many blocks far a gap must be followed to tell whether it is narrow enough.
    fn gap_rounds(&self) -> u32 {
        let half = 0.5 * self.gap_width();
        if half > 0.0 { (half / (8.0 * self.lattice.voxel)).ceil().min(64.0) as u32 + 1 } else { 0 }
    }

    fn depth_view<'i>(
        &self,
        view_index: usize,
        depth: Map<f32>,
        weight: Map<f32>,
        color: Option<&'i pgsag_scene::Image>,
    ) -> DepthView<'i> {
        let camera = self.photographs.camera(view_index);
        let camera_from_world = self.imported.scene.views[view_index].camera_from_world;
        DepthView { camera, camera_from_world, depth, weight, normal: None, color }
    }
}

/// The box cut across its longest side at a multiple of a block; `None` where it is a single block.
fn halves(region: &CellBox) -> Option<[CellBox; 2]> {
    let length = |a: usize| region.high[a] - region.low[a];
    let axis = (0..3).max_by_key(|a| (length(*a), 2 - a))?;
    let middle = (region.low[axis] + length(axis) / 2).div_euclid(8) * 8;
    (middle > region.low[axis] && middle < region.high[axis]).then(|| {
        let (mut first, mut second) = (*region, *region);
        first.high[axis] = middle;
        second.low[axis] = middle;
        [first, second]
    })
}

/// Which group the views say that a face belongs to.
struct Ballot {
    centers: Vec<DVec3>,
    votes: Vec<Vec<(u16, f32)>>,
}

impl Ballot {
    fn new(mesh: &Mesh) -> Self {
        let center = |f: usize| mesh.triangle(f).iter().map(|p| DVec3::from_array(*p)).sum::<DVec3>() / 3.0;
        let centers: Vec<DVec3> = (0..mesh.faces.len()).map(center).collect();
        Self { votes: vec![Vec::new(); centers.len()], centers }
    }

    /// Counts the pixels at which a face's centre is seen, by their confidence.
    fn count(&mut self, view: &DepthView<'_>, group: &Map<u16>, tolerance: f64) {
        use rayon::prelude::*;
        self.centers.par_iter().zip(&mut self.votes).with_min_len(1024).for_each(|(center, votes)| {
            let seen = view.camera_from_world.transform_point(*center);
            let Some(at) = view.camera.project(seen).filter(|at| view.camera.contains(*at)) else { return };
            let (x, y) = (at.x as u32, at.y as u32);
            let depth = f64::from(view.depth.at(x, y));
            if depth > 0.0 && (depth - seen.z).abs() <= tolerance {
                let (number, weight) = (group.at(x, y), view.weight.at(x, y));
                match votes.iter_mut().find(|(known, _)| *known == number) {
                    Some((_, sum)) => *sum += weight,
                    None => votes.push((number, weight)),
                }
            }
        });
    }

    /// The number with the most votes, the lower one on a tie; 0 where nobody sees the face.
    fn winners(&self) -> Vec<u32> {
        let winner = |votes: &Vec<(u16, f32)>| {
            let best = votes.iter().max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
            best.map_or(0, |(number, _)| u32::from(*number))
        };
        self.votes.iter().map(winner).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_meet_at_a_block_and_cover_the_box() {
        let region = CellBox { low: [0, -16, 3], high: [64, 100, 40] };
        let [first, second] = halves(&region).expect("large enough");
        assert_eq!((first.high[1], second.low[1]), (40, 40));
        assert_eq!((first.low, second.high), (region.low, region.high));
        assert_eq!(halves(&CellBox { low: [0; 3], high: [8; 3] }), None);
    }

    #[test]
    fn unseen_faces_belong_to_the_background() {
        let ballot =
            Ballot { centers: Vec::new(), votes: vec![vec![], vec![(0, 1.0), (3, 2.0)], vec![(2, 1.0), (0, 1.0)]] };
        assert_eq!(ballot.winners(), [0, 3, 0]);
    }
}
