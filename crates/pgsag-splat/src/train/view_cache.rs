//! Prepared views within a byte bound: the least recently used go first. Results never depend on what is kept.

use std::sync::Arc;

use crate::backend::{Backend, TrainingView};
use crate::train::Result;
use crate::train::trainer::ViewSource;

/// What a prepared view costs per pixel, for the bound: colour, grey, weights, image gradient, class, edges.
const BYTES_PER_PIXEL: u64 = 40;
/// Pixels along a cell of the coarse masks.
const CELL: u32 = 8;

/// Where a view's mask is active, in cells of 8 x 8 pixels; `None`: everywhere.
pub(crate) struct CoarseMask {
    columns: u32,
    cells: Option<Vec<bool>>,
}

impl CoarseMask {
    fn of(view: &TrainingView) -> Self {
        let Some(mask) = &view.mask else { return Self { columns: 0, cells: None } };
        let columns = mask.width.div_ceil(CELL);
        let mut cells = vec![false; columns as usize * mask.height.div_ceil(CELL) as usize];
        for y in 0..mask.height {
            for x in 0..mask.width {
                if mask.at(x, y).is_active() {
                    cells[(y / CELL * columns + x / CELL) as usize] = true;
                }
            }
        }
        Self { columns, cells: Some(cells) }
    }

    /// Whether the view takes part at these pixel coordinates, which lie on the image.
    pub(crate) fn is_active(&self, at: [f64; 2]) -> bool {
        let cell = (at[1] as u32 / CELL * self.columns + at[0] as u32 / CELL) as usize;
        self.cells.as_ref().is_none_or(|cells| cells[cell])
    }
}

/// A view on the device, and where it takes part.
pub(crate) struct Prepared<V> {
    pub(crate) view: V,
    pub(crate) active: CoarseMask,
}

/// When a view was last used, and the view.
type Entry<V> = (u64, Arc<Prepared<V>>);

pub(crate) struct ViewCache<B: Backend> {
    entries: Vec<Option<Entry<B::View>>>,
    bytes_of: Vec<u64>,
    bound: u64,
    clock: u64,
}

impl<B: Backend> ViewCache<B> {
    pub(crate) fn new(views: &dyn ViewSource, bound: u64) -> Self {
        let bytes_of =
            (0..views.len()).map(|i| views.camera(i).pinhole.pixel_count() as u64 * BYTES_PER_PIXEL).collect();
        Self { entries: (0..views.len()).map(|_| None).collect(), bytes_of, bound, clock: 0 }
    }

    /// Whether a view is kept.
    pub(crate) fn holds(&self, index: usize) -> bool {
        self.entries[index].is_some()
    }

    /// The prepared view; `read` is asked only where it is not kept.
    pub(crate) fn get(
        &mut self,
        backend: &B,
        index: usize,
        read: impl FnOnce() -> Result<Arc<TrainingView>>,
    ) -> Result<Arc<Prepared<B::View>>> {
        self.clock += 1;
        if let Some((used, prepared)) = &mut self.entries[index] {
            *used = self.clock;
            return Ok(Arc::clone(prepared));
        }
        self.make_room(index);
        let view = read()?;
        let prepared = Arc::new(Prepared { view: backend.prepare(&view)?, active: CoarseMask::of(&view) });
        self.entries[index] = Some((self.clock, Arc::clone(&prepared)));
        Ok(prepared)
    }

    fn make_room(&mut self, index: usize) {
        let held = |entries: &[Option<_>], bytes_of: &[u64]| -> u64 {
            entries.iter().zip(bytes_of).filter(|(e, _)| e.is_some()).map(|(_, b)| *b).sum()
        };
        while held(&self.entries, &self.bytes_of) + self.bytes_of[index] > self.bound {
            let oldest =
                (0..self.entries.len()).filter_map(|i| self.entries[i].as_ref().map(|(used, _)| (*used, i))).min();
            let Some((_, i)) = oldest else { return };
            self.entries[i] = None;
        }
    }
}

#[cfg(test)]
mod tests;
