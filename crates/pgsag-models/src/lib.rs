//! Building masks by neural networks: the words `buildings.` in, a mask out.
//!
//! `runtime` runs ONNX graphs (`onnx` reads what stands in them, `guard` refuses what would be computed wrongly), `tensor`
//! travels in between. `wordpiece` and `picture` make what the networks read; `grounding` finds boxes by words, `sam` makes
//! masks of boxes and points, `enlarge` brings them to the photograph's size; `language` and `everything` put them
//! together, `mend` mends, `boxes` and `rle` serve; `bundle` is a folder of files that belong together, `segmenter` what
//! the stages ask. Values in, values out; the only files opened are a bundle's.

pub mod boxes;
pub mod bundle;
pub mod enlarge;
pub mod error;
pub mod everything;
pub mod grounding;
pub mod guard;
pub mod language;
pub mod mend;
pub mod onnx;
pub mod picture;
pub mod rle;
pub mod runtime;
pub mod sam;
pub mod segmenter;
pub mod tensor;
pub mod wordpiece;

#[cfg(test)]
mod golden;

pub use bundle::{Bundle, Engine};
pub use error::ModelError;
pub use grounding::{Detection, GroundingDino, Prompt};
pub use language::LanguageSegmenter;
pub use runtime::{Device, Runtime, RuntimeKind, Session, SessionOptions};
pub use sam::{MaskChoice, Sam2};
pub use segmenter::Wing;
pub use tensor::{Tensor, Values};
