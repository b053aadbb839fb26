//! Photographs as the networks want them: resized the way Pillow and torch resize, normalised, channels first.

use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::F32x3;
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer};
use pgsag_scene::Image;
use serde::{Deserialize, Serialize};

use crate::error::{ModelError, RUN_FAILED};
use crate::tensor::Tensor;

mod pillow;

/// What a network expects of a picture; the manifest's `[image]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PictureRules {
    /// Length of the shortest side after resizing, pixels; aspect is kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shortest: Option<u32>,
    /// Most that the longest side may have then, pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub longest: Option<u32>,
    /// Side of the square that the picture is squashed to, pixels; aspect is not kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub square: Option<u32>,
    /// The only size (width, height) that the graph computes rightly: the picture is fitted in and padded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fixed: Option<[u32; 2]>,
    /// Subtracted from values of 0 to 1, per channel.
    pub mean: [f32; 3],
    /// Divided by after that.
    pub std: [f32; 3],
}

/// A picture for the detector and which part of the canvas it covers.
#[derive(Clone, Debug, PartialEq)]
pub struct Canvasful {
    /// `[1, 3, height, width]`.
    pub pixels: Tensor,
    /// Size of the canvas, pixels.
    pub canvas: [usize; 2],
    /// Size of the picture in its upper left corner, pixels.
    pub covered: [usize; 2],
}

impl PictureRules {
    /// Size of the resized picture: the reference's arithmetic, halves rounded to even.
    #[must_use]
    pub fn resized_size(&self, width: u32, height: u32) -> [u32; 2] {
        if let Some(square) = self.square {
            return [square; 2];
        }
        let shortest = self.shortest.unwrap_or(800);
        let longest = self.fixed.map_or(self.longest.unwrap_or(1333), |fixed| fixed[0].max(fixed[1]));
        let fitted = keep_aspect(width, height, shortest, longest);
        match self.fixed {
            Some([most_width, most_height]) if fitted[0] > most_width || fitted[1] > most_height => {
                let share = (f64::from(most_width) / f64::from(width)).min(f64::from(most_height) / f64::from(height));
                [width, height].map(|side| ((f64::from(side) * share) as u32).max(1))
            }
            _ => fitted,
        }
    }

    /// The picture for a detector: resized in bytes as Pillow does, padded where the graph has one size only.
    ///
    /// # Errors
    /// [`ModelError::Question`] where the picture is empty.
    pub fn detector_picture(&self, image: &Image) -> Result<Canvasful, ModelError> {
        if image.pixels.is_empty() {
            return Err(ModelError::question("a picture without pixels", "check the photograph"));
        }
        let covered = self.resized_size(image.width, image.height);
        let bytes = pillow::resize(&image.pixels, [image.width, image.height], covered);
        let canvas = self.fixed.unwrap_or(covered).map(|side| side as usize);
        let covered = covered.map(|side| side as usize);
        let value = |index: usize, channel: usize| f32::from(bytes[3 * index + channel]) / 255.0;
        let pixels = self.channels_first(canvas, covered, value);
        Ok(Canvasful { pixels, canvas, covered })
    }

    /// The picture for a segmenter: squashed to the square in floats as torch does with `antialias`.
    ///
    /// # Errors
    /// [`ModelError::Question`] where the picture is empty.
    pub fn segmenter_picture(&self, image: &Image) -> Result<Tensor, ModelError> {
        let size = self.resized_size(image.width, image.height);
        let values = resized_floats(image, size)?;
        let size = size.map(|side| side as usize);
        Ok(self.channels_first(size, size, |index, channel| values[3 * index + channel]))
    }

    fn channels_first(&self, canvas: [usize; 2], covered: [usize; 2], value: impl Fn(usize, usize) -> f32) -> Tensor {
        let plane = canvas[0] * canvas[1];
        let mut pixels = vec![0.0; 3 * plane];
        for channel in 0..3 {
            let (mean, std) = (self.mean[channel], self.std[channel]);
            for y in 0..covered[1] {
                let row = &mut pixels[channel * plane + y * canvas[0]..][..covered[0]];
                for (x, pixel) in row.iter_mut().enumerate() {
                    *pixel = (value(y * covered[0] + x, channel) - mean) / std;
                }
            }
        }
        Tensor::floats(&[1, 3, canvas[1], canvas[0]], pixels)
    }
}

/// Shortest side to `shortest` unless the longest would pass `longest`.
fn keep_aspect(width: u32, height: u32, shortest: u32, longest: u32) -> [u32; 2] {
    let (low, high) = (f64::from(width.min(height)), f64::from(width.max(height)));
    let mut wanted = f64::from(shortest);
    let mut side = shortest;
    if high / low * wanted > f64::from(longest) {
        wanted = f64::from(longest) * low / high;
        side = wanted.round_ties_even() as u32;
    }
    let (w, h) = (f64::from(width), f64::from(height));
    let size = if width.min(height) == side {
        [width, height]
    } else if width < height {
        [side, (wanted * h / w) as u32]
    } else {
        [(wanted * w / h) as u32, side]
    };
    size.map(|side| side.max(1))
}

/// A picture that every language makes alike, of whole numbers only: what self-tests are asked about.
#[must_use]
pub fn test_picture(seed: u64, width: u32, height: u32) -> Image {
    let value = |x: u64, y: u64, c: u64| {
        let stripes = 40 * ((x / 19 + y / 23) % 3);
        ((x * (7 + c) + y * (13 + 2 * c) + x * y * (seed + c) / 61 + stripes) % 256) as u8
    };
    let place = |index: u64| (index % u64::from(width), index / u64::from(width));
    let count = u64::from(width) * u64::from(height);
    let pixels = (0..count).map(place).map(|(x, y)| std::array::from_fn(|c| value(x, y, c as u64))).collect();
    Image { width, height, pixels }
}

fn options() -> ResizeOptions {
    ResizeOptions::new().resize_alg(ResizeAlg::Convolution(FilterType::Bilinear))
}

fn stopped(what: impl std::fmt::Display) -> ModelError {
    ModelError::runtime("resize", format!("{RUN_FAILED}: {what}"), "check the photograph")
}

/// Resized in floats of 0 to 1. `[height * width * 3]`
fn resized_floats(image: &Image, [width, height]: [u32; 2]) -> Result<Vec<f32>, ModelError> {
    let values: Vec<f32> = image.pixels.iter().flatten().map(|&value| f32::from(value) / 255.0).collect();
    let bytes: &[u8] = bytemuck::cast_slice(&values);
    let source = TypedImageRef::<F32x3>::from_buffer(image.width, image.height, bytes).map_err(stopped)?;
    let mut target = TypedImage::<F32x3>::new(width, height);
    Resizer::new().resize_typed(&source, &mut target, &options()).map_err(stopped)?;
    Ok(target.pixels().iter().flat_map(|pixel| pixel.0).collect())
}

#[cfg(test)]
mod tests;
