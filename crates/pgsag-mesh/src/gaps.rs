//! Gaps of the measured surface: the border between free and unknown space ([`crate::marching::extract_closed`]) closes
//! them where they are narrow, and is taken away where they are not: the open end of the scene, and what stands in the
//! shadow of all photographs.
//!
//! What is kept is drawn taut like a skin over a frame, since the border itself stands as far out as rays happened to pass.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::DVec3;
use pgsag_scene::Mesh;

use crate::components::{Sets, keep_faces, sides};

/// Rounds of drawing taut, and by how much each goes beyond the middle (successive over-relaxation): for gaps of some 60
/// edges across.
const ROUNDS: usize = 100;
const OVER: f64 = 1.85;

/// What closes the gaps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gaps {
    /// Surface that closes gaps, scene units squared.
    pub area: f64,
    /// Faces of it.
    pub faces: usize,
}

/// Keeps the `closed` faces of a mesh that close gaps no wider than `width` scene units, draws them taut between the
/// measured surface, and gives them its colours, building and group; gaps that reach the background are background, since
/// what nobody measured is not claimed for a building. All other `closed` faces are dropped.
#[must_use]
pub fn close_gaps(mut mesh: Mesh, width: f64) -> (Mesh, Gaps) {
    if mesh.closed.iter().all(|closed| *closed == 0) {
        return (mesh, Gaps::default());
    }
    let patch = Patch::new(&mesh);
    let (from_surface, is_kept) = patch.narrow(&mesh, width);
    for (face, (_, origin)) in from_surface.iter().enumerate().filter(|(_, (distance, _))| distance.is_finite()) {
        for labels in [&mut mesh.buildings, &mut mesh.groups].into_iter().filter(|labels| !labels.is_empty()) {
            labels[face] = labels[*origin as usize];
        }
    }
    drop(from_surface);
    patch.leave_to_background(&mut mesh, |face| is_kept[face]);
    drop(patch);
    let mut kept = keep_faces(&mesh, |face| is_kept[face]);
    drop(mesh);
    kept.closed.iter_mut().for_each(|closed| *closed = (*closed).min(1));
    draw_taut(&mut kept);
    let closing = (0..kept.faces.len()).filter(|face| !kept.is_measured(*face));
    let areas = closing.map(|face| area(&kept, face));
    let gaps = areas.fold(Gaps::default(), |sum, area| Gaps { area: sum.area + area, faces: sum.faces + 1 });
    (kept, gaps)
}

/// Drops the `closed` faces of one cube that [`close_gaps`] would drop from the whole, and marks those that it would keep
/// with 2, as far as the cube alone can tell: `inset` is how far a place is from where another cube goes on. A crumb counts
/// as surface here, so that gaps about crumbs may be kept which the whole would drop.
#[must_use]
pub fn drop_wide(mut mesh: Mesh, width: f64, inset: impl Fn(DVec3) -> f64) -> Mesh {
    let patch = Patch::new(&mesh);
    let (_, is_kept) = patch.narrow(&mesh, width);
    drop(patch);
    let insets: Vec<f64> = (0..mesh.faces.len()).map(|face| inset(center(&mesh, face))).collect();
    for face in 0..mesh.faces.len() {
        if !mesh.is_measured(face) && is_kept[face] && insets[face] > DECIDED_WIDTHS * width {
            mesh.closed[face] = DECIDED;
        }
    }
    keep_faces(&mesh, |face| is_kept[face] || insets[face] <= DROPPED_WIDTHS * width)
}

/// `closed` of a face that stays.
const DECIDED: u32 = 2;
/// What lies farther away than so many widths does not decide whether a face stays: half a width to the surface, the
/// margin beyond, and some.
const DECIDED_WIDTHS: f64 = 1.2;
/// Nor are faces farther away than this missed by those that are still to be decided.
const DROPPED_WIDTHS: f64 = DECIDED_WIDTHS + 0.7;

/// A way over faces is longer than a straight one, and its last step is lost.
const MARGIN: f64 = 1.25;

fn area(mesh: &Mesh, face: usize) -> f64 {
    let [a, b, c] = mesh.triangle(face).map(DVec3::from);
    0.5 * (b - a).cross(c - a).length()
}

fn center(mesh: &Mesh, face: usize) -> DVec3 {
    mesh.triangle(face).map(DVec3::from).iter().sum::<DVec3>() / 3.0
}

/// The closing faces with what they touch.
struct Patch {
    /// `[F + 1]` Where the closing neighbours of each face begin in `beside`.
    starts: Vec<u32>,
    beside: Vec<u32>,
    /// Closing faces at measured ones, with each of these; the smallest last.
    attached: Vec<(u32, u32)>,
    /// `[F]` Closing faces with an edge that no other face has.
    is_open: Vec<bool>,
}

impl Patch {
    fn new(mesh: &Mesh) -> Self {
        let count = mesh.faces.len();
        let mut patch =
            Self { starts: vec![0; count + 1], beside: Vec::new(), attached: Vec::new(), is_open: vec![false; count] };
        let mut pairs: Vec<[u32; 2]> = Vec::new();
        for same in sides(mesh).chunk_by(|a, b| a.0 == b.0) {
            for (_, face) in same.iter().filter(|(_, face)| !mesh.is_measured(*face as usize)) {
                patch.is_open[*face as usize] |= same.len() == 1;
                for (_, other) in same.iter().filter(|(_, other)| other != face) {
                    if mesh.is_measured(*other as usize) {
                        patch.attached.push((*face, *other));
                    } else {
                        pairs.push([*face, *other]);
                    }
                }
            }
        }
        pairs.sort_unstable();
        for [face, _] in &pairs {
            patch.starts[*face as usize + 1] += 1;
        }
        for face in 0..count {
            patch.starts[face + 1] += patch.starts[face];
        }
        patch.beside = pairs.into_iter().map(|[_, other]| other).collect();
        patch.attached.sort_unstable_by_key(|(face, measured)| (*face, Reverse(*measured)));
        patch
    }

    /// The way of every closing face to the measured surface and which face it leads to, and `[F]` whether a face is
    /// measured or closes a gap no wider than `width`.
    fn narrow(&self, mesh: &Mesh, width: f64) -> (Vec<(f64, u32)>, Vec<bool>) {
        let reach = width / 2.0;
        let from_surface = self.walk(mesh, self.attached.iter().copied(), f64::INFINITY);
        // One that hung on a crumb hangs on nothing any more.
        let is_decided = |face: usize| mesh.closed.get(face) == Some(&DECIDED) && from_surface[face].0.is_finite();
        let is_wide = |face: &u32| {
            let at = *face as usize;
            !is_decided(at) && (from_surface[at].0 > reach || self.is_open[at])
        };
        let wide = (0..mesh.faces.len() as u32).filter(|face| !mesh.is_measured(*face as usize)).filter(is_wide);
        let from_wide = self.walk(mesh, wide, MARGIN * reach);
        let is_kept = |face: usize| mesh.is_measured(face) || is_decided(face) || from_wide[face].0.is_infinite();
        let kept = (0..mesh.faces.len()).map(is_kept).collect();
        (from_surface, kept)
    }

    /// Gives group and building 0 to the connected closing faces of which one lies at a measured face of group 0.
    fn leave_to_background(&self, mesh: &mut Mesh, is_kept: impl Fn(usize) -> bool) {
        if mesh.groups.is_empty() {
            return;
        }
        let mut sets = Sets::new(mesh.faces.len());
        for face in (0..mesh.faces.len() as u32).filter(|face| is_kept(*face as usize)) {
            let beside = &self.beside[self.starts[face as usize] as usize..self.starts[face as usize + 1] as usize];
            beside.iter().filter(|other| is_kept(**other as usize)).for_each(|other| sets.join(face, *other));
        }
        let mut is_background = vec![false; mesh.faces.len()];
        for (face, measured) in self.attached.iter().filter(|(face, _)| is_kept(*face as usize)) {
            is_background[sets.find(*face) as usize] |= mesh.groups[*measured as usize] == 0;
        }
        for face in 0..mesh.faces.len() {
            if !mesh.is_measured(face) && is_background[sets.find(face as u32) as usize] {
                mesh.groups[face] = 0;
                mesh.buildings.get_mut(face).into_iter().for_each(|building| *building = 0);
            }
        }
    }

    /// `[F]` For closing faces within `limit` of one of the first: the way over closing faces, and whose it is.
    fn walk<S: Into<Start>>(&self, mesh: &Mesh, first: impl Iterator<Item = S>, limit: f64) -> Vec<(f64, u32)> {
        let mut found = vec![(f64::INFINITY, u32::MAX); mesh.faces.len()];
        let mut heap = BinaryHeap::new();
        for Start { face, origin } in first.map(Into::into) {
            found[face as usize] = (0.0, origin);
            heap.push(Reverse((0u64, face)));
        }
        // Distances that are not negative are ordered as their bits are.
        while let Some(Reverse((bits, face))) = heap.pop() {
            let (distance, origin) = found[face as usize];
            if bits > distance.to_bits() {
                continue;
            }
            let here = center(mesh, face as usize);
            for other in &self.beside[self.starts[face as usize] as usize..self.starts[face as usize + 1] as usize] {
                let further = distance + here.distance(center(mesh, *other as usize));
                if further <= limit && further < found[*other as usize].0 {
                    found[*other as usize] = (further, origin);
                    heap.push(Reverse((further.to_bits(), *other)));
                }
            }
        }
        found
    }
}

/// Where a walk begins, and what its faces are said to come from.
struct Start {
    face: u32,
    origin: u32,
}

impl From<u32> for Start {
    fn from(face: u32) -> Self {
        Self { face, origin: face }
    }
}

impl From<(u32, u32)> for Start {
    fn from((face, origin): (u32, u32)) -> Self {
        Self { face, origin }
    }
}

/// Moves a vertex to the middle of its neighbours and beyond.
fn relax(values: &mut [[f64; 3]], edges: &[[u32; 2]]) {
    let sum: DVec3 = edges.iter().map(|[_, to]| DVec3::from(values[*to as usize])).sum();
    let value = &mut values[edges[0][0] as usize];
    let step = sum / edges.len() as f64 - DVec3::from(*value);
    *value = (DVec3::from(*value) + OVER * step).to_array();
}

/// Moves the vertices that only closing faces have to the middle of their neighbours, again and again, colours too.
fn draw_taut(mesh: &mut Mesh) {
    let all = mesh.faces.iter().enumerate();
    let (measured, closing): (Vec<_>, Vec<_>) = all.partition(|(face, _)| mesh.is_measured(*face));
    let mut is_free = vec![false; mesh.vertices.len()];
    closing.iter().flat_map(|(_, corners)| *corners).for_each(|vertex| is_free[*vertex as usize] = true);
    measured.iter().flat_map(|(_, corners)| *corners).for_each(|vertex| is_free[*vertex as usize] = false);
    let mut edges: Vec<[u32; 2]> = closing
        .iter()
        .flat_map(|(_, [a, b, c])| [[*a, *b], [*b, *a], [*b, *c], [*c, *b], [*c, *a], [*a, *c]])
        .filter(|[from, _]| is_free[*from as usize])
        .collect();
    edges.sort_unstable();
    edges.dedup();
    let around: Vec<&[[u32; 2]]> = edges.chunk_by(|a, b| a[0] == b[0]).collect();
    let mut colors = first_colors(mesh, &is_free, &around);
    for _ in 0..ROUNDS {
        for edges in &around {
            relax(&mut mesh.vertices, edges);
            if !colors.is_empty() {
                relax(&mut colors, edges);
            }
        }
    }
    for (vertex, color) in colors.iter().enumerate().filter(|(vertex, _)| is_free[*vertex]) {
        mesh.colors[vertex] = color.map(|channel| (channel + 0.5).clamp(0.0, 255.0) as u8);
    }
}

/// `[V]` Colours to begin with: of free vertices the mean of those nearer to the measured surface, layer by layer.
fn first_colors(mesh: &Mesh, is_free: &[bool], around: &[&[[u32; 2]]]) -> Vec<[f64; 3]> {
    if mesh.colors.is_empty() {
        return Vec::new();
    }
    let mut colors: Vec<[f64; 3]> = mesh.colors.iter().map(|color| color.map(f64::from)).collect();
    let mut is_known: Vec<bool> = is_free.iter().map(|free| !free).collect();
    let mut waiting: Vec<&[[u32; 2]]> = around.to_vec();
    loop {
        let mean = |edges: &[[u32; 2]]| {
            let known = edges.iter().map(|[_, to]| *to as usize).filter(|to| is_known[*to]);
            let (sum, count) = known.fold((DVec3::ZERO, 0.0), |(sum, n), to| (sum + DVec3::from(colors[to]), n + 1.0));
            (count > 0.0).then(|| (edges[0][0] as usize, (sum / count).to_array()))
        };
        let layer: Vec<(usize, [f64; 3])> = waiting.iter().filter_map(|edges| mean(edges)).collect();
        if layer.is_empty() {
            return colors;
        }
        for (vertex, color) in layer {
            (colors[vertex], is_known[vertex]) = (color, true);
        }
        waiting.retain(|edges| !is_known[edges[0][0] as usize]);
    }
}

#[cfg(test)]
mod tests;
