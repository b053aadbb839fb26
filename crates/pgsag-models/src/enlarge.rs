//! Small maps of logits at the size of the photograph: bilinear, pixel centres at halves (`align_corners = False`),
//! row by row, so that no map of floats of the photograph's size ever exists.

use pgsag_scene::Map;

use crate::boxes::{Corners, Window};

/// A small map of logits.
#[derive(Clone, Copy, Debug)]
pub struct Logits<'a> {
    /// Columns and rows.
    pub size: [usize; 2],
    /// `[rows * columns]`, row-major.
    pub values: &'a [f32],
}

/// Where a new place lies between two old ones, and how far towards the second.
fn places(old: usize, new: u32) -> Vec<(usize, usize, f32)> {
    let scale = old as f32 / new as f32;
    let place = |index: u32| {
        let at = (scale * (index as f32 + 0.5) - 0.5).max(0.0);
        let low = (at as usize).min(old - 1);
        (low, (low + 1).min(old - 1), at - low as f32)
    };
    (0..new).map(place).collect()
}

/// Calls `row(y, values)` for every row of the map at `width` x `height`.
pub fn rows(logits: Logits<'_>, width: u32, height: u32, mut row: impl FnMut(u32, &[f32])) {
    let [columns, _] = logits.size;
    let across = places(columns, width);
    let (mut mixed, mut values) = (vec![0.0f32; columns], vec![0.0f32; width as usize]);
    for (y, (low, high, share)) in places(logits.size[1], height).into_iter().enumerate() {
        let (upper, lower) = (&logits.values[low * columns..][..columns], &logits.values[high * columns..][..columns]);
        for (value, (a, b)) in mixed.iter_mut().zip(upper.iter().zip(lower)) {
            *value = (1.0 - share) * a + share * b;
        }
        for (value, (left, right, share)) in values.iter_mut().zip(&across) {
            *value = (1.0 - share) * mixed[*left] + share * mixed[*right];
        }
        row(y as u32, &values);
    }
}

/// Adds what is above 0 to the window of a mask.
pub fn mark(logits: Logits<'_>, mask: &mut Map<bool>, window: Window) {
    let [x0, y0, x1, y1] = window;
    let stride = mask.width as usize;
    rows(logits, x1 - x0, y1 - y0, |y, values| {
        let start = (y0 + y) as usize * stride + x0 as usize;
        for (inside, value) in mask.values[start..start + values.len()].iter_mut().zip(values) {
            *inside |= *value > 0.0;
        }
    });
}

/// What is known of a mask without keeping it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outline {
    /// Pixels above 0.
    pub area_px: u64,
    /// Pixels above `+offset` as a share of those above `-offset`; 0 where there are none.
    pub stability: f32,
    /// First and last column and row above 0, as the reference counts them: left, top, right, bottom.
    pub corners: Corners,
}

/// Measures a mask at `width` x `height`.
#[must_use]
pub fn outline(logits: Logits<'_>, width: u32, height: u32, offset: f32) -> Outline {
    let (mut area_px, mut sure, mut likely) = (0u64, 0u64, 0u64);
    let mut corners = [u32::MAX, u32::MAX, 0, 0];
    rows(logits, width, height, |y, values| {
        let (mut first, mut last, mut count) = (u32::MAX, 0, 0);
        for (x, value) in values.iter().enumerate() {
            sure += u64::from(*value > offset);
            likely += u64::from(*value > -offset);
            if *value > 0.0 {
                count += 1;
                first = first.min(x as u32);
                last = x as u32;
            }
        }
        if count > 0 {
            area_px += count;
            corners = [corners[0].min(first), corners[1].min(y), corners[2].max(last), y];
        }
    });
    let corners = if area_px > 0 { corners.map(|side| side as f32) } else { [0.0; 4] };
    Outline { area_px, stability: sure as f32 / likely.max(1) as f32, corners }
}

/// Share of pixels above `+offset` among those above `-offset`, of the small map itself; 1 where there are none.
#[must_use]
pub fn small_stability(values: &[f32], offset: f32) -> f32 {
    let count = |least: f32| values.iter().filter(|value| **value > least).count();
    let likely = count(-offset);
    if likely == 0 { 1.0 } else { count(offset) as f32 / likely as f32 }
}

#[cfg(test)]
mod tests;
