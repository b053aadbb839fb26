//! A segmenter for tests: words find what is coloured like roofs, points flood what is coloured like them.

use pgsag_scene::{Image, Map};

use super::{Ask, SegmentError, Segmenter};

/// Largest difference per channel that a flood crosses, one candidate each.
#[derive(Clone, Debug)]
pub(crate) struct Flood {
    pub(crate) tolerances: Vec<u8>,
}

impl Default for Flood {
    fn default() -> Self {
        Self { tolerances: vec![40] }
    }
}

impl Segmenter for Flood {
    fn segment(&self, image: &Image, ask: &Ask<'_>) -> Result<Vec<Map<bool>>, SegmentError> {
        match *ask {
            Ask::Text(_) => {
                let is_roof = |rgb: &[u8; 3]| rgb[0] > 100 && rgb[0] > rgb[1].saturating_add(40);
                let values = image.pixels.iter().map(is_roof).collect();
                Ok(vec![Map { width: image.width, height: image.height, values }])
            }
            Ask::Points { positive, .. } => Ok(self.tolerances.iter().map(|t| flood(image, positive, *t)).collect()),
        }
    }
}

fn flood(image: &Image, positive: &[[f32; 2]], tolerance: u8) -> Map<bool> {
    let mut mask = Map::filled(image.width, image.height, false);
    let mut open: Vec<(u32, u32)> = positive.iter().map(|at| (at[0] as u32, at[1] as u32)).collect();
    open.iter().for_each(|(x, y)| mask.set(*x, *y, true));
    while let Some((x, y)) = open.pop() {
        let beside = [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)];
        for (u, v) in beside.into_iter().filter(|(u, v)| *u < image.width && *v < image.height) {
            let (a, b) = (image.at(x, y), image.at(u, v));
            if !mask.at(u, v) && a.iter().zip(&b).all(|(a, b)| a.abs_diff(*b) <= tolerance) {
                mask.set(u, v, true);
                open.push((u, v));
            }
        }
    }
    mask
}
