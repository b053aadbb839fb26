//! Per-pixel quantities: depth, normal, distance, opacity. What "no value" looks like is said by each field that holds
//! a map; for depth it is 0.

/// A raster of values, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Map<T> {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// `[height * width]`, row-major.
    pub values: Vec<T>,
}

impl<T: Copy> Map<T> {
    /// A map of one value.
    #[must_use]
    pub fn filled(width: u32, height: u32, value: T) -> Self {
        Self { width, height, values: vec![value; width as usize * height as usize] }
    }

    /// The value at column `x`, row `y`.
    #[must_use]
    pub fn at(&self, x: u32, y: u32) -> T {
        self.values[y as usize * self.width as usize + x as usize]
    }

    /// Sets the value at column `x`, row `y`.
    pub fn set(&mut self, x: u32, y: u32, value: T) {
        self.values[y as usize * self.width as usize + x as usize] = value;
    }
}
