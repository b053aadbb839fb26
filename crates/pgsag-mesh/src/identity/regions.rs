//! Roofs as regions: plane cells of one hue grow together, then whole regions are compared along their borders.
//!
//! A cell that only just fits joins two roofs where every link between cells counts by itself; medians over a border and
//! over a region do not mind single cells.

use std::collections::BTreeMap;

use super::{Hue, Relief, RoofRules};
use crate::components::Sets;

/// Steps to the four neighbours.
pub(super) const BESIDE: [[i64; 2]; 4] = [[1, 0], [-1, 0], [0, 1], [0, -1]];
/// A cell begins a region where the hues about it differ by less than this part of the step that parts roofs.
const CORE_HUE: f64 = 0.4;
/// Roofs may be rougher than the rules have it by so many times what the smoothest quarter of all cells is.
const ROUGHNESS: f64 = 1.5;
/// Cells that begin a region, at least.
const CORE_CELLS: u32 = 10;
/// Cells from a border at which slopes are looked at, nearest first; the volume rounds a step over two of them.
const NEAR: [i64; 3] = [-2, -1, 0];
/// And beyond that, two cells farther than the first.
const FAR: i64 = -4;
/// Cells between the places that are compared.
const GAP: f64 = 5.0;

/// Roofs of a relief, by cell; numbers mean nothing but themselves.
pub(super) fn regions(relief: &Relief, rules: &RoofRules) -> Vec<u32> {
    let mut region = fragments(relief, rules);
    loop {
        let joined = alike(relief, rules, &region);
        if joined.is_empty() {
            return region;
        }
        region.iter_mut().for_each(|number| *number = *joined.get(number).unwrap_or(number));
    }
}

/// Regions of plane cells of one hue, grown to where they meet.
fn fragments(relief: &Relief, rules: &RoofRules) -> Vec<u32> {
    let bends: Vec<[f64; 2]> = (0..relief.keys.len()).map(|cell| bend(relief, cell)).collect();
    let mut heights: Vec<f64> = bends.iter().map(|bend| bend[0]).filter(|height| height.is_finite()).collect();
    heights.sort_by(f64::total_cmp);
    let flat = rules.flat + ROUGHNESS * heights.get(heights.len() / 4).copied().unwrap_or(0.0);
    let is_core: Vec<bool> =
        bends.iter().map(|[height, hue]| *height < flat && *hue < CORE_HUE * rules.hue_step).collect();
    let own = connected(relief, |cell| is_core[cell]);
    let (mut cells, mut is_wide) = (vec![0u32; own.len()], vec![false; own.len()]);
    for (cell, root) in own.iter().enumerate() {
        cells[*root as usize] += 1;
        let square = [[1, 0], [0, 1], [1, 1]].map(|step| relief.beside(relief.keys[cell], step, 1));
        // A ridge in the middle of cells is a plane row.
        is_wide[*root as usize] |= square.iter().all(|other| other.is_some_and(|other| own[other] == *root));
    }
    let is_region = |root: u32| is_wide[root as usize] && cells[root as usize] >= CORE_CELLS;
    let begins = |cell: usize| (is_core[cell] && is_region(own[cell])).then_some(own[cell]);
    let mut region: Vec<Option<u32>> = (0..own.len()).map(begins).collect();
    relief.grow(&mut region, |a, b| {
        (relief.tops[a] - relief.tops[b]).abs() / rules.step + distance(relief.hues[a], relief.hues[b]) / rules.hue_step
    });
    let rest = connected(relief, |cell| region[cell].is_none());
    region.into_iter().zip(rest).map(|(known, rest)| known.unwrap_or(rest)).collect()
}

/// Connected cells of those for which `is_in` holds; each of the others by itself.
fn connected(relief: &Relief, is_in: impl Fn(usize) -> bool) -> Vec<u32> {
    let mut sets = Sets::new(relief.keys.len());
    for (cell, at) in relief.keys.iter().enumerate().filter(|(cell, _)| is_in(*cell)) {
        for step in [BESIDE[0], BESIDE[2]] {
            if let Some(other) = relief.beside(*at, step, 1).filter(|other| is_in(*other)) {
                sets.join(cell as u32, other as u32);
            }
        }
    }
    (0..relief.keys.len() as u32).map(|cell| sets.find(cell)).collect()
}

/// How far the nine cells about one are from a plane, and how far their hues are apart; infinite where cells are missing.
fn bend(relief: &Relief, cell: usize) -> [f64; 2] {
    let at = relief.keys[cell];
    let mut around = [0; 9];
    for (k, found) in around.iter_mut().enumerate() {
        let Some(other) = relief.beside(at, [k as i64 / 3 - 1, k as i64 % 3 - 1], 1) else { return [f64::INFINITY; 2] };
        *found = other;
    }
    let top = |k: usize| relief.tops[around[k]];
    let mean = |places: [usize; 3]| places.iter().map(|k| top(*k)).sum::<f64>() / 3.0;
    let middle = (mean([0, 1, 2]) + mean([3, 4, 5]) + mean([6, 7, 8])) / 3.0;
    let slopes = [0.5 * (mean([6, 7, 8]) - mean([0, 1, 2])), 0.5 * (mean([2, 5, 8]) - mean([0, 3, 6]))];
    let plane =
        |k: usize| middle + slopes[0] * (k as f64 / 3.0).floor() - slopes[0] + slopes[1] * (k as f64 % 3.0 - 1.0);
    let height = (0..9).map(|k| (top(k) - plane(k)).abs()).fold(0.0, f64::max);
    let spread = |channel: usize| {
        let hues = around.map(|other| relief.hues[other][channel]);
        hues.iter().fold(f64::MIN, |a, b| a.max(*b)) - hues.iter().fold(f64::MAX, |a, b| a.min(*b))
    };
    [height, spread(0) + spread(1)]
}

/// Pairs of neighbouring regions that are of one roof, those most alike first and none twice: which becomes which.
fn alike(relief: &Relief, rules: &RoofRules, region: &[u32]) -> BTreeMap<u32, u32> {
    let hues = hues_of(relief, region);
    let mut pairs: Vec<(f64, u32, u32)> = Vec::new();
    for ((a, b), mut steps) in borders(relief, region) {
        let apart = (median(&mut steps).abs() / rules.step).max(distance(hues[&a], hues[&b]) / rules.hue_step);
        if apart < 1.0 {
            pairs.push((apart, a, b));
        }
    }
    pairs.sort_by(|x, y| x.0.total_cmp(&y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    let (mut joined, mut is_taken) = (BTreeMap::new(), std::collections::BTreeSet::new());
    for (_, a, b) in pairs {
        if !is_taken.contains(&a) && !is_taken.contains(&b) {
            is_taken.extend([a, b]);
            joined.insert(b, a);
        }
    }
    joined
}

/// Steps along the border of every two regions, from the lesser number to the greater.
fn borders(relief: &Relief, region: &[u32]) -> BTreeMap<(u32, u32), Vec<f64>> {
    let mut steps: BTreeMap<(u32, u32), Vec<f64>> = BTreeMap::new();
    for (cell, at) in relief.keys.iter().enumerate() {
        for step in [BESIDE[0], BESIDE[2]] {
            let Some(other) = relief.beside(*at, step, 1) else { continue };
            let (a, b) = (region[cell], region[other]);
            if a == b {
                continue;
            }
            let back = step.map(|k| -k);
            let beyond = relief.keys[other];
            let height = step_between(side(relief, region, *at, step), side(relief, region, beyond, back));
            let (key, height) = if a < b { ((a, b), height) } else { ((b, a), -height) };
            steps.entry(key).or_default().push(height);
        }
    }
    steps
}

/// Height of a region near its cell at a border, and its slope per cell towards the border along `step`.
fn side(relief: &Relief, region: &[u32], at: [i64; 2], step: [i64; 2]) -> (f64, Option<f64>) {
    let here = relief.beside(at, step, 0).unwrap_or_default();
    let own = |k: i64| relief.beside(at, step, k).filter(|cell| region[*cell] == region[here]);
    let near = NEAR.iter().find_map(|k| own(*k)).unwrap_or(here);
    let slope = own(NEAR[0]).zip(own(FAR)).map(|(near, far)| 0.5 * (relief.tops[near] - relief.tops[far]));
    (relief.tops[near], slope)
}

/// The step between two slopes: none where they meet between the two places, else the lesser of what is left at its
/// two ends. With one slope alone both sides have it.
fn step_between((here, before): (f64, Option<f64>), (there, after): (f64, Option<f64>)) -> f64 {
    // The other side's slope is towards the border too.
    let after = after.map(|slope| -slope);
    let (before, after) = (before.or(after).unwrap_or(0.0), after.or(before).unwrap_or(0.0));
    let (first, last) = (there - GAP * after - here, there - (here + GAP * before));
    let left = if first * last <= 0.0 { 0.0 } else { first.abs().min(last.abs()) };
    // At the rim of a roof the slope is that of the facade.
    left.min((there - here).abs()) * first.signum()
}

/// The middle hue of every region.
fn hues_of(relief: &Relief, region: &[u32]) -> BTreeMap<u32, Hue> {
    let mut hues: BTreeMap<u32, [Vec<f64>; 2]> = BTreeMap::new();
    for (cell, number) in region.iter().enumerate() {
        let lists = hues.entry(*number).or_default();
        lists.iter_mut().zip(relief.hues[cell]).for_each(|(list, hue)| list.push(hue));
    }
    hues.into_iter().map(|(number, mut lists)| (number, lists.each_mut().map(|list| median(list)))).collect()
}

fn distance(a: Hue, b: Hue) -> f64 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).abs()
}

/// The middle of some values, or of the two in the middle.
pub(super) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
}
