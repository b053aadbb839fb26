//! Outlines of buildings in plan view: the cells that their faces cover, traced and smoothed.

use std::collections::{BTreeMap, BTreeSet};

use pgsag_scene::Mesh;
use serde_json::{Value, json};

type Corner = [i64; 2];

/// The outline of a mesh seen along z as GeoJSON geometry, from cells of side `cell` (scene units).
#[must_use]
pub fn outline(mesh: &Mesh, cell: f64) -> Value {
    let mut rings: Vec<Vec<[f64; 2]>> = trace(&covered(mesh, cell))
        .into_iter()
        .map(|ring| smoothed(&ring.iter().map(|corner| corner.map(|c| c as f64 * cell)).collect::<Vec<_>>(), cell))
        .filter(|ring| ring.len() >= 3)
        .collect();
    rings.sort_by(|a, b| signed_area(b).total_cmp(&signed_area(a)));
    let (outer, holes): (Vec<_>, Vec<_>) = rings.into_iter().partition(|ring| signed_area(ring) > 0.0);
    let mut polygons: Vec<Vec<Vec<[f64; 2]>>> = outer.into_iter().map(|ring| vec![ring]).collect();
    for hole in holes {
        // The smallest ring around it; rings are sorted by area.
        if let Some(home) = polygons.iter_mut().rev().find(|polygon| is_inside(&polygon[0], hole[0])) {
            home.push(hole);
        }
    }
    for ring in polygons.iter_mut().flatten() {
        ring.push(ring[0]);
    }
    json!({"type": "MultiPolygon", "coordinates": polygons})
}

/// Cells that faces touch.
fn covered(mesh: &Mesh, cell: f64) -> BTreeSet<Corner> {
    let mut cells = BTreeSet::new();
    for face in 0..mesh.faces.len() {
        let [a, b, c] = mesh.triangle(face).map(|p| [p[0] / cell, p[1] / cell]);
        let reach = |p: [f64; 2], q: [f64; 2]| (p[0] - q[0]).abs().max((p[1] - q[1]).abs());
        let steps = (2.0 * reach(a, b).max(reach(a, c))).ceil().clamp(1.0, 4096.0) as usize;
        for i in 0..=steps {
            for j in 0..=steps - i {
                let (u, v) = (i as f64 / steps as f64, j as f64 / steps as f64);
                cells.insert(std::array::from_fn(|k| (a[k] + (b[k] - a[k]) * u + (c[k] - a[k]) * v).floor() as i64));
            }
        }
    }
    cells
}

/// Rings of cell corners, the covered side on the left: outer rings run counter-clockwise, holes clockwise.
fn trace(cells: &BTreeSet<Corner>) -> Vec<Vec<Corner>> {
    let mut next: BTreeMap<Corner, Vec<Corner>> = BTreeMap::new();
    for &[x, y] in cells {
        let sides = [
            ([x, y - 1], [x, y], [x + 1, y]),
            ([x + 1, y], [x + 1, y], [x + 1, y + 1]),
            ([x, y + 1], [x + 1, y + 1], [x, y + 1]),
            ([x - 1, y], [x, y + 1], [x, y]),
        ];
        for (beside, from, to) in sides {
            if !cells.contains(&beside) {
                next.entry(from).or_default().push(to);
            }
        }
    }
    let mut rings = Vec::new();
    while let Some((&start, _)) = next.first_key_value() {
        let mut ring = vec![start];
        let (mut at, mut came) = (start, [0, 0]);
        while let Some(choices) = next.get_mut(&at) {
            // Where two cells meet at a corner, the left turn stays with the cell one came along.
            let turn = |to: &Corner| came[0] * (to[1] - at[1]) - came[1] * (to[0] - at[0]);
            let best = (0..choices.len()).max_by_key(|i| turn(&choices[*i])).unwrap_or(0);
            let to = choices.swap_remove(best);
            if choices.is_empty() {
                next.remove(&at);
            }
            came = [to[0] - at[0], to[1] - at[1]];
            at = to;
            if at == start {
                break;
            }
            ring.push(at);
        }
        rings.push(ring);
    }
    rings
}

/// Douglas-Peucker on both halves of a ring, then without corners that do not turn.
fn smoothed(ring: &[[f64; 2]], cell: f64) -> Vec<[f64; 2]> {
    let distance = |p: [f64; 2], q: [f64; 2]| libm::hypot(p[0] - q[0], p[1] - q[1]);
    let Some(far) = (0..ring.len()).max_by(|a, b| distance(ring[0], ring[*a]).total_cmp(&distance(ring[0], ring[*b])))
    else {
        return Vec::new();
    };
    let mut second = ring[far..].to_vec();
    second.push(ring[0]);
    let mut kept = vec![ring[0]];
    simplify(&ring[..=far], 0.9 * cell, &mut kept);
    simplify(&second, 0.9 * cell, &mut kept);
    kept.pop();
    kept
}

/// Appends all but the first corner of the simplified line.
fn simplify(line: &[[f64; 2]], tolerance: f64, kept: &mut Vec<[f64; 2]>) {
    let (Some(&first), Some(&last)) = (line.first(), line.last()) else { return };
    let along = [last[0] - first[0], last[1] - first[1]];
    let length = libm::hypot(along[0], along[1]).max(1e-300);
    let off = |p: &[f64; 2]| ((p[0] - first[0]) * along[1] - (p[1] - first[1]) * along[0]).abs() / length;
    let worst = (1..line.len().saturating_sub(1)).max_by(|a, b| off(&line[*a]).total_cmp(&off(&line[*b])));
    match worst {
        Some(at) if off(&line[at]) > tolerance => {
            simplify(&line[..=at], tolerance, kept);
            simplify(&line[at..], tolerance, kept);
        }
        _ => kept.push(last),
    }
}

fn signed_area(ring: &[[f64; 2]]) -> f64 {
    let next = ring.iter().cycle().skip(1);
    0.5 * ring.iter().zip(next).map(|(p, q)| p[0] * q[1] - q[0] * p[1]).sum::<f64>()
}

fn is_inside(ring: &[[f64; 2]], p: [f64; 2]) -> bool {
    let next = ring.iter().cycle().skip(1);
    let crossings = ring
        .iter()
        .zip(next)
        .filter(|(a, b)| (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
    crossings.count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plate(mesh: &mut Mesh, [x0, y0, x1, y1]: [f64; 4]) {
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend([[x0, y0, 1.0], [x1, y0, 1.0], [x1, y1, 2.0], [x0, y1, 2.0]]);
        mesh.faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }

    #[test]
    fn a_courtyard_is_a_hole_and_a_shed_a_polygon_of_its_own() {
        let mut mesh = Mesh::default();
        // Sides off the grid lines, so that rounding does not decide.
        for part in [
            [0.1, 0.1, 8.9, 1.9],
            [0.1, 7.1, 8.9, 8.9],
            [0.1, 0.1, 1.9, 8.9],
            [7.1, 0.1, 8.9, 8.9],
            [20.1, 0.1, 22.9, 2.9],
        ] {
            plate(&mut mesh, part);
        }
        let found = outline(&mesh, 1.0);
        let polygons = found["coordinates"].as_array().expect("polygons");
        assert_eq!(polygons.len(), 2);
        assert_eq!(polygons[0].as_array().map(Vec::len), Some(2), "outer ring and courtyard");
        assert_eq!(polygons[0][0].as_array().map(Vec::len), Some(5), "four corners, closed: {found}");
        assert_eq!(polygons[1].as_array().map(Vec::len), Some(1));
    }

    #[test]
    fn nothing_has_no_outline() {
        assert_eq!(outline(&Mesh::default(), 1.0)["coordinates"], json!([]));
    }
}
