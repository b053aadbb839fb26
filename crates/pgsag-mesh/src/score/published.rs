//! The protocols of others, as published: clouds against clouds, thinned on a grid (method, section 4).

use glam::DVec3;
use pgsag_scene::Mesh;
use rayon::prelude::*;

use super::crop::{in_polygon, thinned};
use super::judge::{Known, truth_points};
use super::options::{Align, Protocol, ScoreOptions, Truth};
use super::sample::{Sampler, area};
use super::stats::{Judged, Part, Verdict};
use super::surface::{Cloud, Target};
use crate::error::MeshError;

/// Both PG-SAG's sampling and GauU-Scene's truth are thinned to this, metres.
const TRUTH_SPACING_M: f64 = 0.35;
/// PG-SAG's threshold, metres.
const PG_SAG_THRESHOLD_M: f64 = 0.6;

/// What a protocol fixes, metres.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Rules {
    pub thresholds_m: Vec<f64>,
    pub spacing_m: f64,
    pub align: Align,
}

/// The rules of a protocol for a truth.
pub(crate) fn rules(mesh: &Mesh, truth: &Truth<'_>, options: &ScoreOptions) -> Result<Rules, MeshError> {
    let scale = options.metres_per_unit;
    Ok(match options.protocol {
        Protocol::PgSag => {
            Rules { thresholds_m: vec![PG_SAG_THRESHOLD_M], spacing_m: TRUTH_SPACING_M, align: options.align }
        }
        Protocol::CitygsV2 => {
            let cloud = truth_cloud(truth, options)?;
            let distances = Cloud::new(thinned(&cloud, TRUTH_SPACING_M / scale), "the truth")?.neighbour_distances();
            let mean = distances.iter().sum::<f64>() / distances.len().max(1) as f64;
            let surface: f64 = (0..mesh.faces.len()).map(|f| area(mesh, f)).sum();
            let count = (mesh.vertices.len() + mesh.faces.len()).max(1) as f64;
            let (threshold, spacing_m) = (1.5 * mean * scale, (surface / count).sqrt() * scale);
            Rules { thresholds_m: vec![threshold], spacing_m, align: Align::IcpScale }
        }
        Protocol::TanksAndTemples | Protocol::Pgsag => Rules {
            thresholds_m: options.thresholds_m.clone(),
            spacing_m: smallest(&options.thresholds_m) / 2.0,
            align: Align::IcpScale,
        },
    })
}

pub(crate) fn smallest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

/// The truth as points: of a mesh, samples half as far apart as what it is thinned to.
pub(crate) fn truth_cloud(truth: &Truth<'_>, options: &ScoreOptions) -> Result<Vec<[f64; 3]>, MeshError> {
    let fine = match options.protocol {
        Protocol::TanksAndTemples | Protocol::Pgsag => smallest(&options.thresholds_m) / 4.0,
        Protocol::PgSag | Protocol::CitygsV2 => TRUTH_SPACING_M / 2.0,
    };
    let uncropped = ScoreOptions { crop: None, ..options.clone() };
    Ok(truth_points(truth, fine / options.metres_per_unit, &uncropped)?.0)
}

/// Judges one threshold. `mesh` is aligned already.
pub(crate) fn verdict(
    mesh: &Mesh,
    truth: &Truth<'_>,
    known: &Known<'_>,
    rules: &Rules,
    threshold_m: f64,
    options: &ScoreOptions,
) -> Result<(Verdict, u64), MeshError> {
    let scale = options.metres_per_unit;
    let mut samples = match options.protocol {
        Protocol::TanksAndTemples => mesh.vertices.clone(),
        _ => Sampler::new(mesh, rules.spacing_m / scale, options.seed)?.points(),
    };
    let mut points = truth_cloud(truth, options)?;
    if options.protocol == Protocol::CitygsV2 {
        points = thinned(&points, TRUTH_SPACING_M / scale);
    }
    let height = |p: &[f64; 3]| DVec3::from(*p).dot(DVec3::from(options.up));
    if let Some(polygon) = &options.crop {
        let range = points.iter().map(height).fold((f64::INFINITY, f64::NEG_INFINITY), |r, h| (r.0.min(h), r.1.max(h)));
        let inside = |p: &[f64; 3]| in_polygon(polygon, p[0], p[1]) && height(p) >= range.0 && height(p) <= range.1;
        samples.retain(inside);
        points.retain(inside);
    }
    let before = samples.len();
    if matches!(truth, Truth::Folder { .. }) {
        let near = |p: &[f64; 3]| known.target().nearest_within((*p).into(), f64::MAX);
        let houses: Vec<bool> =
            samples.par_iter().map(|p| near(p).is_some_and(|hit| known.building(&hit) != 0)).collect();
        let mut house = houses.iter();
        samples.retain(|_| house.next().is_some_and(|h| *h));
    }
    let left_out = (before - samples.len()) as u64;
    let voxel = match options.protocol {
        Protocol::PgSag => TRUTH_SPACING_M,
        _ => threshold_m / 2.0,
    } / scale;
    let (samples, points) = (thinned(&samples, voxel), thinned(&points, voxel));
    let verdict = Verdict {
        accuracy: vec![judged(&samples, &points, scale)],
        completeness: vec![judged(&points, &samples, scale)],
        signed: [false, false],
    };
    Ok((verdict, left_out))
}

fn judged(from: &[[f64; 3]], to: &[[f64; 3]], scale: f64) -> Vec<Judged> {
    let target = Cloud::new(to.to_vec(), "the other side").ok();
    from.par_iter()
        .map(|point| {
            let hit = target.as_ref().and_then(|target| target.nearest_within((*point).into(), f64::MAX));
            let distance_m = hit.map_or(f32::INFINITY, |hit| (hit.distance * scale) as f32);
            Judged { distance_m, building: 0, part: Part::Whole }
        })
        .collect()
}
