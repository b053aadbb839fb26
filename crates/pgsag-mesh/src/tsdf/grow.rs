//! Growing into gaps: where no surface was measured, the border between what photographs saw to be free and what nobody
//! saw is followed, block by block, so that the gap can be closed there (Curless and Levoy 1996, section 4).

use rayon::prelude::*;

use crate::error::MeshError;
use crate::fuse::DepthView;

use super::{BLOCK_SIDE, Block, Volume, planes};

impl Volume {
    /// Lets the volume follow gaps up to so many blocks beyond the surface, the same in all cubes of the lattice. To be
    /// called before the first view is reserved.
    pub fn follow_gaps(&mut self, blocks: u32) {
        self.margin_blocks = blocks.min(1 << 10) as i32;
    }

    /// Makes the blocks that the border of free and unknown space leads to next; returns where they begin among all
    /// blocks, for [`Self::integrate_into`], or `None` where it leads nowhere.
    ///
    /// # Errors
    /// More memory needed than `max_bytes` (then nothing is changed).
    pub fn grow(&mut self) -> Result<Option<usize>, MeshError> {
        let (low, high) = self.region.block_range();
        let margin = self.margin_blocks;
        let is_kept = |key: &[i32; 3]| (0..3).all(|a| key[a] >= low[a] - margin && key[a] <= high[a] + margin);
        let wanted = self.keys.par_iter().map(|key| (key, self.leads_to(*key)));
        let mut next: Vec<[i32; 3]> = wanted
            .flat_map_iter(|(key, sides)| {
                (0..SIDES).filter(move |side| sides >> side & 1 == 1).map(|side| beside(key, side))
            })
            .filter(|key| is_kept(key) && !self.index.contains_key(key))
            .collect();
        next.par_sort_unstable();
        next.dedup();
        let first = self.blocks.len();
        self.allocate(&next)?;
        Ok((self.blocks.len() > first).then_some(first))
    }

    /// Averages a view into the blocks from the `first` on.
    ///
    /// # Errors
    /// A raster of the wrong size.
    pub fn integrate_into(&mut self, first: usize, view: &DepthView<'_>) -> Result<(), MeshError> {
        view.check()?;
        let planes = planes::pixel_planes(view, &self.lattice, &self.options);
        self.average(view, &planes, &[], first);
        Ok(())
    }

    /// The blocks about `key`, as bits, that hold a node of a cell beside one in which free and unknown nodes meet.
    fn leads_to(&self, key: [i32; 3]) -> u32 {
        let around: [Option<&Block>; 8] = std::array::from_fn(|corner| {
            let at = self.index.get(&std::array::from_fn(|a| key[a] + (corner as i32 >> a & 1)))?;
            Some(&*self.blocks[*at as usize])
        });
        // Bit 0: free, bit 1: unknown; the nodes of the block and of the layer beyond.
        let news = |at: [i32; 3]| {
            let corner = (0..3).map(|a| usize::from(at[a] >= BLOCK_SIDE) << a).sum::<usize>();
            let Some(block) = around[corner] else { return 0 };
            let [x, y, z] = at.map(|v| v % BLOCK_SIDE);
            let node = ((z * BLOCK_SIDE + y) * BLOCK_SIDE + x) as usize;
            if block.weight[node] <= self.options.min_weight { 2 } else { u8::from(block.distance[node] >= 0.0) }
        };
        const SIDE: i32 = BLOCK_SIDE + 1;
        let mut all = [0u8; (SIDE * SIDE * SIDE) as usize];
        for (at, seen) in (0..).zip(&mut all) {
            *seen = news([at % SIDE, at / SIDE % SIDE, at / SIDE / SIDE]);
        }
        if all.iter().fold(0, |sum, seen| sum | seen) != 3 {
            return 0;
        }
        let mut sides = 0;
        for z in 0..BLOCK_SIDE {
            for y in 0..BLOCK_SIDE {
                for x in 0..BLOCK_SIDE {
                    let corner = |c: i32| {
                        all[((z + (c >> 2 & 1)) * SIDE * SIDE + (y + (c >> 1 & 1)) * SIDE + x + (c & 1)) as usize]
                    };
                    if (0..8).fold(0, |sum, c| sum | corner(c)) == 3 {
                        let reach = [x, y, z].map(|v| (-i32::from(v == 0), i32::from(v + 2 >= BLOCK_SIDE)));
                        sides |= sides_within(reach);
                    }
                }
            }
        }
        sides
    }
}

/// Blocks about one, itself included.
const SIDES: u32 = 27;

/// The block on one of the sides.
fn beside(key: &[i32; 3], side: u32) -> [i32; 3] {
    let side = side as i32;
    [key[0] + side % 3 - 1, key[1] + side / 3 % 3 - 1, key[2] + side / 9 - 1]
}

/// Bits of the sides that lie within so many blocks on each axis.
fn sides_within(reach: [(i32, i32); 3]) -> u32 {
    let mut sides = 0;
    for z in reach[2].0..=reach[2].1 {
        for y in reach[1].0..=reach[1].1 {
            for x in reach[0].0..=reach[0].1 {
                sides |= 1 << ((z + 1) * 9 + (y + 1) * 3 + x + 1);
            }
        }
    }
    sides
}
