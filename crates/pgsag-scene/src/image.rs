//! 8-bit RGB pixels, row-major, as decoded; colour arithmetic happens in the consumer's own precision.

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
}
