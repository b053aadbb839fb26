//! Whether buildings are told apart as the truth tells them: panoptic quality in plan view, and how much of what a group
//! begins with lies on no building at all.
//!
//! Every cell of plan view belongs to the building whose surface is highest there. A found and a true building match where
//! the cells that they share are more than half of those that either has; then no other pair can match.

use std::collections::{BTreeMap, BTreeSet};

use glam::DVec3;
use pgsag_scene::Mesh;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::judge::Known;
use super::options::Truth;
use super::surface::Walk;

/// Matches share more than this part of their union.
const MATCH_IOU: f64 = 0.5;
/// Samples that are kept before they are thinned to one per cell.
const MAX_SAMPLES: usize = 1 << 20;
/// Points judged together.
const CHUNK: usize = 2048;

/// How well found buildings are those of the truth. Kirillov et al., Panoptic Segmentation, 2019: quality = recognition x
/// segmentation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Panoptic {
    /// Side of a cell of plan view, metres.
    pub cell_m: f64,
    /// Buildings of the mesh.
    pub found: usize,
    /// Buildings of the truth.
    pub truth: usize,
    /// Pairs that share more than half of their union.
    pub matched: usize,
    /// Sum of the matches' shares over the mean of found and true buildings.
    pub quality: f64,
    /// Matches over the mean of found and true buildings.
    pub recognition: f64,
    /// Mean share of the matches.
    pub segmentation: f64,
}

/// Cells of plan view and whose they are.
type Plan = BTreeMap<[i64; 2], u32>;

/// Compares the buildings of two meshes (face property `buildings`, 0: none) in plan view across `up`, in cells of side
/// `cell` scene units. True buildings for which `is_judged` does not hold are nobody's: what was found over them neither
/// helps nor harms. `None` where either mesh knows no buildings.
pub fn panoptic(found: &Mesh, truth: &Mesh, up: DVec3, cell: f64, is_judged: impl Fn(u32) -> bool) -> Option<Panoptic> {
    let knows = |mesh: &Mesh| mesh.buildings.len() == mesh.faces.len() && mesh.buildings.iter().any(|b| *b > 0);
    if !(knows(found) && knows(truth) && cell > 0.0 && cell.is_finite()) {
        return None;
    }
    let (mut found, mut truth) = (plan(found, up, cell), plan(truth, up, cell));
    let void: BTreeSet<[i64; 2]> =
        truth.iter().filter(|(_, building)| !is_judged(**building)).map(|(key, _)| *key).collect();
    found.retain(|key, _| !void.contains(key));
    truth.retain(|key, _| !void.contains(key));
    let (own, theirs) = (areas(&found), areas(&truth));
    let mut shared: BTreeMap<(u32, u32), usize> = BTreeMap::new();
    for (key, building) in &found {
        if let Some(other) = truth.get(key) {
            *shared.entry((*building, *other)).or_default() += 1;
        }
    }
    let iou = |(&(a, b), &both): (&(u32, u32), &usize)| both as f64 / (own[&a] + theirs[&b] - both) as f64;
    let matches: Vec<f64> = shared.iter().map(iou).filter(|iou| *iou > MATCH_IOU).collect();
    let sum: f64 = matches.iter().sum();
    let mean_count = (0.5 * (own.len() + theirs.len()) as f64).max(0.5);
    Some(Panoptic {
        cell_m: cell,
        found: own.len(),
        truth: theirs.len(),
        matched: matches.len(),
        quality: sum / mean_count,
        recognition: matches.len() as f64 / mean_count,
        segmentation: sum / matches.len().max(1) as f64,
    })
}

/// Share of the points whose nearest true surface is no building; `None` without points, or where the truth knows no
/// buildings.
#[must_use]
pub fn off_buildings(points: &[DVec3], truth: &Truth<'_>) -> Option<f64> {
    let known = Known::new(truth).ok().filter(Known::has_surface)?;
    let off = |part: &[DVec3]| {
        let mut walk = Walk::default();
        let is_off = |point: &&DVec3| walk.nearest(known.target(), **point).is_none_or(|hit| known.building(&hit) == 0);
        part.iter().filter(is_off).count()
    };
    let count: usize = points.par_chunks(CHUNK).map(off).sum();
    (!points.is_empty()).then(|| count as f64 / points.len() as f64)
}

fn areas(plan: &Plan) -> BTreeMap<u32, usize> {
    let mut areas = BTreeMap::new();
    plan.values().for_each(|building| *areas.entry(*building).or_default() += 1);
    areas
}

/// The building of the highest face of a building over every cell.
fn plan(mesh: &Mesh, up: DVec3, cell: f64) -> Plan {
    let up = up.normalize_or(DVec3::Z);
    let (east, north) = up.any_orthonormal_pair();
    let mut samples: Vec<([i64; 2], f64, u32)> = Vec::new();
    for face in (0..mesh.faces.len()).filter(|face| mesh.buildings[*face] > 0) {
        let [a, b, c] = mesh.triangle(face).map(DVec3::from);
        let steps = ((b - a).length().max((c - a).length()) / (0.5 * cell)).ceil().clamp(1.0, 4096.0) as i32;
        for i in 0..=steps {
            for j in 0..=steps - i {
                let at = a + ((b - a) * f64::from(i) + (c - a) * f64::from(j)) / f64::from(steps);
                let key = [at.dot(east), at.dot(north)].map(|along| (along / cell).floor() as i64);
                samples.push((key, at.dot(up), mesh.buildings[face]));
            }
        }
        if samples.len() > MAX_SAMPLES {
            highest(&mut samples);
        }
    }
    highest(&mut samples);
    samples.into_iter().map(|(key, _, building)| (key, building)).collect()
}

/// One sample per cell, the highest; of two at one height the smaller number.
fn highest(samples: &mut Vec<([i64; 2], f64, u32)>) {
    samples.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)).then(a.2.cmp(&b.2)));
    samples.dedup_by_key(|sample| sample.0);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Flat roofs: x from, x to, building; 10 deep, 3 high.
    fn roofs(of: &[(f64, f64, u32)]) -> Mesh {
        let mut mesh = Mesh::default();
        for (x0, x1, building) in of {
            let first = mesh.vertices.len() as u32;
            mesh.vertices.extend([[*x0, 0.1, 3.0], [*x1, 0.1, 3.0], [*x1, 9.9, 3.0], [*x0, 9.9, 3.0]]);
            mesh.faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            mesh.buildings.extend([*building; 2]);
        }
        mesh
    }

    fn judged(found: &Mesh, truth: &Mesh) -> Panoptic {
        panoptic(found, truth, DVec3::Z, 0.25, |_| true).expect("buildings")
    }

    #[test]
    fn the_same_houses_under_other_numbers_are_perfect() {
        let truth = roofs(&[(0.1, 9.9, 1), (10.1, 19.9, 2), (30.1, 39.9, 3), (50.0, 60.0, 0)]);
        let found = roofs(&[(0.1, 9.9, 7), (10.1, 19.9, 9), (30.1, 39.9, 1)]);
        let score = judged(&found, &truth);
        assert_eq!((score.found, score.truth, score.matched), (3, 3, 3));
        assert_eq!((score.quality, score.recognition, score.segmentation), (1.0, 1.0, 1.0));
    }

    #[test]
    fn two_houses_in_one_are_no_match_and_a_short_one_counts_less() {
        let truth = roofs(&[(0.1, 9.9, 1), (10.1, 19.9, 2), (30.1, 39.9, 3)]);
        // The first two as one, a quarter of the third missing, one that is not there.
        let found = roofs(&[(0.1, 19.9, 1), (30.1, 37.4, 2), (80.1, 82.4, 3)]);
        let score = judged(&found, &truth);
        assert_eq!(score.matched, 1);
        assert!((score.segmentation - 0.75).abs() < 1e-9, "{score:?}");
        assert!((score.recognition - 1.0 / 3.0).abs() < 1e-9 && (score.quality - 0.25).abs() < 1e-9, "{score:?}");
    }

    #[test]
    fn houses_that_nobody_saw_are_not_judged() {
        let truth = roofs(&[(0.1, 9.9, 1), (30.1, 39.9, 2)]);
        let found = roofs(&[(0.1, 9.9, 1), (30.1, 34.4, 2)]);
        let score = panoptic(&found, &truth, DVec3::Z, 0.25, |building| building == 1).expect("buildings");
        assert_eq!((score.found, score.truth, score.quality), (1, 1, 1.0));
        assert_eq!(panoptic(&Mesh::default(), &truth, DVec3::Z, 0.25, |_| true), None);
    }

    #[test]
    fn points_over_the_garden_are_off() {
        let truth = roofs(&[(0.0, 10.0, 1), (10.0, 20.0, 0)]);
        let points: Vec<DVec3> = (0..20).map(|i| DVec3::new(f64::from(i) + 0.5, 5.0, 3.1)).collect();
        assert_eq!(off_buildings(&points, &Truth::Mesh(&truth)), Some(0.5));
        assert_eq!(off_buildings(&[], &Truth::Mesh(&truth)), None);
    }
}
