//! SAM 2: an image once to its embedding, then points and boxes to masks, as many as wanted.
//!
//! The picture is squashed to a square; prompts follow. The decoder gives one mask per token: token 0 for clear prompts,
//! 1 to 3 for ambiguous ones. Which is taken is a choice; the default is what lang-segment-anything takes.

use std::path::Path;

use pgsag_scene::Image;
use serde::{Deserialize, Serialize};

use crate::boxes::Corners;
use crate::enlarge::{Logits, small_stability};
use crate::error::{ModelError, RUN_FAILED};
use crate::grounding::unknown_graph;
use crate::onnx::Graph;
use crate::picture::PictureRules;
use crate::runtime::Session;
use crate::tensor::{Element, Tensor};

/// Which of a prompt's masks is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MaskChoice {
    /// Token 0, whatever it shows: what lang-segment-anything takes.
    #[default]
    Single,
    /// Token 0 where it is stable, else the best of the others: what SAM 2's own builder switches on.
    Stable,
    /// The best of tokens 1 to 3 by predicted overlap: for one click that could mean several things.
    Best,
}

/// Offset of SAM 2's own test of stability, and the least share that counts as stable.
const STABILITY_OFFSET: f32 = 0.05;
const LEAST_STABILITY: f32 = 0.98;

/// What a point says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PointKind {
    /// Not this.
    Negative,
    /// This.
    Positive,
    /// Upper left corner of a box around it.
    Upper,
    /// Lower right corner of that box.
    Lower,
}

impl PointKind {
    /// The number that the network knows it by.
    fn label(self) -> i64 {
        match self {
            Self::Negative => 0,
            Self::Positive => 1,
            Self::Upper => 2,
            Self::Lower => 3,
        }
    }
}

/// Points that together mean one thing, pixels of the photograph.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointPrompt {
    /// Places and what they say.
    pub points: Vec<([f32; 2], PointKind)>,
}

impl PointPrompt {
    /// A box.
    #[must_use]
    pub fn from_box(corners: &Corners) -> Self {
        let [left, top, right, bottom] = *corners;
        Self { points: vec![([left, top], PointKind::Upper), ([right, bottom], PointKind::Lower)] }
    }
}

/// What the encoder makes of a photograph.
#[derive(Clone, Debug)]
pub struct Embedding {
    /// One per resolution.
    levels: Vec<Tensor>,
    /// Width and height of the photograph, pixels.
    size: [u32; 2],
}

/// The masks of one prompt.
#[derive(Clone, Debug, PartialEq)]
pub struct MaskLogits {
    /// Columns and rows of a mask.
    pub size: [usize; 2],
    /// Tokens 0 to 3, or 1 to 3 where the graph leaves the first out. `[tokens][rows * columns]`
    pub masks: Vec<Vec<f32>>,
    /// Predicted overlap of each with the truth.
    pub scores: Vec<f32>,
}

impl MaskLogits {
    /// Index of the mask that a choice takes.
    #[must_use]
    pub fn chosen(&self, choice: MaskChoice) -> usize {
        let several = usize::from(self.masks.len() != 3 && self.masks.len() > 1);
        let best =
            || (several..self.masks.len()).max_by(|&a, &b| self.scores[a].total_cmp(&self.scores[b])).unwrap_or(0);
        match choice {
            _ if self.masks.len() == 3 => best(),
            MaskChoice::Single => 0,
            MaskChoice::Stable if small_stability(&self.masks[0], STABILITY_OFFSET) >= LEAST_STABILITY => 0,
            MaskChoice::Stable | MaskChoice::Best => best(),
        }
    }

    /// One of the masks.
    #[must_use]
    pub fn logits(&self, token: usize) -> Logits<'_> {
        Logits { size: self.size, values: &self.masks[token] }
    }
}

/// Names of the three resolutions, low to high detail last, by who exported.
const LEVELS: [[&str; 3]; 2] = [
    ["image_embeddings.0", "image_embeddings.1", "image_embeddings.2"],
    ["high_res_feats_0", "high_res_feats_1", "image_embed"],
];

/// Who exported the decoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Family {
    /// `transformers`: `input_points` `[1, prompts, points, 2]`.
    Transformers,
    /// `samexporter`: `point_coords` `[1, points, 2]`, one prompt at a time.
    Samexporter,
}

/// A loaded segmenter.
pub struct Sam2 {
    encoder: Box<dyn Session>,
    decoder: Box<dyn Session>,
    picture: PictureRules,
    pixels: String,
    levels: [&'static str; 3],
    family: Family,
}

fn levels_of(names: impl Fn(&str) -> bool) -> Option<[&'static str; 3]> {
    LEVELS.into_iter().find(|levels| levels.iter().all(|level| names(level)))
}

impl Sam2 {
    /// Adapts to two graphs by the names of their inputs and outputs.
    ///
    /// # Errors
    /// [`ModelError::Refused`] with what was found where they are unknown or do not fit one another.
    pub fn new(
        paths: [&Path; 2],
        encoder: Box<dyn Session>,
        decoder: Box<dyn Session>,
        picture: PictureRules,
    ) -> Result<Self, ModelError> {
        let (graph, heads) = (encoder.graph(), decoder.graph());
        let pixels = graph.inputs.iter().find(|info| info.shape.len() == 4 && graph.inputs.len() == 1);
        let levels = levels_of(|name| graph.output(name).is_some());
        let (Some(pixels), Some(levels)) = (pixels.map(|info| info.name.clone()), levels) else {
            return Err(unknown_graph(paths[0], graph, "a SAM 2 encoder that is known"));
        };
        let Some(family) = family_of(heads).filter(|_| levels_of(|name| heads.input(name).is_some()) == Some(levels))
        else {
            return Err(unknown_graph(paths[1], heads, "a SAM 2 decoder that is known and fits the encoder"));
        };
        let side = picture.square.unwrap_or(1024) as usize;
        crate::guard::check_size(paths[0], graph, &pixels, side, side)?;
        Ok(Self { encoder, decoder, picture, pixels, levels, family })
    }

    /// Side of the square that photographs are squashed to, pixels.
    #[must_use]
    pub fn square(&self) -> u32 {
        self.picture.square.unwrap_or(1024)
    }

    /// Whether the decoder gives token 0; where it does not, [`MaskChoice::Best`] is what every choice means.
    #[must_use]
    pub fn has_single(&self) -> bool {
        let masks = self.decoder.graph().outputs.iter().find(|info| info.name.contains("mask"));
        let count = masks.and_then(|info| info.shape.iter().rev().nth(2).copied().flatten());
        count != Some(3)
    }

    /// The embedding of a photograph.
    ///
    /// # Errors
    /// [`ModelError::Runtime`] where the encoder stops.
    pub fn embed(&self, image: &Image) -> Result<Embedding, ModelError> {
        let pixels = self.picture.segmenter_picture(image)?;
        let levels = self.encoder.run(&[(&self.pixels, &pixels)], &self.levels)?;
        Ok(Embedding { levels, size: [image.width, image.height] })
    }

    /// The masks of each prompt.
    ///
    /// # Errors
    /// [`ModelError::Question`] where a prompt has no points, [`ModelError::Runtime`] where the decoder stops.
    pub fn decode(&self, embedding: &Embedding, prompts: &[PointPrompt]) -> Result<Vec<MaskLogits>, ModelError> {
        if prompts.iter().any(|prompt| prompt.points.is_empty()) {
            return Err(ModelError::question("a prompt without points", "give at least one point or a box"));
        }
        let mut found = Vec::with_capacity(prompts.len());
        let mut rest = prompts;
        while let Some(first) = rest.first() {
            // One call takes prompts of equal length.
            let most = if self.family == Family::Transformers { PROMPTS_AT_ONCE } else { 1 };
            let alike = rest.iter().take(most).take_while(|prompt| prompt.points.len() == first.points.len()).count();
            found.extend(self.decode_alike(embedding, &rest[..alike])?);
            rest = &rest[alike..];
        }
        Ok(found)
    }

    fn decode_alike(&self, embedding: &Embedding, prompts: &[PointPrompt]) -> Result<Vec<MaskLogits>, ModelError> {
        let fed = self.prompt_inputs(embedding, prompts);
        let levels = self.levels.iter().copied().zip(&embedding.levels);
        let inputs: Vec<(&str, &Tensor)> = fed.iter().map(|(name, tensor)| (*name, tensor)).chain(levels).collect();
        let names = match self.family {
            Family::Transformers => ["pred_masks", "iou_scores"],
            Family::Samexporter => ["masks", "iou_predictions"],
        };
        let outputs = self.decoder.run(&inputs, &names)?;
        let rank = if self.family == Family::Transformers { 5 } else { 4 };
        let masks = outputs[0].as_floats(names[0], rank)?;
        let scores = outputs[1].as_floats(names[1], rank - 2)?;
        let shape = &outputs[0].shape[rank - 3..];
        let (tokens, rows, columns) = (shape[0], shape[1], shape[2]);
        if masks.is_empty() || scores.len() != prompts.len() * tokens || masks.len() != scores.len() * rows * columns {
            let what = format!("{RUN_FAILED}: {} masks for {} prompts", scores.len(), prompts.len());
            return Err(ModelError::runtime("decoder", what, "export it with tools/export_models.py"));
        }
        let mask = |index: usize| masks[index * rows * columns..][..rows * columns].to_vec();
        let logits = |prompt: usize| MaskLogits {
            size: [columns, rows],
            masks: (0..tokens).map(|token| mask(prompt * tokens + token)).collect(),
            scores: scores[prompt * tokens..][..tokens].to_vec(),
        };
        Ok((0..prompts.len()).map(logits).collect())
    }

    /// Points in the square's pixels, their kinds, and what else the family's graphs want to be told.
    fn prompt_inputs(&self, embedding: &Embedding, prompts: &[PointPrompt]) -> Vec<(&'static str, Tensor)> {
        let side = self.square() as f32;
        let scale = embedding.size.map(|size| side / size as f32);
        let count = prompts[0].points.len();
        let points = prompts.iter().flat_map(|prompt| &prompt.points);
        let places: Vec<f32> = points.clone().flat_map(|(at, _)| [at[0] * scale[0], at[1] * scale[1]]).collect();
        let labels: Vec<i64> = points.map(|(_, kind)| kind.label()).collect();
        let graph = self.decoder.graph();
        match self.family {
            Family::Transformers => {
                let mut fed = vec![
                    ("input_points", Tensor::floats(&[1, prompts.len(), count, 2], places)),
                    ("input_labels", Tensor::integers(&[1, prompts.len(), count], labels)),
                ];
                if graph.input("input_boxes").is_some() {
                    fed.push(("input_boxes", Tensor::floats(&[1, 0, 4], Vec::new())));
                }
                fed
            }
            Family::Samexporter => {
                let quarter = self.square() as usize / 4;
                let is_float = graph.input("point_labels").is_none_or(|info| info.element == Element::F32);
                let labels = if is_float {
                    Tensor::floats(&[1, count], labels.iter().map(|&label| label as f32).collect())
                } else {
                    Tensor::integers(&[1, count], labels)
                };
                let mut fed = vec![
                    ("point_coords", Tensor::floats(&[1, count, 2], places)),
                    ("point_labels", labels),
                    ("mask_input", Tensor::floats(&[1, 1, quarter, quarter], vec![0.0; quarter * quarter])),
                    ("has_mask_input", Tensor::floats(&[1], vec![0.0])),
                ];
                if graph.input("orig_im_size").is_some() {
                    let size = [quarter as i64, quarter as i64].to_vec();
                    fed.push(("orig_im_size", Tensor::integers(&[2], size)));
                }
                fed
            }
        }
    }
}

/// Prompts that one call of the decoder takes; the reference's everything mode takes as many.
const PROMPTS_AT_ONCE: usize = 8;

fn family_of(graph: &Graph) -> Option<Family> {
    let all = |names: &[&str]| names.iter().all(|name| graph.input(name).is_some());
    if all(&["input_points", "input_labels"]) && graph.output("pred_masks").is_some() {
        Some(Family::Transformers)
    } else if all(&["point_coords", "point_labels", "mask_input", "has_mask_input"]) && graph.output("masks").is_some()
    {
        Some(Family::Samexporter)
    } else {
        None
    }
}

#[cfg(test)]
pub(crate) mod tests;
