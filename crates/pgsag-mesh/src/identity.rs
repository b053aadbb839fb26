//! Which building a face belongs to where houses touch: pieces of plan view, parted where their roofs stand at different
//! heights or have different colours. Row houses and perimeter blocks have no gap (method 8.7).
//!
//! The highest surface in every cell of plan view is a relief. What is plane and of one hue grows to regions (`regions`),
//! and neighbours are of one roof where their slopes meet, as they do at ridges, and their hues are the same. Small or
//! enclosed roofs (chimneys, dormers, lift houses) go to the one that they share most border with.

mod ground;
mod regions;

use std::collections::{BTreeMap, HashMap};

use glam::DVec3;
use pgsag_scene::Mesh;

pub use ground::{Ground, on_ground};
use regions::BESIDE;

use crate::components::Sets;
use crate::error::MeshError;

/// When roofs are of two buildings, in scene units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoofRules {
    /// Side of a cell of plan view.
    pub cell: f64,
    /// Least height difference where roofs meet; infinite: only gaps part buildings.
    pub step: f64,
    /// Distance from a plane that is none, within three cells, beside what all roofs are rough by.
    pub flat: f64,
    /// Least difference of hue where roofs meet, |Δ ln(red / green)| + |Δ ln(blue / green)|; infinite: colours part nothing.
    pub hue_step: f64,
    /// Roofs of less area in plan are parts of others.
    pub min_area: f64,
}

/// A roof that shares at least this part of its border with one other stands on it.
const ENCLOSED_SHARE: f64 = 0.6;
/// Samples of faces that are kept before they are thinned.
const MAX_SAMPLES: usize = 1 << 20;

/// What of a colour light and shade leave alone: natural logarithms of red over green and of blue over green.
type Hue = [f64; 2];

/// The relief: highest point of every occupied cell.
struct Relief {
    keys: Vec<[i64; 2]>,
    tops: Vec<f64>,
    /// `[cells]` Of the surface about the highest point; 0 where colours part nothing.
    hues: Vec<Hue>,
    index: HashMap<[i64; 2], u32>,
}

/// `[F]` The building of every face, from 1 in the order of cells; 0 where `is_building` does not hold.
///
/// # Errors
/// A cell that is no length.
pub fn roof_pieces(
    mesh: &Mesh,
    up: DVec3,
    rules: &RoofRules,
    is_building: impl Fn(usize) -> bool,
) -> Result<Vec<u32>, MeshError> {
    let (up, key) = plan_view(up, rules.cell)?;
    let mut relief = Relief::of(mesh, &key, up, rules.cell, &is_building);
    if rules.step.is_finite() {
        relief.tops = relief.smooth(|cell| relief.tops[cell]);
        let hues = match rules.hue_step.is_finite() && !mesh.colors.is_empty() {
            true => relief.hues_of(mesh, &key, up, rules.cell),
            false => vec![[0.0; 2]; relief.keys.len()],
        };
        let [red, blue] = [0, 1].map(|channel| relief.smooth(|cell| hues[cell][channel]));
        relief.hues = red.into_iter().zip(blue).map(|(red, blue)| [red, blue]).collect();
    }
    let number = relief.pieces(rules);
    let piece = |face: usize| relief.index.get(&key(middle(mesh, face))).map_or(0, |cell| number[*cell as usize]);
    Ok((0..mesh.faces.len()).map(|face| if is_building(face) { piece(face) } else { 0 }).collect())
}

/// The unit up axis, and the cell of plan view (side `cell`) of a point.
fn plan_view(up: DVec3, cell: f64) -> Result<(DVec3, impl Fn(DVec3) -> [i64; 2]), MeshError> {
    if !(cell > 0.0 && cell.is_finite()) {
        return Err(MeshError::Option { name: "cell", value: cell, allowed: "greater than 0" });
    }
    let up = up.normalize_or(DVec3::Z);
    let (east, north) = up.any_orthonormal_pair();
    Ok((up, move |p: DVec3| [(p.dot(east) / cell).floor() as i64, (p.dot(north) / cell).floor() as i64]))
}

fn middle(mesh: &Mesh, face: usize) -> DVec3 {
    mesh.triangle(face).iter().map(|corner| DVec3::from(*corner)).sum::<DVec3>() / 3.0
}

/// Rings of faces that a given number spreads over faces which no view has numbered: rims and shaded spots.
const SPREAD_RINGS: usize = 8;

/// `[F]` The building of every face where views have numbered most of them (`given`, 0: not numbered): the given number,
/// else that of faces close by, else a roof piece of its own under the next free numbers, the largest first. Pieces of
/// less than the least area (surface) are no buildings.
///
/// # Errors
/// A cell that is no length.
pub fn given_pieces(
    mesh: &Mesh,
    up: DVec3,
    rules: &RoofRules,
    given: &[u32],
    is_building: impl Fn(usize) -> bool,
) -> Result<Vec<u32>, MeshError> {
    let mut number: Vec<u32> =
        (0..mesh.faces.len()).map(|face| if is_building(face) { given[face] } else { 0 }).collect();
    for _ in 0..SPREAD_RINGS {
        let mut at_vertex: HashMap<u32, u32> = HashMap::new();
        for (face, corners) in mesh.faces.iter().enumerate().filter(|(face, _)| number[*face] != 0) {
            for corner in corners {
                let smallest = at_vertex.entry(*corner).or_insert(number[face]);
                *smallest = (*smallest).min(number[face]);
            }
        }
        let spread = |face: usize| match number[face] {
            0 if is_building(face) => {
                mesh.faces[face].iter().filter_map(|c| at_vertex.get(c)).min().copied().unwrap_or(0)
            }
            known => known,
        };
        let next: Vec<u32> = (0..number.len()).map(spread).collect();
        if next == number {
            break;
        }
        number = next;
    }
    let pieces = roof_pieces(mesh, up, rules, |face| is_building(face) && number[face] == 0)?;
    let first = number.iter().max().copied().unwrap_or(0);
    let area = |face: usize| {
        let [a, b, c] = mesh.triangle(face).map(DVec3::from);
        0.5 * (b - a).cross(c - a).length()
    };
    let mut areas: BTreeMap<(bool, u32), f64> = BTreeMap::new();
    for face in (0..mesh.faces.len()).filter(|face| is_building(*face)) {
        let is_piece = number[face] == 0;
        *areas.entry((is_piece, if is_piece { pieces[face] } else { number[face] })).or_default() += area(face);
    }
    areas.retain(|_, area| *area >= rules.min_area);
    let mut order: Vec<(u32, f64)> =
        areas.iter().filter(|((is_piece, _), _)| *is_piece).map(|(k, a)| (k.1, *a)).collect();
    order.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let renamed: BTreeMap<u32, u32> = order.iter().zip(first + 1..).map(|((piece, _), new)| (*piece, new)).collect();
    let last = |face: usize| match number[face] {
        0 => renamed.get(&pieces[face]).copied().unwrap_or(0),
        known if areas.contains_key(&(false, known)) => known,
        _ => 0,
    };
    Ok((0..mesh.faces.len()).map(last).collect())
}

impl Relief {
    fn of(
        mesh: &Mesh,
        key: &impl Fn(DVec3) -> [i64; 2],
        up: DVec3,
        cell: f64,
        is_building: &impl Fn(usize) -> bool,
    ) -> Self {
        let mut samples: Vec<([i64; 2], f64)> = Vec::new();
        for face in (0..mesh.faces.len()).filter(|face| is_building(*face)) {
            let [a, b, c] = mesh.triangle(face).map(DVec3::from);
            let steps = ((b - a).length().max((c - a).length()) / (0.5 * cell)).ceil().clamp(1.0, 4096.0) as i32;
            for i in 0..=steps {
                for j in 0..=steps - i {
                    let (u, v) = (f64::from(i) / f64::from(steps), f64::from(j) / f64::from(steps));
                    let at = a + (b - a) * u + (c - a) * v;
                    samples.push((key(at), at.dot(up)));
                }
            }
            let middle = (a + b + c) / 3.0;
            samples.push((key(middle), middle.dot(up)));
            if samples.len() > MAX_SAMPLES {
                highest(&mut samples);
            }
        }
        highest(&mut samples);
        let index = samples.iter().enumerate().map(|(at, (key, _))| (*key, at as u32)).collect();
        let (keys, tops) = samples.into_iter().unzip();
        Self { keys, tops, hues: Vec::new(), index }
    }

    /// The mean colour of the surface within a cell's side below its highest point, as hue.
    fn hues_of(&self, mesh: &Mesh, key: &impl Fn(DVec3) -> [i64; 2], up: DVec3, depth: f64) -> Vec<Hue> {
        let mut sums = vec![[0.0; 3]; self.keys.len()];
        for (vertex, color) in mesh.vertices.iter().zip(&mesh.colors) {
            let at = DVec3::from(*vertex);
            let Some(cell) = self.index.get(&key(at)).map(|cell| *cell as usize) else { continue };
            if self.tops[cell] - at.dot(up) <= depth {
                sums[cell].iter_mut().zip(color).for_each(|(sum, channel)| *sum += f64::from(*channel));
            }
        }
        let hue = |[red, green, blue]: [f64; 3]| [red, blue].map(|other| libm::log((other + 1.0) / (green + 1.0)));
        sums.into_iter().map(hue).collect()
    }

    /// The cell `k` steps from a place.
    fn beside(&self, at: [i64; 2], step: [i64; 2], k: i64) -> Option<usize> {
        self.index.get(&[at[0] + k * step[0], at[1] + k * step[1]]).map(|cell| *cell as usize)
    }

    /// The middle value of every cell and the eight around it: what is narrower than half of that goes, steps stay.
    fn smooth(&self, value: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut around = Vec::with_capacity(9);
        let middle = |at: &[i64; 2]| {
            around.clear();
            around.extend((0..9).filter_map(|k| self.beside(*at, [k / 3 - 1, k % 3 - 1], 1).map(&value)));
            regions::median(&mut around)
        };
        self.keys.iter().map(middle).collect()
    }

    /// Ring by ring, cells without a number take that of the neighbour from which they are least `apart`.
    fn grow(&self, number: &mut [Option<u32>], apart: impl Fn(usize, usize) -> f64) {
        let mut open: Vec<usize> = (0..number.len()).filter(|cell| number[*cell].is_none()).collect();
        loop {
            let like = |cell: usize| {
                let beside = BESIDE.iter().filter_map(|step| self.beside(self.keys[cell], *step, 1));
                let known = beside.filter(|other| number[*other].is_some());
                known.min_by(|a, b| apart(*a, cell).total_cmp(&apart(*b, cell)))
            };
            let taken: Vec<(usize, Option<u32>)> =
                open.iter().filter_map(|cell| like(*cell).map(|other| (*cell, number[other]))).collect();
            if taken.is_empty() {
                return;
            }
            taken.into_iter().for_each(|(cell, found)| number[cell] = found);
            open.retain(|cell| number[*cell].is_none());
        }
    }

    fn pieces(&self, rules: &RoofRules) -> Vec<u32> {
        let mut sets = Sets::new(self.keys.len());
        if rules.step.is_finite() {
            for (cell, region) in regions::regions(self, rules).into_iter().enumerate() {
                sets.join(cell as u32, region);
            }
            sets = self.without_strips(sets, rules);
            self.absorb(&mut sets, rules);
        } else {
            for (cell, at) in self.keys.iter().enumerate() {
                for step in [[1, 0], [0, 1], [1, 1], [1, -1]] {
                    if let Some(other) = self.beside(*at, step, 1) {
                        sets.join(cell as u32, other as u32);
                    }
                }
            }
        }
        let mut number = vec![0; self.keys.len()];
        let mut next = 0;
        (0..self.keys.len())
            .map(|cell| {
                let root = sets.find(cell as u32) as usize;
                if number[root] == 0 {
                    next += 1;
                    number[root] = next;
                }
                number[root]
            })
            .collect()
    }

    /// Roofs too small, or too narrow to hold a square of three cells, dissolve: ring by ring their cells go to the
    /// neighbour of the most similar height. What touches no other roof stays.
    fn without_strips(&self, mut sets: Sets, rules: &RoofRules) -> Sets {
        let own: Vec<u32> = (0..self.keys.len() as u32).map(|cell| sets.find(cell)).collect();
        let mut cells = vec![0u32; own.len()];
        let mut is_wide = vec![false; own.len()];
        for (at, root) in self.keys.iter().zip(&own) {
            cells[*root as usize] += 1;
            let beside = |k: i64| self.index.get(&[at[0] + k / 3 - 1, at[1] + k % 3 - 1]);
            is_wide[*root as usize] |= (0..9).all(|k| beside(k).is_some_and(|cell| own[*cell as usize] == *root));
        }
        let is_roof = |root: u32| {
            is_wide[root as usize] && f64::from(cells[root as usize]) * rules.cell * rules.cell >= rules.min_area
        };
        let mut roof: Vec<Option<u32>> = own.iter().map(|root| is_roof(*root).then_some(*root)).collect();
        self.grow(&mut roof, |a, b| (self.tops[a] - self.tops[b]).abs());
        let mut again = Sets::new(own.len());
        for (cell, number) in roof.into_iter().enumerate() {
            again.join(cell as u32, number.unwrap_or(own[cell]));
        }
        again
    }

    /// Small and enclosed roofs go to the one that they share most border with, the smallest first.
    fn absorb(&self, sets: &mut Sets, rules: &RoofRules) {
        loop {
            let mut sizes: BTreeMap<u32, u32> = BTreeMap::new();
            let mut borders: BTreeMap<u32, BTreeMap<u32, u32>> = BTreeMap::new();
            for (cell, at) in self.keys.iter().enumerate() {
                let own = sets.find(cell as u32);
                *sizes.entry(own).or_default() += 1;
                for step in [[1, 0], [-1, 0], [0, 1], [0, -1]] {
                    let beside = self.index.get(&[at[0] + step[0], at[1] + step[1]]);
                    let other = beside.map_or(u32::MAX, |other| sets.find(*other));
                    if other != own {
                        *borders.entry(own).or_default().entry(other).or_default() += 1;
                    }
                }
            }
            let mut order: Vec<(u32, u32)> = sizes.iter().map(|(root, size)| (*size, *root)).collect();
            order.sort_unstable();
            let mut is_touched: BTreeMap<u32, bool> = BTreeMap::new();
            let mut joined = 0;
            for (size, root) in order {
                let Some(border) = borders.get(&root) else { continue };
                let perimeter: u32 = border.values().sum();
                let most = border.iter().filter(|(other, _)| **other != u32::MAX);
                let Some((other, shared)) = most.max_by_key(|(other, shared)| (**shared, u32::MAX - **other)) else {
                    continue;
                };
                let is_small = f64::from(size) * rules.cell * rules.cell < rules.min_area;
                let is_enclosed = f64::from(*shared) >= ENCLOSED_SHARE * f64::from(perimeter) && sizes[other] > size;
                // What has just grown is measured again in the next round.
                let is_fresh = !is_touched.contains_key(&root) && !is_touched.contains_key(other);
                if (is_small || is_enclosed) && is_fresh {
                    sets.join(root, *other);
                    is_touched.insert(root, true);
                    is_touched.insert(*other, true);
                    joined += 1;
                }
            }
            if joined == 0 {
                break;
            }
        }
    }
}

/// One sample per cell, the highest, in the order of the cells.
fn highest(samples: &mut Vec<([i64; 2], f64)>) {
    samples.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)));
    samples.dedup_by_key(|sample| sample.0);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Roofs as heights over plan, a metre per quad.
    fn town(columns: i64, rows: i64, height: impl Fn(f64, f64) -> Option<f64>) -> Mesh {
        let mut mesh = Mesh::default();
        for (x, y) in (0..rows * 2).flat_map(|y| (0..columns * 2).map(move |x| (x as f64 * 0.5, y as f64 * 0.5))) {
            let Some(z) = height(x + 0.25, y + 0.25) else { continue };
            let first = mesh.vertices.len() as u32;
            let tilt = |dx: f64, dy: f64| height(x + dx, y + dy).filter(|h| (h - z).abs() < 0.4).unwrap_or(z);
            for (dx, dy) in [(0.01, 0.01), (0.49, 0.01), (0.49, 0.49), (0.01, 0.49)] {
                mesh.vertices.push([x + dx, y + dy, tilt(dx, dy)]);
            }
            mesh.faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        mesh
    }

    fn count(mesh: &Mesh, step: f64) -> usize {
        let rules = RoofRules { cell: 0.5, step, flat: 0.03, hue_step: f64::INFINITY, min_area: 10.0 };
        let mut found = roof_pieces(mesh, DVec3::Z, &rules, |_| true).expect("a good cell");
        found.sort_unstable();
        found.dedup();
        found.len()
    }

    #[test]
    fn a_row_of_houses_is_parted_at_steps_but_not_at_ridges_or_chimneys() {
        // Three houses 6 m wide under one long gable, the middle one 0.7 m higher, with a chimney on a party wall.
        let height = |x: f64, y: f64| {
            if (5.6..6.4).contains(&x) && (2.0..3.0).contains(&y) {
                return Some(10.0);
            }
            let base = if (6.0..12.0).contains(&x) { 5.7 } else { 5.0 };
            Some(base + 2.5 - 0.6 * (y - 4.5).abs())
        };
        let mesh = town(18, 9, height);
        assert_eq!(count(&mesh, 0.45), 3);
        assert_eq!(count(&mesh, f64::INFINITY), 1);
    }

    #[test]
    fn roofs_of_one_height_are_parted_by_hue_but_not_by_shade_or_small_things() {
        let mut mesh = town(18, 8, |x, y| {
            let is_chimney = (2.0..3.5).contains(&x) && (2.0..3.5).contains(&y);
            Some(if is_chimney { 7.0 } else { 6.0 })
        });
        let mut paint = |color: fn(f64, f64) -> [u8; 3], hue_step: f64| {
            mesh.colors = mesh.vertices.iter().map(|at| color(at[0], at[1])).collect();
            let rules = RoofRules { cell: 0.5, step: 0.2, flat: 0.03, hue_step, min_area: 10.0 };
            let mut found = roof_pieces(&mesh, DVec3::Z, &rules, |_| true).expect("a good cell");
            found.sort_unstable();
            found.dedup();
            found.len()
        };
        let tiles = |x: f64, y: f64| {
            let is_chimney = (2.0..3.5).contains(&x) && (2.0..3.5).contains(&y);
            if x > 9.2 || is_chimney { [110, 112, 120] } else { [170, 90, 70] }
        };
        assert_eq!(paint(tiles, 0.15), 2);
        assert_eq!(paint(tiles, f64::INFINITY), 1);
        let shade = |x: f64, y: f64| if x + y > 12.0 { [51, 27, 21] } else { [170, 90, 70] };
        assert_eq!(paint(shade, 0.15), 1);
        // A patch of new tiles in the middle of a roof.
        let patch = |x: f64, y: f64| {
            if (6.0..11.0).contains(&x) && (2.0..6.0).contains(&y) { [110, 112, 120] } else { [170, 90, 70] }
        };
        assert_eq!(paint(patch, 0.15), 1);
    }

    #[test]
    fn a_step_that_the_volume_has_rounded_parts_and_a_steep_ridge_does_not() {
        let step = |height: f64| {
            move |x: f64, _: f64| {
                Some(match x {
                    x if x < 8.0 => 6.0,
                    x if x < 9.0 => 6.0 + (x - 8.0) * height,
                    _ => 6.0 + height,
                })
            }
        };
        for height in [0.3, 1.0, 2.5] {
            assert_eq!(count(&town(18, 8, step(height)), 0.2), 2, "a step of {height}");
        }
        assert_eq!(count(&town(18, 8, step(0.1)), 0.2), 1);
        // Ridges on a cell's middle and on its border.
        for ridge in [4.0, 4.25, 4.4] {
            assert_eq!(count(&town(12, 9, |_, y| Some(9.0 - (y - ridge).abs())), 0.2), 1, "ridge at {ridge}");
        }
    }

    #[test]
    fn a_border_that_photographs_have_blurred_parts_roofs_of_two_hues() {
        // Over almost three metres no link from cell to cell is a step of hue; the roofs as wholes are.
        let mut mesh = town(18, 9, |_, _| Some(6.0));
        let blurred = |x: f64| {
            let share = ((x - 7.6) / 2.8).clamp(0.0, 1.0);
            [120.0 + 10.0 * share, 120.0, 120.0 - 9.0 * share].map(|channel: f64| channel.round() as u8)
        };
        mesh.colors = mesh.vertices.iter().map(|at| blurred(at[0])).collect();
        let rules = RoofRules { cell: 0.5, step: 0.2, flat: 0.03, hue_step: 0.12, min_area: 10.0 };
        let found = roof_pieces(&mesh, DVec3::Z, &rules, |_| true).expect("a good cell");
        assert_eq!(found.iter().collect::<std::collections::BTreeSet<_>>().len(), 2);
    }

    #[test]
    fn gaps_part_houses_and_boxes_on_roofs_do_not() {
        let height = |x: f64, y: f64| match (x, y) {
            (x, _) if (8.0..10.0).contains(&x) => None,
            (x, y) if (2.0..6.0).contains(&x) && (2.0..6.0).contains(&y) => Some(9.0),
            _ => Some(6.0),
        };
        assert_eq!(count(&town(18, 8, height), 0.5), 2);
        assert!(
            roof_pieces(
                &Mesh::default(),
                DVec3::Z,
                &RoofRules { cell: 0.0, step: 1.0, flat: 0.1, hue_step: 1.0, min_area: 1.0 },
                |_| true
            )
            .is_err()
        );
    }
}
