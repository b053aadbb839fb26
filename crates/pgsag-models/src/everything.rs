//! Everything mode: a grid of clicks, the masks that hold, each thing once. What SAM 2's automatic generator does.

use pgsag_scene::{Image, Map};
use serde::{Deserialize, Serialize};

use crate::boxes::{Corners, Window, crops, point_grid, suppress};
use crate::enlarge::{Logits, mark, outline, rows};
use crate::error::ModelError;
use crate::sam::{MaskLogits, PointKind, PointPrompt, Sam2};

/// When a mask is kept; the defaults are SAM 2's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EverythingOptions {
    /// Clicks along each side of the image.
    pub points_per_side: u32,
    /// Least predicted overlap with the truth.
    pub least_iou: f32,
    /// Least share of sure pixels among likely ones, at the photograph's size.
    pub least_stability: f32,
    /// How far from 0 a logit is sure.
    pub stability_offset: f32,
    /// Boxes that overlap by more are the same thing.
    pub most_overlap: f32,
    /// Layers of crops beside the whole image: 4 crops, then 16, …
    pub crop_layers: u32,
}

impl Default for EverythingOptions {
    fn default() -> Self {
        Self {
            points_per_side: 32,
            least_iou: 0.8,
            least_stability: 0.95,
            stability_offset: 1.0,
            most_overlap: 0.7,
            crop_layers: 0,
        }
    }
}

/// A mask that was kept.
#[derive(Clone, Debug, PartialEq)]
pub struct Segment {
    /// First and last column and row, pixels of the photograph.
    pub corners: Corners,
    /// Predicted overlap with the truth.
    pub score: f32,
    /// Pixels.
    pub area_px: u64,
    /// Part of the photograph that it was found in.
    pub window: Window,
    logits: Vec<f32>,
    size: [usize; 2],
}

impl Segment {
    /// Adds it to a mask of the photograph's size.
    pub fn mark(&self, mask: &mut Map<bool>) {
        mark(self.small(), mask, self.window);
    }

    /// Writes a number where it is, into a map of the photograph's size.
    pub fn paint(&self, numbers: &mut Map<u32>, number: u32) {
        let [x0, y0, x1, y1] = self.window;
        let stride = numbers.width as usize;
        rows(self.small(), x1 - x0, y1 - y0, |y, values| {
            let start = (y0 + y) as usize * stride + x0 as usize;
            let row = numbers.values[start..start + values.len()].iter_mut().zip(values);
            row.filter(|(_, value)| **value > 0.0).for_each(|(own, _)| *own = number);
        });
    }

    fn small(&self) -> Logits<'_> {
        Logits { size: self.size, values: &self.logits }
    }
}

/// A mask this close to the edge of a crop is cut off by it, pixels; SAM 2's.
const CUT_OFF_PX: f32 = 20.0;
/// Clicks that are decoded at once; SAM 2's.
const CLICKS_AT_ONCE: usize = 64;

/// All segments of an image, best first within each crop. `keep_going` is asked between batches.
///
/// # Errors
/// [`ModelError`] of the network; what `keep_going` says.
pub fn segments<E: From<ModelError>>(
    sam: &Sam2,
    image: &Image,
    options: &EverythingOptions,
    keep_going: &dyn Fn() -> Result<(), E>,
) -> Result<Vec<Segment>, E> {
    let windows = crops(image.width, image.height, options.crop_layers);
    let mut found = Vec::new();
    for window in &windows {
        let kept = in_window(sam, image, *window, options, keep_going)?;
        let boxes: Vec<Corners> = kept.iter().map(|segment| segment.corners).collect();
        let scores: Vec<f32> = kept.iter().map(|segment| segment.score).collect();
        found.extend(chosen(kept, &suppress(&boxes, &scores, options.most_overlap)));
    }
    if windows.len() > 1 {
        // What is seen in a smaller crop is seen better.
        let boxes: Vec<Corners> = found.iter().map(|segment| segment.corners).collect();
        let area = |[x0, y0, x1, y1]: Window| (x1 - x0) as f32 * (y1 - y0) as f32;
        let scores: Vec<f32> = found.iter().map(|segment| 1.0 / area(segment.window)).collect();
        found = chosen(found, &suppress(&boxes, &scores, options.most_overlap));
    }
    Ok(found)
}

fn chosen(segments: Vec<Segment>, order: &[usize]) -> Vec<Segment> {
    let mut slots: Vec<Option<Segment>> = segments.into_iter().map(Some).collect();
    order.iter().filter_map(|&index| slots[index].take()).collect()
}

fn in_window<E: From<ModelError>>(
    sam: &Sam2,
    image: &Image,
    window: Window,
    options: &EverythingOptions,
    keep_going: &dyn Fn() -> Result<(), E>,
) -> Result<Vec<Segment>, E> {
    let [x0, y0, x1, y1] = window;
    let (width, height) = (x1 - x0, y1 - y0);
    let is_whole = (width, height) == (image.width, image.height);
    let embedding = if is_whole { sam.embed(image)? } else { sam.embed(&image.cropped(x0, y0, width, height))? };
    let click = |[x, y]: &[f64; 2]| PointPrompt {
        points: vec![([(x * f64::from(width)) as f32, (y * f64::from(height)) as f32], PointKind::Positive)],
    };
    let clicks: Vec<PointPrompt> = point_grid(options.points_per_side).iter().map(click).collect();
    let mut kept = Vec::new();
    for batch in clicks.chunks(CLICKS_AT_ONCE) {
        keep_going()?;
        for masks in sam.decode(&embedding, batch)? {
            kept.extend(that_hold(masks, window, [image.width, image.height], options));
        }
    }
    Ok(kept)
}

/// The masks of tokens 1 to 3 that are good, stable and not cut off.
fn that_hold(masks: MaskLogits, window: Window, image: [u32; 2], options: &EverythingOptions) -> Vec<Segment> {
    let [x0, y0, x1, y1] = window;
    let first = usize::from(masks.masks.len() > 3);
    let (size, scores) = (masks.size, masks.scores);
    let mut kept = Vec::new();
    for (logits, score) in masks.masks.into_iter().zip(scores).skip(first) {
        if score <= options.least_iou {
            continue;
        }
        let small = Logits { size, values: &logits };
        let outline = outline(small, x1 - x0, y1 - y0, options.stability_offset);
        let shift = [x0, y0, x0, y0].map(|side| side as f32);
        let corners: Corners = std::array::from_fn(|side| outline.corners[side] + shift[side]);
        if outline.stability >= options.least_stability && !is_cut_off(&corners, window, image) {
            kept.push(Segment { corners, score, area_px: outline.area_px, window, logits, size });
        }
    }
    kept
}

fn is_cut_off(corners: &Corners, window: Window, image: [u32; 2]) -> bool {
    let whole = [0, 0, image[0], image[1]];
    let is_near = |side: usize, edges: [u32; 4]| (corners[side] - edges[side] as f32).abs() <= CUT_OFF_PX;
    (0..4).any(|side| is_near(side, window) && !is_near(side, whole))
}

#[cfg(test)]
mod tests;
