//! A reader of little-endian numbers that knows its file and its place, and believes no count.

use crate::error::{FileError, Place};

/// A place in the bytes of a file.
pub(crate) struct Cursor<'a> {
    file: &'a str,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    pub(crate) fn new(file: &'a str, bytes: &'a [u8]) -> Self {
        Self { file, bytes, at: 0 }
    }

    pub(crate) fn at(&self) -> u64 {
        self.at as u64
    }

    pub(crate) fn remaining(&self) -> usize {
        self.bytes.len() - self.at
    }

    /// An error at this place.
    pub(crate) fn error(&self, what: impl Into<String>) -> FileError {
        FileError::damaged(self.file, Place::Byte(self.at()), what)
    }

    pub(crate) fn slice(&mut self, len: usize) -> Result<&'a [u8], FileError> {
        let end = self.at.checked_add(len).filter(|&end| end <= self.bytes.len());
        let end = end
            .ok_or_else(|| self.error(format!("the file ends {} bytes early", len.saturating_sub(self.remaining()))))?;
        let slice = &self.bytes[self.at..end];
        self.at = end;
        Ok(slice)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], FileError> {
        let mut array = [0; N];
        array.copy_from_slice(self.slice(N)?);
        Ok(array)
    }

    pub(crate) fn u32(&mut self) -> Result<u32, FileError> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    pub(crate) fn i32(&mut self) -> Result<i32, FileError> {
        Ok(i32::from_le_bytes(self.array()?))
    }

    pub(crate) fn u64(&mut self) -> Result<u64, FileError> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    pub(crate) fn f64(&mut self) -> Result<f64, FileError> {
        Ok(f64::from_le_bytes(self.array()?))
    }

    /// A finite number.
    pub(crate) fn finite(&mut self, what: &str) -> Result<f64, FileError> {
        let start = self.at;
        let value = self.f64()?;
        if value.is_finite() {
            return Ok(value);
        }
        let place = Place::Byte(start as u64);
        Err(FileError::damaged(self.file, place, format!("{what} is {value}")))
    }

    /// A 64-bit count of things that take at least `bytes_each`; refused where the file cannot hold them.
    pub(crate) fn count(&mut self, bytes_each: usize, what: &str) -> Result<usize, FileError> {
        let start = self.at;
        let count = self.u64()?;
        let room = (self.remaining() / bytes_each) as u64;
        if count <= room {
            return Ok(count as usize);
        }
        let what = format!("{count} {what} are announced, but the file has room for {room} at most");
        Err(FileError::damaged(self.file, Place::Byte(start as u64), what))
    }

    /// Bytes up to a zero byte, which is consumed.
    pub(crate) fn zero_terminated(&mut self) -> Result<&'a [u8], FileError> {
        let rest = &self.bytes[self.at..];
        let len = rest.iter().position(|&byte| byte == 0);
        let len = len.ok_or_else(|| self.error("a name without an end"))?;
        self.at += len + 1;
        Ok(&rest[..len])
    }

    /// Refuses bytes that nothing explains.
    pub(crate) fn finish(self) -> Result<(), FileError> {
        match self.remaining() {
            0 => Ok(()),
            rest => Err(self.error(format!("{rest} bytes follow the last entry"))),
        }
    }
}
