//! Codecs: bytes <-> words. Nothing outside this folder touches bytes of a foreign format.
//!
//! Parsers take the name of the file and its bytes; every error names that file, the place and the cure. No count in a
//! header is believed beyond the bytes that follow it. Only `folder` opens files.

pub mod colmap;
mod cursor;
pub mod folder;
pub mod georef;
mod json;
mod lines;
pub mod map;
pub mod nerfstudio;
pub mod opensfm;
pub mod photo;
pub mod ply;
pub mod raster;

/// Something about a scene that its owner should know, which is no error.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// Stable name of the kind of note, such as `camera-rescaled`.
    pub code: &'static str,
    /// One sentence with the names and numbers.
    pub text: String,
}

impl Note {
    /// A note.
    #[must_use]
    pub fn new(code: &'static str, text: impl Into<String>) -> Self {
        Self { code, text: text.into() }
    }
}
