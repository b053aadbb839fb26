//! Where streets, houses, trees and cars stand. Plan coordinates are metres about the middle of the town, x east, y north.
//! The town is a grid of parcels; a street runs between every second pair of columns and of rows.

use glam::DVec2;

use super::options::TownOptions;
use crate::numbers::SplitMix64;

/// Parcel size, metres.
const CELL: DVec2 = DVec2::new(15.2, 13.6);
/// Width between facing parcels: carriageway and two pavements, metres.
const STREET: f64 = 7.0;
/// Width between parcels back to back, metres.
const GARDEN: f64 = 4.0;
/// Pavement on each side of a street, metres.
pub(super) const PAVEMENT: f64 = 1.4;

/// A house on a rectangle.
#[derive(Clone, Debug)]
pub(super) struct House {
    pub number: u32,
    pub center: DVec2,
    /// Unit vector of the house's own x axis.
    pub axis: DVec2,
    /// Half sizes along the house's own axes.
    pub half: DVec2,
    /// Height of the walls.
    pub eaves: f64,
    /// Ridge above the eaves; 0 = flat roof.
    pub rise: f64,
    /// Whether the ridge runs along the house's own x axis.
    pub ridge_along_x: bool,
    /// Whether it shares walls with its neighbours along x.
    pub in_row: bool,
    pub seed: u32,
}

impl House {
    /// From the house's own plan coordinates to the town's.
    pub(super) fn plan(&self, own: DVec2) -> DVec2 {
        self.center + self.axis * own.x + self.axis.perp() * own.y
    }

    /// Distance in plan from the walls; 0 inside.
    pub(super) fn distance(&self, at: DVec2) -> f64 {
        let d = at - self.center;
        let own = DVec2::new(d.dot(self.axis).abs(), d.dot(self.axis.perp()).abs());
        (own - self.half).max(DVec2::ZERO).length()
    }

    /// The corners, counter-clockwise.
    pub(super) fn corners(&self) -> [DVec2; 4] {
        let h = self.half;
        [(-h.x, -h.y), (h.x, -h.y), (h.x, h.y), (-h.x, h.y)].map(|(x, y)| self.plan(DVec2::new(x, y)))
    }
}

/// A tree: an ellipsoid on a trunk.
#[derive(Clone, Debug)]
pub(super) struct Tree {
    pub at: DVec2,
    pub radius: f64,
    pub trunk: f64,
    pub seed: u32,
}

/// A parked car.
#[derive(Clone, Debug)]
pub(super) struct Car {
    pub at: DVec2,
    pub along_x: bool,
    pub seed: u32,
}

/// The plan of the town.
#[derive(Clone, Debug, Default)]
pub(super) struct Layout {
    /// Half the town's size.
    pub half: DVec2,
    /// x intervals of the columns of parcels.
    pub columns: Vec<[f64; 2]>,
    /// y intervals of the rows of parcels.
    pub rows: Vec<[f64; 2]>,
    /// x intervals of the streets that run north-south.
    pub streets_x: Vec<[f64; 2]>,
    /// y intervals of the streets that run east-west.
    pub streets_y: Vec<[f64; 2]>,
    pub houses: Vec<House>,
    /// `[rows * columns]`, the range in `houses` of each parcel.
    pub cell_houses: Vec<std::ops::Range<usize>>,
    pub trees: Vec<Tree>,
    pub cars: Vec<Car>,
}

impl Layout {
    pub(super) fn new(options: &TownOptions) -> Self {
        let mut random = SplitMix64::new(options.seed ^ 0x0070_1A9D);
        let groups = house_groups(options);
        let cells = groups.len().max(1);
        let columns = ((cells as f64).sqrt().ceil() as usize).max(1);
        let rows = cells.div_ceil(columns);
        let mut town = Self::default();
        (town.columns, town.streets_x, town.half.x) = intervals(columns, CELL.x);
        (town.rows, town.streets_y, town.half.y) = intervals(rows, CELL.y);
        let mut detached = 0;
        for (cell, &count) in groups.iter().enumerate() {
            let (x, y) = (town.columns[cell % columns], town.rows[cell / columns]);
            let center = DVec2::new((x[0] + x[1]) / 2.0, (y[0] + y[1]) / 2.0);
            let first = town.houses.len();
            if count > 1 {
                town.add_row(options, &mut random, center, count);
            } else {
                let share = options.flat_roof_share;
                let flat = (f64::from(detached + 1) * share).floor() > (f64::from(detached) * share).floor();
                detached += 1;
                town.add_detached(options, &mut random, center, flat);
            }
            town.cell_houses.push(first..town.houses.len());
        }
        town.cell_houses.resize(rows * columns, 0..0);
        town.park_cars(options, &mut random);
        town.plant_trees(options, &mut random);
        town
    }

    fn add_row(&mut self, options: &TownOptions, random: &mut SplitMix64, center: DVec2, count: u32) {
        let axis = turned(random.range(-0.5, 0.5) * options.house_yaw_rad);
        let width = (CELL.x - 0.8) / f64::from(count);
        let depth = random.range(4.3, 4.7);
        let eaves = random.range(5.2, 5.8);
        for k in 0..count {
            let own_x = (f64::from(k) + 0.5 - f64::from(count) / 2.0) * width;
            self.houses.push(House {
                number: self.houses.len() as u32 + 1,
                center: center + axis * own_x,
                axis,
                half: DVec2::new(width / 2.0, depth),
                eaves: eaves + 0.6 * f64::from(k % 2) + random.range(-0.1, 0.1),
                rise: random.range(2.6, 3.0),
                ridge_along_x: true,
                in_row: true,
                seed: random.next_u64() as u32,
            });
        }
    }

    fn add_detached(&mut self, options: &TownOptions, random: &mut SplitMix64, center: DVec2, flat: bool) {
        let half = DVec2::new(random.range(4.0, 5.2), random.range(3.9, 4.7));
        let room = (CELL / 2.0 - half - 0.9).max(DVec2::ZERO);
        let shift = DVec2::new(random.range(-1.0, 1.0), random.range(-1.0, 1.0)) * room * 0.8;
        let eaves = if flat { random.range(5.8, 8.2) } else { random.range(4.2, 5.4) };
        self.houses.push(House {
            number: self.houses.len() as u32 + 1,
            center: center + shift,
            axis: turned(random.range(-1.0, 1.0) * options.house_yaw_rad),
            half,
            eaves,
            rise: if flat { 0.0 } else { random.range(2.4, 3.4) },
            ridge_along_x: random.uniform() < 0.5,
            in_row: false,
            seed: random.next_u64() as u32,
        });
    }

    fn park_cars(&mut self, options: &TownOptions, random: &mut SplitMix64) {
        for _ in 0..options.car_count {
            let along_x = random.uniform() < 0.5;
            let (streets, reach) =
                if along_x { (&self.streets_y, self.half.x) } else { (&self.streets_x, self.half.y) };
            let Some(street) = streets.get(random.below(streets.len())) else { continue };
            let side = if random.uniform() < 0.5 { street[0] + PAVEMENT + 0.95 } else { street[1] - PAVEMENT - 0.95 };
            let run = random.range(5.5, reach - 3.0) * if random.uniform() < 0.5 { -1.0 } else { 1.0 };
            let at = if along_x { DVec2::new(run, side) } else { DVec2::new(side, run) };
            let car = Car { at, along_x, seed: random.next_u64() as u32 };
            if self.cars.iter().all(|other| other.at.distance(at) > 5.5) {
                self.cars.push(car);
            }
        }
    }

    /// Darts thrown at the gardens; one that would touch a house, a street or another tree is lost.
    fn plant_trees(&mut self, options: &TownOptions, random: &mut SplitMix64) {
        let reach = self.half + 3.0;
        for _ in 0..options.tree_count.saturating_mul(60) {
            if self.trees.len() as u32 >= options.tree_count {
                return;
            }
            let at = DVec2::new(random.range(-reach.x, reach.x), random.range(-reach.y, reach.y));
            let radius = random.range(0.9, 1.9);
            let tree = Tree { at, radius, trunk: random.range(0.9, 1.6), seed: random.next_u64() as u32 };
            let clear = self.nearest_house(at) > radius + 0.6
                && self.street_depth(at) < -0.4
                && self.trees.iter().all(|other| other.at.distance(at) > radius + other.radius);
            if clear {
                self.trees.push(tree);
            }
        }
    }

    /// How far inside a street's corridor a place lies, metres; negative outside.
    pub(super) fn street_depth(&self, at: DVec2) -> f64 {
        depth_in(&self.streets_x, at.x).max(depth_in(&self.streets_y, at.y))
    }

    /// Distance in plan to the nearest house of the parcel that `at` lies nearest to; infinite where it has none.
    pub(super) fn nearest_house(&self, at: DVec2) -> f64 {
        let column = nearest_interval(&self.columns, at.x);
        let row = nearest_interval(&self.rows, at.y);
        let cell = row * self.columns.len() + column;
        let houses = self.cell_houses.get(cell).map_or(&[][..], |range| &self.houses[range.clone()]);
        houses.iter().map(|house| house.distance(at)).fold(f64::INFINITY, f64::min)
    }
}

/// How many houses stand on each parcel: every seventh parcel is a row, as long as the houses last.
pub(super) fn house_groups(options: &TownOptions) -> Vec<u32> {
    let mut groups = Vec::new();
    let mut left = options.house_count;
    while left > 0 {
        let row = options.row_house_count >= 2 && left >= options.row_house_count && groups.len() % 7 == 0;
        let count = if row { options.row_house_count } else { 1 };
        groups.push(count);
        left -= count;
    }
    groups
}

/// Parcels and streets along one axis, centred, and half the whole length.
fn intervals(count: usize, size: f64) -> (Vec<[f64; 2]>, Vec<[f64; 2]>, f64) {
    let (mut cells, mut streets, mut at) = (Vec::new(), Vec::new(), 0.0);
    for k in 0..count {
        if k % 2 == 1 {
            streets.push([at, at + STREET]);
            at += STREET;
        } else if k > 0 {
            at += GARDEN;
        }
        cells.push([at, at + size]);
        at += size;
    }
    let half = at / 2.0;
    for interval in cells.iter_mut().chain(&mut streets) {
        *interval = interval.map(|end| end - half);
    }
    (cells, streets, half)
}

fn depth_in(intervals: &[[f64; 2]], at: f64) -> f64 {
    let next = intervals.partition_point(|interval| interval[1] < at);
    let near = [next.checked_sub(1), Some(next)];
    near.iter()
        .flatten()
        .filter_map(|&k| intervals.get(k))
        .map(|interval| (at - interval[0]).min(interval[1] - at))
        .fold(f64::NEG_INFINITY, f64::max)
}

fn nearest_interval(intervals: &[[f64; 2]], at: f64) -> usize {
    let next = intervals.partition_point(|interval| interval[1] < at).min(intervals.len().saturating_sub(1));
    if next > 0 && at - intervals[next - 1][1] < intervals[next][0] - at { next - 1 } else { next }
}

fn turned(angle: f64) -> DVec2 {
    DVec2::new(libm::cos(angle), libm::sin(angle))
}
