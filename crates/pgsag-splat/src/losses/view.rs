//! What the losses need of a view, derived once from the photograph and its mask.

use std::ops::Range;

use pgsag_scene::PixelClass;

use super::image_gradient::ImageGradient;
use crate::backend::{TrainingView, ViewCamera};

/// Half the side of an NCC patch, pixels: 7 x 7. PGSR.
pub const PATCH_HALF: usize = 3;

/// A view prepared for the losses. All maps `[H * W]`, row-major; 16 bytes per pixel.
#[derive(Clone, Debug)]
pub struct LossView {
    /// Of the image.
    pub camera: ViewCamera,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The photograph: R, G, B.
    pub photo: [Vec<u8>; 3],
    /// Class of every pixel; `Inside` everywhere without a mask.
    pub classes: Vec<PixelClass>,
    /// Whether a pixel takes part in the losses: boundary or inside.
    pub active: Vec<bool>,
    /// Pixels that take part: boundary or inside.
    pub active_count: usize,
    /// Seen background.
    pub free_count: usize,
    /// Per row, the columns from the first active pixel to past the last; empty where there is none.
    pub spans: Vec<Range<usize>>,
    /// Where the normal weighs less: the boundary band and known inner edges.
    pub edge: Vec<bool>,
    /// Luma 0.299 R + 0.587 G + 0.114 B, full scale 1.
    pub gray: Vec<f32>,
    /// Texture of the photograph.
    pub gradient: ImageGradient,
    /// Whether the 7 x 7 patch about the pixel is active throughout.
    pub patch_fits: Vec<bool>,
    /// Whether the pixel and its right, lower and lower right neighbours are active.
    pub quad_fits: Vec<bool>,
}

impl LossView {
    /// Derives everything. Linear in pixels. Image and mask must have the camera's size.
    #[must_use]
    pub fn new(view: &TrainingView) -> Self {
        let (width, height) = (view.image.width as usize, view.image.height as usize);
        let classes = match &view.mask {
            Some(mask) => mask.classes.clone(),
            None => vec![PixelClass::Inside; width * height],
        };
        let mut edge: Vec<bool> = classes.iter().map(|&class| class == PixelClass::Boundary).collect();
        if let Some(inner) = &view.inner_edges {
            edge.iter_mut().zip(&inner.values).for_each(|(edge, &inner)| *edge |= inner);
        }
        let spans = classes.chunks(width.max(1)).map(span).collect();
        let gray = view.image.pixels.iter().map(|&rgb| luma(rgb)).collect();
        let active: Vec<bool> = classes.iter().map(|class| class.is_active()).collect();
        Self {
            camera: view.camera,
            width,
            height,
            active_count: active.iter().filter(|&&active| active).count(),
            free_count: classes.iter().filter(|&&class| class == PixelClass::Free).count(),
            spans,
            edge,
            gray,
            gradient: ImageGradient::new(&view.image),
            patch_fits: fits(&active, width, height, PATCH_HALF, PATCH_HALF),
            quad_fits: fits(&active, width, height, 0, 1),
            photo: std::array::from_fn(|channel| view.image.pixels.iter().map(|rgb| rgb[channel]).collect()),
            classes,
            active,
        }
    }

    /// Whether a pixel takes part in the losses.
    #[must_use]
    #[inline]
    pub fn is_active(&self, index: usize) -> bool {
        self.active[index]
    }

    /// Columns of a row in which somebody may look at a gradient: from the first to the last active pixel, or all where
    /// free pixels may be drawn too.
    #[must_use]
    #[inline]
    pub fn reach(&self, row: usize) -> Range<usize> {
        if self.free_count > 0 { 0..self.width } else { self.spans[row].clone() }
    }

    /// Over how many pixels the photometric and normal terms average, at least 1.
    #[must_use]
    pub fn mean_count(&self, mean_over_mask: bool) -> usize {
        if mean_over_mask { self.active_count.max(1) } else { (self.width * self.height).max(1) }
    }
}

fn luma([r, g, b]: [u8; 3]) -> f32 {
    (0.299 * f32::from(r) + 0.587 * f32::from(g) + 0.114 * f32::from(b)) / 255.0
}

fn span(row: &[PixelClass]) -> Range<usize> {
    let first = row.iter().position(|class| class.is_active());
    let last = row.iter().rposition(|class| class.is_active());
    match (first, last) {
        (Some(first), Some(last)) => first..last + 1,
        _ => 0..0,
    }
}

/// Whether all pixels from `before` before to `after` after, in both axes, are active; false where the window leaves
/// the image. Two passes over runs: linear in pixels, whatever the window.
fn fits(active: &[bool], width: usize, height: usize, before: usize, after: usize) -> Vec<bool> {
    let mut across = vec![false; active.len()];
    for y in 0..height {
        let mut run = 0;
        for x in 0..width {
            run = if active[y * width + x] { run + 1 } else { 0 };
            if run > before + after {
                across[y * width + x - after] = true;
            }
        }
    }
    let mut both = vec![false; active.len()];
    let mut runs = vec![0; width];
    for y in 0..height {
        for x in 0..width {
            runs[x] = if across[y * width + x] { runs[x] + 1 } else { 0 };
            if runs[x] > before + after {
                both[(y - after) * width + x] = true;
            }
        }
    }
    both
}
