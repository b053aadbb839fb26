//! A mesh as binary glTF 2.0 for viewers: local coordinates in single precision, the root node carries the offset.

use std::io::{self, Write};

use glam::{DQuat, DVec3};
use pgsag_scene::Mesh;
use serde_json::json;

const MAGIC: u32 = 0x4654_6C67;
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BIN_CHUNK: u32 = 0x004E_4942;
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_BYTE: u32 = 5121;

/// Faces of a mesh under a name.
pub struct Part<'a> {
    /// Of the object.
    pub name: &'a str,
    /// Where the faces are.
    pub mesh: &'a Mesh,
    /// Which of them.
    pub keep: &'a dyn Fn(usize) -> bool,
}

impl Part<'_> {
    fn faces(&self) -> impl Iterator<Item = &[u32; 3]> {
        self.mesh.faces.iter().enumerate().filter(|(face, _)| (self.keep)(*face)).map(|(_, corners)| corners)
    }

    /// The vertices in the order of their first faces.
    fn vertices(&self) -> Vec<u32> {
        let mut is_known = vec![false; self.mesh.vertices.len()];
        let is_new = |vertex: &u32| !std::mem::replace(&mut is_known[*vertex as usize], true);
        self.faces().flatten().copied().filter(is_new).collect()
    }
}

/// Writes the file of several parts about one origin, without a copy of them. `up_world` becomes glTF's y axis.
///
/// # Errors
/// What the writer says; [`io::ErrorKind::FileTooLarge`] beyond 4 GiB, before anything is written.
pub fn encode(out: &mut impl Write, parts: &[Part<'_>], origin_world: DVec3, up_world: DVec3) -> io::Result<()> {
    let mut file = Layout::default();
    let parts: Vec<&Part<'_>> = parts.iter().filter(|part| part.faces().next().is_some()).collect();
    let mut shapes = Vec::new();
    let mut nodes = Vec::new();
    for (at, part) in parts.iter().enumerate() {
        let vertices = part.vertices();
        let mut attributes = json!({"POSITION": file.positions(part.mesh, &vertices, origin_world)});
        if !part.mesh.colors.is_empty() {
            attributes["COLOR_0"] = file.colors(vertices.len()).into();
        }
        let indices = file.indices(part.faces().count());
        let primitive = json!({"attributes": attributes, "indices": indices, "material": 0});
        shapes.push(json!({"name": part.name, "primitives": [primitive]}));
        nodes.push(json!({"name": part.name, "mesh": at}));
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
        "accessors": file.accessors, "bufferViews": file.views, "buffers": [{"byteLength": file.length}],
    });
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + text.len() + 8 + file.length;
    let words =
        |out: &mut dyn Write, words: &[u32]| words.iter().try_for_each(|word| out.write_all(&word.to_le_bytes()));
    words(out, &[MAGIC, 2, word(total)?, word(text.len())?, JSON_CHUNK])?;
    out.write_all(&text)?;
    words(out, &[word(file.length)?, BIN_CHUNK])?;
    parts.iter().try_for_each(|part| write_values(out, part, origin_world))
}

/// A length as the file says it.
fn word(length: usize) -> io::Result<u32> {
    let too_large = |_| io::Error::new(io::ErrorKind::FileTooLarge, "a binary glTF holds at most 4 GiB");
    u32::try_from(length).map_err(too_large)
}

/// Positions, colours and indices, as [`Layout`] has them.
fn write_values(out: &mut impl Write, part: &Part<'_>, origin: DVec3) -> io::Result<()> {
    let vertices = part.vertices();
    let mut renamed = vec![0; part.mesh.vertices.len()];
    for (name, vertex) in (0u32..).zip(&vertices) {
        renamed[*vertex as usize] = name;
        let position = local(&part.mesh.vertices[*vertex as usize], origin);
        position.iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))?;
    }
    for [r, g, b] in vertices.iter().filter_map(|vertex| part.mesh.colors.get(*vertex as usize)) {
        out.write_all(&[linear(*r), linear(*g), linear(*b), 255])?;
    }
    part.faces().flatten().try_for_each(|vertex| out.write_all(&renamed[*vertex as usize].to_le_bytes()))
}

fn local(vertex: &[f64; 3], origin: DVec3) -> [f32; 3] {
    (DVec3::from_array(*vertex) - origin).as_vec3().to_array()
}

/// Where everything will lie. All values are multiples of four bytes.
#[derive(Default)]
struct Layout {
    length: usize,
    views: Vec<serde_json::Value>,
    accessors: Vec<serde_json::Value>,
}

impl Layout {
    /// Adds an accessor over the next bytes.
    fn accessor(&mut self, bytes: usize, mut accessor: serde_json::Value) -> usize {
        accessor["bufferView"] = self.views.len().into();
        self.views.push(json!({"buffer": 0, "byteOffset": self.length, "byteLength": bytes}));
        self.length += bytes;
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn positions(&mut self, mesh: &Mesh, vertices: &[u32], origin: DVec3) -> usize {
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for local in vertices.iter().map(|vertex| local(&mesh.vertices[*vertex as usize], origin)) {
            for a in 0..3 {
                low[a] = low[a].min(local[a]);
                high[a] = high[a].max(local[a]);
            }
        }
        let count = vertices.len();
        let accessor = json!({"componentType": FLOAT, "count": count, "type": "VEC3", "min": low, "max": high});
        self.accessor(12 * count, accessor)
    }

    fn colors(&mut self, count: usize) -> usize {
        let accessor = json!({"componentType": UNSIGNED_BYTE, "normalized": true, "count": count, "type": "VEC4"});
        self.accessor(4 * count, accessor)
    }

    fn indices(&mut self, face_count: usize) -> usize {
        let count = 3 * face_count;
        self.accessor(4 * count, json!({"componentType": UNSIGNED_INT, "count": count, "type": "SCALAR"}))
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
        // The last vertex belongs to a face that is left out.
        let mesh = Mesh {
            vertices: vec![[9e9; 3], [1e6 + 1.0, 0.0, 0.0], [1e6, 2.0, 0.0], [1e6, 0.0, 0.0]],
            colors: vec![[255, 0, 10]; 4],
            faces: vec![[0, 1, 2], [3, 1, 2]],
            ..Mesh::default()
        };
        let part = |name, keep| Part { name, mesh: &mesh, keep };
        let parts = [part("buildings", &|face| face == 1), part("background", &|_| false)];
        let mut bytes = Vec::new();
        encode(&mut bytes, &parts, DVec3::new(1e6, 0.0, 0.0), DVec3::Z).expect("memory");
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("4 bytes")) as usize;
        assert_eq!((word(8), word(0)), (bytes.len(), MAGIC as usize));
        let document: serde_json::Value = serde_json::from_slice(&bytes[20..20 + word(12)]).expect("JSON");
        assert_eq!(document["meshes"].as_array().map(Vec::len), Some(1), "empty parts are left out");
        let offset = document["nodes"][1]["translation"][0].as_f64().expect("a number");
        assert!((offset - 1e6).abs() < 1e-6, "{offset}");
        assert_eq!(document["accessors"][0]["max"], json!([1.0, 2.0, 0.0]));
        let binary = 20 + word(12) + 8;
        assert_eq!(binary + word(20 + word(12)), bytes.len());
        let number = |at: usize| f32::from_bits(word(binary + 4 * at) as u32);
        assert_eq!((0..9).map(number).collect::<Vec<_>>(), [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.0]);
        assert_eq!(super::word(1 << 32).map_err(|error| error.kind()), Err(io::ErrorKind::FileTooLarge));
        assert_eq!((12..15).map(|at| word(binary + 4 * at)).collect::<Vec<_>>(), [0, 1, 2]);
    }
}
