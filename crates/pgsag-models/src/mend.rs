//! Masks mended: holes filled, specks removed, edges moved outwards.

use pgsag_scene::Map;
use serde::{Deserialize, Serialize};

/// What is done to a mask, in this order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Mending {
    /// Holes of at most so many pixels are filled; 0: none.
    pub hole_px: u32,
    /// Pieces of fewer pixels are removed; 0: none.
    pub speck_px: u32,
    /// How far the edge moves outwards, pixels.
    pub grow_px: u32,
}

/// Mends a mask.
pub fn mend(mask: &mut Map<bool>, how: &Mending) {
    if how.hole_px > 0 {
        turn(mask, false, |piece| !piece.is_at_border && piece.area_px <= how.hole_px);
    }
    if how.speck_px > 0 {
        turn(mask, true, |piece| piece.area_px < how.speck_px);
    }
    if how.grow_px > 0 {
        grow(mask, how.grow_px);
    }
}

/// A connected piece of equal pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Piece {
    /// Pixels.
    pub area_px: u32,
    /// Whether it touches the image's border.
    pub is_at_border: bool,
}

/// Turns every piece of `value` that is to go; neighbours are the four beside.
fn turn(mask: &mut Map<bool>, value: bool, goes: impl Fn(&Piece) -> bool) {
    let (width, height) = (mask.width as usize, mask.height as usize);
    let mut is_seen = vec![false; mask.values.len()];
    let (mut open, mut members) = (Vec::new(), Vec::new());
    for start in 0..mask.values.len() {
        if is_seen[start] || mask.values[start] != value {
            continue;
        }
        let mut is_at_border = false;
        members.clear();
        is_seen[start] = true;
        open.push(start);
        while let Some(at) = open.pop() {
            members.push(at);
            let (x, y) = (at % width, at / width);
            is_at_border |= x == 0 || y == 0 || x + 1 == width || y + 1 == height;
            let beside = [
                (x > 0).then(|| at - 1),
                (x + 1 < width).then(|| at + 1),
                (y > 0).then(|| at - width),
                (y + 1 < height).then(|| at + width),
            ];
            for next in beside.into_iter().flatten() {
                if !is_seen[next] && mask.values[next] == value {
                    is_seen[next] = true;
                    open.push(next);
                }
            }
        }
        if goes(&Piece { area_px: members.len() as u32, is_at_border }) {
            members.iter().for_each(|&at| mask.values[at] = !value);
        }
    }
}

/// A square of `2 radius + 1` pixels drawn at every pixel: along rows, then along columns.
fn grow(mask: &mut Map<bool>, radius: u32) {
    let (width, height, radius) = (mask.width as usize, mask.height as usize, radius as usize);
    let spread = |line: &mut dyn FnMut(usize) -> bool, length: usize| {
        let mut sums = vec![0u32; length + 1];
        for at in 0..length {
            sums[at + 1] = sums[at] + u32::from(line(at));
        }
        (0..length).map(|at| sums[(at + radius + 1).min(length)] > sums[at.saturating_sub(radius)]).collect::<Vec<_>>()
    };
    for y in 0..height {
        let row = spread(&mut |x| mask.values[y * width + x], width);
        mask.values[y * width..][..width].copy_from_slice(&row);
    }
    for x in 0..width {
        let column = spread(&mut |y| mask.values[y * width + x], height);
        (0..height).for_each(|y| mask.values[y * width + x] = column[y]);
    }
}

#[cfg(test)]
mod tests;
