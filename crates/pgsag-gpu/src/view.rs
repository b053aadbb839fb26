//! A view on a card: packed pixels, and which tiles its mask touches.

use std::sync::Arc;

use pgsag_scene::PixelClass;
use pgsag_splat::backend::{BackendError, Result, TrainingView};

use crate::device::Device;
use crate::losses;
use crate::memory::Buffer;

/// Pixels along a tile's side.
pub(crate) const TILE: u32 = 16;
/// Bit of a packed pixel: boundary or known inner edge.
const EDGE: u32 = 1 << 26;

/// The drawn tiles of a raster.
#[derive(Debug)]
pub(crate) struct Tiles {
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// Drawn tiles. A tile's *slot* is its place among them, row by row.
    pub(crate) count: u32,
    /// `[count]` tile of each slot, `row · columns + column`.
    pub(crate) list: Buffer,
    /// `[rows · columns + 1]` drawn tiles before each tile: its slot, and slots of a run of tiles are a run.
    pub(crate) before: Buffer,
}

impl Tiles {
    /// Tiles with a pixel for which `drawn(index)` holds.
    pub(crate) fn new(device: &Device, width: u32, height: u32, drawn: impl Fn(usize) -> bool) -> Result<Self> {
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let mut any = vec![false; (columns * rows) as usize];
        for y in 0..height {
            let row = (y / TILE * columns) as usize;
            for x in 0..width {
                let tile = &mut any[row + (x / TILE) as usize];
                *tile = *tile || drawn((y * width + x) as usize);
            }
        }
        let list: Vec<u32> = (0..columns * rows).filter(|&tile| any[tile as usize]).collect();
        let mut before = vec![0u32; any.len() + 1];
        for (tile, drawn) in any.into_iter().enumerate() {
            before[tile + 1] = before[tile] + u32::from(drawn);
        }
        Ok(Self {
            width,
            height,
            count: list.len() as u32,
            list: device.buffer_with("tiles", &list)?,
            before: device.buffer_with("tiles", &before)?,
        })
    }
}

/// What is drawn, and compared, of one photograph.
pub struct GpuView {
    /// `[H · W]` R, G, B, and in the top byte the class (2 bits) and [`EDGE`].
    pub(crate) pixels: Arc<Buffer>,
    pub(crate) active: Arc<Tiles>,
    /// With the free pixels; `None` where there are none.
    pub(crate) with_free: Option<Arc<Tiles>>,
    /// What the losses derive.
    pub(crate) losses: losses::View,
}

impl std::fmt::Debug for GpuView {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Tiles { width, height, count, .. } = *self.active;
        f.debug_struct("GpuView").field("size", &(width, height)).field("tiles", &count).finish_non_exhaustive()
    }
}

impl GpuView {
    pub(crate) fn new(device: &Device, view: &TrainingView) -> Result<Self> {
        let (width, height) = (view.camera.pinhole.width, view.camera.pinhole.height);
        if (view.image.width, view.image.height) != (width, height) {
            return Err(BackendError::Device(format!(
                "an image of {} x {} pixels does not belong to a camera of {width} x {height}",
                view.image.width, view.image.height
            )));
        }
        let class = |index: usize| view.mask.as_ref().map_or(PixelClass::Inside, |mask| mask.classes[index]);
        let edge = |index: usize| {
            let inner = view.inner_edges.as_ref().is_some_and(|edges| edges.values[index]);
            inner || class(index) == PixelClass::Boundary
        };
        let packed = |(index, [r, g, b]): (usize, &[u8; 3])| {
            let bytes = u32::from_le_bytes([*r, *g, *b, class(index) as u8]);
            bytes | if edge(index) { EDGE } else { 0 }
        };
        let packed: Vec<u32> = view.image.pixels.iter().enumerate().map(packed).collect();
        let pixels = device.buffer_with("pixels", &packed)?;
        let has_free = view.mask.as_ref().is_some_and(|mask| mask.classes.contains(&PixelClass::Free));
        let with_free = || Tiles::new(device, width, height, |index| class(index) != PixelClass::Occluded);
        Ok(Self {
            active: Arc::new(Tiles::new(device, width, height, |index| class(index).is_active())?),
            with_free: if has_free { Some(Arc::new(with_free()?)) } else { None },
            losses: losses::prepare(device, &pixels, view)?,
            pixels: Arc::new(pixels),
        })
    }
}
