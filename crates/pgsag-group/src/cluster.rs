//! Building points to clusters that one worker can train: density clusters in plan view, cut where they exceed the
//! budget, merged where they are tiny. Paper 4.1, "building grouping".
//!
//! A cluster is a core that it owns and a halo of its neighbours' points; cores never overlap. Cuts are straight lines
//! in plan, where they cross the least building: gaps first, then height steps.

use std::collections::{BTreeMap, HashMap};

use glam::{DVec2, DVec3};
use pgsag_scene::numbers::median;

use crate::dbscan::{Neighborhoods, dbscan};
use crate::plan::PlanFrame;

/// Thinned points per neighbourhood radius: a neighbourhood holds at most about (2 × 6)² of them.
const THINNING: f64 = 6.0;
/// Share of a neighbourhood that must be covered by points for its middle to be core.
const CORE_SHARE: f64 = 0.3;
/// Spacings of points that a neighbourhood reaches, where nothing else is asked for.
const EPS_SPACINGS: f64 = 8.0;

/// What makes a cluster, in scene units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClusterRules {
    /// Radius of a neighbourhood.
    pub eps: f64,
    /// Points that a neighbourhood of a core point holds.
    pub min_neighbors: f64,
    /// Clusters with fewer points are merged with one within two `eps`, or are noise.
    pub min_points: usize,
    /// Clusters with more points are cut.
    pub max_points: usize,
    /// How far a part of a cut cluster sees into the others.
    pub halo: f64,
    /// Height difference that halves the cost of a cut.
    pub height_step: f64,
}

/// Density of points in plan view, and the radius and count that follow from it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Density {
    /// Points per unit of area, median over what is occupied.
    pub points_per_area: f64,
    /// Radius of a neighbourhood.
    pub eps: f64,
    /// Points that a neighbourhood of a core point holds.
    pub min_neighbors: f64,
}

impl Density {
    /// From the points: eight spacings, held between `low` and `high`; `eps` replaces it where given.
    #[must_use]
    pub fn measure(plan: &[DVec2], spacing: f64, [low, high]: [f64; 2], eps: Option<f64>) -> Self {
        let side = 3.0 * spacing;
        let mut counts: HashMap<[i64; 2], u32> = HashMap::new();
        for at in plan {
            *counts.entry(key(*at, side)).or_default() += 1;
        }
        let mut values: Vec<f64> = counts.into_values().map(f64::from).collect();
        let points_per_area = median(&mut values).unwrap_or(1.0) / (side * side);
        let eps = eps.unwrap_or_else(|| (EPS_SPACINGS / points_per_area.sqrt()).clamp(low, high));
        let min_neighbors = (CORE_SHARE * points_per_area * std::f64::consts::PI * eps * eps).max(1.0);
        Self { points_per_area, eps, min_neighbors }
    }
}

/// A unit of training in plan view. Indices are those of the caller's points.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Cluster {
    /// Points that it owns.
    pub core: Vec<u32>,
    /// Points of neighbouring parts of the same density cluster.
    pub halo: Vec<u32>,
}

/// How the points fell.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Clusters {
    /// The largest first.
    pub clusters: Vec<Cluster>,
    /// Points in no cluster.
    pub noise: Vec<u32>,
    /// Density clusters before merging and cutting.
    pub found: usize,
    /// Tiny clusters that went into another.
    pub merged: usize,
    /// Cuts made.
    pub cuts: usize,
}

/// Points of one small cell.
struct Cell {
    at: DVec2,
    top: f64,
    members: Vec<u32>,
}

/// Divides building points. `indices` name them in the caller's list.
#[must_use]
pub fn clusters(indices: &[u32], positions: &[DVec3], frame: &PlanFrame, rules: &ClusterRules) -> Clusters {
    let side = rules.eps / THINNING;
    let cells = thinned(indices, positions, frame, side);
    let places: Vec<DVec2> = cells.iter().map(|cell| cell.at).collect();
    let weights: Vec<f64> = cells.iter().map(|cell| cell.members.len() as f64).collect();
    let mut label = dbscan(&places, &weights, rules.eps, rules.min_neighbors);
    let found = label.iter().flatten().max().map_or(0, |last| *last as usize + 1);
    let merged = merge_tiny(&mut label, &places, &weights, rules);
    let mut parts: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    let mut noise = Vec::new();
    for (cell, label) in (0u32..).zip(&label) {
        match label {
            Some(label) => parts.entry(*label).or_default().push(cell),
            None => noise.extend(&cells[cell as usize].members),
        }
    }
    let mut result = Clusters { found, merged, ..Clusters::default() };
    let links = Links::new(&cells, side, rules.height_step);
    for whole in parts.into_values() {
        let mut pieces = Vec::new();
        links.cut(whole, rules.max_points, &mut pieces);
        result.cuts += pieces.len() - 1;
        result.clusters.extend(with_halos(&pieces, &cells, rules.halo));
    }
    noise.sort_unstable();
    result.noise = noise;
    result.clusters.sort_by(|a, b| b.core.len().cmp(&a.core.len()).then_with(|| a.core.first().cmp(&b.core.first())));
    result
}

fn key(at: DVec2, side: f64) -> [i64; 2] {
    [(at.x / side).floor() as i64, (at.y / side).floor() as i64]
}

fn thinned(indices: &[u32], positions: &[DVec3], frame: &PlanFrame, side: f64) -> Vec<Cell> {
    let mut cells: BTreeMap<[i64; 2], Cell> = BTreeMap::new();
    for &index in indices {
        let position = positions[index as usize];
        let (at, top) = (frame.plan(position), frame.height(position));
        let cell = cells.entry(key(at, side)).or_insert(Cell { at: DVec2::ZERO, top, members: Vec::new() });
        cell.at += at;
        cell.top = cell.top.max(top);
        cell.members.push(index);
    }
    let mut cells: Vec<Cell> = cells.into_values().collect();
    cells.iter_mut().for_each(|cell| cell.at /= cell.members.len() as f64);
    cells
}

/// Clusters below the least size join the nearest other within two `eps`; without one they are noise. How many joined.
fn merge_tiny(label: &mut [Option<u32>], places: &[DVec2], weights: &[f64], rules: &ClusterRules) -> usize {
    let mut sizes: BTreeMap<u32, f64> = BTreeMap::new();
    for (label, weight) in label.iter().zip(weights) {
        if let Some(label) = label {
            *sizes.entry(*label).or_default() += weight;
        }
    }
    let is_tiny = |label: u32| sizes[&label] < rules.min_points as f64;
    let around = Neighborhoods::new(places, 2.0 * rules.eps);
    let mut nearest: BTreeMap<u32, (f64, u32)> = BTreeMap::new();
    for (own, at) in label.iter().zip(places) {
        let Some(own) = own.filter(|own| is_tiny(*own)) else { continue };
        for (other, squared) in around.near(*at) {
            let Some(other) = label[other as usize].filter(|other| *other != own && !is_tiny(*other)) else { continue };
            let best = nearest.entry(own).or_insert((squared, other));
            if (squared, other) < *best {
                *best = (squared, other);
            }
        }
    }
    for own in label.iter_mut() {
        if let Some(tiny) = own.filter(|own| is_tiny(*own)) {
            *own = nearest.get(&tiny).map(|(_, other)| *other);
        }
    }
    nearest.len()
}

/// Directions of cuts that are tried.
const DIRECTIONS: u32 = 8;
/// Least share of the points on each side of a cut.
const MIN_SIDE: f64 = 0.25;

/// What touches what in plan, and how firmly.
struct Links<'a> {
    cells: &'a [Cell],
    side: f64,
    /// Cell, cell beside it, strength.
    beside: Vec<Vec<(u32, f64)>>,
}

impl<'a> Links<'a> {
    fn new(cells: &'a [Cell], side: f64, height_step: f64) -> Self {
        let index: HashMap<[i64; 2], u32> =
            (0u32..).zip(cells).map(|(number, cell)| (key(cell.at, side), number)).collect();
        let beside = |cell: &Cell| {
            let [x, y] = key(cell.at, side);
            let others = [[x + 1, y - 1], [x + 1, y], [x + 1, y + 1], [x, y + 1]];
            let strength = |other: u32| {
                let step = (cells[other as usize].top - cell.top) / height_step;
                (other, 1.0 / (1.0 + step * step))
            };
            others.iter().filter_map(|key| index.get(key)).map(|other| strength(*other)).collect()
        };
        Self { cells, side, beside: cells.iter().map(beside).collect() }
    }

    fn weight(&self, cells: &[u32]) -> usize {
        cells.iter().map(|cell| self.cells[*cell as usize].members.len()).sum()
    }

    /// Cuts until every piece has at most `max_points`; a piece of one cell is left as it is.
    fn cut(&self, whole: Vec<u32>, max_points: usize, pieces: &mut Vec<Vec<u32>>) {
        if self.weight(&whole) <= max_points || whole.len() < 2 {
            pieces.push(whole);
            return;
        }
        let (first, second) = self.halved(&whole);
        self.cut(first, max_points, pieces);
        self.cut(second, max_points, pieces);
    }

    /// The best of the straight cuts: little building crossed, sides of like size.
    fn halved(&self, whole: &[u32]) -> (Vec<u32>, Vec<u32>) {
        let mut is_member = vec![false; self.cells.len()];
        whole.iter().for_each(|cell| is_member[*cell as usize] = true);
        let mut best = (f64::INFINITY, DVec2::X, 0.0);
        for step in 0..DIRECTIONS {
            let angle = f64::from(step) * std::f64::consts::PI / f64::from(DIRECTIONS);
            let across = DVec2::new(libm::cos(angle), libm::sin(angle));
            let (cost, place) = self.best_place(whole, &is_member, across);
            if cost < best.0 {
                best = (cost, across, place);
            }
        }
        let (_, across, place) = best;
        let (first, second): (Vec<u32>, Vec<u32>) =
            whole.iter().partition(|cell| self.cells[**cell as usize].at.dot(across) < place);
        if first.is_empty() || second.is_empty() {
            let (a, b) = whole.split_at(whole.len() / 2);
            return (a.to_vec(), b.to_vec());
        }
        (first, second)
    }

    /// Along one direction: the strength of the links that a cut breaks, over how even the sides are.
    fn best_place(&self, whole: &[u32], is_member: &[bool], across: DVec2) -> (f64, f64) {
        let place = |cell: u32| self.cells[cell as usize].at.dot(across);
        let low = whole.iter().map(|cell| place(*cell)).fold(f64::INFINITY, f64::min);
        let bin = |at: f64| ((at - low) / self.side).max(0.0) as usize;
        let bins = whole.iter().map(|cell| bin(place(*cell))).max().unwrap_or(0) + 1;
        let (mut points, mut change) = (vec![0usize; bins], vec![0.0f64; bins + 1]);
        for &cell in whole {
            let own = bin(place(cell));
            points[own] += self.cells[cell as usize].members.len();
            for (other, strength) in self.beside[cell as usize].iter().filter(|(other, _)| is_member[*other as usize]) {
                let there = bin(place(*other));
                // The link is broken by every cut between its ends.
                change[own.min(there)] += strength;
                change[own.max(there)] -= strength;
            }
        }
        let total = points.iter().sum::<usize>() as f64;
        let (mut before, mut broken, mut best) = (0.0, 0.0, (f64::INFINITY, 0.0));
        for at in 0..bins - 1 {
            before += points[at] as f64;
            broken += change[at];
            let share = before / total;
            if (MIN_SIDE..=1.0 - MIN_SIDE).contains(&share) {
                let cost = (broken + 0.5) / (share * (1.0 - share));
                if cost < best.0 {
                    best = (cost, low + (at + 1) as f64 * self.side);
                }
            }
        }
        best
    }
}

/// The pieces of one density cluster, each with the points of the others that lie near it.
fn with_halos(pieces: &[Vec<u32>], cells: &[Cell], halo: f64) -> Vec<Cluster> {
    // Two rings of cells half a halo wide reach between one and one and a half halos.
    let side = 0.5 * halo;
    let mut owners: HashMap<[i64; 2], Vec<u32>> = HashMap::new();
    for (piece, members) in (0u32..).zip(pieces) {
        for cell in members {
            let owners = owners.entry(key(cells[*cell as usize].at, side)).or_default();
            if owners.last() != Some(&piece) {
                owners.push(piece);
            }
        }
    }
    let mut clusters = vec![Cluster::default(); pieces.len()];
    for (piece, members) in (0u32..).zip(pieces) {
        for cell in members {
            let cell = &cells[*cell as usize];
            clusters[piece as usize].core.extend(&cell.members);
            if pieces.len() == 1 || halo <= 0.0 {
                continue;
            }
            let [x, y] = key(cell.at, side);
            let rings = (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| [x + dx, y + dy]));
            let mut near: Vec<u32> = rings.filter_map(|key| owners.get(&key)).flatten().copied().collect();
            near.sort_unstable();
            near.dedup();
            for other in near.into_iter().filter(|other| *other != piece) {
                clusters[other as usize].halo.extend(&cell.members);
            }
        }
    }
    for cluster in &mut clusters {
        cluster.core.sort_unstable();
        cluster.halo.sort_unstable();
    }
    clusters
}

#[cfg(test)]
mod tests;
