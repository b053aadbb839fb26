//! What can be wrong with a file: its name, the place in it, what is wrong there, and the cure, in one line.

use std::fmt;

/// Where in a file something is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// The file as a whole.
    Whole,
    /// Offset from the start of the file, bytes.
    Byte(u64),
    /// Line, counted from 1.
    Line(u64),
    /// A named part: a JSON path, a PLY element, a field of a header.
    Part(String),
}

impl fmt::Display for Place {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Whole => Ok(()),
            Self::Byte(at) => write!(out, ", byte {at}"),
            Self::Line(at) => write!(out, ", line {at}"),
            Self::Part(name) => write!(out, ", {}", OneLine(name)),
        }
    }
}

/// Why a file could not be used. Every message is one line: file, place, what, cure.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FileError {
    /// The operating system refused.
    #[error("{}: cannot be read ({}); check the path and its permissions", OneLine(.file), OneLine(.reason))]
    Unreadable {
        /// Name of the file.
        file: String,
        /// The operating system's words.
        reason: String,
    },
    /// Something that must be there is not.
    #[error("{}: {}; {}", OneLine(.file), OneLine(.what), OneLine(.cure))]
    Missing {
        /// Name of the file or folder.
        file: String,
        /// What is missing.
        what: String,
        /// What to do about it.
        cure: String,
    },
    /// The content is not what its format says.
    #[error("{}{place}: {}; {}", OneLine(.file), OneLine(.what), OneLine(.cure))]
    Damaged {
        /// Name of the file.
        file: String,
        /// Where in it.
        place: Place,
        /// What is wrong there.
        what: String,
        /// What to do about it.
        cure: String,
    },
    /// Sound, but of a kind that cannot be used.
    #[error("{}{place}: {} is not supported; {}", OneLine(.file), OneLine(.what), OneLine(.cure))]
    Unsupported {
        /// Name of the file.
        file: String,
        /// Where in it.
        place: Place,
        /// The feature, by its own name.
        what: String,
        /// What to do about it.
        cure: String,
    },
    /// Two sound files that contradict each other.
    #[error("{}: {}; {}", OneLine(.file), OneLine(.what), OneLine(.cure))]
    Mismatch {
        /// Name of the file to be changed.
        file: String,
        /// The contradiction, both sides named.
        what: String,
        /// What to do about it.
        cure: String,
    },
}

impl FileError {
    /// A damaged file with the usual cure.
    pub(crate) fn damaged(file: &str, place: Place, what: impl Into<String>) -> Self {
        let cure = "copy or export the file again".into();
        Self::Damaged { file: file.into(), place, what: what.into(), cure }
    }

    /// Name of the file that the error is about.
    #[must_use]
    pub fn file(&self) -> &str {
        match self {
            Self::Unreadable { file, .. }
            | Self::Missing { file, .. }
            | Self::Damaged { file, .. }
            | Self::Unsupported { file, .. }
            | Self::Mismatch { file, .. } => file,
        }
    }
}

/// Text from a file, fit for one line of a terminal: no control characters, at most 200 characters.
struct OneLine<'a>(&'a str);

impl fmt::Display for OneLine<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        const LONGEST: usize = 200;
        for (i, letter) in self.0.chars().enumerate() {
            if i == LONGEST {
                return out.write_str("…");
            }
            let letter = if letter.is_control() { '\u{FFFD}' } else { letter };
            fmt::Write::write_char(out, letter)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_one_line_whatever_the_file_says() {
        let error = FileError::damaged("a\nb.ply", Place::Part("x\r\n".into()), "bad\u{1b}[2J".repeat(100));
        let text = error.to_string();
        assert!(!text.chars().any(char::is_control), "{text:?}");
        assert!(text.len() < 1000);
        assert_eq!(error.file(), "a\nb.ply");
    }

    #[test]
    fn a_message_names_file_place_and_cure() {
        let error = FileError::damaged("cameras.bin", Place::Byte(12), "ends early");
        assert_eq!(error.to_string(), "cameras.bin, byte 12: ends early; copy or export the file again");
    }
}
