//! Edges inside of a building mask, where normals on the two sides have nothing to do with one another: between two
//! buildings (from instance masks) and at height steps (from the depth of the coarse points). Method 3.3.

use pgsag_scene::Map;

use crate::surface::Seen;

/// A step is larger than so many times what the slope beside it predicts …
const SLOPE_FACTOR: f64 = 3.0;
/// … and than so many distances between points, since the buffer's squares are rough by one.
const STEP_SPACINGS: f64 = 3.0;

/// Pixels of `building` within `band_px` of an inner edge, at the size of `building`. `instances`, where known, has the
/// same size (0: none); `spacing` is the distance between the points of the buffer, scene units.
#[must_use]
pub fn inner_edges(
    building: &Map<bool>,
    seen: &Seen,
    spacing: f64,
    instances: Option<&Map<u16>>,
    band_px: f32,
) -> Map<bool> {
    let mut seeds = depth_steps(seen, spacing).resized_nearest(building.width, building.height);
    if let Some(instances) = instances.filter(|map| (map.width, map.height) == (building.width, building.height)) {
        mark_borders(instances, &mut seeds);
    }
    // The edge runs between seeds, whose outer sides are one pixel away from it.
    let near = crate::distance::signed_distance(&seeds);
    let values =
        near.values.iter().zip(&building.values).map(|(d, is_in)| *is_in && *d + 1.0 < band_px.max(1.0)).collect();
    Map { width: building.width, height: building.height, values }
}

/// The pixels on both sides of every border between two numbers.
fn mark_borders(instances: &Map<u16>, seeds: &mut Map<bool>) {
    let width = instances.width as usize;
    for at in 0..instances.values.len() {
        let right = (at % width + 1 < width).then(|| at + 1);
        let below = Some(at + width).filter(|below| *below < instances.values.len());
        for other in right.into_iter().chain(below) {
            let (a, b) = (instances.values[at], instances.values[other]);
            if a != b && a > 0 && b > 0 {
                (seeds.values[at], seeds.values[other]) = (true, true);
            }
        }
    }
}

/// The pixels on both sides of every step of depth, in the buffer.
fn depth_steps(seen: &Seen, spacing: f64) -> Map<bool> {
    let (width, height) = (seen.depth.width as usize, seen.depth.height as usize);
    let mut steps = Map::filled(seen.depth.width, seen.depth.height, false);
    let depth = |at: usize| Some(f64::from(seen.depth.values[at])).filter(|z| z.is_finite());
    let least = STEP_SPACINGS * spacing;
    let mut mark = |before: Option<usize>, a: usize, b: usize, after: Option<usize>| {
        let (Some(za), Some(zb)) = (depth(a), depth(b)) else { return };
        let slope = |other: Option<usize>, z: f64| other.and_then(depth).map(|there| (there - z).abs());
        let slopes = [slope(before, za), slope(after, zb)];
        let predicted = slopes.into_iter().flatten().fold(f64::INFINITY, f64::min);
        let predicted = if predicted.is_finite() { predicted } else { 0.0 };
        if (za - zb).abs() > least.max(SLOPE_FACTOR * predicted) {
            (steps.values[a], steps.values[b]) = (true, true);
        }
    };
    for y in 0..height {
        for x in 0..width {
            let at = y * width + x;
            if x + 1 < width {
                mark((x > 0).then(|| at - 1), at, at + 1, (x + 2 < width).then(|| at + 2));
            }
            if y + 1 < height {
                mark((y > 0).then(|| at - width), at, at + width, (y + 2 < height).then(|| at + 2 * width));
            }
        }
    }
    steps
}

#[cfg(test)]
mod tests {
    use pgsag_scene::Pinhole;

    use super::*;

    const WIDTH: u32 = 40;
    const HEIGHT: u32 = 12;

    fn seen(depth: impl Fn(u32) -> f32) -> Seen {
        let camera = Pinhole { width: WIDTH, height: HEIGHT, fx: 50.0, fy: 50.0, cx: 20.0, cy: 6.0 };
        let values = (0..WIDTH * HEIGHT).map(|at| depth(at % WIDTH)).collect();
        Seen { camera, point: Map::filled(WIDTH, HEIGHT, 0), depth: Map { width: WIDTH, height: HEIGHT, values } }
    }

    fn row(edges: &Map<bool>) -> Vec<u32> {
        (0..WIDTH).filter(|x| edges.at(*x, 5)).collect()
    }

    #[test]
    fn a_step_is_an_edge_and_a_slope_is_none() {
        let all = Map::filled(WIDTH, HEIGHT, true);
        // A steep roof, then a house three lower, from x = 25 on.
        let found =
            inner_edges(&all, &seen(|x| 40.0 + 0.5 * x as f32 + if x < 25 { 0.0 } else { 3.0 }), 0.1, None, 2.0);
        assert_eq!(row(&found), [23, 24, 25, 26]);
        let slope = inner_edges(&all, &seen(|x| 40.0 + 0.5 * x as f32), 0.1, None, 2.0);
        assert!(!slope.values.contains(&true));
        // What nobody sees is no step, and half a spacing is roughness.
        let holes = inner_edges(&all, &seen(|x| if x % 7 == 0 { f32::INFINITY } else { 40.0 }), 0.1, None, 2.0);
        assert!(!holes.values.contains(&true));
        let rough = inner_edges(&all, &seen(|x| 40.0 + 0.05 * (x % 2) as f32), 0.1, None, 2.0);
        assert!(!rough.values.contains(&true));
    }

    #[test]
    fn two_instances_meet_at_an_edge_inside_of_the_mask_only() {
        let mut building = Map::filled(WIDTH, HEIGHT, true);
        (0..WIDTH).for_each(|x| building.set(x, 0, false));
        let number = |x: u32| if x < 4 { 0 } else { 1 + u16::from(x >= 20) };
        let values = (0..WIDTH * HEIGHT).map(|at| number(at % WIDTH)).collect();
        let instances = Map { width: WIDTH, height: HEIGHT, values };
        let found = inner_edges(&building, &seen(|_| 40.0), 0.1, Some(&instances), 2.0);
        assert_eq!(row(&found), [18, 19, 20, 21], "where a house meets the garden the mask has its own band");
        assert!((0..WIDTH).all(|x| !found.at(x, 0)));
    }
}
