//! Protocol buffers on the wire: numbered fields, each a number or so many bytes, messages inside messages.

use std::io::{Read, Seek};

/// A message that is being read.
#[derive(Clone, Copy, Debug)]
pub(super) struct Message {
    end: u64,
}

impl Message {
    /// A file of `length` bytes.
    pub(super) fn whole(length: u64) -> Self {
        Self { end: length }
    }
}

/// One field: a number, or the length of bytes that follow and must be read or skipped.
#[derive(Clone, Copy, Debug)]
pub(super) struct Field {
    pub(super) number: u64,
    pub(super) value: u64,
    pub(super) length: Option<u64>,
}

/// A place in a file.
pub(super) struct Wire<'a, R> {
    source: &'a mut R,
    at: u64,
    end: u64,
    /// Graphs within graphs that are open.
    pub(super) depth: u32,
}

/// Deeper nesting of graphs is damage.
const DEEPEST: u32 = 16;

/// Names are short; a longer one is damage.
const LONGEST_NAME: u64 = 1 << 16;

impl<'a, R: Read + Seek> Wire<'a, R> {
    pub(super) fn new(source: &'a mut R) -> Self {
        Self { source, at: 0, end: u64::MAX, depth: 0 }
    }

    /// The message of `length` bytes that begins here; [`Self::next`] has seen to it that it fits.
    pub(super) fn message(&self, length: u64) -> Message {
        Message { end: self.at + length }
    }

    /// A graph within a graph begins.
    pub(super) fn deeper(&mut self) -> Result<(), String> {
        self.depth += 1;
        if self.depth > DEEPEST { Err("graphs nested without end".into()) } else { Ok(()) }
    }

    /// The next field of a message, until its end.
    pub(super) fn next(&mut self, message: &mut Message) -> Result<Option<Field>, String> {
        self.end = message.end;
        if self.at == self.end {
            return Ok(None);
        }
        let key = self.varint()?;
        let mut field = Field { number: key >> 3, value: 0, length: None };
        match key & 7 {
            0 => field.value = self.varint()?,
            1 => self.advance(8)?,
            2 => {
                let length = self.varint()?;
                if length > self.end - self.at {
                    return Err(format!("a part of {length} bytes at byte {} does not fit", self.at));
                }
                field.length = Some(length);
            }
            5 => self.advance(4)?,
            kind => return Err(format!("unknown wire type {kind} at byte {}", self.at)),
        }
        Ok(Some(field))
    }

    /// Leaves a field's bytes out.
    pub(super) fn skip(&mut self, field: &Field) -> Result<(), String> {
        self.advance(field.length.unwrap_or(0))
    }

    /// A field's bytes as text.
    pub(super) fn text(&mut self, length: u64) -> Result<String, String> {
        if length > LONGEST_NAME {
            return Err(format!("a name of {length} bytes at byte {}", self.at));
        }
        let mut bytes = vec![0; length as usize];
        self.source.read_exact(&mut bytes).map_err(|_| self.too_short())?;
        self.at += length;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }

    fn advance(&mut self, length: u64) -> Result<(), String> {
        if length > self.end - self.at {
            return Err(self.too_short());
        }
        self.source.seek_relative(length.cast_signed()).map_err(|_| self.too_short())?;
        self.at += length;
        Ok(())
    }

    fn varint(&mut self) -> Result<u64, String> {
        let mut value = 0u64;
        for shift in (0..64).step_by(7) {
            if self.at == self.end {
                return Err(self.too_short());
            }
            let mut byte = [0];
            self.source.read_exact(&mut byte).map_err(|_| self.too_short())?;
            self.at += 1;
            value |= u64::from(byte[0] & 127) << shift;
            if byte[0] < 128 {
                return Ok(value);
            }
        }
        Err(format!("a number without end at byte {}", self.at))
    }

    fn too_short(&self) -> String {
        format!("it ends at byte {}, in the middle of something", self.at)
    }
}
