//! Connected parts of a mesh: crumbs are swept out (and counted), buildings are told apart in plan view.

use std::collections::HashMap;

use glam::DVec3;
use pgsag_scene::Mesh;
use serde::{Deserialize, Serialize};

use crate::error::MeshError;

/// What is too small to be a surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ComponentOptions {
    /// Parts of less surface are dropped, scene units squared (method 3.8: 2 square metres).
    pub min_area: f64,
    /// Parts of fewer faces are dropped.
    pub min_faces: usize,
}

impl Default for ComponentOptions {
    fn default() -> Self {
        Self { min_area: 2.0, min_faces: 50 }
    }
}

/// A part that was dropped.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dropped {
    /// How many faces it had.
    pub faces: usize,
    /// Scene units squared.
    pub area: f64,
    /// Mean of its faces' centres, world frame.
    pub center: [f64; 3],
}

/// Sets that grow together; the smallest member stands for its set.
pub(crate) struct Sets(Vec<u32>);

impl Sets {
    pub(crate) fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    pub(crate) fn find(&mut self, mut at: u32) -> u32 {
        while self.0[at as usize] != at {
            self.0[at as usize] = self.0[self.0[at as usize] as usize];
            at = self.0[at as usize];
        }
        at
    }

    pub(crate) fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

/// The three edges of every face, the smaller vertex first, with the face; the same edges beside one another.
pub(crate) fn sides(mesh: &Mesh) -> Vec<([u32; 2], u32)> {
    let mut sides: Vec<([u32; 2], u32)> = Vec::with_capacity(3 * mesh.faces.len());
    for (face, corners) in (0u32..).zip(&mesh.faces) {
        for (a, b) in [(0, 1), (1, 2), (2, 0)] {
            let (a, b) = (corners[a], corners[b]);
            sides.push(([a.min(b), a.max(b)], face));
        }
    }
    sides.sort_unstable();
    sides
}

/// `[F]` Number of the connected part (measured faces that share vertices) of every face, from 0 in the order of first faces;
/// a face that closes a gap holds nothing together, and is of the part of its first corner.
#[must_use]
pub fn label_components(mesh: &Mesh) -> Vec<u32> {
    let mut sets = Sets::new(mesh.vertices.len());
    for (_, face) in mesh.faces.iter().enumerate().filter(|(at, _)| mesh.is_measured(*at)) {
        sets.join(face[0], face[1]);
        sets.join(face[0], face[2]);
    }
    let mut number = vec![u32::MAX; mesh.vertices.len()];
    let mut next = 0;
    mesh.faces
        .iter()
        .map(|face| {
            let root = sets.find(face[0]) as usize;
            if number[root] == u32::MAX {
                number[root] = next;
                next += 1;
            }
            number[root]
        })
        .collect()
}

/// The mesh without its small parts, and what was dropped, largest first. Where gaps are to be closed the faces of small
/// parts stay, no longer as measured ones: what closes a gap goes on beyond a crumb that lies in it.
#[must_use]
pub fn drop_small(mut mesh: Mesh, options: &ComponentOptions) -> (Mesh, Vec<Dropped>) {
    let labels = label_components(&mesh);
    let parts = measure(&mesh, &labels);
    // Parts of no measured face are what gaps are closed with.
    let is_small = |part: &Dropped| part.area < options.min_area || part.faces < options.min_faces;
    let small: Vec<bool> = parts.iter().map(|part| part.faces > 0 && is_small(part)).collect();
    let mut dropped: Vec<Dropped> =
        parts.iter().zip(&small).filter(|(_, small)| **small).map(|(part, _)| *part).collect();
    dropped.sort_by(|a, b| b.area.total_cmp(&a.area));
    if !mesh.closed.is_empty() {
        for (closed, label) in mesh.closed.iter_mut().zip(&labels) {
            *closed = (*closed).max(u32::from(small[*label as usize]));
        }
        return (mesh, dropped);
    }
    (keep_faces(&mesh, |face| !small[labels[face] as usize]), dropped)
}

/// The `count` parts with the most surface.
#[must_use]
pub fn largest(mesh: &Mesh, count: usize) -> Mesh {
    let labels = label_components(mesh);
    let parts = measure(mesh, &labels);
    let mut order: Vec<usize> = (0..parts.len()).collect();
    order.sort_by(|a, b| parts[*b].area.total_cmp(&parts[*a].area));
    let mut keep = vec![false; parts.len()];
    order.iter().take(count).for_each(|part| keep[*part] = true);
    keep_faces(mesh, |face| keep[labels[face] as usize])
}

/// Size of every labelled part, measured faces alone.
fn measure(mesh: &Mesh, labels: &[u32]) -> Vec<Dropped> {
    let count = labels.iter().max().map_or(0, |last| *last as usize + 1);
    let mut parts = vec![Dropped { faces: 0, area: 0.0, center: [0.0; 3] }; count];
    for (face, label) in labels.iter().enumerate().filter(|(face, _)| mesh.is_measured(*face)) {
        let [a, b, c] = mesh.triangle(face).map(DVec3::from);
        let part = &mut parts[*label as usize];
        part.faces += 1;
        part.area += 0.5 * (b - a).cross(c - a).length();
        part.center = (DVec3::from(part.center) + (a + b + c) / 3.0).into();
    }
    for part in &mut parts {
        part.center = part.center.map(|v| v / part.faces.max(1) as f64);
    }
    parts
}

/// The faces for which `keep` holds, with the vertices they use, in their order.
#[must_use]
pub fn keep_faces(mesh: &Mesh, keep: impl Fn(usize) -> bool) -> Mesh {
    let faces = (0..mesh.faces.len() as u32).filter(|face| keep(*face as usize));
    pick_faces(mesh, faces, &mut vec![u32::MAX; mesh.vertices.len()])
}

/// The given faces with the vertices they use, in their order. `renamed` must be `u32::MAX` for every vertex of `mesh`,
/// and is so again afterwards: many picks of one mesh share it.
pub(crate) fn pick_faces(mesh: &Mesh, faces: impl IntoIterator<Item = u32>, renamed: &mut [u32]) -> Mesh {
    let mut kept = Mesh::default();
    let mut used = Vec::new();
    for at in faces {
        kept.faces.push(mesh.faces[at as usize].map(|v| {
            let name = &mut renamed[v as usize];
            if *name == u32::MAX {
                *name = used.len() as u32;
                used.push(v);
            }
            *name
        }));
        kept.buildings.extend(mesh.buildings.get(at as usize));
        kept.groups.extend(mesh.groups.get(at as usize));
        kept.closed.extend(mesh.closed.get(at as usize));
    }
    for v in used {
        renamed[v as usize] = u32::MAX;
        kept.vertices.push(mesh.vertices[v as usize]);
        kept.colors.extend(mesh.colors.get(v as usize));
    }
    kept
}

/// `[F]` Which connected piece of plan view every face of a building belongs to, from 1 in the order of the cells;
/// 0 for faces that `is_building` does not hold for. Pieces are connected where cells of side `cell` (scene units)
/// touch, corners included, so a gap wider than two cells always parts them.
///
/// # Errors
/// A cell that is no length, or so small that the map would not fit.
pub fn plan_pieces(
    mesh: &Mesh,
    up: DVec3,
    cell: f64,
    is_building: impl Fn(usize) -> bool,
) -> Result<Vec<u32>, MeshError> {
    if !(cell > 0.0 && cell.is_finite()) {
        return Err(MeshError::Option { name: "cell", value: cell, allowed: "greater than 0" });
    }
    let (east, north) = up.normalize_or(DVec3::Z).any_orthonormal_pair();
    let key = |p: DVec3| [(p.dot(east) / cell).floor() as i64, (p.dot(north) / cell).floor() as i64];
    let mut cells: Vec<[i64; 2]> = Vec::new();
    for face in (0..mesh.faces.len()).filter(|face| is_building(*face)) {
        let [a, b, c] = mesh.triangle(face).map(DVec3::from);
        let steps = ((b - a).length().max((c - a).length()) / (0.5 * cell)).ceil().clamp(1.0, 4096.0) as i32;
        for i in 0..=steps {
            for j in 0..=steps - i {
                let (u, v) = (f64::from(i) / f64::from(steps), f64::from(j) / f64::from(steps));
                cells.push(key(a + (b - a) * u + (c - a) * v));
            }
        }
        if cells.len() > 1 << 20 {
            cells.sort_unstable();
            cells.dedup();
        }
    }
    cells.sort_unstable();
    cells.dedup();
    let index: HashMap<[i64; 2], u32> = cells.iter().enumerate().map(|(at, key)| (*key, at as u32)).collect();
    let mut sets = Sets::new(cells.len());
    for (at, [x, y]) in cells.iter().enumerate() {
        for beside in [[x - 1, y - 1], [x - 1, *y], [x - 1, y + 1], [*x, y - 1]] {
            if let Some(other) = index.get(&beside) {
                sets.join(at as u32, *other);
            }
        }
    }
    let mut number = vec![0; cells.len()];
    let mut next = 0;
    for at in 0..cells.len() as u32 {
        let root = sets.find(at) as usize;
        if number[root] == 0 {
            next += 1;
            number[root] = next;
        }
    }
    let mut piece = |face: usize| {
        let corner = key(DVec3::from(mesh.triangle(face)[0]));
        index.get(&corner).map_or(0, |at| number[sets.find(*at) as usize])
    };
    Ok((0..mesh.faces.len()).map(|face| if is_building(face) { piece(face) } else { 0 }).collect())
}

#[cfg(test)]
mod tests;
