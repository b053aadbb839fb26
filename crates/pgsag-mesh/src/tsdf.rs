//! A sparse truncated signed distance volume (Curless and Levoy 1996; block hashing after Niessner 2013): 8^3 nodes per
//! block, fed one depth view at a time, of any cube of one common lattice. Only blocks near a surface exist, and none
//! is made when the limit would be passed. The value of a node depends on the views and the lattice alone, so cubes
//! agree on the nodes that they share, and nothing depends on the number of threads.

use std::collections::{HashMap, HashSet};

use serde::{Deserialize, Serialize};

use crate::error::MeshError;
use crate::fuse::DepthView;

mod grow;
mod integrate;
mod lattice;
mod planes;
mod touch;

pub use lattice::{BLOCK_SIDE, CellBox, Lattice};

/// Nodes in a block.
pub(crate) const BLOCK_NODES: usize = (BLOCK_SIDE * BLOCK_SIDE * BLOCK_SIDE) as usize;
/// Key, index entry and box of one block besides its nodes, bytes, rounded up.
const BLOCK_OVERHEAD: u64 = 64;

/// How depth becomes volume. Lengths in voxels unless named otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TsdfOptions {
    /// Distances in front of the surface are cut to this many voxels (method 3.8).
    pub front_voxels: f32,
    /// Nodes farther behind the surface than this many voxels are not touched: more closes up parapets, fewer let the
    /// news of free space that leaks through holes paint a second sheet inside (decision 0010).
    pub behind_voxels: f32,
    /// Weight, as a share of a measurement's own, of what it says `behind_voxels` behind the surface; it falls linearly from
    /// the surface on (Bylow et al. 2013). Below an eave a roof seen from behind hides open air: 1 rounds it outwards.
    pub behind_weight: f32,
    /// Weight, as a share of a measurement's own, of the news that a node beyond the truncation is free; 0 = no carving.
    pub free_space_weight: f32,
    /// Nodes of no more weight than this are unknown: no surface is made beside them. 1 = one frontal pixel per voxel.
    pub min_weight: f32,
    /// Pixels seen at a smaller cosine of incidence say nothing (method 3.8: 80 degrees).
    pub min_cos: f64,
    /// Depths beyond are not used, scene units.
    pub max_depth: f64,
    /// Whether colours are kept (half of the memory).
    pub color: bool,
    /// Bytes that the blocks may take.
    pub max_bytes: u64,
}

impl Default for TsdfOptions {
    fn default() -> Self {
        Self {
            front_voxels: 4.0,
            behind_voxels: 3.0,
            behind_weight: 0.5,
            free_space_weight: 0.25,
            min_weight: 0.01,
            min_cos: 0.174,
            max_depth: f64::INFINITY,
            color: true,
            max_bytes: 4 << 30,
        }
    }
}

/// Values of 8^3 nodes, x fastest.
pub(crate) struct Block {
    /// Signed distance over the front truncation, at most 1, positive outside.
    pub distance: [f32; BLOCK_NODES],
    /// Sum of the weights.
    pub weight: [f32; BLOCK_NODES],
    /// RGB in 1/256 steps and the weight behind it in 1/256 steps (saturating).
    pub color: Option<Box<[[u16; 4]; BLOCK_NODES]>>,
}

impl Block {
    fn new(color: bool) -> Self {
        Self {
            distance: [1.0; BLOCK_NODES],
            weight: [0.0; BLOCK_NODES],
            color: color.then(|| Box::new([[0; 4]; BLOCK_NODES])),
        }
    }
}

/// Bytes one block takes.
fn block_bytes(color: bool) -> u64 {
    let nodes = BLOCK_NODES as u64;
    BLOCK_OVERHEAD + 8 * nodes + if color { 8 * nodes } else { 0 }
}

/// The distance volume of one cube.
pub struct Volume {
    pub(crate) lattice: Lattice,
    pub(crate) region: CellBox,
    /// Blocks that are kept beyond the region, so that what grows into gaps is the same in all cubes.
    pub(crate) margin_blocks: i32,
    pub(crate) options: TsdfOptions,
    pub(crate) index: HashMap<[i32; 3], u32>,
    pub(crate) keys: Vec<[i32; 3]>,
    pub(crate) blocks: Vec<Box<Block>>,
}

impl Volume {
    /// An empty volume over the cells of `region`.
    ///
    /// # Errors
    /// Options out of range.
    pub fn new(lattice: Lattice, region: CellBox, options: TsdfOptions) -> Result<Self, MeshError> {
        check_options(&lattice, &options)?;
        let (index, keys, blocks) = Default::default();
        Ok(Self { lattice, region, margin_blocks: 0, options, index, keys, blocks })
    }

    /// Adds one view: makes the blocks near its surface and averages its distances into all blocks it sees.
    ///
    /// # Errors
    /// A raster of the wrong size; more memory needed than `max_bytes` (then nothing is changed).
    pub fn integrate(&mut self, view: &DepthView<'_>) -> Result<(), MeshError> {
        view.check()?;
        let planes = planes::pixel_planes(view, &self.lattice, &self.options);
        let touched = touch::touched_blocks(view, &planes, &self.lattice, &self.region, self.margin_blocks);
        self.allocate(&touched)?;
        self.average(view, &planes, &touched, 0);
        Ok(())
    }

    /// Makes the blocks near the surface of a view without averaging it in. Where all views are reserved before the
    /// first is integrated, free space counts for every block and the order of the views matters only in the last bits.
    ///
    /// # Errors
    /// As [`Self::integrate`].
    pub fn reserve(&mut self, view: &DepthView<'_>) -> Result<(), MeshError> {
        view.check()?;
        let planes = planes::pixel_planes(view, &self.lattice, &self.options);
        self.allocate(&touch::touched_blocks(view, &planes, &self.lattice, &self.region, self.margin_blocks))
    }

    /// Bytes in use.
    #[must_use]
    pub fn memory_bytes(&self) -> u64 {
        self.blocks.len() as u64 * block_bytes(self.options.color)
    }

    /// Blocks in use.
    #[must_use]
    pub fn block_count(&self) -> usize {
        self.blocks.len()
    }

    fn allocate(&mut self, touched: &[[i32; 3]]) -> Result<(), MeshError> {
        let new: Vec<_> = touched.iter().filter(|key| !self.index.contains_key(*key)).copied().collect();
        let needed_bytes = self.memory_bytes() + new.len() as u64 * block_bytes(self.options.color);
        if needed_bytes > self.options.max_bytes {
            return Err(MeshError::Memory { needed_bytes, max_bytes: self.options.max_bytes });
        }
        for key in new {
            self.index.insert(key, self.blocks.len() as u32);
            self.keys.push(key);
            self.blocks.push(Box::new(Block::new(self.options.color)));
        }
        Ok(())
    }
}

/// Counts the blocks that views would need, without making them: 12 bytes a block instead of 8 256.
pub struct Estimate {
    lattice: Lattice,
    region: CellBox,
    options: TsdfOptions,
    keys: HashSet<[i32; 3]>,
}

impl Estimate {
    /// Nothing counted yet.
    ///
    /// # Errors
    /// Options out of range.
    pub fn new(lattice: Lattice, region: CellBox, options: TsdfOptions) -> Result<Self, MeshError> {
        check_options(&lattice, &options)?;
        Ok(Self { lattice, region, options, keys: HashSet::new() })
    }

    /// Counts one view.
    ///
    /// # Errors
    /// A raster of the wrong size.
    pub fn add(&mut self, view: &DepthView<'_>) -> Result<(), MeshError> {
        view.check()?;
        let planes = planes::pixel_planes(view, &self.lattice, &self.options);
        self.keys.extend(touch::touched_blocks(view, &planes, &self.lattice, &self.region, 0));
        Ok(())
    }

    /// Bytes a [`Volume`] of the same views takes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.keys.len() as u64 * block_bytes(self.options.color)
    }
}

fn check_options(lattice: &Lattice, options: &TsdfOptions) -> Result<(), MeshError> {
    positive("voxel", lattice.voxel)?;
    options.check()
}

fn positive(name: &'static str, value: f64) -> Result<(), MeshError> {
    if value > 0.0 { Ok(()) } else { Err(MeshError::Option { name, value, allowed: "greater than 0" }) }
}

impl TsdfOptions {
    /// Whether a volume can be made with these.
    ///
    /// # Errors
    /// The first that is out of range.
    pub fn check(&self) -> Result<(), MeshError> {
        positive("front_voxels", self.front_voxels.into())?;
        positive("behind_voxels", self.behind_voxels.into())?;
        positive("min_cos", self.min_cos)?;
        if !(0.0..=1.0).contains(&self.behind_weight) {
            let value = f64::from(self.behind_weight);
            return Err(MeshError::Option { name: "behind_weight", value, allowed: "0 to 1" });
        }
        if !(self.free_space_weight >= 0.0 && self.min_weight >= 0.0) {
            let value = f64::from(self.free_space_weight.min(self.min_weight));
            return Err(MeshError::Option { name: "free_space_weight, min_weight", value, allowed: "0 or more" });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;

/// A volume whose nodes inside `region` hold a given field (over the front truncation) with weight 1.
#[cfg(test)]
pub(crate) fn volume_of_field(
    lattice: Lattice,
    region: CellBox,
    options: TsdfOptions,
    mut field: impl FnMut(glam::DVec3) -> f64,
) -> Volume {
    let mut volume = Volume::new(lattice, region, options).expect("good options");
    let (low, high) = region.block_range();
    let keys = (low[0]..=high[0])
        .flat_map(|x| (low[1]..=high[1]).flat_map(move |y| (low[2]..=high[2]).map(move |z| [x, y, z])));
    volume.allocate(&keys.collect::<Vec<_>>()).expect("fits");
    for (key, block) in volume.keys.iter().zip(&mut volume.blocks) {
        for node in 0..BLOCK_NODES as i32 {
            let at = [node % 8, node / 8 % 8, node / 64];
            let at = std::array::from_fn(|a| key[a] * 8 + at[a]);
            block.weight[node as usize] = 1.0;
            block.distance[node as usize] = field(lattice.node(at)).min(1.0) as f32;
        }
    }
    volume
}
