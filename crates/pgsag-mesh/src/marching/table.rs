//! The 256 cases of marching cubes (Lorensen and Cline 1987), derived instead of typed: on every face of the cube the
//! inside corners are kept apart where there is a choice, so two cells that share a face always cut it alike and the
//! surface has no cracks.

/// Corner `c` of a cell lies at `(c & 1, c >> 1 & 1, c >> 2 & 1)`.
pub(crate) const CORNERS: usize = 8;

/// Edges of a cell as (corner with the smaller coordinates, axis).
pub(crate) const EDGES: [(usize, usize); 12] =
    [(0, 0), (2, 0), (4, 0), (6, 0), (0, 1), (1, 1), (4, 1), (5, 1), (0, 2), (1, 2), (2, 2), (3, 2)];

/// Corners of the six faces, counter-clockwise seen from outside.
const FACES: [[usize; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// Triangles (three edges each) of every case; bit `c` of the case is set where corner `c` is inside.
pub(crate) struct CaseTable {
    /// Counter-clockwise seen from outside the surface.
    pub triangles: Vec<Vec<[u8; 3]>>,
}

impl CaseTable {
    /// Derives all cases (a few microseconds each).
    pub(crate) fn new() -> Self {
        Self { triangles: (0..256).map(triangles_of_case).collect() }
    }
}

fn edge_between(a: usize, b: usize) -> usize {
    let (low, axis) = (a.min(b), (a ^ b).trailing_zeros() as usize);
    EDGES.iter().position(|edge| *edge == (low, axis)).expect("neighbouring corners share an edge")
}

/// Whether two edges lie on one face of the cube.
fn share_face(a: usize, b: usize) -> bool {
    let on = |face: &[usize; 4], edge: usize| {
        let (corner, axis) = EDGES[edge];
        face.contains(&corner) && face.contains(&(corner | (1 << axis)))
    };
    FACES.iter().any(|face| on(face, a) && on(face, b))
}

fn triangles_of_case(case: usize) -> Vec<[u8; 3]> {
    let inside = |corner: usize| case >> corner & 1 == 1;
    // On a face walked counter-clockwise every run of inside corners is entered over one edge and left over another;
    // the cut goes from the one to the other. An edge is entered on one of its faces and left on the other.
    let mut next = [usize::MAX; 12];
    for face in &FACES {
        for start in 0..4 {
            let (before, first) = (face[start], face[(start + 1) % 4]);
            if inside(before) || !inside(first) {
                continue;
            }
            let mut at = start + 1;
            while inside(face[(at + 1) % 4]) {
                at += 1;
            }
            next[edge_between(before, first)] = edge_between(face[at % 4], face[(at + 1) % 4]);
        }
    }
    let mut triangles = Vec::new();
    let mut used = [false; 12];
    for start in 0..12 {
        let mut ring = Vec::new();
        let mut edge = start;
        while next[edge] != usize::MAX && !used[edge] {
            used[edge] = true;
            ring.push(edge);
            edge = next[edge];
        }
        if ring.len() >= 3 {
            triangulate(&ring, &mut triangles);
        }
    }
    triangles
}

/// Cuts a ring into triangles whose inner sides lie on no face of the cube where that is possible: two cells that both
/// laid a side on their common face would share it four times.
fn triangulate(ring: &[usize], triangles: &mut Vec<[u8; 3]>) {
    if !cut(ring, true, triangles) {
        cut(ring, false, triangles);
    }
}

fn cut(ring: &[usize], strict: bool, triangles: &mut Vec<[u8; 3]>) -> bool {
    let n = ring.len();
    if n < 3 {
        return true;
    }
    let last = n - 1;
    for middle in 1..last {
        let blocked = |a: usize, b: usize, side: bool| side && strict && share_face(ring[a], ring[b]);
        if blocked(0, middle, middle > 1) || blocked(middle, last, middle + 1 < last) {
            continue;
        }
        let before = triangles.len();
        triangles.push([ring[0] as u8, ring[middle] as u8, ring[last] as u8]);
        if cut(&ring[..=middle], strict, triangles) && cut(&ring[middle..], strict, triangles) {
            return true;
        }
        triangles.truncate(before);
    }
    false
}
