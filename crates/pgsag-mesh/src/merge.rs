//! Many meshes into one: the surfaces of cubes are sewn together where their vertices are equal bit for bit.

use std::collections::{BTreeMap, HashMap};

use glam::DVec3;
use pgsag_scene::Mesh;
use rayon::prelude::*;

use crate::components::pick_faces;
use crate::error::MeshError;
use crate::score::{Cloud, Target};

/// Joins meshes in the given order. Vertices with equal coordinates become one (the colour of the first is kept), faces
/// that lose a side in that are dropped. Face properties and colours survive where any mesh has them; faces of meshes
/// without them get 0, vertices black.
#[must_use]
pub fn merge(parts: &[Mesh]) -> Mesh {
    let any = |has: fn(&Mesh) -> bool| parts.iter().any(has);
    let colored = any(|part| !part.colors.is_empty());
    let housed = any(|part| !part.buildings.is_empty());
    let grouped = any(|part| !part.groups.is_empty());
    let closed = any(|part| !part.closed.is_empty());
    let mut mesh = Mesh::default();
    let mut known: HashMap<[u64; 3], u32> = HashMap::new();
    for part in parts {
        let mut renamed = Vec::with_capacity(part.vertices.len());
        for (at, vertex) in part.vertices.iter().enumerate() {
            let new = mesh.vertices.len() as u32;
            let index = *known.entry(vertex.map(|v| (v + 0.0).to_bits())).or_insert(new);
            if index == new {
                mesh.vertices.push(*vertex);
                if colored {
                    mesh.colors.push(part.colors.get(at).copied().unwrap_or_default());
                }
            }
            renamed.push(index);
        }
        for (at, face) in part.faces.iter().enumerate() {
            let face = face.map(|v| renamed[v as usize]);
            if face[0] == face[1] || face[1] == face[2] || face[2] == face[0] {
                continue;
            }
            mesh.faces.push(face);
            if housed {
                mesh.buildings.push(part.buildings.get(at).copied().unwrap_or_default());
            }
            if grouped {
                mesh.groups.push(part.groups.get(at).copied().unwrap_or_default());
            }
            if closed {
                mesh.closed.push(part.closed.get(at).copied().unwrap_or_default());
            }
        }
    }
    mesh
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
