//! 8-bit RGB pixels, row-major, as decoded; colour arithmetic happens in the consumer's own precision.

use rayon::prelude::*;

/// An RGB image, sRGB-encoded as in the file, row-major.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// `[height * width]`, row-major.
    pub pixels: Vec<[u8; 3]>,
}

impl Image {
    /// An image of one colour.
    #[must_use]
    pub fn filled(width: u32, height: u32, color: [u8; 3]) -> Self {
        Self { width, height, pixels: vec![color; width as usize * height as usize] }
    }

    /// The pixel at column `x`, row `y`.
    #[must_use]
    pub fn at(&self, x: u32, y: u32) -> [u8; 3] {
        self.pixels[y as usize * self.width as usize + x as usize]
    }

    /// The window whose top-left pixel is `(x0, y0)`; it must lie inside the image.
    #[must_use]
    pub fn cropped(&self, x0: u32, y0: u32, width: u32, height: u32) -> Self {
        let mut pixels = Vec::with_capacity(width as usize * height as usize);
        for y in y0..y0 + height {
            let start = y as usize * self.width as usize + x0 as usize;
            pixels.extend_from_slice(&self.pixels[start..start + width as usize]);
        }
        Self { width, height, pixels }
    }

    /// The image at another size: every new pixel is the exact mean of the area that it covers.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        if (width, height) == (self.width, self.height) {
            return self.clone();
        }
        let area = u64::from(self.width) * u64::from(self.height);
        let sums = box_sums([self.width, self.height], [width, height], |i| self.pixels[i].map(u64::from));
        let pixels = sums.into_iter().map(|sum| sum.map(|sum| ((2 * sum + area) / (2 * area)) as u8)).collect();
        Self { width, height, pixels }
    }
}

/// Which old pixels a new pixel covers along one axis, and how much of each, in units that make a new pixel `old` wide
/// and an old one `new`: whole numbers, so that the mean is exact.
fn box_weights(old: u32, new: u32) -> Vec<(usize, Vec<u64>)> {
    let (old, new) = (u64::from(old), u64::from(new));
    let weights = |i: u64| {
        let (start, end) = (i * old, (i + 1) * old);
        let (first, last) = (start / new, end.div_ceil(new));
        let share = |p: u64| end.min((p + 1) * new) - start.max(p * new);
        (first as usize, (first..last).map(share).collect())
    };
    (0..new).map(weights).collect()
}

/// Weighted sums over the areas of the new pixels, row-major; the weights of each add up to the area of the old image.
/// `value` gives the channels of an old pixel by its index.
pub(crate) fn box_sums<const C: usize>(
    old: [u32; 2],
    new: [u32; 2],
    value: impl Fn(usize) -> [u64; C] + Sync,
) -> Vec<[u64; C]> {
    let (across, down) = (box_weights(old[0], new[0]), box_weights(old[1], new[1]));
    let mut sums = vec![[0; C]; new[0] as usize * new[1] as usize];
    sums.par_chunks_mut((new[0] as usize).max(1)).zip(&down).for_each(|(row, (first_y, weights_y))| {
        for (pixel, (first_x, weights_x)) in row.iter_mut().zip(&across) {
            for (y, weight_y) in (*first_y..).zip(weights_y) {
                let start = y * old[0] as usize;
                for (x, weight_x) in (*first_x..).zip(weights_x) {
                    let (value, weight) = (value(start + x), weight_x * weight_y);
                    (0..C).for_each(|c| pixel[c] += weight * value[c]);
                }
            }
        }
    });
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resizing_is_the_mean_over_the_area() {
        let pixels = (0..12u8).map(|i| [i * 10, 255, i]).collect();
        let image = Image { width: 4, height: 3, pixels };
        assert_eq!(image.resized(2, 3).pixels[0], [5, 255, 1]);
        assert_eq!(image.resized(1, 1).pixels, [[55, 255, 6]]);
        // Columns 0 and a third of 1, over one row: (0 + 10 / 3) / (4 / 3) = 2.5.
        assert_eq!(image.resized(3, 3).pixels[0][0], 3);
        assert_eq!(image.resized(8, 6).pixels[9], image.pixels[0]);
        let flat = Image::filled(101, 67, [200, 3, 255]);
        assert_eq!(flat.resized(13, 29), Image::filled(13, 29, [200, 3, 255]));
    }
}
