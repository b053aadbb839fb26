//! Small holes of a surface are closed with the triangles that bend least (Liepa, Filling Holes in Meshes, 2003, its
//! minimal triangulation): panes of glass, and specks between what two views saw.

use std::collections::{HashMap, HashSet};

use glam::DVec3;
use pgsag_scene::Mesh;

use crate::components::sides;

/// Rims of more corners stay open: the cost grows with their cube.
const MAX_CORNERS: usize = 256;
/// Steps around one vertex before it counts as tangled.
const MAX_FAN: usize = 64;
/// Cosine between the lid and the surface around it, at least: the rim of a loose scrap is no hole.
const MIN_COS: f64 = 0.3;

/// What was closed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Closed {
    /// How many holes.
    pub holes: usize,
    /// Surface that closes them, scene units squared.
    pub area: f64,
}

/// Closes the holes whose rim is no longer than `max_rim` scene units. New faces take building and group of most of the
/// faces along the rim; no vertex is added.
pub fn close_holes(mesh: &mut Mesh, max_rim: f64) -> Closed {
    let open = open_edges(mesh);
    let beside = Beside::new(mesh, &open);
    let mut walked: HashSet<[u32; 2]> = HashSet::with_capacity(open.len());
    let mut closed = Closed::default();
    for (edge, _) in &open {
        for rim in beside.rims(mesh, *edge, max_rim, &mut walked) {
            if let Some(lid) = lid(mesh, &rim, &beside) {
                closed.holes += 1;
                closed.area += lid.iter().map(|face| normal(mesh, *face).length() / 2.0).sum::<f64>();
                attach(mesh, &lid, &rim);
            }
        }
    }
    closed
}

/// Edges of one face alone, as that face turns, with the face; by face.
fn open_edges(mesh: &Mesh) -> Vec<([u32; 2], u32)> {
    let mut open: Vec<([u32; 2], u32)> = sides(mesh)
        .chunk_by(|a, b| a.0 == b.0)
        .filter(|same| same.len() == 1)
        .map(|same| {
            let ([a, b], face) = same[0];
            let is_forward = mesh.faces[face as usize]
                .iter()
                .zip([1, 2, 0])
                .any(|(corner, next)| *corner == a && mesh.faces[face as usize][next] == b);
            (if is_forward { [a, b] } else { [b, a] }, face)
        })
        .collect();
    open.sort_unstable_by_key(|(edge, face)| (*face, *edge));
    open
}

/// An edge of a hole and the face that it belongs to.
type Rim = Vec<([u32; 2], u32)>;

/// Faces by their directed edges, near open edges only.
struct Beside(HashMap<[u32; 2], u32>);

/// Stands for an edge that two faces turn alike around.
const TANGLED: u32 = u32::MAX;

impl Beside {
    fn new(mesh: &Mesh, open: &[([u32; 2], u32)]) -> Self {
        let mut is_rim = vec![false; mesh.vertices.len()];
        open.iter().flat_map(|(edge, _)| edge).for_each(|vertex| is_rim[*vertex as usize] = true);
        let mut faces = HashMap::with_capacity(6 * open.len());
        for (face, corners) in (0u32..).zip(&mesh.faces).filter(|(_, f)| f.iter().any(|v| is_rim[*v as usize])) {
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                faces.entry([corners[a], corners[b]]).and_modify(|known| *known = TANGLED).or_insert(face);
            }
        }
        Self(faces)
    }

    /// The simple closed walks along open edges that `first` leads to, those no longer than `max_rim`. A walk that meets
    /// a corner again is pinched there: what lies between is a rim of its own.
    fn rims(&self, mesh: &Mesh, first: [u32; 2], max_rim: f64, walked: &mut HashSet<[u32; 2]>) -> Vec<Rim> {
        let place = |vertex: u32| DVec3::from(mesh.vertices[vertex as usize]);
        let length = |rim: &Rim| rim.iter().map(|([a, b], _)| place(*a).distance(place(*b))).sum::<f64>();
        let (mut rims, mut path, mut position, mut edge) = (Vec::new(), Rim::new(), HashMap::new(), first);
        while walked.insert(edge) {
            let Some(face) = self.0.get(&edge).filter(|face| **face != TANGLED) else { break };
            position.insert(edge[0], path.len());
            path.push((edge, *face));
            if let Some(from) = position.get(&edge[1]) {
                let rim = path.split_off(*from);
                rim.iter().for_each(|(edge, _)| {
                    position.remove(&edge[0]);
                });
                if (3..=MAX_CORNERS).contains(&rim.len()) && length(&rim) <= max_rim {
                    rims.push(rim);
                }
            }
            let Some(next) = self.next(mesh, edge) else { break };
            edge = next;
        }
        rims
    }

    /// The open edge that leaves where `edge` ends, around the same fan of faces.
    fn next(&self, mesh: &Mesh, edge: [u32; 2]) -> Option<[u32; 2]> {
        let [_, hub] = edge;
        let mut at = edge;
        for _ in 0..MAX_FAN {
            let face = *self.0.get(&at).filter(|face| **face != TANGLED)?;
            let tip = mesh.faces[face as usize].into_iter().find(|corner| !at.contains(corner))?;
            match self.0.get(&[tip, hub]) {
                None => return Some([hub, tip]),
                Some(_) => at = [tip, hub],
            }
        }
        None
    }

    fn is_edge(&self, a: u32, b: u32) -> bool {
        self.0.contains_key(&[a, b]) || self.0.contains_key(&[b, a])
    }
}

/// Twice the area, along the normal.
fn normal(mesh: &Mesh, [a, b, c]: [u32; 3]) -> DVec3 {
    let [a, b, c] = [a, b, c].map(|vertex| DVec3::from(mesh.vertices[vertex as usize]));
    (b - a).cross(c - a)
}

/// How bad a triangulation is: its sharpest bend as 1 − cos, then its area.
#[derive(Clone, Copy, PartialEq, PartialOrd)]
struct Cost(f64, f64);

const IMPOSSIBLE: Cost = Cost(f64::INFINITY, f64::INFINITY);

/// The cheapest triangulation of every part of a rim: `[n x n]`, of the part from corner i to corner k.
struct Table {
    count: usize,
    cost: Vec<Cost>,
    tip: Vec<usize>,
    /// Unit normal of the triangle on the chord (i, k), or of the face beyond the rim.
    normal: Vec<DVec3>,
}

/// Triangles that close a rim; `None` where none fit.
fn lid(mesh: &Mesh, rim: &Rim, beside: &Beside) -> Option<Vec<[u32; 3]>> {
    // The lid turns the other way round.
    let corners: Vec<u32> = rim.iter().rev().map(|(edge, _)| edge[1]).collect();
    let table = Table::new(mesh, rim, &corners, beside);
    let n = corners.len();
    if table.cost[n - 1].0.is_infinite() {
        return None;
    }
    let (mut faces, mut parts) = (Vec::with_capacity(n - 2), vec![(0, n - 1)]);
    while let Some((i, k)) = parts.pop() {
        if k > i + 1 {
            let tip = table.tip[i * n + k];
            faces.push([corners[i], corners[tip], corners[k]]);
            parts.extend([(i, tip), (tip, k)]);
        }
    }
    let lid: DVec3 = faces.iter().map(|face| normal(mesh, *face)).sum();
    let around: DVec3 = rim.iter().map(|(_, face)| normal(mesh, mesh.faces[*face as usize])).sum();
    (lid.normalize_or_zero().dot(around.normalize_or_zero()) >= MIN_COS).then_some(faces)
}

impl Table {
    fn new(mesh: &Mesh, rim: &Rim, corners: &[u32], beside: &Beside) -> Self {
        let n = corners.len();
        let unit = |face: [u32; 3]| normal(mesh, face).normalize_or_zero();
        let mut table =
            Self { count: n, cost: vec![IMPOSSIBLE; n * n], tip: vec![0; n * n], normal: vec![DVec3::ZERO; n * n] };
        // Of the edge from corner i to i + 1; the last one closes.
        let beyond: Vec<DVec3> = rim.iter().rev().map(|(_, face)| unit(mesh.faces[*face as usize])).collect();
        for i in 0..n - 1 {
            table.cost[i * n + i + 1] = Cost(0.0, 0.0);
            table.normal[i * n + i + 1] = beyond[i];
        }
        for span in 2..n {
            for i in 0..n - span {
                let last = (span == n - 1).then(|| beyond[n - 1]);
                table.settle(mesh, corners, i, i + span, last, beside);
            }
        }
        table
    }

    /// The best tip over the chord from corner `i` to corner `k`; `last`: the face beyond the chord, where it closes the rim.
    fn settle(&mut self, mesh: &Mesh, corners: &[u32], i: usize, k: usize, last: Option<DVec3>, beside: &Beside) {
        let n = self.count;
        if last.is_none() && beside.is_edge(corners[i], corners[k]) {
            return;
        }
        let mut best = IMPOSSIBLE;
        for tip in i + 1..k {
            let (left, right) = (self.cost[i * n + tip], self.cost[tip * n + k]);
            if left.0.is_infinite() || right.0.is_infinite() {
                continue;
            }
            let double = normal(mesh, [corners[i], corners[tip], corners[k]]);
            let unit = double.normalize_or_zero();
            let bend = |other: DVec3| 1.0 - unit.dot(other);
            let own = bend(self.normal[i * n + tip]).max(bend(self.normal[tip * n + k])).max(last.map_or(0.0, bend));
            let cost = Cost(own.max(left.0).max(right.0), left.1 + right.1 + 0.5 * double.length());
            if cost < best {
                best = cost;
                self.tip[i * n + k] = tip;
                self.normal[i * n + k] = unit;
            }
        }
        self.cost[i * n + k] = best;
    }
}

/// Adds the lid, of the building and the group that most of the rim is of.
fn attach(mesh: &mut Mesh, lid: &[[u32; 3]], rim: &Rim) {
    if mesh.closed.is_empty() {
        mesh.closed = vec![0; mesh.faces.len()];
    }
    mesh.faces.extend_from_slice(lid);
    mesh.closed.extend(std::iter::repeat_n(1, lid.len()));
    for labels in [&mut mesh.buildings, &mut mesh.groups].into_iter().filter(|labels| !labels.is_empty()) {
        let mut around: Vec<u32> = rim.iter().map(|(_, face)| labels[*face as usize]).collect();
        around.sort_unstable();
        let most = around.chunk_by(|a, b| a == b).max_by_key(|same| (same.len(), u32::MAX - same[0]));
        let label = most.map_or(0, |same| same[0]);
        labels.extend(std::iter::repeat_n(label, lid.len()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seams::seams;

    /// A wall of `side` x `side` squares of two triangles with a round pane missing, bent upwards by `bend` from its middle on.
    fn wall(side: u32, pane: f64, bend: f64) -> Mesh {
        let mut mesh = Mesh::default();
        let middle = f64::from(side) / 2.0;
        for y in 0..=side {
            for x in 0..=side {
                let (x, y) = (f64::from(x), f64::from(y));
                mesh.vertices.push([x, y, bend * (x - middle).max(0.0)]);
            }
        }
        for y in 0..side {
            for x in 0..side {
                let at = y * (side + 1) + x;
                let away = libm::hypot(f64::from(x) + 0.5 - middle, f64::from(y) + 0.5 - middle);
                if away > pane {
                    let (right, up) = (at + 1, at + side + 1);
                    mesh.faces.extend([[at, right, up], [right, up + 1, up]]);
                    mesh.groups.extend([1 + u32::from(x >= 2 * side / 3); 2]);
                }
            }
        }
        mesh
    }

    fn area(mesh: &Mesh) -> f64 {
        mesh.faces.iter().map(|face| normal(mesh, *face).length() / 2.0).sum()
    }

    #[test]
    fn a_pane_is_closed_flat_and_the_wall_stays_open_around() {
        let mut mesh = wall(20, 3.2, 0.0);
        let before = (area(&mesh), mesh.vertices.len());
        let closed = close_holes(&mut mesh, 40.0);
        assert_eq!(closed.holes, 1);
        assert!((area(&mesh) - 400.0).abs() < 1e-9, "{} of 400", area(&mesh));
        assert!((before.0 + closed.area - 400.0).abs() < 1e-9);
        assert_eq!(mesh.vertices.len(), before.1, "no vertex is added");
        assert!(mesh.faces.iter().all(|face| normal(&mesh, *face).z >= 0.0), "all look one way");
        assert_eq!(mesh.groups.len(), mesh.faces.len());
        assert!(mesh.groups[mesh.faces.len() - 4..].iter().all(|group| *group == 1));
        // The wall's own rim, 80 long, is longer than 40; with more allowed it is still no hole.
        assert_eq!(close_holes(&mut mesh, 1000.0), Closed::default());
    }

    #[test]
    fn every_edge_of_a_closed_hole_has_two_faces() {
        for bend in [0.0, 0.5, 1.0] {
            let mut mesh = wall(16, 2.6, bend);
            assert_eq!(close_holes(&mut mesh, 40.0).holes, 1);
            let outer = open_edges(&mesh);
            assert_eq!(outer.len(), 64, "only the wall's own rim is open");
            // A lid over a bent wall stays within its two planes.
            let flat = 256.0 / 2.0 * (1.0 + (1.0 + bend * bend).sqrt());
            assert!((area(&mesh) - flat).abs() < 0.02 * flat, "{} and {flat}", area(&mesh));
        }
    }

    #[test]
    fn long_rims_and_pinched_ones_stay() {
        let mut mesh = wall(20, 3.2, 0.0);
        assert_eq!(close_holes(&mut mesh, 10.0), Closed::default());
        // Two missing squares that meet at a corner are two holes.
        let mut mesh = wall(8, 0.0, 0.0);
        let keep =
            |face: &usize| ![2 * (3 * 8 + 3), 2 * (3 * 8 + 3) + 1, 2 * (4 * 8 + 4), 2 * (4 * 8 + 4) + 1].contains(face);
        let kept: Vec<[u32; 3]> = (0..mesh.faces.len()).filter(keep).map(|face| mesh.faces[face]).collect();
        mesh.faces = kept;
        mesh.groups.clear();
        assert_eq!(close_holes(&mut mesh, 6.0).holes, 2);
        assert!((area(&mesh) - 64.0).abs() < 1e-9);
    }

    #[test]
    fn seams_are_closed_with_the_holes_along_them() {
        let mut mesh = wall(20, 3.2, 0.0);
        mesh.buildings = mesh.faces.iter().map(|face| u32::from(face[0] % 21 >= 10)).collect();
        let before = seams(&mesh, 1.0);
        close_holes(&mut mesh, 40.0);
        let after = seams(&mesh, 1.0);
        assert!(after.open_share < before.open_share, "{before:?} {after:?}");
    }
}
