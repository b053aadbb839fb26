//! Indexed triangles whose faces know their building and their group.

/// A triangle mesh in the world frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// `[V]`, world frame, f64.
    pub vertices: Vec<[f64; 3]>,
    /// `[V]` RGB, or empty where the mesh has no colour.
    pub colors: Vec<[u8; 3]>,
    /// `[F]` vertex indices, counter-clockwise seen from outside.
    pub faces: Vec<[u32; 3]>,
    /// `[F]` building number, 0 = none; or empty.
    pub buildings: Vec<u32>,
    /// `[F]` group number, 0 = background; or empty.
    pub groups: Vec<u32>,
    /// `[F]` 1 where no photograph measured the face and it only closes a gap, else 0; or empty where none does.
    pub closed: Vec<u32>,
}

impl Mesh {
    /// Corners of face `f`.
    #[must_use]
    pub fn triangle(&self, f: usize) -> [[f64; 3]; 3] {
        self.faces[f].map(|v| self.vertices[v as usize])
    }

    /// Whether face `f` was measured, not put in to close a gap.
    #[must_use]
    pub fn is_measured(&self, f: usize) -> bool {
        self.closed.get(f).is_none_or(|closed| *closed == 0)
    }
}
