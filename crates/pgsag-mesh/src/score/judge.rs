//! Our own protocol: every sample against the true surface, every true point against the mesh's surface.

use glam::DVec3;
use pgsag_scene::Mesh;
use rayon::prelude::*;

use super::crop::in_polygon;
use super::edges::Edges;
use super::options::{ScoreOptions, Truth};
use super::pieces::nearest;
use super::sample::Sampler;
use super::stats::{Judged, Part, Parts, Verdict};
use super::surface::{Cloud, Hit, Surface, Target, Walk};
use crate::error::MeshError;

/// Faces or points judged together.
const CHUNK: usize = 2048;
/// True points that are looked for on the mesh together.
const BATCH: usize = 1 << 21;
/// A true face is a facade where its normal is within 20 degrees of the horizontal.
const FACADE_MAX_UP: f64 = 0.342;

/// The truth, ready to be asked.
pub(crate) enum Known<'a> {
    Surface { mesh: &'a Mesh, surface: Box<Surface>, edges: Edges },
    Cloud(Cloud),
}

impl<'a> Known<'a> {
    pub(crate) fn new(truth: &Truth<'a>) -> Result<Self, MeshError> {
        match truth {
            Truth::Mesh(mesh) | Truth::Folder { scene: mesh, .. } => {
                Ok(Self::Surface { mesh, surface: Box::new(Surface::new(mesh, "the truth")?), edges: Edges::new(mesh) })
            }
            Truth::Cloud(points) => Ok(Self::Cloud(Cloud::new(points.to_vec(), "the truth")?)),
        }
    }

    pub(crate) fn target(&self) -> &dyn Target {
        match self {
            Self::Surface { surface, .. } => surface.as_ref(),
            Self::Cloud(cloud) => cloud,
        }
    }

    pub(crate) fn has_surface(&self) -> bool {
        matches!(self, Self::Surface { .. })
    }

    /// Building of what was hit; 0 where the truth knows none.
    pub(crate) fn building(&self, hit: &Hit) -> u32 {
        match self {
            Self::Surface { mesh, .. } => mesh.buildings.get(hit.index as usize).copied().unwrap_or(0),
            Self::Cloud(_) => 0,
        }
    }

    /// What part of the truth was hit.
    fn part(&self, hit: &Hit, options: &ScoreOptions) -> Part {
        let Self::Surface { surface, edges, .. } = self else { return Part::Whole };
        if edges.within(hit.place, options.edge_band_m / options.metres_per_unit) {
            return Part::Edge;
        }
        let up = DVec3::from(options.up).normalize_or(DVec3::Z);
        if surface.normal(hit.index).dot(up).abs() < FACADE_MAX_UP { Part::Facade } else { Part::Roof }
    }
}

/// Judges both directions; also how many samples were left out.
pub(crate) fn verdict(
    mesh: &Mesh,
    truth: &Truth<'_>,
    known: &Known<'_>,
    spacing: f64,
    options: &ScoreOptions,
) -> Result<(Verdict, u64), MeshError> {
    let only_buildings = matches!(truth, Truth::Folder { .. });
    let (accuracy, left_out) = accuracy(mesh, known, spacing, only_buildings, options)?;
    let (points, buildings) = truth_points(truth, spacing, options)?;
    let completeness = completeness(mesh, known, &points, &buildings, options);
    Ok((Verdict { accuracy, completeness, signed: [known.has_surface(), true] }, left_out))
}

fn judged(hit: &Hit, building: u32, part: Part, options: &ScoreOptions) -> Judged {
    let distance = hit.distance * options.metres_per_unit;
    Judged { distance_m: if hit.behind { -distance } else { distance } as f32, building, part }
}

fn inside(point: DVec3, options: &ScoreOptions) -> bool {
    options.crop.as_ref().is_none_or(|polygon| in_polygon(polygon, point.x, point.y))
}

fn accuracy(
    mesh: &Mesh,
    known: &Known<'_>,
    spacing: f64,
    only_buildings: bool,
    options: &ScoreOptions,
) -> Result<(Parts, u64), MeshError> {
    let sampler = Sampler::new(mesh, spacing, options.seed)?;
    let chunks = mesh.faces.len().div_ceil(CHUNK);
    let parts: Vec<(Vec<Judged>, u64)> = (0..chunks)
        .into_par_iter()
        .map(|chunk| {
            let mut walk = Walk::default();
            let (mut kept, mut left_out) = (Vec::new(), 0);
            for face in chunk * CHUNK..mesh.faces.len().min((chunk + 1) * CHUNK) {
                for point in sampler.of_face(face).filter(|point| inside(*point, options)) {
                    let Some(hit) = walk.nearest(known.target(), point) else { continue };
                    let building = known.building(&hit);
                    if only_buildings && building == 0 {
                        left_out += 1;
                        continue;
                    }
                    kept.push(judged(&hit, building, known.part(&hit, options), options));
                }
            }
            kept.shrink_to_fit();
            (kept, left_out)
        })
        .collect();
    let left_out = parts.iter().map(|part| part.1).sum();
    Ok((parts.into_iter().map(|part| part.0).collect(), left_out))
}

/// Where recall is judged, with buildings (empty where unknown).
pub(crate) fn truth_points(
    truth: &Truth<'_>,
    spacing: f64,
    options: &ScoreOptions,
) -> Result<(Vec<[f64; 3]>, Vec<u32>), MeshError> {
    let (points, buildings) = match truth {
        Truth::Cloud(points) => (points.to_vec(), Vec::new()),
        Truth::Folder { visible, building, .. } => (visible.to_vec(), building.to_vec()),
        Truth::Mesh(mesh) => {
            let sampler = Sampler::new(mesh, spacing, options.seed ^ 0x7E57)?;
            let mut points = Vec::with_capacity(sampler.total() as usize);
            let mut buildings = Vec::new();
            for face in 0..mesh.faces.len() {
                points.extend(sampler.of_face(face).map(<[f64; 3]>::from));
                if let Some(building) = mesh.buildings.get(face) {
                    buildings.resize(points.len(), *building);
                }
            }
            (points, buildings)
        }
    };
    let keep: Vec<bool> = points.iter().map(|p| inside(DVec3::from(*p), options)).collect();
    let mut at = keep.iter();
    let buildings = buildings.into_iter().filter(|_| at.next().is_some_and(|k| *k)).collect();
    let mut at = keep.iter();
    Ok((points.into_iter().filter(|_| at.next().is_some_and(|k| *k)).collect(), buildings))
}

fn completeness(
    mesh: &Mesh,
    known: &Known<'_>,
    points: &[[f64; 3]],
    buildings: &[u32],
    options: &ScoreOptions,
) -> Parts {
    let reach = options.mean_cap_m / options.metres_per_unit;
    let batch = |(number, batch): (usize, &[[f64; 3]])| {
        let places: Vec<DVec3> = batch.iter().map(|point| DVec3::from(*point)).collect();
        let hits = nearest(mesh, &places, reach, |_| f64::INFINITY);
        let first = number * BATCH;
        let part_of = |walk: &mut Walk, point: DVec3| {
            let hit = if known.has_surface() { walk.nearest(known.target(), point) } else { None };
            hit.map_or(Part::Whole, |hit| known.part(&hit, options))
        };
        let judged: Vec<Vec<Judged>> = places
            .par_chunks(CHUNK)
            .enumerate()
            .map(|(chunk, part)| {
                let mut walk = Walk::default();
                let one = |(at, point): (usize, &DVec3)| {
                    let at = chunk * CHUNK + at;
                    let building = buildings.get(first + at).copied().unwrap_or(0);
                    let part = part_of(&mut walk, *point);
                    // A mesh without surface misses every point, however far the threshold.
                    let nowhere = Judged { distance_m: f32::INFINITY, building, part };
                    hits[at].map_or(nowhere, |hit| judged(&hit, building, part, options))
                };
                part.iter().enumerate().map(one).collect()
            })
            .collect();
        judged
    };
    points.chunks(BATCH).enumerate().flat_map(batch).collect()
}
