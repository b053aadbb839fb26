//! Which tiles, blocks and pixels of a raster are drawn. Everything of size "pixels" is stored for drawn tiles only,
//! tile by tile in row-major order, block by block within a tile, 16 lanes to a block.

use super::lanes::{BLOCK, BLOCKS, TILE};

/// The slot of a tile that is not drawn.
pub(crate) const NOT_DRAWN: u32 = u32::MAX;

/// The drawn part of a raster.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    /// Pixels.
    pub(crate) width: u32,
    /// Pixels.
    pub(crate) height: u32,
    /// Tiles per row.
    pub(crate) columns: u32,
    /// Tile rows.
    pub(crate) rows: u32,
    /// Drawn tiles, ascending, `row * columns + column`.
    pub(crate) tiles: Vec<u32>,
    /// `[rows * columns]` position of a tile in `tiles`, or [`NOT_DRAWN`].
    pub(crate) slot_of_tile: Vec<u32>,
    /// `[tiles]` one bit per pixel of every block, lane 0 lowest.
    pub(crate) drawn: Vec<[u16; BLOCKS]>,
    /// `[(rows + 1) * (columns + 1)]` drawn tiles above and left: a summed-area table.
    sums: Vec<u32>,
}

impl Layout {
    /// The pixels for which `drawn(x, y)` holds.
    pub(crate) fn new(width: u32, height: u32, drawn: impl Fn(u32, u32) -> bool) -> Self {
        let (columns, rows) = (width.div_ceil(TILE as u32), height.div_ceil(TILE as u32));
        let mut layout = Self {
            width,
            height,
            columns,
            rows,
            tiles: Vec::new(),
            slot_of_tile: vec![NOT_DRAWN; (columns * rows) as usize],
            drawn: Vec::new(),
            sums: vec![0; ((columns + 1) * (rows + 1)) as usize],
        };
        for tile in 0..columns * rows {
            let bits = layout.tile_bits(tile, &drawn);
            if bits != [0; BLOCKS] {
                layout.slot_of_tile[tile as usize] = layout.tiles.len() as u32;
                layout.tiles.push(tile);
                layout.drawn.push(bits);
            }
        }
        layout.sum_tiles();
        layout
    }

    fn tile_bits(&self, tile: u32, drawn: &impl Fn(u32, u32) -> bool) -> [u16; BLOCKS] {
        let mut bits = [0u16; BLOCKS];
        let (x0, y0) = self.corner(tile);
        for y in y0..(y0 + TILE as u32).min(self.height) {
            for x in x0..(x0 + TILE as u32).min(self.width) {
                if drawn(x, y) {
                    let (block, lane) = place((x - x0) as usize, (y - y0) as usize);
                    bits[block] |= 1 << lane;
                }
            }
        }
        bits
    }

    fn sum_tiles(&mut self) {
        let stride = (self.columns + 1) as usize;
        for row in 0..self.rows as usize {
            let mut along = 0;
            for column in 0..self.columns as usize {
                along += u32::from(self.slot_of_tile[row * self.columns as usize + column] != NOT_DRAWN);
                self.sums[(row + 1) * stride + column + 1] = self.sums[row * stride + column + 1] + along;
            }
        }
    }

    /// The top-left pixel of a tile.
    pub(crate) fn corner(&self, tile: u32) -> (u32, u32) {
        (tile % self.columns * TILE as u32, tile / self.columns * TILE as u32)
    }

    /// A row-major map with 0 in all tiles that are not drawn.
    pub(crate) fn only_drawn(&self, map: &[f32]) -> Vec<f32> {
        let mut out = map.to_vec();
        let width = self.width as usize;
        for (y, row) in out.chunks_exact_mut(width).enumerate() {
            let slots = &self.slot_of_tile[y / TILE * self.columns as usize..];
            let outside = row.chunks_mut(TILE).zip(slots).filter(|(_, slot)| **slot == NOT_DRAWN);
            outside.for_each(|(run, _)| run.fill(0.0));
        }
        out
    }

    /// Whether any tile of columns `x0..=x1`, rows `y0..=y1` is drawn.
    pub(crate) fn any_drawn(&self, x0: u32, x1: u32, y0: u32, y1: u32) -> bool {
        let stride = self.columns + 1;
        let at = |x: u32, y: u32| self.sums[(y * stride + x) as usize];
        at(x1 + 1, y1 + 1) + at(x0, y0) > at(x0, y1 + 1) + at(x1 + 1, y0)
    }
}

/// Block and lane of a pixel within its tile.
#[inline(always)]
pub(crate) fn place(x: usize, y: usize) -> (usize, usize) {
    (y / BLOCK * (TILE / BLOCK) + x / BLOCK, y % BLOCK * BLOCK + x % BLOCK)
}

/// First pixel column or row of every block of a tile.
pub(crate) fn block_corner(block: usize) -> (f32, f32) {
    ((block % (TILE / BLOCK) * BLOCK) as f32, (block / (TILE / BLOCK) * BLOCK) as f32)
}
