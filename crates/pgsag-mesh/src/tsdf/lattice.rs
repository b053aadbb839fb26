//! The lattice of voxel corners that all cubes of a city share. Because nodes are numbered from one origin and blocks
//! are aligned to multiples of 8 nodes, two cubes compute the same bits for a node that both hold.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Nodes along the side of a block.
pub const BLOCK_SIDE: i32 = 8;

/// Where node `[i, j, k]` lies: `origin + voxel * [i, j, k]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lattice {
    /// Node `[0, 0, 0]`, world frame.
    pub origin: DVec3,
    /// Distance between nodes, scene units.
    pub voxel: f64,
}

impl Lattice {
    /// A node's place, world frame.
    #[must_use]
    pub fn node(&self, index: [i32; 3]) -> DVec3 {
        self.origin + self.voxel * DVec3::new(f64::from(index[0]), f64::from(index[1]), f64::from(index[2]))
    }

    /// A world point in units of voxels from the origin.
    #[must_use]
    pub fn to_voxels(&self, point: DVec3) -> DVec3 {
        (point - self.origin) / self.voxel
    }

    /// The smallest box of cells that covers the world box from `low` to `high`.
    #[must_use]
    pub fn cells_covering(&self, low: DVec3, high: DVec3) -> CellBox {
        let low = self.to_voxels(low).floor();
        let high = self.to_voxels(high).ceil();
        CellBox { low: [low.x as i32, low.y as i32, low.z as i32], high: [high.x as i32, high.y as i32, high.z as i32] }
    }
}

/// Cells `low..high` (half open on every axis); its nodes are `low..=high`, so neighbouring boxes share a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CellBox {
    /// First cell.
    pub low: [i32; 3],
    /// One past the last cell.
    pub high: [i32; 3],
}

impl CellBox {
    /// Whether it holds no cell.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        (0..3).any(|a| self.low[a] >= self.high[a])
    }

    /// Whether the cell is one of its.
    #[must_use]
    pub fn contains(&self, cell: [i32; 3]) -> bool {
        (0..3).all(|a| cell[a] >= self.low[a] && cell[a] < self.high[a])
    }

    /// Parts the box into cubes of at most `cells_per_side` cells (rounded up to whole blocks), cut where the lattice
    /// index is a multiple of that side, x fastest. Meshes of the cubes meet without cracks.
    #[must_use]
    pub fn tiles(&self, cells_per_side: u32) -> Vec<Self> {
        let side = (cells_per_side.clamp(1, 1 << 20) as i32 + BLOCK_SIDE - 1) / BLOCK_SIDE * BLOCK_SIDE;
        let mut tiles = Vec::new();
        if self.is_empty() {
            return tiles;
        }
        let first = self.low.map(|v| v.div_euclid(side));
        let last = self.high.map(|v| (v - 1).div_euclid(side));
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                for x in first[0]..=last[0] {
                    let at = [x, y, z];
                    tiles.push(Self {
                        low: std::array::from_fn(|a| self.low[a].max(at[a] * side)),
                        high: std::array::from_fn(|a| self.high[a].min((at[a] + 1) * side)),
                    });
                }
            }
        }
        tiles
    }

    /// First and last block (inclusive) that hold its nodes.
    pub(crate) fn block_range(&self) -> ([i32; 3], [i32; 3]) {
        (self.low.map(|v| v.div_euclid(BLOCK_SIDE)), self.high.map(|v| v.div_euclid(BLOCK_SIDE)))
    }
}
