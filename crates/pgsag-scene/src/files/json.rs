//! JSON with the line in every error.

use serde::de::DeserializeOwned;

use crate::error::{FileError, Place};

/// Reads a JSON document into a type; unknown keys are passed over.
pub(crate) fn parse<T: DeserializeOwned>(file: &str, bytes: &[u8]) -> Result<T, FileError> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    serde_json::from_slice(bytes).map_err(|error| {
        let place = if error.line() > 0 { Place::Line(error.line() as u64) } else { Place::Whole };
        FileError::damaged(file, place, error.to_string())
    })
}
