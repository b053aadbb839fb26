//! Buildings without a network: what rises above the ground, is smooth, and is not green. Method 3.6, 8.12.
//!
//! Decisions are made in cells of plan view and for whole connected pieces, so that a roof with a patch of moss stays and
//! a tree with a flat top goes; the points then take the label of their cell.

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use crate::ground::{Ground, GroundRules, spread};
use crate::label::Label;
use crate::plan::{PlanFrame, PlanGrid};

/// What is a building.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeometryOptions {
    /// Least height of a roof above the ground, metres.
    pub min_height_m: f64,
    /// Least area of a building in plan, square metres.
    pub min_area_m2: f64,
    /// Parts narrower than this are no buildings, metres.
    pub min_width_m: f64,
    /// The widest building, metres.
    pub max_width_m: f64,
    /// Steepest ground, rise over run.
    pub max_slope: f64,
    /// Vegetation, 0 to 1, above which a cell is no roof. Sum of greenness, roughness and scatter of normals.
    pub max_vegetation: f64,
    /// Share of a piece that must be smooth for the piece to be a building.
    pub min_smooth_share: f64,
}

impl Default for GeometryOptions {
    fn default() -> Self {
        Self {
            min_height_m: 2.2,
            min_area_m2: 12.0,
            min_width_m: 2.0,
            max_width_m: 60.0,
            max_slope: 0.15,
            max_vegetation: 0.8,
            min_smooth_share: 0.3,
        }
    }
}

/// Points on everything.
#[derive(Clone, Copy, Debug)]
pub struct Points<'a> {
    /// World frame.
    pub positions: &'a [DVec3],
    /// RGB.
    pub colors: &'a [[u8; 3]],
    /// Unit, world frame, or empty.
    pub normals: &'a [[f32; 3]],
    /// Distance between neighbours, scene units.
    pub spacing: f64,
}

/// What geometry says.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// `[points]`.
    pub labels: Vec<Label>,
    /// Pieces that are buildings.
    pub buildings: usize,
    /// Pieces that rise above the ground and are something else.
    pub others: usize,
}

/// Excess green (2G − R − B) / (R + G + B) at which vegetation begins, and above it where it is certain.
const GREEN: [f64; 2] = [0.05, 0.12];
/// Deviation from a plane, metres, at which roughness begins and is certain.
const ROUGH_M: [f64; 2] = [0.15, 0.5];
/// 1 − length of the mean normal, at which scatter begins and is certain.
const SCATTER: [f64; 2] = [0.12, 0.4];
/// What greenness, roughness and scatter count.
const WEIGHTS: [f64; 3] = [0.6, 0.5, 0.3];
/// Share of the least height that the surface falls at the edge of a building …
const EDGE_DROP: f64 = 0.6;
/// … within so many cells …
const EDGE_CELLS: i64 = 3;
/// … along this share of what is seen of the edge: terrain that rises slowly is no building.
const MIN_EDGE_SHARE: f64 = 0.35;
/// Normals of walls rise less than this, as a share of their length.
const WALL: f64 = 0.5;
/// Points lower than this above the ground are ground, metres.
const FOOT_M: f64 = 0.4;
/// Bumps of the ground, metres.
const BUMP_M: f64 = 0.4;
/// Least side of a cell, metres.
const MIN_CELL_M: f64 = 0.5;

/// Finds buildings. `units_per_metre` tells how long a metre of the options is.
#[must_use]
pub fn find(points: &Points<'_>, frame: &PlanFrame, options: &GeometryOptions, units_per_metre: f64) -> Option<Found> {
    let cell = (MIN_CELL_M * units_per_metre).max(2.0 * points.spacing);
    let rules = GroundRules {
        cell,
        largest_building: options.max_width_m * units_per_metre,
        slope: options.max_slope,
        bump: BUMP_M * units_per_metre,
    };
    let ground = Ground::find(points.positions, frame, &rules)?;
    let roofs = Roofs::new(points, frame, &ground, options, units_per_metre);
    let width_cells = options.min_width_m * units_per_metre / ground.grid.cell;
    let raised = opened(&ground.grid, &roofs.is_raised, width_cells);
    let smooth = opened(&ground.grid, &roofs.is_roof, width_cells);
    let area = (ground.grid.cell / units_per_metre).powi(2);
    let (mut is_building, mut buildings, mut others) = (vec![false; ground.grid.len()], 0, 0);
    for piece in pieces(&ground.grid, &smooth) {
        let is_smooth = |cell: &&usize| roofs.vegetation[**cell] < 0.6 * options.max_vegetation;
        let smooth_share = piece.iter().filter(is_smooth).count() as f64 / piece.len() as f64;
        let is_steep = roofs
            .edge_share(&ground.grid, &piece, EDGE_DROP * options.min_height_m * units_per_metre)
            .is_some_and(|share| share >= MIN_EDGE_SHARE);
        let is_large = piece.len() as f64 * area >= options.min_area_m2;
        if is_large && is_steep && smooth_share >= options.min_smooth_share {
            piece.iter().for_each(|cell| is_building[*cell] = true);
            buildings += 1;
        }
    }
    for piece in pieces(&ground.grid, &raised) {
        others += usize::from(!piece.iter().any(|cell| is_building[*cell]));
    }
    let labels = roofs.labels(points, frame, &ground, &is_building, FOOT_M * units_per_metre);
    Some(Found { labels, buildings, others })
}

/// The upper surface in cells of plan view.
struct Roofs {
    /// `[cells]` height of the highest points; infinite below where there are none.
    top: Vec<f64>,
    /// `[cells]` 0 = smooth and grey, 1 = vegetation for sure.
    vegetation: Vec<f64>,
    is_raised: Vec<bool>,
    is_roof: Vec<bool>,
}

/// Sums over the points of a cell's upper surface.
#[derive(Clone, Copy, Default)]
struct Sums {
    count: f64,
    green: f64,
    normal: DVec3,
    normals: f64,
    /// Moments of x, y, z about the cell's middle: 1, x, y, xx, xy, yy, z, xz, yz, zz.
    moments: [f64; 10],
}

impl Sums {
    fn add(&mut self, other: &Self, shift: DVec2) {
        self.count += other.count;
        self.green += other.green;
        self.normal += other.normal;
        self.normals += other.normals;
        let [n, x, y, xx, xy, yy, z, xz, yz, zz] = other.moments;
        let (dx, dy) = (shift.x, shift.y);
        let moved = [
            n,
            x + n * dx,
            y + n * dy,
            xx + 2.0 * x * dx + n * dx * dx,
            xy + x * dy + y * dx + n * dx * dy,
            yy + 2.0 * y * dy + n * dy * dy,
            z,
            xz + z * dx,
            yz + z * dy,
            zz,
        ];
        self.moments.iter_mut().zip(moved).for_each(|(sum, value)| *sum += value);
    }

    /// Root mean square distance in height from the best plane z = a x + b y + c.
    fn roughness(&self) -> f64 {
        let [n, x, y, xx, xy, yy, z, xz, yz, zz] = self.moments;
        if n < 4.0 {
            return 0.0;
        }
        let (mx, my, mz) = (x / n, y / n, z / n);
        let (sxx, sxy, syy) = (xx / n - mx * mx, xy / n - mx * my, yy / n - my * my);
        let (sxz, syz, szz) = (xz / n - mx * mz, yz / n - my * mz, zz / n - mz * mz);
        let determinant = sxx * syy - sxy * sxy;
        let explained = if determinant > 1e-6 * (sxx + syy).powi(2) {
            (sxz * (syy * sxz - sxy * syz) + syz * (sxx * syz - sxy * sxz)) / determinant
        } else {
            0.0
        };
        (szz - explained).max(0.0).sqrt()
    }
}

fn ramp(value: f64, [low, high]: [f64; 2]) -> f64 {
    ((value - low) / (high - low)).clamp(0.0, 1.0)
}

impl Roofs {
    fn new(points: &Points<'_>, frame: &PlanFrame, ground: &Ground, options: &GeometryOptions, metre: f64) -> Self {
        let grid = &ground.grid;
        let cell_of = |at: &DVec3| grid.index(frame.plan(*at));
        let mut top = vec![f64::NEG_INFINITY; grid.len()];
        for at in points.positions {
            if let Some(cell) = cell_of(at) {
                top[cell] = top[cell].max(frame.height(*at));
            }
        }
        let min_height = options.min_height_m * metre;
        let is_high = |cell: usize| top[cell] - ground.height[cell] >= min_height;
        let mut sums = vec![Sums::default(); grid.len()];
        for (index, at) in points.positions.iter().enumerate() {
            let Some(cell) = cell_of(at).filter(|cell| is_high(*cell)) else { continue };
            // Facades and what lies below the canopy say nothing of the roof.
            if top[cell] - frame.height(*at) > grid.cell.max(0.5 * min_height) {
                continue;
            }
            sums[cell].add(&sums_of(points, index, frame, grid.center(cell)), DVec2::ZERO);
        }
        let mut vegetation = vec![0.0; grid.len()];
        let mut is_raised: Vec<bool> = (0..grid.len()).map(|cell| sums[cell].count > 0.0).collect();
        close_gaps(grid, &mut is_raised, &mut top);
        for cell in (0..grid.len()).filter(|cell| is_raised[*cell]) {
            let mut around = sums[cell];
            for other in grid.around(cell) {
                around.add(&sums[other], grid.center(other) - grid.center(cell));
            }
            let scatter = if around.normals > 0.0 { 1.0 - around.normal.length() / around.normals } else { 0.0 };
            let evidence = [
                ramp(around.green / around.count.max(1.0), GREEN),
                ramp(around.roughness() / metre, ROUGH_M),
                ramp(scatter, SCATTER),
            ];
            vegetation[cell] = evidence.iter().zip(WEIGHTS).map(|(value, weight)| value * weight).sum::<f64>().min(1.0);
        }
        let vegetation = averaged(grid, &vegetation, &is_raised);
        let is_roof =
            (0..grid.len()).map(|cell| is_raised[cell] && vegetation[cell] <= options.max_vegetation).collect();
        Self { top, vegetation, is_raised, is_roof }
    }

    /// Share of the places a few cells beyond a piece's edge where the surface lies lower by `drop`, of those where there is
    /// any; `None` where nothing is seen around the piece.
    fn edge_share(&self, grid: &PlanGrid, piece: &[usize], drop: f64) -> Option<f64> {
        let mut is_own = vec![false; grid.len()];
        piece.iter().for_each(|cell| is_own[*cell] = true);
        let (mut known, mut steep) = (0u32, 0u32);
        for &cell in piece.iter().filter(|cell| grid.around(**cell).any(|other| !is_own[other])) {
            let (x, y) = ((cell % grid.columns) as i64, (cell / grid.columns) as i64);
            for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                let (u, v) = (x + EDGE_CELLS * dx, y + EDGE_CELLS * dy);
                if u < 0 || v < 0 || u >= grid.columns as i64 || v >= grid.rows as i64 {
                    continue;
                }
                let other = v as usize * grid.columns + u as usize;
                if !is_own[other] && self.top[other].is_finite() {
                    known += 1;
                    steep += u32::from(self.top[cell] - self.top[other] >= drop);
                }
            }
        }
        (known > 0).then(|| f64::from(steep) / f64::from(known))
    }

    /// Points above the ground in a building's cell, or beside one below its roof (facades), are the building's.
    fn labels(
        &self,
        points: &Points<'_>,
        frame: &PlanFrame,
        ground: &Ground,
        is_building: &[bool],
        foot: f64,
    ) -> Vec<Label> {
        use rayon::prelude::*;
        let grid = &ground.grid;
        let up = frame.world(DVec2::ZERO, 1.0) - frame.world(DVec2::ZERO, 0.0);
        let label = |(index, at): (usize, &DVec3)| {
            let normal = points.normals.get(index).map(|normal| DVec3::from_array(normal.map(f64::from)));
            let is_wall = normal.is_some_and(|normal| normal.dot(up).abs() < WALL);
            let foot = if is_wall { 0.0 } else { foot };
            let Some(cell) = grid.index(frame.plan(*at)) else { return Label::Background };
            let height = frame.height(*at);
            let beside = |other: usize| is_building[other] && height <= self.top[other];
            let is_facade = || !self.is_raised[cell] || self.vegetation[cell] < 0.5;
            let is_in = is_building[cell] || (is_facade() && grid.around(cell).any(beside));
            if is_in && height - ground.height[cell] > foot { Label::Building } else { Label::Background }
        };
        points.positions.par_iter().enumerate().map(label).collect()
    }
}

fn sums_of(points: &Points<'_>, index: usize, frame: &PlanFrame, middle: DVec2) -> Sums {
    let at = points.positions[index];
    let [red, green, blue] = points.colors[index].map(f64::from);
    let normal = points.normals.get(index).map(|normal| DVec3::from_array(normal.map(f64::from)));
    let (p, z) = (frame.plan(at) - middle, frame.height(at));
    Sums {
        count: 1.0,
        green: (2.0 * green - red - blue) / (red + green + blue).max(1.0),
        normal: normal.unwrap_or_default(),
        normals: if normal.is_some() { 1.0 } else { 0.0 },
        moments: [1.0, p.x, p.y, p.x * p.x, p.x * p.y, p.y * p.y, z, p.x * z, p.y * z, z * z],
    }
}

/// Cells without points that five or more raised ones surround are raised too, twice over.
fn close_gaps(grid: &PlanGrid, is_raised: &mut [bool], top: &mut [f64]) {
    for _ in 0..2 {
        let before = is_raised.to_vec();
        let mut filled = top.to_vec();
        spread(grid, &mut filled, &before);
        for cell in (0..grid.len()).filter(|cell| top[*cell] == f64::NEG_INFINITY) {
            if grid.around(cell).filter(|other| before[*other]).count() >= 5 {
                is_raised[cell] = true;
                filled[cell] =
                    grid.around(cell).filter(|o| before[*o]).map(|o| top[o]).fold(f64::NEG_INFINITY, f64::max);
            }
        }
        for cell in 0..grid.len() {
            if is_raised[cell] && top[cell] == f64::NEG_INFINITY {
                top[cell] = filled[cell];
            }
        }
    }
}

/// Mean over a cell and those of its neighbours that take part.
fn averaged(grid: &PlanGrid, values: &[f64], takes_part: &[bool]) -> Vec<f64> {
    let mean = |cell: usize| {
        let others = grid.around(cell).filter(|other| takes_part[*other]);
        let (sum, count) = others.fold((values[cell], 1.0), |(sum, count), other| (sum + values[other], count + 1.0));
        sum / count
    };
    (0..grid.len()).map(|cell| if takes_part[cell] { mean(cell) } else { values[cell] }).collect()
}

/// Opening in steps of one cell: parts narrower than `width` cells go.
fn opened(grid: &PlanGrid, cells: &[bool], width: f64) -> Vec<bool> {
    let steps = ((width - 1.0) / 2.0).round().max(0.0) as usize;
    let shrunk = |cells: &[bool]| -> Vec<bool> {
        (0..grid.len()).map(|cell| cells[cell] && grid.around(cell).all(|other| cells[other])).collect()
    };
    let grown = |cells: &[bool]| -> Vec<bool> {
        (0..grid.len()).map(|cell| cells[cell] || grid.around(cell).any(|other| cells[other])).collect()
    };
    let small = (0..steps).fold(cells.to_vec(), |cells, _| shrunk(&cells));
    (0..steps).fold(small, |cells, _| grown(&cells))
}

/// Connected pieces, corners included, in the order of their first cells.
fn pieces(grid: &PlanGrid, cells: &[bool]) -> Vec<Vec<usize>> {
    let mut is_done = vec![false; grid.len()];
    let mut found = Vec::new();
    for start in 0..grid.len() {
        if !cells[start] || is_done[start] {
            continue;
        }
        let mut piece = vec![start];
        is_done[start] = true;
        let mut next = 0;
        while next < piece.len() {
            for other in grid.around(piece[next]) {
                if cells[other] && !is_done[other] {
                    is_done[other] = true;
                    piece.push(other);
                }
            }
            next += 1;
        }
        found.push(piece);
    }
    found
}

#[cfg(test)]
mod tests;
