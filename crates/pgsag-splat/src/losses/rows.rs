//! Rows in parallel, sums in row order: the same bytes on any number of threads.

use rayon::prelude::*;

/// Fewest rows that a thread takes at a time.
const ROWS_AT_ONCE: usize = 8;

/// Calls `work(row index, row)` for every row of a map and returns what it returned, in row order.
pub(super) fn map_rows<T: Send, R: Send>(
    map: &mut [T],
    width: usize,
    work: impl Fn(usize, &mut [T]) -> R + Sync + Send,
) -> Vec<R> {
    map.par_chunks_mut(width.max(1)).with_min_len(ROWS_AT_ONCE).enumerate().map(|(y, row)| work(y, row)).collect()
}

/// Sum over rows, in row order, of what `work(row index, row)` returns.
pub(super) fn sum_rows<T: Send>(
    map: &mut [T],
    width: usize,
    work: impl Fn(usize, &mut [T]) -> f64 + Sync + Send,
) -> f64 {
    map_rows(map, width, work).into_iter().sum()
}
