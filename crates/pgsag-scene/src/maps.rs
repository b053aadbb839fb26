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

    /// A map of what a function makes of every pixel.
    #[must_use]
    pub fn mapped<U>(&self, of: impl Fn(&T) -> U) -> Map<U> {
        Map { width: self.width, height: self.height, values: self.values.iter().map(of).collect() }
    }
}

impl<T: Copy> Map<T> {
    /// The map at another size, every pixel from the nearest one.
    #[must_use]
    pub fn resized_nearest(&self, width: u32, height: u32) -> Self {
        let nearest = |at: u32, new: u32, old: u32| {
            let place = (f64::from(at) + 0.5) * f64::from(old) / f64::from(new);
            (place as u32).min(old.saturating_sub(1))
        };
        let mut values = Vec::with_capacity(width as usize * height as usize);
        for y in 0..height {
            let row = nearest(y, height, self.height);
            values.extend((0..width).map(|x| self.at(nearest(x, width, self.width), row)));
        }
        Self { width, height, values }
    }
}

impl Map<bool> {
    /// The mask at another size: true where at least half of the area that the pixel covers is.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let area = u64::from(self.width) * u64::from(self.height);
        let inside = |i: usize| [u64::from(self.values[i])];
        let sums = crate::image::box_sums([self.width, self.height], [width, height], inside);
        let values = sums.into_iter().map(|[sum]: [u64; 1]| 2 * sum >= area).collect();
        Self { width, height, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_keep_what_is_half_covered() {
        let mut mask = Map::filled(6, 2, false);
        [(0, 0), (0, 1), (2, 0)].iter().for_each(|&(x, y)| mask.set(x, y, true));
        assert_eq!(mask.resized(3, 1).values, [true, false, false]);
        assert!(mask.resized_nearest(12, 4).at(1, 3));
        assert!(!mask.resized_nearest(12, 4).at(2, 3));
        assert_eq!(mask.resized_nearest(6, 2), mask);
    }
}
