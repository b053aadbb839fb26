//! A stable, parallel radix sort of 32-bit keys.
//!
//! Every pass counts digits per chunk, adds them up in digit-major order and scatters. The result is the one stable
//! order, whatever the number of chunks. Scattered stores go through relaxed atomics, which are plain moves: every
//! element is written once, by one thread.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use rayon::prelude::*;

/// Digits of at most this many bits.
const DIGIT_BITS: u32 = 11;
/// Below this count one chunk is enough.
const MIN_CHUNK: usize = 8192;

/// Buffers that are kept between sorts.
#[derive(Debug, Default)]
pub(crate) struct Sorter {
    from: Vec<AtomicU64>,
    into: Vec<AtomicU64>,
    cursors: Vec<u32>,
}

impl Sorter {
    /// Writes into `order` the positions of `items`, smallest key first, equal keys in order of position.
    pub(crate) fn order<T: Sync>(&mut self, items: &[T], key: impl Fn(&T) -> u32 + Sync, order: &mut Vec<u32>) {
        let bounds = items.par_iter().with_min_len(MIN_CHUNK).map(|item| (key(item), key(item)));
        let (low, high) = bounds.reduce(|| (u32::MAX, 0), |a, b| (a.0.min(b.0), a.1.max(b.1)));
        let bits = 32 - high.saturating_sub(low).leading_zeros();
        let passes = bits.div_ceil(DIGIT_BITS).max(1);
        let width = bits.div_ceil(passes).max(1);
        self.from.resize_with(items.len(), AtomicU64::default);
        self.into.resize_with(items.len(), AtomicU64::default);
        let pairs = self.from.par_iter_mut().zip(items).with_min_len(MIN_CHUNK).enumerate();
        pairs.for_each(|(i, (pair, item))| *pair.get_mut() = u64::from(key(item) - low) << 32 | i as u64);
        for pass in 0..passes {
            self.pass(32 + pass * width, width);
        }
        let sorted = self.from.par_iter().with_min_len(MIN_CHUNK);
        sorted.map(|pair| pair.load(Relaxed) as u32).collect_into_vec(order);
    }

    fn pass(&mut self, shift: u32, width: u32) {
        let bins = 1usize << width;
        let chunk = self.from.len().div_ceil(rayon::current_num_threads()).max(MIN_CHUNK);
        let chunks = self.from.len().div_ceil(chunk).max(1);
        let digit = |pair: &AtomicU64| (pair.load(Relaxed) >> shift) as usize & (bins - 1);
        self.cursors.clear();
        self.cursors.resize(bins * chunks, 0);
        self.cursors.par_chunks_mut(bins).zip(self.from.par_chunks(chunk)).for_each(|(counts, pairs)| {
            for pair in pairs {
                counts[digit(pair)] += 1;
            }
        });
        starts(&mut self.cursors, bins);
        self.cursors.par_chunks_mut(bins).zip(self.from.par_chunks(chunk)).for_each(|(cursors, pairs)| {
            for pair in pairs {
                let cursor = &mut cursors[digit(pair)];
                self.into[*cursor as usize].store(pair.load(Relaxed), Relaxed);
                *cursor += 1;
            }
        });
        std::mem::swap(&mut self.from, &mut self.into);
    }
}

/// Turns counts `[chunks, bins]` into the position where each chunk begins to write each bin.
/// Returns the number of elements.
pub(crate) fn starts(counts: &mut [u32], bins: usize) -> u32 {
    let mut total = 0;
    for bin in 0..bins {
        for at in (bin..counts.len()).step_by(bins) {
            total += std::mem::replace(&mut counts[at], total);
        }
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;
    use pgsag_scene::numbers::SplitMix64;

    #[test]
    fn order_is_that_of_a_stable_sort() {
        let mut stream = SplitMix64::new(3);
        let mut sorter = Sorter::default();
        for (count, spread) in [(0, 1), (1, 1), (1000, 10), (70_000, 5000), (70_000, usize::MAX >> 33)] {
            let keys: Vec<u32> = (0..count).map(|_| 77 + stream.below(spread) as u32).collect();
            let mut expected: Vec<u32> = (0..count as u32).collect();
            expected.sort_by_key(|&i| keys[i as usize]);
            let mut order = Vec::new();
            sorter.order(&keys, |&key| key, &mut order);
            assert_eq!(order, expected);
        }
    }
}
