//! Lines and words of text files, with the line number in every error.

use crate::error::{FileError, Place};

/// One line and where it stands.
#[derive(Clone, Copy)]
pub(crate) struct Line<'a> {
    file: &'a str,
    number: u64,
    pub(crate) text: &'a str,
}

impl<'a> Line<'a> {
    pub(crate) fn error(&self, what: impl Into<String>) -> FileError {
        FileError::damaged(self.file, Place::Line(self.number), what)
    }

    pub(crate) fn place(&self) -> Place {
        Place::Line(self.number)
    }

    /// The words of the line, parted by white space.
    pub(crate) fn words(&self) -> Words<'a> {
        Words { line: *self, rest: self.text }
    }
}

/// The words of a line that are still to be read.
pub(crate) struct Words<'a> {
    line: Line<'a>,
    rest: &'a str,
}

impl<'a> Words<'a> {
    /// The next word, if there is one.
    pub(crate) fn next_word(&mut self) -> Option<&'a str> {
        let text = self.rest.trim_ascii_start();
        let end = text.find(|letter: char| letter.is_ascii_whitespace()).unwrap_or(text.len());
        self.rest = &text[end..];
        (end > 0).then(|| &text[..end])
    }

    /// Everything that is left, trimmed.
    pub(crate) fn rest(self) -> &'a str {
        self.rest.trim_ascii()
    }

    /// Whether nothing but white space is left.
    pub(crate) fn is_empty(&self) -> bool {
        self.rest.trim_ascii().is_empty()
    }

    /// The next word as a number.
    pub(crate) fn number<T: std::str::FromStr>(&mut self, what: &str) -> Result<T, FileError> {
        let word = self.next_word().ok_or_else(|| self.line.error(format!("{what} is missing")))?;
        word.parse().map_err(|_| self.line.error(format!("{what} is '{word}', not a number of its kind")))
    }

    /// The next word as a finite number.
    pub(crate) fn finite(&mut self, what: &str) -> Result<f64, FileError> {
        let value: f64 = self.number(what)?;
        if value.is_finite() { Ok(value) } else { Err(self.line.error(format!("{what} is {value}"))) }
    }
}

/// The text of a file; refused where it is not UTF-8.
pub(crate) fn text<'a>(file: &str, bytes: &'a [u8]) -> Result<&'a str, FileError> {
    std::str::from_utf8(bytes)
        .map_err(|error| FileError::damaged(file, Place::Byte(error.valid_up_to() as u64), "the text is not UTF-8"))
}

/// All lines, numbered from 1.
pub(crate) fn lines<'a>(file: &'a str, text: &'a str) -> impl Iterator<Item = Line<'a>> {
    (1..).zip(text.lines()).map(move |(number, text)| Line { file, number, text })
}

/// Whether a line of COLMAP's text format holds nothing: blank or a comment.
pub(crate) fn is_blank(line: &Line<'_>) -> bool {
    let text = line.text.trim_ascii_start();
    text.is_empty() || text.starts_with('#')
}
