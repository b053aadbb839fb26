//! Points in polygons, and clouds thinned on a voxel grid.

use std::collections::HashMap;

/// Whether `(x, y)` lies in the polygon (even-odd rule; the last corner joins the first).
pub(crate) fn in_polygon(polygon: &[[f64; 2]], x: f64, y: f64) -> bool {
    let mut inside = false;
    for (at, a) in polygon.iter().enumerate() {
        let b = polygon[(at + 1) % polygon.len()];
        if (a[1] > y) != (b[1] > y) && x < (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1]) + a[0] {
            inside = !inside;
        }
    }
    inside
}

/// One point per occupied voxel, the mean of its points, in the order of their first points. The grid starts half a
/// voxel below the smallest coordinates, as Open3D's does.
pub(crate) fn thinned(points: &[[f64; 3]], voxel: f64) -> Vec<[f64; 3]> {
    let low: [f64; 3] =
        std::array::from_fn(|a| points.iter().map(|p| p[a]).fold(f64::INFINITY, f64::min) - 0.5 * voxel);
    let mut known: HashMap<[i64; 3], usize> = HashMap::new();
    let mut sums: Vec<([f64; 3], f64)> = Vec::new();
    for point in points {
        let key = std::array::from_fn(|a| ((point[a] - low[a]) / voxel).floor() as i64);
        let at = *known.entry(key).or_insert(sums.len());
        if at == sums.len() {
            sums.push(([0.0; 3], 0.0));
        }
        for a in 0..3 {
            sums[at].0[a] += point[a];
        }
        sums[at].1 += 1.0;
    }
    sums.into_iter().map(|(sum, count)| sum.map(|v| v / count)).collect()
}
