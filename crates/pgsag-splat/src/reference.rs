//! The slow true one: f64, pixel by pixel, no tricks.
