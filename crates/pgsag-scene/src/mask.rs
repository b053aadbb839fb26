//! Per-pixel class of an image for one group (`free`, `occluded`, `boundary`, `inside`).
//! A view without a mask is "unknown": it is `Option::None` where a mask may be given, never an all-zero mask.

use serde::{Deserialize, Serialize};

/// What a pixel shows, from the point of view of one group.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[repr(u8)]
pub enum PixelClass {
    /// Seen background: no surface of the group lies on this ray in front of it.
    Free = 0,
    /// Something in front; the group may continue behind. Says nothing.
    Occluded = 1,
    /// The group, within the band where the mask's edge is uncertain.
    Boundary = 2,
    /// The group, for sure.
    Inside = 3,
}

impl PixelClass {
    /// Whether the pixel takes part in the losses of the group: `Boundary` or `Inside`.
    #[must_use]
    #[inline]
    pub fn is_active(self) -> bool {
        self >= Self::Boundary
    }
}

/// Classes of every pixel, row-major; the same size as its image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// `[height * width]`, row-major.
    pub classes: Vec<PixelClass>,
}

impl Mask {
    /// A mask of one class.
    #[must_use]
    pub fn filled(width: u32, height: u32, class: PixelClass) -> Self {
        Self { width, height, classes: vec![class; width as usize * height as usize] }
    }

    /// The class at column `x`, row `y`.
    #[must_use]
    pub fn at(&self, x: u32, y: u32) -> PixelClass {
        self.classes[y as usize * self.width as usize + x as usize]
    }

    /// How many pixels take part in the losses.
    #[must_use]
    pub fn active_count(&self) -> usize {
        self.classes.iter().filter(|class| class.is_active()).count()
    }

    /// The window whose top-left pixel is `(x0, y0)`; it must lie inside the mask.
    #[must_use]
    pub fn cropped(&self, x0: u32, y0: u32, width: u32, height: u32) -> Self {
        let mut classes = Vec::with_capacity(width as usize * height as usize);
        for y in y0..y0 + height {
            let start = y as usize * self.width as usize + x0 as usize;
            classes.extend_from_slice(&self.classes[start..start + width as usize]);
        }
        Self { width, height, classes }
    }
}
