//! Superpixels (SLIC, Achanta et al. 2012): small patches of like colour, so that labels can follow edges of the image.

use pgsag_scene::{Image, Map};
use rayon::prelude::*;

/// Rounds of assignment and averaging.
const ROUNDS: u32 = 4;
/// Colour difference (grey levels) that counts as much as one step of the grid.
const COMPACTNESS: f32 = 22.0;

/// Where every pixel belongs.
#[derive(Clone, Debug, PartialEq)]
pub struct Superpixels {
    /// Number of the superpixel of every pixel.
    pub label: Map<u32>,
    /// How many there are; some may hold no pixel.
    pub count: usize,
}

#[derive(Clone, Copy, Default)]
struct Center {
    at: [f32; 2],
    color: [f32; 3],
}

/// Superpixels about `step_px` wide. Each pixel looks only at the nine centres of the grid around it, so that the work is
/// linear and rows are independent.
#[must_use]
pub fn superpixels(image: &Image, step_px: u32) -> Superpixels {
    let step = step_px.max(2);
    let (columns, rows) = (image.width.div_ceil(step), image.height.div_ceil(step));
    let mut centers: Vec<Center> = (0..columns * rows)
        .map(|k| {
            let (x, y) = ((k % columns) * step + step / 2, (k / columns) * step + step / 2);
            let (x, y) = (x.min(image.width - 1), y.min(image.height - 1));
            Center { at: [x as f32 + 0.5, y as f32 + 0.5], color: image.at(x, y).map(f32::from) }
        })
        .collect();
    let mut label = Map::filled(image.width, image.height, 0u32);
    for _ in 0..ROUNDS {
        assign(image, &centers, [columns, rows], step, &mut label);
        centers = averages(image, &label, &centers);
    }
    Superpixels { label, count: centers.len() }
}

fn assign(image: &Image, centers: &[Center], [columns, rows]: [u32; 2], step: u32, label: &mut Map<u32>) {
    let (place_weight, color_weight) = (1.0 / (step * step) as f32, 1.0 / (COMPACTNESS * COMPACTNESS));
    label.values.par_chunks_mut(image.width.max(1) as usize).enumerate().for_each(|(y, row)| {
        let cell_y = y as u32 / step;
        for (x, own) in row.iter_mut().enumerate() {
            let (cell_x, color) = (x as u32 / step, image.at(x as u32, y as u32).map(f32::from));
            let mut best = f32::INFINITY;
            for v in cell_y.saturating_sub(1)..(cell_y + 2).min(rows) {
                for u in cell_x.saturating_sub(1)..(cell_x + 2).min(columns) {
                    let center = &centers[(v * columns + u) as usize];
                    let (dx, dy) = (x as f32 + 0.5 - center.at[0], y as f32 + 0.5 - center.at[1]);
                    let off: f32 = (0..3).map(|c| (color[c] - center.color[c]).powi(2)).sum();
                    let distance = (dx * dx + dy * dy) * place_weight + off * color_weight;
                    if distance < best {
                        (best, *own) = (distance, v * columns + u);
                    }
                }
            }
        }
    });
}

fn averages(image: &Image, label: &Map<u32>, before: &[Center]) -> Vec<Center> {
    // Whole numbers, so that the order of summation does not matter.
    let mut sums = vec![[0u64; 6]; before.len()];
    for (at, (number, color)) in label.values.iter().zip(&image.pixels).enumerate() {
        let (x, y) = (at as u64 % u64::from(image.width), at as u64 / u64::from(image.width));
        let own = [1, 2 * x + 1, 2 * y + 1, color[0].into(), color[1].into(), color[2].into()];
        sums[*number as usize].iter_mut().zip(own).for_each(|(sum, value)| *sum += value);
    }
    let average = |(sum, before): (&[u64; 6], &Center)| {
        if sum[0] == 0 {
            return *before;
        }
        let mean = |k: usize| sum[k] as f32 / sum[0] as f32;
        Center { at: [0.5 * mean(1), 0.5 * mean(2)], color: [mean(3), mean(4), mean(5)] }
    };
    sums.iter().zip(before).map(average).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn superpixels_do_not_cross_a_strong_edge() {
        let mut image = Image::filled(61, 40, [40, 40, 40]);
        for y in 0..40u32 {
            for x in 27 + y / 8..61 {
                image.pixels[(y * 61 + x) as usize] = [200, 190, 180];
            }
        }
        let found = superpixels(&image, 8);
        let mut sides = vec![[0u32; 2]; found.count];
        for (at, number) in found.label.values.iter().enumerate() {
            sides[*number as usize][usize::from(image.pixels[at][0] > 100)] += 1;
        }
        let mixed: u32 = sides.iter().map(|side| side[0].min(side[1])).sum();
        assert!(mixed <= 12, "{mixed} pixels on the wrong side");
        assert!(sides.iter().filter(|side| side[0] + side[1] > 0).count() > 30);
    }
}
