//! The zero surface of a volume as an indexed mesh: marching cubes whose vertices are shared between cells and blocks
//! and, bit for bit, between cubes of one lattice. Cells with an unknown corner are skipped, or, where gaps are to be
//! closed, what is unknown counts as inside.

use std::collections::HashMap;

use pgsag_scene::Mesh;
use rayon::prelude::*;

use crate::tsdf::{BLOCK_NODES, BLOCK_SIDE, Volume};

mod table;

use table::{CORNERS, CaseTable, EDGES};

/// Nodes along the side of a block with the first layer of its neighbours.
const SIDE: usize = BLOCK_SIDE as usize + 1;
/// Vertices keep this share of a voxel's edge away from its ends, so that no triangle collapses.
const MIN_SHARE: f32 = 1e-3;
const NO_VERTEX: u32 = u32::MAX;

/// An edge of the lattice: the node with the smaller coordinates, and the axis.
type EdgeKey = ([i32; 3], u8);

/// The surface inside one block.
#[derive(Default)]
struct Piece {
    vertices: Vec<[f64; 3]>,
    colors: Vec<[u8; 3]>,
    faces: Vec<[u32; 3]>,
    /// As [`Mesh::closed`], one per face.
    closed: Vec<u32>,
    /// Vertices on the block's hull with the edge they lie on; in the order of their making.
    shared: Vec<(u32, EdgeKey)>,
}

/// Values of a block's nodes and of the layer beyond.
struct Window {
    distance: Vec<f32>,
    state: Vec<State>,
    color: Vec<[u16; 4]>,
}

/// What is known of a node.
#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    /// Nothing, and it may not be guessed.
    Absent,
    /// No photograph saw it; it counts as inside.
    Unknown,
    Measured,
}

/// Distance, over the front truncation, of nodes that nobody saw.
const UNKNOWN_DISTANCE: f32 = -1.0;

/// Takes the surface of the cells of the volume's region. Faces are counter-clockwise seen from outside; vertices and
/// faces come in an order that depends on the volume's content alone. Colours are there where the volume keeps them.
#[must_use]
pub fn extract(volume: &Volume) -> Mesh {
    surface(volume, false)
}

/// As [`extract`], with the border between free and unknown space as surface too; its faces are `closed`.
#[must_use]
pub fn extract_closed(volume: &Volume) -> Mesh {
    surface(volume, true)
}

fn surface(volume: &Volume, closes: bool) -> Mesh {
    let table = CaseTable::new();
    let mut order: Vec<[i32; 3]> = volume.keys.clone();
    order.sort_unstable();
    let pieces: Vec<Piece> = order.par_iter().map(|key| piece_of_block(volume, &table, *key, closes)).collect();
    join(pieces, closes)
}

fn window(volume: &Volume, key: [i32; 3], closes: bool) -> Option<Window> {
    let colored = volume.options.color;
    let mut window = Window {
        distance: vec![1.0; SIDE * SIDE * SIDE],
        state: vec![State::Absent; SIDE * SIDE * SIDE],
        color: if colored { vec![[0; 4]; SIDE * SIDE * SIDE] } else { Vec::new() },
    };
    let (mut any_in, mut any_out) = (false, false);
    for corner in 0..8 {
        let beyond: [i32; 3] = std::array::from_fn(|a| corner >> a & 1);
        let Some(&at) = volume.index.get(&std::array::from_fn(|a| key[a] + beyond[a])) else { continue };
        let block = &volume.blocks[at as usize];
        let range = |a: usize| if beyond[a] == 1 { (BLOCK_SIDE as usize, SIDE) } else { (0, BLOCK_SIDE as usize) };
        let (xs, ys, zs) = (range(0), range(1), range(2));
        for z in zs.0..zs.1 {
            for y in ys.0..ys.1 {
                for x in xs.0..xs.1 {
                    let side = BLOCK_SIDE as usize;
                    let node = ((z % side) * side + y % side) * side + x % side;
                    let to = (z * SIDE + y) * SIDE + x;
                    if block.weight[node] <= volume.options.min_weight {
                        if closes {
                            (window.state[to], window.distance[to], any_in) = (State::Unknown, UNKNOWN_DISTANCE, true);
                        }
                        continue;
                    }
                    window.state[to] = State::Measured;
                    window.distance[to] = block.distance[node];
                    any_in |= block.distance[node] < 0.0;
                    any_out |= block.distance[node] >= 0.0;
                    if let Some(colors) = &block.color {
                        window.color[to] = colors[node];
                    }
                }
            }
        }
    }
    debug_assert!(BLOCK_NODES < window.distance.len());
    (any_in && any_out).then_some(window)
}

fn piece_of_block(volume: &Volume, table: &CaseTable, key: [i32; 3], closes: bool) -> Piece {
    let mut piece = Piece::default();
    let Some(window) = window(volume, key, closes) else { return piece };
    let base = key.map(|k| k * BLOCK_SIDE);
    let mut made = vec![[NO_VERTEX; 3]; SIDE * SIDE * SIDE];
    let offsets: [usize; CORNERS] = std::array::from_fn(|c| ((c >> 2 & 1) * SIDE + (c >> 1 & 1)) * SIDE + (c & 1));
    for z in 0..BLOCK_SIDE {
        for y in 0..BLOCK_SIDE {
            for x in 0..BLOCK_SIDE {
                let cell = [x, y, z];
                let first = (z as usize * SIDE + y as usize) * SIDE + x as usize;
                let Some((case, is_measured)) = case_of_cell(&window, first, &offsets) else { continue };
                if !volume.region.contains(std::array::from_fn(|a| base[a] + cell[a])) {
                    continue;
                }
                for triangle in &table.triangles[case] {
                    let face = triangle.map(|edge| {
                        let (corner, axis) = EDGES[edge as usize];
                        let node = first + offsets[corner];
                        if made[node][axis] == NO_VERTEX {
                            let at = std::array::from_fn(|a| cell[a] + (corner >> a & 1) as i32);
                            made[node][axis] = piece.add_vertex(volume, &window, base, at, axis);
                        }
                        made[node][axis]
                    });
                    piece.faces.push(face);
                    piece.closed.push(u32::from(!is_measured));
                }
            }
        }
    }
    piece
}

/// The case of the cell whose first node is `first` and whether all its corners were measured; `None` where a corner is
/// absent or all are on one side.
fn case_of_cell(window: &Window, first: usize, offsets: &[usize; CORNERS]) -> Option<(usize, bool)> {
    let (mut case, mut is_measured) = (0, true);
    for (corner, offset) in offsets.iter().enumerate() {
        match window.state[first + offset] {
            State::Absent => return None,
            State::Unknown => is_measured = false,
            State::Measured => {}
        }
        case |= usize::from(window.distance[first + offset] < 0.0) << corner;
    }
    (case != 0 && case != 255).then_some((case, is_measured))
}

impl Piece {
    fn add_vertex(&mut self, volume: &Volume, window: &Window, base: [i32; 3], at: [i32; 3], axis: usize) -> u32 {
        let node = |at: [i32; 3]| (at[2] as usize * SIDE + at[1] as usize) * SIDE + at[0] as usize;
        let mut far = at;
        far[axis] += 1;
        let (near, far) = (node(at), node(far));
        let (a, b) = (window.distance[near], window.distance[far]);
        let share = (a / (a - b)).clamp(MIN_SHARE, 1.0 - MIN_SHARE);
        let global = std::array::from_fn(|i| base[i] + at[i]);
        let mut position = volume.lattice.node(global).to_array();
        position[axis] += volume.lattice.voxel * f64::from(share);
        let index = self.vertices.len() as u32;
        self.vertices.push(position);
        if volume.options.color {
            self.colors.push(mix(window.color[near], window.color[far], share));
        }
        // Edges on the low hull and on the high layer may be met by another block too.
        if (0..3).any(|i| i != axis && (at[i] == 0 || at[i] == BLOCK_SIDE)) {
            self.shared.push((index, (global, axis as u8)));
        }
        index
    }
}

/// Colour between two nodes; a node that never saw a colour does not count.
fn mix(near: [u16; 4], far: [u16; 4], share: f32) -> [u8; 3] {
    let share = match (near[3] > 0, far[3] > 0) {
        (true, true) => share,
        (true, false) => 0.0,
        _ => 1.0,
    };
    std::array::from_fn(|c| {
        let value = f32::from(near[c]) * (1.0 - share) + f32::from(far[c]) * share;
        (value / 256.0).round().min(255.0) as u8
    })
}

fn join(pieces: Vec<Piece>, closes: bool) -> Mesh {
    let count = |part: fn(&Piece) -> usize| pieces.iter().map(part).sum::<usize>();
    let mut mesh = Mesh {
        vertices: Vec::with_capacity(count(|piece| piece.vertices.len())),
        colors: Vec::with_capacity(count(|piece| piece.colors.len())),
        faces: Vec::with_capacity(count(|piece| piece.faces.len())),
        ..Mesh::default()
    };
    let mut known: HashMap<EdgeKey, u32> = HashMap::with_capacity(count(|piece| piece.shared.len()));
    for piece in pieces {
        let mut shared = piece.shared.iter().peekable();
        let mut renamed = Vec::with_capacity(piece.vertices.len());
        for (at, vertex) in piece.vertices.iter().enumerate() {
            let new = mesh.vertices.len() as u32;
            let key = shared.next_if(|(index, _)| *index as usize == at).map(|(_, key)| *key);
            let index = key.map_or(new, |key| *known.entry(key).or_insert(new));
            if index == new {
                mesh.vertices.push(*vertex);
                mesh.colors.extend(piece.colors.get(at));
            }
            renamed.push(index);
        }
        mesh.faces.extend(piece.faces.iter().map(|face| face.map(|v| renamed[v as usize])));
        if closes {
            mesh.closed.extend_from_slice(&piece.closed);
        }
    }
    mesh
}

#[cfg(test)]
mod tests;
