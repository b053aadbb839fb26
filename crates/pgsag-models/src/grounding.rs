//! GroundingDINO: an image and a text in, boxes with scores and words out.
//!
//! Thresholds, words and the absence of any suppression are those of lang-segment-anything. The graph's own input names
//! choose what it is fed: exports of `transformers` make the text's attention blocks themselves, IDEA's want them given.

use std::path::Path;

use pgsag_scene::Image;
use serde::{Deserialize, Serialize};

use crate::boxes::Corners;
use crate::error::{ModelError, RUN_FAILED};
use crate::onnx::Graph;
use crate::picture::{Canvasful, PictureRules};
use crate::runtime::Session;
use crate::tensor::{Element, Tensor, TensorInfo};
use crate::wordpiece::WordPiece;

/// What is asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Prompt {
    /// Kinds of things, each ended by a full stop; letters of any case.
    pub text: String,
    /// Least score of a box, 0 to 1. lang-segment-anything: 0.3.
    pub box_threshold: f32,
    /// Least score of a word to be part of a box's label, 0 to 1; labels decide nothing. lang-segment-anything: 0.25.
    pub text_threshold: f32,
}

impl Default for Prompt {
    fn default() -> Self {
        Self { text: "buildings.".into(), box_threshold: 0.3, text_threshold: 0.25 }
    }
}

/// A thing that was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Detection {
    /// Left, top, right, bottom, pixels of the photograph; may reach beyond it.
    pub corners: Corners,
    /// Largest probability of any word.
    pub score: f32,
    /// The words that it was found by; may be empty.
    pub label: String,
}

/// What the network says of all its queries.
#[derive(Clone, Debug, PartialEq)]
pub struct Queries {
    /// Centre and size, shares of the covered picture. `[batch * queries]`
    pub boxes: Vec<[f32; 4]>,
    /// One per token. `[batch * queries, width]`
    pub logits: Vec<f32>,
    /// Logits per query.
    pub width: usize,
}

impl Queries {
    /// The largest logit of each query.
    #[must_use]
    pub fn best(&self) -> Vec<f32> {
        self.logits.chunks(self.width).map(|row| row.iter().copied().fold(f32::NEG_INFINITY, f32::max)).collect()
    }
}

/// What an input of the graph carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    Pixels,
    Ids,
    Types,
    Attention,
    Cover,
    Positions,
    Blocks,
}

const INPUT_NAMES: [(&str, Role); 14] = [
    ("pixel_values", Role::Pixels),
    ("img", Role::Pixels),
    ("image", Role::Pixels),
    ("images", Role::Pixels),
    ("samples", Role::Pixels),
    ("input_ids", Role::Ids),
    ("token_type_ids", Role::Types),
    ("attention_mask", Role::Attention),
    ("pixel_mask", Role::Cover),
    ("mask", Role::Cover),
    ("position_ids", Role::Positions),
    ("text_self_attention_masks", Role::Blocks),
    ("text_token_mask", Role::Blocks),
    ("text_self_attention_mask", Role::Blocks),
];
const LOGIT_NAMES: [&str; 2] = ["logits", "pred_logits"];
const BOX_NAMES: [&str; 2] = ["pred_boxes", "boxes"];

/// What was found in a graph that no adapter fits.
pub(crate) fn unknown_graph(path: &Path, graph: &Graph, wanted: &str) -> ModelError {
    let list = |infos: &[TensorInfo]| infos.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
    let what = format!("not {wanted}: inputs {}, outputs {}", list(&graph.inputs), list(&graph.outputs));
    ModelError::refused(path, what, "export it with tools/export_models.py")
}

/// A loaded detector.
pub struct GroundingDino {
    session: Box<dyn Session>,
    words: WordPiece,
    picture: PictureRules,
    longest_text: usize,
    roles: Vec<(String, Element, Role)>,
    logits: String,
    boxes: String,
}

impl GroundingDino {
    /// Adapts to a graph by the names of its inputs and outputs.
    ///
    /// # Errors
    /// [`ModelError::Refused`] with what was found where they are unknown.
    pub fn new(
        path: &Path,
        session: Box<dyn Session>,
        words: WordPiece,
        picture: PictureRules,
        longest_text: usize,
    ) -> Result<Self, ModelError> {
        let graph = session.graph();
        let unknown = || unknown_graph(path, graph, "a GroundingDINO that is known");
        let role = |info: &TensorInfo| {
            let (_, role) = INPUT_NAMES.iter().find(|(name, _)| *name == info.name)?;
            Some((info.name.clone(), info.element, *role))
        };
        let roles = graph.inputs.iter().map(role).collect::<Option<Vec<_>>>().ok_or_else(unknown)?;
        let has = |wanted| roles.iter().any(|(_, _, role)| *role == wanted);
        let output = |names: &[&str]| names.iter().find(|name| graph.output(name).is_some()).map(|name| (*name).into());
        let (Some(logits), Some(boxes)) = (output(&LOGIT_NAMES), output(&BOX_NAMES)) else { return Err(unknown()) };
        if !has(Role::Pixels) || !has(Role::Ids) {
            return Err(unknown());
        }
        if let Some([width, height]) = picture.fixed {
            let pixels = roles.iter().find(|(_, _, role)| *role == Role::Pixels).map_or("", |(name, ..)| name);
            crate::guard::check_size(path, graph, pixels, width as usize, height as usize)?;
        } else if let Some(info) = graph.inputs.iter().find(|info| info.shape.len() == 4 && info.shape[2].is_some()) {
            let what = format!("it takes one size only ({info}), which the manifest does not say");
            return Err(ModelError::refused(path, what, "add `fixed = [width, height]` to [image] in manifest.toml"));
        }
        Ok(Self { words, picture, longest_text, roles, logits, boxes, session })
    }

    /// What was asked for as numbers.
    ///
    /// # Errors
    /// [`ModelError::Question`] where the text is empty or too long.
    pub fn ids(&self, text: &str) -> Result<Vec<u32>, ModelError> {
        let cure = "say what to look for, such as `buildings.`";
        let Some(last) = text.trim_end().chars().last() else {
            return Err(ModelError::question("the prompt is empty", cure));
        };
        let ended = if last == '.' { text.trim_end().to_owned() } else { format!("{}.", text.trim_end()) };
        let ids = self.words.encode(&ended).ids;
        if ids.iter().all(|id| PARTING.contains(id)) {
            return Err(ModelError::question("the prompt names nothing", cure));
        }
        if ids.len() > self.longest_text {
            let what = format!("the prompt has {} tokens, the network reads {}", ids.len(), self.longest_text);
            return Err(ModelError::question(what, "name fewer kinds of things"));
        }
        Ok(ids)
    }

    /// Everything in the image that the words fit, in the network's order.
    ///
    /// # Errors
    /// [`ModelError`] of the question or of the runtime.
    pub fn detect(&self, image: &Image, prompt: &Prompt) -> Result<Vec<Detection>, ModelError> {
        let ids = self.ids(&prompt.text)?;
        let picture = self.picture.detector_picture(image)?;
        let queries = self.queries(&picture, std::slice::from_ref(&ids))?;
        // Boxes are shares of the picture, also where a canvas surrounds it: the network is told what is covered.
        let size = [image.width as f32, image.height as f32];
        let mut found = Vec::new();
        for (corners, logits) in queries.boxes.iter().zip(queries.logits.chunks(queries.width)) {
            let score = probability(logits.iter().copied().fold(f32::NEG_INFINITY, f32::max));
            if score > prompt.box_threshold {
                let [x, y, width, height] = *corners;
                let [left, top] = [x - width / 2.0, y - height / 2.0];
                let corners = [left * size[0], top * size[1], (left + width) * size[0], (top + height) * size[1]];
                found.push(Detection { corners, score, label: self.label(&ids, logits, prompt.text_threshold) });
            }
        }
        Ok(found)
    }

    /// The words above the threshold; the first place and the last possible one do not count, as in the reference.
    fn label(&self, ids: &[u32], logits: &[f32], threshold: f32) -> String {
        let chosen = |(place, _): &(usize, &u32)| (1..255).contains(place) && probability(logits[*place]) > threshold;
        let ids: Vec<u32> = ids.iter().enumerate().filter(chosen).map(|(_, id)| *id).collect();
        self.words.decode(&ids)
    }

    /// Runs the network on a canvas and one text per picture in it; shorter texts are padded.
    ///
    /// # Errors
    /// [`ModelError::Runtime`] where it stops.
    pub fn queries(&self, picture: &Canvasful, texts: &[Vec<u32>]) -> Result<Queries, ModelError> {
        let batch = picture.pixels.shape[0];
        let fed = self
            .roles
            .iter()
            .map(|(name, element, role)| (name.as_str(), input(*role, *element, picture, texts)))
            .collect::<Vec<_>>();
        let inputs: Vec<(&str, &Tensor)> = fed.iter().map(|(name, tensor)| (*name, tensor)).collect();
        let outputs = self.session.run(&inputs, &[&self.logits, &self.boxes])?;
        let logits = outputs[0].as_floats(&self.logits, 3)?;
        let boxes = outputs[1].as_floats(&self.boxes, 3)?;
        let (rows, width) = (outputs[0].shape[1], outputs[0].shape[2]);
        let longest = texts.iter().map(Vec::len).max().unwrap_or(0);
        if outputs[0].shape[0] != batch || outputs[1].shape != [batch, rows, 4] || width < longest.max(1) {
            let what = format!("{RUN_FAILED}: {:?} and {:?} do not fit", outputs[0].shape, outputs[1].shape);
            return Err(ModelError::runtime("detector", what, "export it with tools/export_models.py"));
        }
        Ok(Queries { boxes: bytemuck::cast_slice(boxes).to_vec(), logits: logits.to_vec(), width })
    }
}

/// 1 / (1 + e⁻ˣ)
fn probability(logit: f32) -> f32 {
    1.0 / (1.0 + libm::expf(-logit))
}

/// One input, in the type that the graph declares.
fn input(role: Role, element: Element, picture: &Canvasful, texts: &[Vec<u32>]) -> Tensor {
    let batch = picture.pixels.shape[0];
    let count = texts.iter().map(Vec::len).max().unwrap_or(0);
    let id = |row: usize, place: usize| texts.get(row).and_then(|text| text.get(place));
    let text_shape = [batch, count];
    let per_token = |value: &dyn Fn(usize, usize) -> i64| {
        let values = (0..batch * count).map(|index| value(index / count, index % count)).collect();
        typed(element, &text_shape, values)
    };
    match role {
        Role::Pixels => picture.pixels.clone(),
        Role::Ids => per_token(&|row, place| id(row, place).map_or(0, |id| i64::from(*id))),
        Role::Types => per_token(&|_, _| 0),
        Role::Attention => per_token(&|row, place| i64::from(id(row, place).is_some())),
        Role::Cover => {
            let [width, height] = picture.canvas;
            let covers = |index: usize| {
                let (x, y) = (index % width, index / width % height);
                i64::from(x < picture.covered[0] && y < picture.covered[1])
            };
            typed(element, &[batch, height, width], (0..batch * width * height).map(covers).collect())
        }
        Role::Positions => {
            let blocks: Vec<TextBlocks> = texts.iter().map(|text| text_blocks(text)).collect();
            per_token(&|row, place| blocks[row].positions.get(place).copied().unwrap_or(0))
        }
        Role::Blocks => {
            let blocks: Vec<TextBlocks> = texts.iter().map(|text| text_blocks(text)).collect();
            let value = |index: usize| {
                let (row, place, other) = (index / (count * count), index / count % count, index % count);
                let length = texts[row].len();
                let inside = place < length && other < length && blocks[row].attention[place * length + other];
                i64::from(inside || place == other)
            };
            typed(element, &[batch, count, count], (0..batch * count * count).map(value).collect())
        }
    }
}

fn typed(element: Element, shape: &[usize], values: Vec<i64>) -> Tensor {
    match element {
        Element::F32 => Tensor::floats(shape, values.into_iter().map(|value| value as f32).collect()),
        Element::Bool => Tensor::truths(shape, values.into_iter().map(|value| value != 0).collect()),
        _ => Tensor::integers(shape, values),
    }
}

/// Which tokens of a text see one another, and their places within their phrase.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextBlocks {
    /// `[count * count]`
    pub attention: Vec<bool>,
    /// `[count]`
    pub positions: Vec<i64>,
}

/// `[CLS]`, `[SEP]`, the full stop and the question mark part phrases; GroundingDINO knows their numbers by heart.
const PARTING: [u32; 4] = [101, 102, 1012, 1029];

/// Tokens between two parting ones form a block with the second; all others see themselves only.
#[must_use]
pub fn text_blocks(ids: &[u32]) -> TextBlocks {
    let count = ids.len();
    let is_parting = |place: usize| PARTING.contains(&ids[place]);
    let next: Vec<usize> = (0..count).map(|from| (from..count).find(|&at| is_parting(at)).unwrap_or(count)).collect();
    let is_block = |place: usize| next[place] != 0 && next[place] + 1 < count;
    let together = |a: usize, b: usize| a == b || (next[a] == next[b] && is_block(b));
    let attention = (0..count * count).map(|index| together(index / count, index % count)).collect();
    let position = |place: usize| {
        let before = (0..place).rev().find(|&at| is_parting(at)).map_or(0, |at| at + 1);
        if is_block(place) { (place - before) as i64 } else { 0 }
    };
    TextBlocks { attention, positions: (0..count).map(position).collect() }
}

#[cfg(test)]
mod tests;
