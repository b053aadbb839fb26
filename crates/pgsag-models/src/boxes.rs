//! Boxes in pixels: overlap, suppression of near copies, and the crops of the everything mode.

/// Left, top, right, bottom, pixels.
pub type Corners = [f32; 4];

/// Area of a box; 0 where it is turned inside out.
#[must_use]
pub fn area(corners: &Corners) -> f32 {
    (corners[2] - corners[0]).max(0.0) * (corners[3] - corners[1]).max(0.0)
}

/// Intersection over union.
#[must_use]
pub fn overlap(a: &Corners, b: &Corners) -> f32 {
    let inner = [a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])];
    let inner = area(&inner);
    let both = area(a) + area(b) - inner;
    if both > 0.0 { inner / both } else { 0.0 }
}

/// Indices of the boxes that stay, best first: a box goes where a better one overlaps it by more than `most`.
#[must_use]
pub fn suppress(boxes: &[Corners], scores: &[f32], most: f32) -> Vec<usize> {
    let mut order: Vec<usize> = (0..boxes.len()).collect();
    order.sort_by(|&a, &b| scores[b].total_cmp(&scores[a]).then(a.cmp(&b)));
    let mut kept: Vec<usize> = Vec::new();
    for index in order {
        if kept.iter().all(|&better| overlap(&boxes[index], &boxes[better]) <= most) {
            kept.push(index);
        }
    }
    kept
}

/// A part of an image: left, top, right (not included), bottom (not included), pixels.
pub type Window = [u32; 4];

/// Share of the short side by which crops of one layer overlap; the reference's.
pub const CROP_OVERLAP: f64 = 512.0 / 1500.0;

/// The image itself, then 4 crops, then 16, … per layer, column by column.
#[must_use]
pub fn crops(width: u32, height: u32, layers: u32) -> Vec<Window> {
    let mut windows = vec![[0, 0, width, height]];
    for layer in 0..layers {
        let count = 2u32 << layer;
        let overlap = (CROP_OVERLAP * f64::from(width.min(height)) * (2.0 / f64::from(count))) as u32;
        let side = |whole: u32| (overlap * (count - 1) + whole).div_ceil(count);
        let (w, h) = (side(width), side(height));
        for column in 0..count {
            for row in 0..count {
                let (x, y) = (w.saturating_sub(overlap) * column, h.saturating_sub(overlap) * row);
                windows.push([x, y, (x + w).min(width), (y + h).min(height)]);
            }
        }
    }
    windows.retain(|window| window[0] < window[2] && window[1] < window[3]);
    windows
}

/// Tiles of at most `side` pixels that overlap by at least `share` of it and cover the image evenly.
#[must_use]
pub fn tiles(width: u32, height: u32, side: u32, share: f64) -> Vec<Window> {
    let starts = |whole: u32| {
        if whole <= side {
            return vec![0];
        }
        let step = (f64::from(side) * (1.0 - share)).max(1.0);
        let count = (f64::from(whole - side) / step).ceil() as u32 + 1;
        (0..count).map(|i| (u64::from(whole - side) * u64::from(i) / u64::from(count - 1)) as u32).collect()
    };
    let mut windows = Vec::new();
    for y in starts(height) {
        windows.extend(starts(width).into_iter().map(|x| [x, y, (x + side).min(width), (y + side).min(height)]));
    }
    windows
}

/// `count` x `count` points in the middle of equal cells of the unit square, row by row.
#[must_use]
pub fn point_grid(count: u32) -> Vec<[f64; 2]> {
    let place = |index: u32| (f64::from(index) + 0.5) / f64::from(count);
    (0..count).flat_map(|y| (0..count).map(move |x| [place(x), place(y)])).collect()
}

#[cfg(test)]
mod tests;
