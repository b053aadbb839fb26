//! Roof edges, looked at from straight above: over how long a way does the height fall from roof to ground?
//!
//! Seen from above a facade has no width, and a skirt of smeared depth has all of its own: the relief of the highest
//! surface steps at a clean edge and slopes at a blurred one.

use std::collections::BTreeMap;

use glam::{DVec2, DVec3};
use pgsag_scene::Mesh;
use pgsag_scene::numbers::quantile;
use rayon::prelude::*;

use super::StructureOptions;

/// Cells of the relief per ground sampling distance.
const CELLS_PER_GSD: f64 = 2.0;
/// The relief of one building never has more cells; larger ones are looked at more coarsely.
const MAX_CELLS: f64 = 4e6;
/// At most so many edges are read per building.
const MAX_PROFILES: usize = 2000;
/// Side of the buckets of plan view in which faces find the buildings near them, in profiles.
const BUCKET_PROFILES: f64 = 4.0;
/// Buckets of a face that is looked up bucket by bucket.
const MANY: usize = 64;
/// Building surface covers this much of a disc about a straight edge; corners and narrow parts are left out.
const STRAIGHT: std::ops::RangeInclusive<f64> = 0.4..=0.6;
/// Radius of that disc, cells.
const DISC: i64 = 8;
/// Roof and ground are read beyond this share of the profile from the edge.
const PLATEAU: f64 = 0.5;
/// A plateau that strays from its line by more than this share of the fall is none.
const MAX_STRAY: f64 = 0.1;

/// How wide the roof edges of a building are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeWidths {
    /// Which.
    pub building: u32,
    /// Edges that were read.
    pub count: u64,
    /// Median way from 90 % to 10 % of the fall, scene units. What is sharper than a cell, half a ground sampling
    /// distance, reads as that.
    pub median: f64,
    /// 90 % are narrower, scene units.
    pub p90: f64,
}

/// Per building with any edge that can be read, in the order of their numbers.
#[must_use]
pub fn edge_widths(mesh: &Mesh, up: DVec3, gsd: f64, options: &StructureOptions) -> Vec<EdgeWidths> {
    if !(gsd > 0.0 && gsd.is_finite()) {
        return Vec::new();
    }
    let up = up.normalize_or(DVec3::Z);
    let (east, north) = up.any_orthonormal_pair();
    let flat = |v: [f64; 3]| [DVec3::from(v).dot(east), DVec3::from(v).dot(north), DVec3::from(v).dot(up)];
    let lots = lots(mesh, &flat, options.profile_gsd * gsd);
    lots.into_par_iter().filter_map(|lot| lot.relief(mesh, &flat, gsd).widths(gsd, options)).collect()
}

/// A building's rectangle in plan view, and the faces in or near it.
struct Lot {
    building: u32,
    low: DVec2,
    high: DVec2,
    faces: Vec<u32>,
}

/// The buildings with their faces and those near them.
fn lots(mesh: &Mesh, flat: &impl Fn([f64; 3]) -> [f64; 3], margin: f64) -> Vec<Lot> {
    let bounds = |face: usize| {
        let corners = mesh.triangle(face).map(|v| DVec2::from_slice(&flat(v)[..2]));
        (corners[0].min(corners[1]).min(corners[2]), corners[0].max(corners[1]).max(corners[2]))
    };
    let mut lots: BTreeMap<u32, Lot> = BTreeMap::new();
    for (face, building) in mesh.buildings.iter().enumerate().filter(|(_, building)| **building != 0) {
        let (low, high) = bounds(face);
        if !(low.is_finite() && high.is_finite()) {
            continue;
        }
        let lot = lots.entry(*building).or_insert(Lot { building: *building, low, high, faces: Vec::new() });
        (lot.low, lot.high) = (lot.low.min(low), lot.high.max(high));
    }
    let mut lots: Vec<Lot> = lots.into_values().collect();
    let bucket = BUCKET_PROFILES * margin;
    let buckets = |low: DVec2, high: DVec2| {
        let (low, high) = ((low / bucket).floor().as_i64vec2(), (high / bucket).floor().as_i64vec2());
        (low.x..=high.x).flat_map(move |x| (low.y..=high.y).map(move |y| [x, y]))
    };
    let mut near: BTreeMap<[i64; 2], Vec<u32>> = BTreeMap::new();
    for (number, lot) in lots.iter_mut().enumerate() {
        (lot.low, lot.high) = (lot.low - margin, lot.high + margin);
        for key in buckets(lot.low, lot.high) {
            near.entry(key).or_default().push(number as u32);
        }
    }
    for face in 0..mesh.faces.len() {
        let (low, high) = bounds(face);
        if !(low.is_finite() && high.is_finite()) {
            continue;
        }
        // Faces of a tidy mesh lie in a bucket or two; one that lies in very many is asked of every lot.
        let mut met: Vec<u32> =
            buckets(low, high).take(MANY).flat_map(|key| near.get(&key)).flatten().copied().collect();
        if buckets(low, high).nth(MANY).is_some() {
            met = (0..lots.len() as u32).collect();
        }
        met.sort_unstable();
        met.dedup();
        for number in met {
            let lot = &mut lots[number as usize];
            if low.cmple(lot.high).all() && high.cmpge(lot.low).all() {
                lot.faces.push(face as u32);
            }
        }
    }
    lots
}

/// The highest surface over a lot, cell by cell.
struct Relief {
    building: u32,
    cell: f64,
    width: i64,
    height: i64,
    /// Height, or NaN where nothing is.
    tops: Vec<f32>,
    is_building: Vec<bool>,
}

impl Lot {
    fn relief(&self, mesh: &Mesh, flat: &impl Fn([f64; 3]) -> [f64; 3], gsd: f64) -> Relief {
        let size = self.high - self.low;
        let cell = (gsd / CELLS_PER_GSD).max((size.x * size.y / MAX_CELLS).sqrt());
        let (width, height) = ((size.x / cell).ceil() as i64 + 1, (size.y / cell).ceil() as i64 + 1);
        let count = (width * height) as usize;
        let (mut tops, mut is_building) = (vec![f32::NAN; count], vec![false; count]);
        for face in &self.faces {
            let corners = mesh.triangle(*face as usize).map(flat);
            let plan = corners.map(|c| (DVec2::new(c[0], c[1]) - self.low) / cell);
            let area = (plan[1] - plan[0]).perp_dot(plan[2] - plan[0]);
            if area == 0.0 || !area.is_finite() {
                continue;
            }
            let low = plan[0].min(plan[1]).min(plan[2]);
            let high = plan[0].max(plan[1]).max(plan[2]);
            let rows = (low.y.floor() as i64).max(0)..=(high.y as i64).min(height - 1);
            for (y, x) in
                rows.flat_map(|y| ((low.x.floor() as i64).max(0)..=(high.x as i64).min(width - 1)).map(move |x| (y, x)))
            {
                let at = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let share = |k: usize| {
                    let (p, q) = (plan[(k + 1) % 3], plan[(k + 2) % 3]);
                    (q - p).perp_dot(at - p) / area
                };
                let shares = [share(0), share(1), share(2)];
                if shares.iter().any(|share| *share < -1e-9) {
                    continue;
                }
                let top = (0..3).map(|k| shares[k] * corners[k][2]).sum::<f64>() as f32;
                let place = (y * width + x) as usize;
                // NaN gives way to everything.
                if tops[place].is_nan() || top > tops[place] {
                    tops[place] = top;
                    is_building[place] = mesh.buildings[*face as usize] == self.building;
                }
            }
        }
        Relief { building: self.building, cell, width, height, tops, is_building }
    }
}

impl Relief {
    fn at(&self, x: i64, y: i64) -> Option<usize> {
        (x >= 0 && y >= 0 && x < self.width && y < self.height).then(|| (y * self.width + x) as usize)
    }

    fn holds(&self, x: i64, y: i64) -> bool {
        self.at(x, y).is_some_and(|place| self.is_building[place])
    }

    fn widths(&self, gsd: f64, options: &StructureOptions) -> Option<EdgeWidths> {
        let is_outline = |x: i64, y: i64| {
            self.holds(x, y) && [(1, 0), (-1, 0), (0, 1), (0, -1)].iter().any(|(dx, dy)| !self.holds(x + dx, y + dy))
        };
        let outline: Vec<(i64, i64)> = (0..self.height)
            .flat_map(|y| (0..self.width).map(move |x| (x, y)))
            .filter(|(x, y)| is_outline(*x, *y))
            .collect();
        let step = outline.len().div_ceil(MAX_PROFILES).max(1);
        let mut found: Vec<f64> = outline
            .iter()
            .step_by(step)
            .filter_map(|(x, y)| {
                let outward = self.outward(*x, *y)?;
                let start = DVec2::new(*x as f64 + 0.5, *y as f64 + 0.5);
                self.profile(start, outward, gsd, options)
            })
            .collect();
        let count = found.len() as u64;
        let (median, p90) = (quantile(&mut found, 0.5)?, quantile(&mut found, 0.9)?);
        Some(EdgeWidths { building: self.building, count, median, p90 })
    }

    /// Away from the building, where its outline is straight.
    fn outward(&self, x: i64, y: i64) -> Option<DVec2> {
        let (mut inward, mut inside, mut all) = (DVec2::ZERO, 0.0, 0.0);
        for dy in -DISC..=DISC {
            for dx in (-DISC..=DISC).filter(|dx| dx * dx + dy * dy <= DISC * DISC) {
                all += 1.0;
                if self.holds(x + dx, y + dy) {
                    inside += 1.0;
                    inward += DVec2::new(dx as f64, dy as f64);
                }
            }
        }
        STRAIGHT.contains(&(inside / all)).then(|| -inward.normalize_or_zero()).filter(|d| *d != DVec2::ZERO)
    }

    /// Way from 90 % to 10 % of the fall along a line across the outline, scene units; `None` where there is no clean one.
    fn profile(&self, start: DVec2, outward: DVec2, gsd: f64, options: &StructureOptions) -> Option<f64> {
        let reach = options.profile_gsd * gsd / self.cell;
        let half = reach.floor() as i64;
        let height = |s: f64| {
            let at = start + outward * s;
            self.at(at.x.floor() as i64, at.y.floor() as i64).map_or(f64::NAN, |place| f64::from(self.tops[place]))
        };
        let samples: Vec<[f64; 2]> = (-2 * half..=2 * half).map(|k| 0.5 * k as f64).map(|s| [s, height(s)]).collect();
        let part = |keep: &dyn Fn(f64) -> bool| -> Vec<[f64; 2]> {
            samples.iter().filter(|s| keep(s[0]) && !s[1].is_nan()).copied().collect()
        };
        let wanted = (PLATEAU * reach) as usize;
        let roof = part(&|s| s < -PLATEAU * reach);
        let ground = part(&|s| s > PLATEAU * reach);
        if roof.len() < wanted || ground.len() < wanted {
            return None;
        }
        let (roof, stray) = straight(&roof)?;
        let mut heights: Vec<f64> = ground.iter().map(|s| s[1]).collect();
        let low = quantile(&mut heights, 0.5)?;
        let fall = roof(0.0) - low;
        let mut off: Vec<f64> = heights.iter().map(|h| (h - low).abs()).collect();
        let is_clean = stray <= MAX_STRAY * fall && quantile(&mut off, 0.9)? <= MAX_STRAY * fall;
        if fall < options.min_drop_gsd * gsd || !is_clean {
            return None;
        }
        // Holes are where nothing holds the roof up.
        let share = |s: &[f64; 2]| if s[1].is_nan() { 0.0 } else { (s[1] - low) / (roof(s[0]) - low) };
        let low_at = samples.iter().position(|s| share(s) <= 0.1)?;
        let high_at = samples[..low_at].iter().rposition(|s| share(s) >= 0.9)?;
        // Between two samples the fall is straight.
        let crossing = |before: usize, level: f64| {
            let (a, b) = (share(&samples[before]), share(&samples[before + 1]));
            samples[before][0] + 0.5 * ((a - level) / (a - b).max(1e-9)).clamp(0.0, 1.0)
        };
        Some((crossing(low_at - 1, 0.1) - crossing(high_at, 0.9)) * self.cell)
    }
}

/// The line through samples `[way, height]`, and how far nine in ten keep to it.
fn straight(samples: &[[f64; 2]]) -> Option<(impl Fn(f64) -> f64 + use<>, f64)> {
    let count = samples.len() as f64;
    let (x, y) = (samples.iter().map(|s| s[0]).sum::<f64>() / count, samples.iter().map(|s| s[1]).sum::<f64>() / count);
    let across: f64 = samples.iter().map(|s| (s[0] - x) * (s[1] - y)).sum();
    let along: f64 = samples.iter().map(|s| (s[0] - x) * (s[0] - x)).sum();
    if along <= 0.0 {
        return None;
    }
    let slope = across / along;
    let line = move |s: f64| y + slope * (s - x);
    let mut off: Vec<f64> = samples.iter().map(|s| (s[1] - line(s[0])).abs()).collect();
    Some((line, quantile(&mut off, 0.9)?))
}
