//! Rays against triangles: a binary tree of boxes, split at the median of the longest axis.
//! Built for a few thousand to a few hundred thousand triangles that never move.

use glam::DVec3;

/// Triangles per leaf.
const LEAF: usize = 3;

struct Node {
    low: DVec3,
    high: DVec3,
    /// Leaf: first triangle; inner node: its right child (the left one follows the node).
    start: u32,
    /// Triangles of a leaf; 0 = inner node.
    count: u32,
    axis: u8,
}

struct Triangle {
    corner: DVec3,
    edges: [DVec3; 2],
    face: u32,
}

/// The tree.
pub(super) struct Bvh {
    nodes: Vec<Node>,
    triangles: Vec<Triangle>,
}

impl Bvh {
    pub(super) fn new(faces: &[[DVec3; 3]]) -> Self {
        let mut order: Vec<u32> = (0..faces.len() as u32).collect();
        let mut nodes = Vec::new();
        if !faces.is_empty() {
            split(faces, &mut order, 0, &mut nodes);
        }
        let triangles = order
            .iter()
            .map(|&face| {
                let [a, b, c] = faces[face as usize];
                Triangle { corner: a, edges: [b - a, c - a], face }
            })
            .collect();
        Self { nodes, triangles }
    }

    /// The first face hit and the ray parameter there, below `limit`.
    pub(super) fn nearest(&self, origin: DVec3, direction: DVec3, limit: f64) -> Option<(u32, f64)> {
        let mut best = None;
        let mut reach = limit;
        self.walk(
            origin,
            direction,
            |triangle, reached| {
                if let Some(t) = triangle.hit(origin, direction)
                    && t < *reached
                {
                    *reached = t;
                    best = Some((triangle.face, t));
                }
                false
            },
            &mut reach,
        );
        best
    }

    /// Whether anything lies between the origin and `origin + limit * direction`.
    pub(super) fn blocked(&self, origin: DVec3, direction: DVec3, limit: f64) -> bool {
        let mut reach = limit;
        self.walk(
            origin,
            direction,
            |triangle, reached| triangle.hit(origin, direction).is_some_and(|t| t < *reached),
            &mut reach,
        )
    }

    /// Visits the triangles of every box the ray meets before `reach`, near boxes first, until `visit` says stop.
    fn walk(
        &self,
        origin: DVec3,
        direction: DVec3,
        mut visit: impl FnMut(&Triangle, &mut f64) -> bool,
        reach: &mut f64,
    ) -> bool {
        let inverse = direction.recip();
        let negative = [direction.x < 0.0, direction.y < 0.0, direction.z < 0.0];
        let mut stack = [0u32; 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let at = stack[depth];
            let node = &self.nodes[at as usize];
            let (a, b) = ((node.low - origin) * inverse, (node.high - origin) * inverse);
            let enter = a.min(b).max_element();
            let leave = a.max(b).min_element();
            if !(enter <= leave * (1.0 + 1e-12) && leave >= 0.0 && enter <= *reach) {
                continue;
            }
            if node.count > 0 {
                let first = node.start as usize;
                for triangle in &self.triangles[first..first + node.count as usize] {
                    if visit(triangle, reach) {
                        return true;
                    }
                }
            } else {
                let (left, right) = (at + 1, node.start);
                let right_first = negative[node.axis as usize];
                (stack[depth], stack[depth + 1]) = if right_first { (left, right) } else { (right, left) };
                depth += 2;
            }
        }
        false
    }
}

impl Triangle {
    /// Möller and Trumbore 1997, both sides, edges included.
    fn hit(&self, origin: DVec3, direction: DVec3) -> Option<f64> {
        let [e1, e2] = self.edges;
        let p = direction.cross(e2);
        let determinant = e1.dot(p);
        if determinant == 0.0 {
            return None;
        }
        let inverse = 1.0 / determinant;
        let s = origin - self.corner;
        let u = s.dot(p) * inverse;
        if !(-1e-9..=1.0 + 1e-9).contains(&u) {
            return None;
        }
        let q = s.cross(e1);
        let v = direction.dot(q) * inverse;
        if v < -1e-9 || u + v > 1.0 + 1e-9 {
            return None;
        }
        let t = e2.dot(q) * inverse;
        (t > 0.0).then_some(t)
    }
}

/// Appends the subtree of `order`, whose first triangle will have index `first`.
fn split(faces: &[[DVec3; 3]], order: &mut [u32], first: u32, nodes: &mut Vec<Node>) {
    let corners = || order.iter().flat_map(|&face| faces[face as usize]);
    let low = corners().fold(DVec3::INFINITY, DVec3::min);
    let high = corners().fold(DVec3::NEG_INFINITY, DVec3::max);
    let at = nodes.len();
    let count = if order.len() <= LEAF { order.len() as u32 } else { 0 };
    nodes.push(Node { low, high, start: first, count, axis: 0 });
    if count > 0 {
        return;
    }
    let size = high - low;
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let key = |face: u32| faces[face as usize].iter().map(|corner| corner[axis]).sum::<f64>();
    let middle = order.len() / 2;
    order.select_nth_unstable_by(middle, |&a, &b| key(a).total_cmp(&key(b)).then(a.cmp(&b)));
    let (left, right) = order.split_at_mut(middle);
    split(faces, left, first, nodes);
    nodes[at].start = nodes.len() as u32;
    nodes[at].axis = axis as u8;
    split(faces, right, first + middle as u32, nodes);
}
