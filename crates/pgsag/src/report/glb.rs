//! A mesh as binary glTF 2.0 for viewers: local coordinates in single precision, the root node carries the offset.

use glam::{DQuat, DVec3};
use pgsag_scene::Mesh;
use serde_json::json;

const MAGIC: u32 = 0x4654_6C67;
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BIN_CHUNK: u32 = 0x004E_4942;
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_BYTE: u32 = 5121;

/// The file of several named meshes about one origin. `up_world` becomes glTF's y axis.
#[must_use]
pub fn encode(meshes: &[(&str, &Mesh)], origin_world: DVec3, up_world: DVec3) -> Vec<u8> {
    let mut file = Parts::default();
    let meshes: Vec<_> = meshes.iter().filter(|(_, mesh)| !mesh.faces.is_empty()).collect();
    let mut shapes = Vec::new();
    let mut nodes = Vec::new();
    for (at, (name, mesh)) in meshes.iter().enumerate() {
        let mut attributes = json!({"POSITION": file.positions(mesh, origin_world)});
        if !mesh.colors.is_empty() {
            attributes["COLOR_0"] = file.colors(mesh).into();
        }
        let indices = file.indices(mesh);
        shapes
            .push(json!({"name": name, "primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}));
        nodes.push(json!({"name": name, "mesh": at}));
    }
    let y_from_up = DQuat::from_rotation_arc(up_world.normalize_or(DVec3::Z), DVec3::Y);
    let root = json!({
        "name": "city", "children": (0..nodes.len()).collect::<Vec<_>>(),
        "rotation": y_from_up.to_array(), "translation": (y_from_up * origin_world).to_array(),
    });
    nodes.push(root);
    let document = json!({
        "asset": {"version": "2.0", "generator": concat!("pgsag ", env!("CARGO_PKG_VERSION"))},
        "scene": 0, "scenes": [{"nodes": [nodes.len() - 1]}], "nodes": nodes, "meshes": shapes,
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}, "doubleSided": true}],
        "accessors": file.accessors, "bufferViews": file.views, "buffers": [{"byteLength": file.bytes.len()}],
    });
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + text.len() + 8 + file.bytes.len();
    let mut out = Vec::with_capacity(total);
    let words = |out: &mut Vec<u8>, words: &[u32]| words.iter().for_each(|word| out.extend(word.to_le_bytes()));
    words(&mut out, &[MAGIC, 2, total as u32, text.len() as u32, JSON_CHUNK]);
    out.extend(text);
    words(&mut out, &[file.bytes.len() as u32, BIN_CHUNK]);
    out.extend(file.bytes);
    out
}

#[derive(Default)]
struct Parts {
    bytes: Vec<u8>,
    views: Vec<serde_json::Value>,
    accessors: Vec<serde_json::Value>,
}

impl Parts {
    /// Adds an accessor over everything appended since `start`.
    fn accessor(&mut self, start: usize, mut accessor: serde_json::Value) -> usize {
        accessor["bufferView"] = self.views.len().into();
        self.views.push(json!({"buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start}));
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn positions(&mut self, mesh: &Mesh, origin: DVec3) -> usize {
        let start = self.bytes.len();
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for vertex in &mesh.vertices {
            let local = (DVec3::from_array(*vertex) - origin).as_vec3().to_array();
            for a in 0..3 {
                low[a] = low[a].min(local[a]);
                high[a] = high[a].max(local[a]);
                self.bytes.extend(local[a].to_le_bytes());
            }
        }
        let count = mesh.vertices.len();
        self.accessor(start, json!({"componentType": FLOAT, "count": count, "type": "VEC3", "min": low, "max": high}))
    }

    fn colors(&mut self, mesh: &Mesh) -> usize {
        let start = self.bytes.len();
        mesh.colors.iter().for_each(|[r, g, b]| self.bytes.extend([linear(*r), linear(*g), linear(*b), 255]));
        let count = mesh.colors.len();
        self.accessor(
            start,
            json!({"componentType": UNSIGNED_BYTE, "normalized": true, "count": count, "type": "VEC4"}),
        )
    }

    fn indices(&mut self, mesh: &Mesh) -> usize {
        let start = self.bytes.len();
        mesh.faces.iter().flatten().for_each(|index| self.bytes.extend(index.to_le_bytes()));
        let count = 3 * mesh.faces.len();
        self.accessor(start, json!({"componentType": UNSIGNED_INT, "count": count, "type": "SCALAR"}))
    }
}

/// Vertex colours of glTF are linear, ours are as in photographs.
fn linear(encoded: u8) -> u8 {
    let value = f64::from(encoded) / 255.0;
    let light = if value <= 0.040_45 { value / 12.92 } else { libm::pow((value + 0.055) / 1.055, 2.4) };
    (255.0 * light + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_says_its_own_lengths_and_carries_the_offset() {
        let mesh = Mesh {
            vertices: vec![[1e6, 0.0, 0.0], [1e6 + 1.0, 0.0, 0.0], [1e6, 2.0, 0.0]],
            colors: vec![[255, 0, 10]; 3],
            faces: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let bytes =
            encode(&[("buildings", &mesh), ("background", &Mesh::default())], DVec3::new(1e6, 0.0, 0.0), DVec3::Z);
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("4 bytes")) as usize;
        assert_eq!((word(8), word(0)), (bytes.len(), MAGIC as usize));
        let document: serde_json::Value = serde_json::from_slice(&bytes[20..20 + word(12)]).expect("JSON");
        assert_eq!(document["meshes"].as_array().map(Vec::len), Some(1), "empty meshes are left out");
        let offset = document["nodes"][1]["translation"][0].as_f64().expect("a number");
        assert!((offset - 1e6).abs() < 1e-6, "{offset}");
        assert_eq!(document["accessors"][0]["max"], json!([1.0, 2.0, 0.0]));
        assert_eq!(20 + word(12) + 8 + word(20 + word(12)), bytes.len());
    }
}
