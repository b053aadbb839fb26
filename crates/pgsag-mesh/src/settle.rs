//! Labels of faces without speckles: views vote face by face, and where few see a face, at the rims of holes and in
//! shade, single faces fall to the wrong side. Patches too small to be anything take the label around them.

use std::collections::BTreeMap;

use glam::DVec3;
use pgsag_scene::Mesh;

use crate::components::{Sets, sides};

/// Patches are joined in rounds, the smallest first; what is left after so many stays.
const MAX_ROUNDS: usize = 64;

/// Two faces that share an edge, and its length.
struct Joint {
    faces: [u32; 2],
    length: f64,
}

/// `[F]` Labels in which no connected patch of one label has less surface than `min_area` (scene units squared), unless
/// nothing else touches it: the label with the longest border takes it.
#[must_use]
pub fn settle(mesh: &Mesh, labels: &[u32], min_area: f64) -> Vec<u32> {
    if labels.len() != mesh.faces.len() {
        return labels.to_vec();
    }
    let sides = sides(mesh);
    let mut sets = Sets::new(mesh.faces.len());
    for Joint { faces: [a, b], .. } in joints(mesh, &sides) {
        if labels[a as usize] == labels[b as usize] {
            sets.join(a, b);
        }
    }
    let mut patches = Patches::new(mesh, labels, joints(mesh, &sides), sets);
    drop(sides);
    for _ in 0..MAX_ROUNDS {
        if patches.join_small(min_area) == 0 {
            break;
        }
    }
    (0..mesh.faces.len() as u32).map(|face| patches.label_of(face)).collect()
}

fn joints<'a>(mesh: &'a Mesh, sides: &'a [([u32; 2], u32)]) -> impl Iterator<Item = Joint> + 'a {
    let place = |vertex: u32| DVec3::from(mesh.vertices[vertex as usize]);
    let joint = move |pair: &[([u32; 2], u32)]| {
        let [([a, b], first), (same, second)] = [pair[0], pair[1]];
        (same == [a, b]).then(|| Joint { faces: [first, second], length: place(a).distance(place(b)) })
    };
    sides.windows(2).filter_map(joint)
}

/// Patches of one label, each known by its smallest face.
struct Patches {
    sets: Sets,
    area: BTreeMap<u32, f64>,
    label: BTreeMap<u32, u32>,
    /// Lengths of the borders between patches, as they were first; the smaller number first.
    borders: Vec<([u32; 2], f64)>,
}

impl Patches {
    fn new(mesh: &Mesh, labels: &[u32], joints: impl Iterator<Item = Joint>, mut sets: Sets) -> Self {
        let (mut area, mut label) = (BTreeMap::new(), BTreeMap::new());
        for face in 0..mesh.faces.len() {
            let [a, b, c] = mesh.triangle(face).map(DVec3::from);
            let root = sets.find(face as u32);
            *area.entry(root).or_insert(0.0) += 0.5 * (b - a).cross(c - a).length();
            label.insert(root, labels[face]);
        }
        let mut borders: BTreeMap<[u32; 2], f64> = BTreeMap::new();
        for joint in joints {
            let [a, b] = joint.faces.map(|face| sets.find(face));
            if a != b {
                *borders.entry([a.min(b), a.max(b)]).or_default() += joint.length;
            }
        }
        Self { sets, area, label, borders: borders.into_iter().collect() }
    }

    fn label_of(&mut self, face: u32) -> u32 {
        let root = self.sets.find(face);
        self.label[&root]
    }

    /// Small patches go to the label that they share most border with; how many went.
    fn join_small(&mut self, min_area: f64) -> usize {
        let mut beside: BTreeMap<u32, BTreeMap<u32, f64>> = BTreeMap::new();
        for ([a, b], length) in &self.borders {
            let (a, b) = (self.sets.find(*a), self.sets.find(*b));
            if a != b {
                *beside.entry(a).or_default().entry(b).or_default() += length;
                *beside.entry(b).or_default().entry(a).or_default() += length;
            }
        }
        let small = self.area.iter().filter(|(_, area)| **area < min_area);
        let mut order: Vec<(f64, u32)> = small.map(|(root, area)| (*area, *root)).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut is_touched: BTreeMap<u32, bool> = BTreeMap::new();
        let mut joined = 0;
        for (_, root) in order {
            let Some(around) = beside.get(&root) else { continue };
            let longest = around.iter().max_by(|a, b| a.1.total_cmp(b.1).then(b.0.cmp(a.0)));
            let Some((&other, _)) = longest else { continue };
            // What has just grown is measured again in the next round.
            if is_touched.contains_key(&root) || is_touched.contains_key(&other) {
                continue;
            }
            self.join(root, other);
            is_touched.insert(root, true);
            is_touched.insert(other, true);
            joined += 1;
        }
        joined
    }

    /// `root` becomes a part of `other`.
    fn join(&mut self, root: u32, other: u32) {
        let area = self.area.remove(&root).unwrap_or(0.0) + self.area.remove(&other).unwrap_or(0.0);
        let label = self.label[&other];
        self.sets.join(root, other);
        let both = self.sets.find(other);
        self.area.insert(both, area);
        self.label.insert(both, label);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of unit squares along x with a label each.
    fn strip(labels: &[u32]) -> (Mesh, Vec<u32>) {
        let mut mesh = Mesh::default();
        for x in 0..=labels.len() {
            mesh.vertices.extend([[x as f64, 0.0, 0.0], [x as f64, 1.0, 0.0]]);
        }
        for x in 0..labels.len() as u32 {
            let [a, b, c, d] = [2 * x, 2 * x + 2, 2 * x + 3, 2 * x + 1];
            mesh.faces.extend([[a, b, c], [a, c, d]]);
        }
        (mesh, labels.iter().flat_map(|label| [*label; 2]).collect())
    }

    fn settled(labels: &[u32], min_area: f64) -> Vec<u32> {
        let (mesh, labels) = strip(labels);
        settle(&mesh, &labels, min_area).chunks(2).map(|pair| pair[0]).collect()
    }

    #[test]
    fn speckles_take_the_label_around_them_and_the_border_stays() {
        assert_eq!(settled(&[1, 1, 0, 1, 1, 1, 0, 0, 0, 3, 0, 0], 1.5), [1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0]);
        assert_eq!(settled(&[1, 1, 0, 0, 2, 2], 1.5), [1, 1, 0, 0, 2, 2]);
    }

    #[test]
    fn speckles_in_a_row_become_one_patch_and_what_stands_alone_stays() {
        let found = settled(&[1, 1, 1, 1, 0, 2, 0, 2, 1, 1, 1, 1], 1.5);
        assert!(found[..4].iter().chain(&found[8..]).all(|label| *label == 1), "{found:?}");
        assert_eq!(settled(&[7], 10.0), [7]);
        assert!(settle(&Mesh::default(), &[], 1.0).is_empty());
    }
}
