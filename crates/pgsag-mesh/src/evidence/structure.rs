//! What a mesh says of itself: how far its planes are from flat, and how wide its roof edges are. A mesh that is smoothed
//! gains the first and loses the second, so neither is worth anything without the other.

use serde::{Deserialize, Serialize};

mod edges;
mod planes;

pub use edges::{EdgeWidths, edge_widths};
pub use planes::{Plane, planes};

/// What counts as a plane and as an edge. Lengths in ground sampling distances.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StructureOptions {
    /// Faces turned by more than this from a plane are not of it, degrees.
    pub max_turn_deg: f64,
    /// Faces farther from a plane are not of it.
    pub max_off_gsd: f64,
    /// Side of the smallest square that is judged as a plane.
    pub min_side_gsd: f64,
    /// Edges lower than this are not judged.
    pub min_drop_gsd: f64,
    /// Roof and ground are read so far to either side of an edge.
    pub profile_gsd: f64,
}

impl Default for StructureOptions {
    fn default() -> Self {
        Self { max_turn_deg: 20.0, max_off_gsd: 3.0, min_side_gsd: 12.0, min_drop_gsd: 10.0, profile_gsd: 10.0 }
    }
}

#[cfg(test)]
mod tests;
