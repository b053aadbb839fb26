//! Precision, recall, F1 and distances of a mesh against the truth (contract, section 5; method, section 4).

use std::collections::BTreeSet;

use glam::DVec3;
use pgsag_scene::Mesh;

use crate::error::MeshError;

mod align;
mod crop;
mod edges;
mod judge;
mod options;
mod panoptic;
mod picture;
mod pieces;
mod published;
mod sample;
mod stats;
mod surface;

pub use align::{Similarity, icp};
pub use options::{Align, BuildingScore, Distances, Protocol, Score, ScoreOptions, Spread, ThresholdScore, Truth};
pub use panoptic::{Panoptic, off_buildings, panoptic};
pub use picture::{distance_color, distances_from_mesh, distances_from_truth};

use crop::in_polygon;
use judge::Known;
use published::{Rules, smallest, truth_cloud};

pub(crate) use pieces::nearest;
pub(crate) use sample::Sampler;
pub(crate) use surface::{Cloud, Surface, Target, Walk, face_normal};

/// Scores `mesh` (scene units) against `truth`. `Score::inputs` is left empty for the caller.
///
/// # Errors
/// Options out of range; a truth without surface or points; samples too many to be meant.
pub fn score(mesh: &Mesh, truth: &Truth<'_>, options: &ScoreOptions) -> Result<Score, MeshError> {
    check(options)?;
    check_truth(truth)?;
    let known = Known::new(truth)?;
    let rules = match options.protocol {
        Protocol::Pgsag => Rules {
            thresholds_m: options.thresholds_m.clone(),
            spacing_m: options.spacing_m.unwrap_or_else(|| smallest(&options.thresholds_m) / 3.0),
            align: options.align,
        },
        _ => published::rules(mesh, truth, options)?,
    };
    let options = &ScoreOptions { thresholds_m: rules.thresholds_m.clone(), ..options.clone() };
    let motion = alignment(mesh, truth, &rules, options)?;
    let moved = motion
        .map(|motion| Mesh { vertices: mesh.vertices.iter().map(|v| motion.apply(*v)).collect(), ..mesh.clone() });
    let mesh = moved.as_ref().unwrap_or(mesh);
    let mut score = match options.protocol {
        Protocol::Pgsag => ours(mesh, truth, &known, &rules, options)?,
        _ => theirs(mesh, truth, &known, &rules, options)?,
    };
    score.alignment = motion.map(|motion| motion.matrix());
    note_sparse_truth(&mut score, &known, options);
    if mesh.faces.is_empty() {
        score.notes.push("the mesh has no faces".into());
    }
    Ok(score)
}

fn ours(
    mesh: &Mesh,
    truth: &Truth<'_>,
    known: &Known<'_>,
    rules: &Rules,
    options: &ScoreOptions,
) -> Result<Score, MeshError> {
    let (verdict, left_out) = judge::verdict(mesh, truth, known, rules.spacing_m / options.metres_per_unit, options)?;
    Ok(Score {
        protocol: options.protocol.name().into(),
        spacing_m: rules.spacing_m,
        scores: stats::rows(&verdict, options),
        accuracy_m: stats::distances(&verdict.accuracy, verdict.signed[0], options.mean_cap_m),
        completeness_m: stats::distances(&verdict.completeness, verdict.signed[1], options.mean_cap_m),
        per_building: stats::per_building(&verdict, options),
        left_out,
        panoptic: identity(mesh, truth, options),
        ..Score::default()
    })
}

/// Buildings told apart in plan view, where both sides know some; those without a visible point are not judged.
fn identity(mesh: &Mesh, truth: &Truth<'_>, options: &ScoreOptions) -> Option<Panoptic> {
    let (scene, seen) = match truth {
        Truth::Mesh(scene) => (scene, None),
        Truth::Folder { scene, building, .. } => (scene, Some(building.iter().copied().collect::<BTreeSet<u32>>())),
        Truth::Cloud(_) => return None,
    };
    let cell = options.plan_cell_m / options.metres_per_unit;
    let is_judged = |building: u32| seen.as_ref().is_none_or(|seen| seen.contains(&building));
    let up = DVec3::from(options.up);
    let found = match &options.crop {
        Some(area) => panoptic(&cropped(mesh, area), &cropped(scene, area), up, cell, is_judged)?,
        None => panoptic(mesh, scene, up, cell, is_judged)?,
    };
    Some(Panoptic { cell_m: options.plan_cell_m, ..found })
}

/// The faces whose centre lies in a polygon, with their buildings.
fn cropped(mesh: &Mesh, polygon: &[[f64; 2]]) -> Mesh {
    let is_inside = |face: &usize| {
        let middle = mesh.triangle(*face).map(DVec3::from).iter().sum::<DVec3>() / 3.0;
        in_polygon(polygon, middle.x, middle.y)
    };
    let kept: Vec<usize> = (0..mesh.faces.len()).filter(is_inside).collect();
    let buildings = kept.iter().filter_map(|face| mesh.buildings.get(*face).copied()).collect();
    let faces = kept.iter().map(|face| mesh.faces[*face]).collect();
    Mesh { vertices: mesh.vertices.clone(), faces, buildings, ..Mesh::default() }
}

/// One verdict per threshold, since the clouds are thinned to it; distances are those of the smallest.
fn theirs(
    mesh: &Mesh,
    truth: &Truth<'_>,
    known: &Known<'_>,
    rules: &Rules,
    options: &ScoreOptions,
) -> Result<Score, MeshError> {
    let mut score = Score { protocol: options.protocol.name().into(), spacing_m: rules.spacing_m, ..Score::default() };
    let first = smallest(&rules.thresholds_m);
    for &threshold_m in &rules.thresholds_m {
        let (verdict, left_out) = published::verdict(mesh, truth, known, rules, threshold_m, options)?;
        let one = ScoreOptions { thresholds_m: vec![threshold_m], ..options.clone() };
        score.scores.extend(stats::rows(&verdict, &one));
        if threshold_m <= first {
            score.accuracy_m = stats::distances(&verdict.accuracy, false, options.mean_cap_m);
            score.completeness_m = stats::distances(&verdict.completeness, false, options.mean_cap_m);
            score.left_out = left_out;
        }
    }
    Ok(score)
}

fn alignment(
    mesh: &Mesh,
    truth: &Truth<'_>,
    rules: &Rules,
    options: &ScoreOptions,
) -> Result<Option<Similarity>, MeshError> {
    if rules.align == Align::None || mesh.faces.is_empty() {
        return Ok(None);
    }
    let tau = smallest(&rules.thresholds_m) / options.metres_per_unit;
    let source = match options.protocol {
        Protocol::TanksAndTemples => mesh.vertices.clone(),
        _ => Sampler::new(mesh, 0.5 * tau, options.seed)?.points(),
    };
    let target = truth_cloud(truth, options)?;
    icp(&source, &target, tau, rules.align == Align::IcpScale).map(Some)
}

fn note_sparse_truth(score: &mut Score, known: &Known<'_>, options: &ScoreOptions) {
    let Known::Cloud(cloud) = known else { return };
    let spacing_m = mean_spacing(cloud) * options.metres_per_unit;
    score.truth_spacing_m = Some(spacing_m);
    for row in &mut score.scores {
        row.truth_too_sparse = spacing_m > 0.5 * row.threshold_m;
        if row.truth_too_sparse {
            score.notes.push(format!(
                "the truth's points are {spacing_m:.3} m apart: too sparse for the threshold of {} m",
                row.threshold_m
            ));
        }
    }
}

fn mean_spacing(cloud: &Cloud) -> f64 {
    let distances = cloud.neighbour_distances();
    distances.iter().sum::<f64>() / cloud.points().len().max(1) as f64
}

fn check(options: &ScoreOptions) -> Result<(), MeshError> {
    let bad = |name, value, allowed| Err(MeshError::Option { name, value, allowed });
    if options.thresholds_m.is_empty() {
        return bad("thresholds_m", f64::NAN, "at least one length");
    }
    let lengths = options.thresholds_m.iter().chain(&options.spacing_m);
    if let Some(value) = lengths.chain([&options.metres_per_unit]).find(|v| !(**v > 0.0 && v.is_finite())) {
        return bad("threshold, spacing or metres per unit", *value, "greater than 0");
    }
    match options.crop.as_ref().map(Vec::len) {
        Some(corners) if corners < 3 => bad("crop", corners as f64, "a polygon of three corners or more"),
        _ => Ok(()),
    }
}

fn check_truth(truth: &Truth<'_>) -> Result<(), MeshError> {
    let Truth::Folder { scene, visible, building } = truth else { return Ok(()) };
    let bad = |what: String, cure| Err(MeshError::Geometry { what, cure });
    if scene.buildings.len() != scene.faces.len() {
        return bad("the true scene's faces have no `building`".into(), "give scene.ply with the face property");
    }
    if visible.len() != building.len() {
        let what = format!("{} visible points but {} building numbers", visible.len(), building.len());
        return bad(what, "give visible.ply with the property `building`");
    }
    Ok(())
}

#[cfg(test)]
mod tests;
