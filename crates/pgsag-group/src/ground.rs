//! The ground below a scene, from points alone: a grid in plan view, opened with windows that grow until no building
//! survives (progressive morphological filter, Zhang et al. 2003).

use std::collections::VecDeque;

use glam::{DVec2, DVec3};
use pgsag_scene::numbers::quantile;

use crate::plan::{PlanFrame, PlanGrid};

/// What counts as ground, in scene units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundRules {
    /// Side of a cell.
    pub cell: f64,
    /// Buildings are no wider than this.
    pub largest_building: f64,
    /// Rise over run that the ground may have.
    pub slope: f64,
    /// Bumps of the ground and noise of its points.
    pub bump: f64,
}

/// Heights along the up axis in cells of plan view.
#[derive(Clone, Debug, PartialEq)]
pub struct Ground {
    /// The cells.
    pub grid: PlanGrid,
    /// `[cells]` height of the ground.
    pub height: Vec<f64>,
}

/// Share of a cell's points below which its lowest lie: single low points are false matches.
const LOW_SHARE: f64 = 0.1;
/// Ground so many bumps below nearly all of it is a false match (the sky in a canal) …
const CHASM_BUMPS: f64 = 25.0;
/// … and so is what lies this far below, connected with it.
const RIM_BUMPS: f64 = 2.0;
/// Rounds of smoothing where ground is not seen.
const SMOOTHING: u32 = 30;

impl Ground {
    /// Finds the ground; `None` without points.
    #[must_use]
    pub fn find(positions: &[DVec3], frame: &PlanFrame, rules: &GroundRules) -> Option<Self> {
        let plan: Vec<DVec2> = positions.iter().map(|at| frame.plan(*at)).collect();
        let grid = PlanGrid::covering(&plan, rules.cell)?;
        let low = lowest(&grid, &plan, positions, frame);
        let is_known: Vec<bool> = low.iter().map(|height| height.is_finite()).collect();
        let mut surface = low.clone();
        spread(&grid, &mut surface, &is_known);
        without_pits(&grid, &mut surface, rules.bump);
        let whole = surface.clone();
        let mut is_ground = is_known;
        let mut window = 1;
        while (window as f64) * grid.cell <= rules.largest_building {
            surface = opened(&grid, &surface, window);
            // Of the whole height: roofs that crumble a little at every window would pass otherwise.
            let tolerance = rules.bump + rules.slope * window as f64 * grid.cell;
            for ((ground, height), opened) in is_ground.iter_mut().zip(&whole).zip(&surface) {
                *ground &= height - opened <= tolerance;
            }
            window *= 2;
        }
        let mut height = low;
        spread(&grid, &mut height, &is_ground);
        without_chasms(&grid, &height, &mut is_ground, rules.bump);
        without_feet(&grid, &mut height, &is_ground);
        spread(&grid, &mut height, &is_ground);
        smooth(&grid, &mut height, &is_ground);
        Some(Self { grid, height })
    }

    /// Height of the ground at a place; that of the nearest cell outside of the grid.
    #[must_use]
    pub fn at(&self, plan: DVec2) -> f64 {
        let high = self.grid.low + DVec2::new(self.grid.columns as f64, self.grid.rows as f64) * self.grid.cell;
        let inside = plan.clamp(self.grid.low, high - DVec2::splat(0.5 * self.grid.cell));
        self.grid.index(inside).map_or(0.0, |cell| self.height[cell])
    }
}

/// Cells of ground beside what rises hold feet of walls: they are as low as the lowest ground about them.
fn without_feet(grid: &PlanGrid, height: &mut [f64], is_ground: &[bool]) {
    let before = height.to_vec();
    for cell in (0..grid.len()).filter(|cell| is_ground[*cell]) {
        if grid.around(cell).any(|other| !is_ground[other]) {
            let lowest = grid.around(cell).filter(|other| is_ground[*other]).map(|other| before[other]);
            height[cell] = lowest.fold(before[cell], f64::min);
        }
    }
}

/// Takes chasms and their rims from the ground.
fn without_chasms(grid: &PlanGrid, height: &[f64], is_ground: &mut [bool], bump: f64) {
    let mut known: Vec<f64> = (0..grid.len()).filter(|cell| is_ground[*cell]).map(|cell| height[cell]).collect();
    let (Some(low), Some(middle)) = (quantile(&mut known, 0.1), quantile(&mut known, 0.5)) else { return };
    let bottom = low - 2.0 * (middle - low) - CHASM_BUMPS * bump;
    let mut open: Vec<usize> = (0..grid.len()).filter(|cell| is_ground[*cell] && height[*cell] < bottom).collect();
    open.iter().for_each(|cell| is_ground[*cell] = false);
    while let Some(cell) = open.pop() {
        for other in grid.around(cell) {
            if is_ground[other] && height[other] < low - RIM_BUMPS * bump {
                is_ground[other] = false;
                open.push(other);
            }
        }
    }
}

/// A low height of every cell's points; infinite where there are none.
fn lowest(grid: &PlanGrid, plan: &[DVec2], positions: &[DVec3], frame: &PlanFrame) -> Vec<f64> {
    let mut heights: Vec<(u32, f64)> = plan
        .iter()
        .zip(positions)
        .filter_map(|(plan, at)| grid.index(*plan).map(|cell| (cell as u32, frame.height(*at))))
        .collect();
    heights.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut low = vec![f64::INFINITY; grid.len()];
    for members in heights.chunk_by(|a, b| a.0 == b.0) {
        low[members[0].0 as usize] = members[(members.len() as f64 * LOW_SHARE) as usize].1;
    }
    low
}

/// Gives every cell that is not known the value of the nearest that is.
pub(crate) fn spread(grid: &PlanGrid, values: &mut [f64], is_known: &[bool]) {
    let mut is_done = is_known.to_vec();
    let mut open: VecDeque<usize> = (0..values.len()).filter(|cell| is_known[*cell]).collect();
    while let Some(cell) = open.pop_front() {
        for other in grid.around(cell) {
            if !is_done[other] {
                is_done[other] = true;
                values[other] = values[cell];
                open.push_back(other);
            }
        }
    }
}

/// Lifts cells that lie below all cells around them by more than a bump.
fn without_pits(grid: &PlanGrid, surface: &mut [f64], bump: f64) {
    let before = surface.to_vec();
    for cell in 0..grid.len() {
        let lowest = grid.around(cell).map(|other| before[other]).fold(f64::INFINITY, f64::min);
        if lowest.is_finite() && before[cell] < lowest - bump {
            surface[cell] = lowest;
        }
    }
}

/// Opening by a square of `2 × reach + 1` cells.
fn opened(grid: &PlanGrid, surface: &[f64], reach: usize) -> Vec<f64> {
    let eroded = filtered(grid, surface, reach, f64::min, f64::INFINITY);
    filtered(grid, &eroded, reach, f64::max, f64::NEG_INFINITY)
}

/// Minimum or maximum over a square, one axis after the other, in time independent of its size (van Herk 1992).
fn filtered(grid: &PlanGrid, values: &[f64], reach: usize, pick: fn(f64, f64) -> f64, neutral: f64) -> Vec<f64> {
    let (columns, rows) = (grid.columns, grid.rows);
    let mut across = vec![0.0; values.len()];
    for y in 0..rows {
        let row = y * columns;
        line(|x| values[row + x], |x, value| across[row + x] = value, columns, reach, pick, neutral);
    }
    let mut down = vec![0.0; values.len()];
    for x in 0..columns {
        line(|y| across[y * columns + x], |y, value| down[y * columns + x] = value, rows, reach, pick, neutral);
    }
    down
}

fn line(
    get: impl Fn(usize) -> f64,
    mut set: impl FnMut(usize, f64),
    count: usize,
    reach: usize,
    pick: fn(f64, f64) -> f64,
    neutral: f64,
) {
    let window = 2 * reach + 1;
    let padded = count + 2 * reach;
    let value = |at: usize| if at < reach || at >= reach + count { neutral } else { get(at - reach) };
    let (mut forward, mut backward) = (vec![neutral; padded], vec![neutral; padded]);
    for at in 0..padded {
        forward[at] = if at % window == 0 { value(at) } else { pick(forward[at - 1], value(at)) };
    }
    for at in (0..padded).rev() {
        let is_end = at + 1 == padded || (at + 1) % window == 0;
        backward[at] = if is_end { value(at) } else { pick(backward[at + 1], value(at)) };
    }
    (0..count).for_each(|at| set(at, pick(backward[at], forward[at + window - 1])));
}

/// Bends the surface smoothly between the cells that are known.
fn smooth(grid: &PlanGrid, values: &mut [f64], is_known: &[bool]) {
    for _ in 0..SMOOTHING {
        let before = values.to_vec();
        for cell in (0..grid.len()).filter(|cell| !is_known[*cell]) {
            let (sum, count) = grid.around(cell).fold((0.0, 0u32), |(sum, n), other| (sum + before[other], n + 1));
            values[cell] = sum / f64::from(count.max(1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(slope: f64) -> Vec<DVec3> {
        let mut points = Vec::new();
        for i in 0..120 {
            for j in 0..120 {
                let (x, y) = (f64::from(i) * 0.5, f64::from(j) * 0.5);
                let is_house = (20.0..40.0).contains(&x) && (20.0..32.0).contains(&y);
                points.push(DVec3::new(x, y, slope * x + if is_house { 6.0 } else { 0.0 }));
            }
        }
        points.push(DVec3::new(10.2, 10.2, -30.0));
        points
    }

    #[test]
    fn ground_goes_on_below_houses_on_flat_land_and_on_slopes() {
        let rules = GroundRules { cell: 1.0, largest_building: 40.0, slope: 0.15, bump: 0.3 };
        for slope in [0.0, 0.1] {
            let ground = Ground::find(&scene(slope), &PlanFrame::new(DVec3::Z), &rules).expect("points");
            let frame = PlanFrame::new(DVec3::Z);
            for (x, y) in [(5.0, 5.0), (30.0, 26.0), (21.0, 21.0), (50.0, 40.0), (10.0, 10.0)] {
                let height = ground.at(frame.plan(DVec3::new(x, y, 0.0)));
                assert!((height - slope * x).abs() < 1.0, "slope {slope} at {x} {y}: {height}");
            }
        }
    }

    #[test]
    fn a_low_roof_that_crumbles_towards_its_rim_is_no_ground() {
        // As stereo draws low blocks: every ring of cells lies a little lower, none by more than a window of its width may.
        let mut points = scene(0.0);
        for at in &mut points {
            let off = (at.x - 30.0).abs().max((at.y - 26.0).abs());
            at.z = match off {
                ..2.0 => 3.2,
                ..4.0 => 2.4,
                ..5.0 => 1.4,
                ..6.0 => 0.7,
                ..7.0 => 0.35,
                _ => 0.0,
            };
        }
        let rules = GroundRules { cell: 1.0, largest_building: 40.0, slope: 0.15, bump: 0.4 };
        let ground = Ground::find(&points, &PlanFrame::new(DVec3::Z), &rules).expect("points");
        for (x, y) in [(30.0, 26.0), (28.5, 26.0), (26.5, 26.0), (50.0, 26.0)] {
            assert!(ground.at(DVec2::new(x, y)).abs() < 0.8, "{x} {y}: {}", ground.at(DVec2::new(x, y)));
        }
    }

    #[test]
    fn feet_of_walls_do_not_lift_the_ground_below_a_house() {
        // The lowest that is seen in the ring about the house is the foot of its wall.
        let mut points = scene(0.0);
        for at in &mut points {
            let off = ((at.x - 29.75).abs() - 10.0).max((at.y - 25.75).abs() - 6.0);
            at.z += if (0.0..1.0).contains(&off) { 0.35 } else { 0.0 };
        }
        let rules = GroundRules { cell: 1.0, largest_building: 40.0, slope: 0.15, bump: 0.4 };
        let ground = Ground::find(&points, &PlanFrame::new(DVec3::Z), &rules).expect("points");
        assert!(ground.at(DVec2::new(30.0, 26.0)).abs() < 0.05, "{}", ground.at(DVec2::new(30.0, 26.0)));
    }

    #[test]
    fn the_sky_in_a_canal_is_no_ground_and_a_sunken_yard_is() {
        let mut points = scene(0.0);
        let within = |at: &DVec3, x: f64, y: f64, side: f64| (at.x - x).abs() < side && (at.y - y).abs() < side;
        // A funnel of false matches, and a yard of 3 m depth.
        for at in &mut points {
            let off = (at.x - 50.0).abs().max((at.y - 10.0).abs());
            at.z -= (36.0 - 6.0 * off).max(0.0);
            at.z -= if within(at, 10.0, 50.0, 5.0) { 3.0 } else { 0.0 };
        }
        let rules = GroundRules { cell: 1.0, largest_building: 40.0, slope: 0.15, bump: 0.4 };
        let ground = Ground::find(&points, &PlanFrame::new(DVec3::Z), &rules).expect("points");
        for (x, y, wanted) in [(50.0, 10.0, 0.0), (47.0, 10.0, 0.0), (53.0, 12.0, 0.0), (10.0, 50.0, -3.0)] {
            let height = ground.at(DVec2::new(x, y));
            assert!((height - wanted).abs() < 1.0, "{x} {y}: {height}");
        }
    }

    #[test]
    fn sliding_windows_equal_brute_force() {
        let mut stream = pgsag_scene::numbers::SplitMix64::new(4);
        let grid = PlanGrid { low: DVec2::ZERO, cell: 1.0, columns: 13, rows: 7 };
        let values: Vec<f64> = (0..grid.len()).map(|_| stream.uniform()).collect();
        for reach in [1, 2, 8] {
            let found = filtered(&grid, &values, reach, f64::max, f64::NEG_INFINITY);
            for cell in 0..grid.len() {
                let (x, y) = ((cell % 13) as i64, (cell / 13) as i64);
                let near = |other: &usize| {
                    let (u, v) = ((other % 13) as i64, (other / 13) as i64);
                    (u - x).unsigned_abs().max((v - y).unsigned_abs()) <= reach as u64
                };
                let expected = (0..grid.len()).filter(near).map(|o| values[o]).fold(f64::NEG_INFINITY, f64::max);
                assert!((found[cell] - expected).abs() < 1e-15);
            }
        }
    }
}
