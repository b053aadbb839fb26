//! Words to a mask: the detector's boxes, the segmenter's masks of them, all of them together in one mask.
//!
//! lang-segment-anything holds a float mask of the photograph's size per box; here each is added to one mask row by row
//! and forgotten. Large photographs may be cut into tiles that overlap; a tile's masks join in the same mask.

use pgsag_scene::{Image, Map};
use serde::{Deserialize, Serialize};

use crate::boxes::{Window, tiles};
use crate::enlarge::mark;
use crate::error::ModelError;
use crate::grounding::{Detection, GroundingDino, Prompt};
use crate::sam::{MaskChoice, PointPrompt, Sam2};

/// How large photographs are cut.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Tiling {
    /// Side of a tile, pixels; 0: the photograph as a whole, as lang-segment-anything does.
    pub side_px: u32,
    /// Share of a tile's side that its neighbour shows as well.
    pub overlap: f64,
}

impl Default for Tiling {
    fn default() -> Self {
        Self { side_px: 0, overlap: 0.2 }
    }
}

impl Tiling {
    /// The parts of a photograph.
    #[must_use]
    pub fn windows(&self, width: u32, height: u32) -> Vec<Window> {
        if self.side_px == 0 {
            return vec![[0, 0, width, height]];
        }
        tiles(width, height, self.side_px, self.overlap.clamp(0.0, 0.9))
    }
}

/// A mask and what it is made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// True where any of the detections is.
    pub mask: Map<bool>,
    /// Boxes, scores and words, pixels of the photograph.
    pub detections: Vec<Detection>,
}

/// A detector, a segmenter, and how they are asked.
pub struct LanguageSegmenter {
    /// Finds boxes by words.
    pub detector: GroundingDino,
    /// Makes masks of boxes and points.
    pub segmenter: Sam2,
    /// Which mask of a box is taken.
    pub choice: MaskChoice,
    /// How large photographs are cut.
    pub tiling: Tiling,
}

impl LanguageSegmenter {
    /// The mask of all that the words fit. `keep_going` is asked before each tile.
    ///
    /// # Errors
    /// [`ModelError`] of the question or the networks; what `keep_going` says.
    pub fn find<E: From<ModelError>>(
        &self,
        image: &Image,
        prompt: &Prompt,
        keep_going: &dyn Fn() -> Result<(), E>,
    ) -> Result<Finding, E> {
        self.find_in_windows(image, prompt, &self.tiling.windows(image.width, image.height), keep_going)
    }

    /// The same without tiles.
    ///
    /// # Errors
    /// As [`Self::find`].
    pub fn find_whole<E: From<ModelError>>(
        &self,
        image: &Image,
        prompt: &Prompt,
        keep_going: &dyn Fn() -> Result<(), E>,
    ) -> Result<Finding, E> {
        self.find_in_windows(image, prompt, &[[0, 0, image.width, image.height]], keep_going)
    }

    fn find_in_windows<E: From<ModelError>>(
        &self,
        image: &Image,
        prompt: &Prompt,
        windows: &[Window],
        keep_going: &dyn Fn() -> Result<(), E>,
    ) -> Result<Finding, E> {
        self.detector.ids(&prompt.text)?;
        let mut mask = Map::filled(image.width, image.height, false);
        let mut detections = Vec::new();
        for window in windows {
            keep_going()?;
            let [x0, y0, x1, y1] = *window;
            let is_whole = (x1 - x0, y1 - y0) == (image.width, image.height);
            let found = if is_whole {
                self.find_in(image, prompt, *window, &mut mask)?
            } else {
                self.find_in(&image.cropped(x0, y0, x1 - x0, y1 - y0), prompt, *window, &mut mask)?
            };
            let shift = [x0, y0, x0, y0].map(|side| side as f32);
            detections.extend(found.into_iter().map(|mut detection| {
                detection.corners = std::array::from_fn(|side| detection.corners[side] + shift[side]);
                detection
            }));
        }
        Ok(Finding { mask, detections })
    }

    fn find_in(
        &self,
        part: &Image,
        prompt: &Prompt,
        window: Window,
        mask: &mut Map<bool>,
    ) -> Result<Vec<Detection>, ModelError> {
        let detections = self.detector.detect(part, prompt)?;
        if detections.is_empty() {
            return Ok(detections);
        }
        let embedding = self.segmenter.embed(part)?;
        for batch in detections.chunks(BOXES_AT_ONCE) {
            let boxes: Vec<PointPrompt> = batch.iter().map(|found| PointPrompt::from_box(&found.corners)).collect();
            for masks in self.segmenter.decode(&embedding, &boxes)? {
                mark(masks.logits(masks.chosen(self.choice)), mask, window);
            }
        }
        Ok(detections)
    }
}

/// Boxes whose small masks are held at once.
const BOXES_AT_ONCE: usize = 64;

#[cfg(test)]
pub(crate) mod tests;
