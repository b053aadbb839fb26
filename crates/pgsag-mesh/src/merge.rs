//! Many meshes into one: the surfaces of cubes are sewn together where their vertices are equal bit for bit.

use std::collections::BTreeMap;

use glam::DVec3;
use hashbrown::HashTable;
use hashbrown::hash_table::Entry;
use pgsag_scene::Mesh;
use pgsag_scene::numbers::SplitMix64;
use rayon::prelude::*;

use crate::components::pick_faces;
use crate::error::MeshError;
use crate::score::{Cloud, Target};

/// Joins meshes in the order in which they come, one at a time. Vertices with equal coordinates become one (the colour of
/// the first is kept), faces that lose a side in that are dropped. Face properties and colours survive where any mesh has
/// them; faces of meshes without them get 0, vertices black.
#[derive(Default)]
pub struct Merger {
    mesh: Mesh,
    /// Vertices, found by their coordinates.
    known: HashTable<u32>,
}

impl Merger {
    /// Joins one more.
    pub fn add(&mut self, part: &Mesh) {
        let (mesh, known) = (&mut self.mesh, &mut self.known);
        let (first_vertex, first_face) = (mesh.vertices.len(), mesh.faces.len());
        let mut renamed = Vec::with_capacity(part.vertices.len());
        let mut added = Vec::new();
        for (at, vertex) in (0u32..).zip(&part.vertices) {
            let bits = bits(vertex);
            let vertices = &mesh.vertices;
            let is_same = |other: &u32| self::bits(&vertices[*other as usize]) == bits;
            let hash = |other: &u32| hash(self::bits(&vertices[*other as usize]));
            let index = match known.entry(self::hash(bits), is_same, hash) {
                Entry::Occupied(entry) => *entry.get(),
                Entry::Vacant(entry) => {
                    let new = vertices.len() as u32;
                    entry.insert(new);
                    mesh.vertices.push(*vertex);
                    added.push(at);
                    new
                }
            };
            renamed.push(index);
        }
        extend(&mut mesh.colors, first_vertex, &part.colors, &added);
        let mut kept = Vec::with_capacity(part.faces.len());
        for (at, face) in (0u32..).zip(&part.faces) {
            let face = face.map(|v| renamed[v as usize]);
            if face[0] != face[1] && face[1] != face[2] && face[2] != face[0] {
                mesh.faces.push(face);
                kept.push(at);
            }
        }
        for (all, own) in
            [(&mut mesh.buildings, &part.buildings), (&mut mesh.groups, &part.groups), (&mut mesh.closed, &part.closed)]
        {
            extend(all, first_face, own, &kept);
        }
    }

    /// All of them as one.
    #[must_use]
    pub fn finish(self) -> Mesh {
        self.mesh
    }
}

/// Joins meshes as [`Merger`] does.
#[must_use]
pub fn merge(parts: &[Mesh]) -> Mesh {
    let mut merger = Merger::default();
    parts.iter().for_each(|part| merger.add(part));
    merger.finish()
}

/// The same for 0 and -0.
fn bits(vertex: &[f64; 3]) -> [u64; 3] {
    vertex.map(|v| (v + 0.0).to_bits())
}

fn hash(bits: [u64; 3]) -> u64 {
    bits.iter().fold(0, |hash, word| SplitMix64::new(hash ^ word).next_u64())
}

/// Appends what `own` says of the members `kept`, once any mesh says something; `before` members were there already.
fn extend<T: Copy + Default>(all: &mut Vec<T>, before: usize, own: &[T], kept: &[u32]) {
    if !(all.is_empty() && own.is_empty()) {
        all.resize(before, T::default());
        all.extend(kept.iter().map(|at| own.get(*at as usize).copied().unwrap_or_default()));
    }
}

/// Gives every face the building and the group that `of` names for it (face index, centre in the world frame).
pub fn assign_faces(mesh: &mut Mesh, of: impl Fn(usize, DVec3) -> (u32, u32) + Sync) {
    let centers = |face: usize| mesh.triangle(face).map(DVec3::from).iter().sum::<DVec3>() / 3.0;
    let labels: Vec<(u32, u32)> = (0..mesh.faces.len()).into_par_iter().map(|face| of(face, centers(face))).collect();
    (mesh.buildings, mesh.groups) = labels.into_iter().unzip();
}

/// Gives every face the building and the group of the labelled point nearest to its centre, or 0 and 0 where none is
/// within `reach` (scene units).
///
/// # Errors
/// No points, or not as many labels as points.
pub fn assign_from_points(
    mesh: &mut Mesh,
    points: &[[f64; 3]],
    labels: &[(u32, u32)],
    reach: f64,
) -> Result<(), MeshError> {
    if points.len() != labels.len() {
        let what = format!("{} points but {} labels", points.len(), labels.len());
        return Err(MeshError::Geometry { what, cure: "give one label per point" });
    }
    let cloud = Cloud::new(points.to_vec(), "the labelled cloud")?;
    assign_faces(mesh, |_, center| {
        let near = cloud.nearest_within(center, reach).filter(|hit| hit.distance <= reach);
        near.map_or((0, 0), |hit| labels[hit.index as usize])
    });
    Ok(())
}

/// One mesh per building number other than 0, in their order.
#[must_use]
pub fn split_by_building(mesh: &Mesh) -> BTreeMap<u32, Mesh> {
    let mut faces: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (face, building) in mesh.buildings.iter().enumerate().filter(|(_, building)| **building != 0) {
        faces.entry(*building).or_default().push(face as u32);
    }
    let mut renamed = vec![u32::MAX; mesh.vertices.len()];
    faces.into_iter().map(|(building, faces)| (building, pick_faces(mesh, faces, &mut renamed))).collect()
}

#[cfg(test)]
mod tests;
