//! What masks draw past the foot of a wall: building surface that lies on the ground about it.
//!
//! The ground is known block by block, from what is no building: the level that nearly a third of its surface there lies
//! below, and of the blocks around the lowest such. On a slope that is too low, and less is taken for ground. Only a strip
//! along the rim can be: a roof that goes on where no mask shows it looks like ground too, if no street is near.

use std::collections::{HashMap, HashSet};

use glam::DVec3;
use pgsag_scene::Mesh;
use pgsag_scene::numbers::quantile;

use super::regions::BESIDE;
use super::{Relief, middle, plan_view};
use crate::error::MeshError;

/// When building surface is ground, in scene units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ground {
    /// Side of a cell of plan view: a face, so that no cell of a strip holds a piece of the wall too.
    pub cell: f64,
    /// Above the ground nearby.
    pub height: f64,
    /// Side of a block of plan view.
    pub block: f64,
}

/// Blocks to every side that are nearby.
const REACH: i64 = 4;
/// Width of the strip along the rim of buildings that can be ground, blocks.
const STRIP: f64 = 1.5;
/// Share of the surface of a block that lies below its level.
const LEVEL_SHARE: f64 = 0.3;
/// A block of fewer faces has no level.
const MIN_FACES: usize = 20;

/// `[F]` whether a face for which `is_building` holds is of a cell of plan view whose highest such
/// surface lies on the ground, which the other faces show.
///
/// # Errors
/// A cell that is no length.
pub fn on_ground(
    mesh: &Mesh,
    up: DVec3,
    ground: &Ground,
    is_building: impl Fn(usize) -> bool,
) -> Result<Vec<bool>, MeshError> {
    let cell = ground.cell;
    let (up, key) = plan_view(up, cell)?;
    let relief = Relief::of(mesh, &key, up, cell, &is_building);
    let cells = (ground.block / cell).ceil().max(1.0) as i64;
    let block = |at: &[i64; 2]| at.map(|k| k.div_euclid(cells));

    let own: HashSet<[i64; 2]> = relief.keys.iter().map(block).collect();
    let wanted: HashSet<[i64; 2]> = own.iter().flat_map(nearby).collect();
    let mut heights: HashMap<[i64; 2], Vec<f64>> = HashMap::new();
    for face in (0..mesh.faces.len()).filter(|face| !is_building(*face)) {
        let at = block(&key(middle(mesh, face)));
        if wanted.contains(&at) {
            heights.entry(at).or_default().push(middle(mesh, face).dot(up));
        }
    }
    heights.retain(|_, heights| heights.len() >= MIN_FACES);
    let levels: HashMap<[i64; 2], f64> =
        heights.iter_mut().filter_map(|(at, heights)| Some((*at, quantile(heights, LEVEL_SHARE)?))).collect();
    let lowest = |at: &[i64; 2]| nearby(at).filter_map(|at| levels.get(&at)).copied().reduce(f64::min);
    let level: HashMap<[i64; 2], f64> = own.iter().filter_map(|at| Some((*at, lowest(at)?))).collect();

    let inner = relief.inside((STRIP * ground.block / cell).ceil() as usize);
    let is_low = |k: usize| {
        !inner[k] && level.get(&block(&relief.keys[k])).is_some_and(|level| relief.tops[k] - level < ground.height)
    };
    let is_ground: Vec<bool> = (0..relief.keys.len()).map(is_low).collect();
    let lies = |face: usize| relief.index.get(&key(middle(mesh, face))).is_some_and(|cell| is_ground[*cell as usize]);
    Ok((0..mesh.faces.len()).map(|face| is_building(face) && lies(face)).collect())
}

impl Relief {
    /// `[cells]` whether a cell lies more than so many rings of cells inside of the rim.
    fn inside(&self, rings: usize) -> Vec<bool> {
        let mut inner = vec![true; self.keys.len()];
        let is_rim = |cell: usize| BESIDE.iter().any(|step| self.beside(self.keys[cell], *step, 1).is_none());
        let mut ring: Vec<usize> = (0..self.keys.len()).filter(|cell| is_rim(*cell)).collect();
        for _ in 0..rings {
            ring.iter().for_each(|cell| inner[*cell] = false);
            let mut next: Vec<usize> = Vec::new();
            for step in BESIDE {
                let beside = ring.iter().filter_map(|cell| self.beside(self.keys[*cell], step, 1));
                next.extend(beside.filter(|cell| inner[*cell]));
            }
            next.sort_unstable();
            next.dedup();
            ring = next;
        }
        inner
    }
}

/// A block and those about it.
fn nearby(at: &[i64; 2]) -> impl Iterator<Item = [i64; 2]> {
    let [x, y] = *at;
    (-REACH..=REACH).flat_map(move |i| (-REACH..=REACH).map(move |j| [x + i, y + j]))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use pgsag_scene::Mesh;

    use crate::identity::{Ground, on_ground};

    /// Squares of half a metre over `x` and `y` (metres), at the heights of `z`; whether each face is of a building.
    fn squares(x: f64, y: f64, z: impl Fn(f64, f64) -> (f64, bool)) -> (Mesh, Vec<bool>) {
        let (mut mesh, mut is_building) = (Mesh::default(), Vec::new());
        for i in 0..(2.0 * x) as i32 {
            for j in 0..(2.0 * y) as i32 {
                let (east, north) = (0.5 * f64::from(i), 0.5 * f64::from(j));
                let (up, building) = z(east + 0.25, north + 0.25);
                let first = mesh.vertices.len() as u32;
                // Within its cell.
                let corner = |a: f64, b: f64| [east + a, north + b, up];
                mesh.vertices.extend([corner(0.1, 0.1), corner(0.4, 0.1), corner(0.4, 0.4), corner(0.1, 0.4)]);
                mesh.faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
                is_building.extend([building; 2]);
            }
        }
        (mesh, is_building)
    }

    fn kept((mesh, is_building): &(Mesh, Vec<bool>)) -> Vec<bool> {
        let ground = Ground { cell: 0.5, height: 0.5, block: 2.0 };
        let low = on_ground(mesh, DVec3::Z, &ground, |face| is_building[face]).expect("a good cell");
        low.into_iter().zip(is_building).map(|(low, building)| *building && !low).collect()
    }

    #[test]
    fn the_strip_about_a_house_is_ground_and_its_roof_is_not() {
        // A mask a metre too wide, on ground that rises a little.
        let inside = |x: f64, y: f64, by: f64| x > 8.0 - by && x < 16.0 + by && y > 8.0 - by && y < 16.0 + by;
        let scene = squares(24.0, 24.0, |x, y| {
            let slope = 0.02 * x;
            if inside(x, y, 0.0) { (slope + 5.0, true) } else { (slope, inside(x, y, 1.0)) }
        });
        let kept = kept(&scene);
        for (face, kept) in kept.iter().enumerate() {
            let at = scene.0.triangle(face)[0];
            assert_eq!(*kept, at[2] > 4.0, "{at:?}");
        }
        assert!(kept.iter().any(|kept| *kept));
    }

    #[test]
    fn a_roof_stays_beside_one_that_no_mask_shows_and_where_no_ground_is_known() {
        // One flat roof, its western half unmasked, with streets about it.
        let scene = squares(24.0, 24.0, |x, y| {
            let is_roof = x > 6.0 && y > 6.0 && y < 18.0;
            (if is_roof { 6.0 } else { 0.0 }, is_roof && x > 12.0)
        });
        assert!(kept(&scene) == scene.1);
        // Without a street no more than a strip is lost.
        let scene = squares(40.0, 40.0, |x, _| (6.0, x > 20.0));
        let kept_beside = kept(&scene);
        for (face, kept) in kept_beside.iter().enumerate() {
            let [x, y, _] = scene.0.triangle(face)[0];
            let is_far = x > 28.0;
            assert_eq!(*kept, is_far || x > 23.0 && (3.0..37.0).contains(&y), "{x} {y}");
        }
        let alone = squares(6.0, 6.0, |_, _| (0.1, true));
        assert!(kept(&alone).into_iter().all(|kept| kept));
    }
}
