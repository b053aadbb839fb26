//! Many meshes into one: the surfaces of cubes are sewn together where their vertices are equal bit for bit.

use std::collections::HashMap;

use pgsag_scene::Mesh;

/// Joins meshes in the given order. Vertices with equal coordinates become one (the colour of the first is kept), faces
/// that lose a side in that are dropped. Face properties and colours survive where any mesh has them; faces of meshes
/// without them get 0, vertices black.
#[must_use]
pub fn merge(parts: &[Mesh]) -> Mesh {
    let any = |has: fn(&Mesh) -> bool| parts.iter().any(has);
    let colored = any(|part| !part.colors.is_empty());
    let housed = any(|part| !part.buildings.is_empty());
    let grouped = any(|part| !part.groups.is_empty());
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
        }
    }
    mesh
}
