//! How textured a photograph is: the image gradient behind the weights of Eq. 8 (PGSR) and Eq. 9.
//!
//! Differences run over two pixels (right − left, below − above; one-sided at the border), absolute, averaged over
//! R G B; the larger axis counts. Computed on the unmasked photograph: the edge of a mask is no texture.

use pgsag_scene::Image;
use rayon::prelude::*;

/// Quantile of the gradient that counts as full texture. The published code divides by the maximum, which one
/// specular pixel decides.
const FULL_TEXTURE: f64 = 0.99;
/// Sum of three absolute differences of bytes at full scale.
const LEVELS: usize = 3 * 255;

/// Gradient of a photograph.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageGradient {
    /// `[H * W]` ∇I as printed: in units of full scale per two pixels, in [0, 1].
    pub printed: Vec<f32>,
    /// The 99th percentile of `printed`, at least one grey level.
    pub full: f32,
}

impl ImageGradient {
    /// Of a photograph. Linear in pixels.
    #[must_use]
    pub fn new(image: &Image) -> Self {
        let (width, height) = (image.width as usize, image.height as usize);
        let mut levels = vec![0u16; width * height];
        levels.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, row)| {
            let (above, below) = (y.saturating_sub(1) * width, (y + 1).min(height - 1) * width);
            for x in 0..width {
                let (left, right) = (y * width + x.saturating_sub(1), y * width + (x + 1).min(width - 1));
                let across = difference(image.pixels[left], image.pixels[right]);
                row[x] = across.max(difference(image.pixels[above + x], image.pixels[below + x]));
            }
        });
        let printed = levels.iter().map(|&level| f32::from(level) / LEVELS as f32).collect();
        Self { printed, full: quantile(&levels).max(1.0 / 255.0) }
    }

    /// g of a pixel, in [0, 1]: the gradient in units of full texture. The published code's weight is (1 − g)².
    #[must_use]
    pub fn normalized(&self, index: usize) -> f32 {
        (self.printed[index] / self.full).min(1.0)
    }
}

fn difference(a: [u8; 3], b: [u8; 3]) -> u16 {
    (0..3).map(|channel| u16::from(a[channel].abs_diff(b[channel]))).sum()
}

/// The full-texture quantile by counting, in the unit of `printed`.
fn quantile(levels: &[u16]) -> f32 {
    let mut counts = [0usize; LEVELS + 1];
    for &level in levels {
        counts[usize::from(level)] += 1;
    }
    let rank = (levels.len() as f64 * FULL_TEXTURE) as usize;
    let mut below = 0;
    for (level, count) in counts.iter().enumerate() {
        below += count;
        if below > rank {
            return level as f32 / LEVELS as f32;
        }
    }
    1.0
}
