//! The rows of a PLY file, into columns.

use std::io::{self, Read};

use super::header::{self, ElementHeader, Format, Header, PropertyHeader, Scalar};
use super::{Column, Element, Property};
use crate::error::{FileError, Place};

/// A number of the file, before it is sorted into a column.
#[derive(Clone, Copy)]
enum Number {
    Int(i64),
    Float(f64),
}

/// Where the next number comes from.
trait Numbers {
    /// The next number, of the given type.
    fn next(&mut self, scalar: Scalar) -> Result<Number, FileError>;
    /// How many numbers of the given sizes (bytes, binary) can follow at most.
    fn room(&self, bytes_each: usize, numbers_each: usize) -> u64;
    fn error(&self, what: String) -> FileError;
}

/// Bytes of a file through a window of bounded size: a city's mesh is larger than what it is read into.
pub(super) struct Stream<'a> {
    file: &'a str,
    input: &'a mut dyn Read,
    window: Vec<u8>,
    /// Next byte, in the window.
    at: usize,
    /// First byte of the window, in the file.
    start: u64,
    /// Length of the file, bytes.
    length: u64,
}

/// Bytes that are asked for at once.
const WINDOW: usize = 1 << 20;

impl<'a> Stream<'a> {
    pub(super) fn new(file: &'a str, input: &'a mut dyn Read, length: u64) -> Self {
        Self { file, input, window: Vec::new(), at: 0, start: 0, length }
    }

    /// What is in the window from the next byte on, after one more reading; as long as before at the end of the file.
    pub(super) fn more(&mut self) -> Result<&[u8], FileError> {
        self.window.drain(..self.at);
        self.start += self.at as u64;
        self.at = 0;
        let wanted = (self.length - self.place()).min((self.window.len() + WINDOW) as u64) as usize;
        let (known, file) = (self.window.len(), self.file);
        let unreadable = |error: io::Error| FileError::Unreadable { file: file.into(), reason: error.to_string() };
        if wanted > known {
            (&mut *self.input).take((wanted - known) as u64).read_to_end(&mut self.window).map_err(unreadable)?;
        }
        Ok(&self.window)
    }

    /// The header, and on to the body.
    pub(super) fn header(&mut self) -> Result<Header, FileError> {
        let file = self.file;
        let header = header::parse(file, self.more()?)?;
        self.skip(header.body);
        Ok(header)
    }

    /// The next bytes; fewer at the end of the file.
    fn peek(&mut self, count: usize) -> Result<&[u8], FileError> {
        if self.window.len() - self.at < count {
            self.more()?;
        }
        Ok(&self.window[self.at..self.window.len().min(self.at + count)])
    }

    fn skip(&mut self, count: usize) {
        self.at += count;
    }

    /// Next byte, in the file.
    fn place(&self) -> u64 {
        self.start + self.at as u64
    }

    fn left(&self) -> u64 {
        self.length.saturating_sub(self.place())
    }
}

struct Binary<'a> {
    stream: Stream<'a>,
    big: bool,
}

impl Numbers for Binary<'_> {
    fn next(&mut self, scalar: Scalar) -> Result<Number, FileError> {
        let mut raw = [0u8; 8];
        let len = scalar.bytes();
        let bytes = self.stream.peek(len)?;
        if bytes.len() < len {
            return Err(self.error("the file ends within the rows".into()));
        }
        raw[..len].copy_from_slice(bytes);
        if self.big {
            raw[..len].reverse();
        }
        self.stream.skip(len);
        let bits = u64::from_le_bytes(raw);
        Ok(match scalar {
            Scalar::I8 => Number::Int(i64::from(bits as u8 as i8)),
            Scalar::I16 => Number::Int(i64::from(bits as u16 as i16)),
            Scalar::I32 => Number::Int(i64::from(bits as u32 as i32)),
            Scalar::U8 | Scalar::U16 | Scalar::U32 => Number::Int(bits as i64),
            Scalar::F32 => Number::Float(f64::from(f32::from_bits(bits as u32))),
            Scalar::F64 => Number::Float(f64::from_bits(bits)),
        })
    }

    fn room(&self, bytes_each: usize, _: usize) -> u64 {
        self.stream.left() / bytes_each.max(1) as u64
    }

    fn error(&self, what: String) -> FileError {
        FileError::damaged(self.stream.file, Place::Byte(self.stream.place()), what)
    }
}

/// Numbers parted by white space; lines are counted for the errors only.
struct Ascii<'a> {
    stream: Stream<'a>,
    line: u64,
}

/// Longer words are no numbers.
const LONGEST_WORD: usize = 4096;

impl Ascii<'_> {
    fn word(&mut self) -> Result<String, FileError> {
        while let Some(byte) = self.stream.peek(1)?.first().copied().filter(u8::is_ascii_whitespace) {
            self.line += u64::from(byte == b'\n');
            self.stream.skip(1);
        }
        let rest = self.stream.peek(LONGEST_WORD)?;
        let word = &rest[..rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len())];
        let (len, word) = (word.len(), std::str::from_utf8(word).unwrap_or_default().to_owned());
        self.stream.skip(len);
        Ok(word)
    }
}

impl Numbers for Ascii<'_> {
    fn next(&mut self, scalar: Scalar) -> Result<Number, FileError> {
        let word = self.word()?;
        if word.is_empty() {
            return Err(self.error("a number is missing".into()));
        }
        let number =
            if scalar.is_float() { word.parse().ok().map(Number::Float) } else { word.parse().ok().map(Number::Int) };
        number.ok_or_else(|| self.error(format!("'{word}' is not a number of its kind")))
    }

    fn room(&self, _: usize, numbers_each: usize) -> u64 {
        self.stream.left().div_ceil(2) / numbers_each.max(1) as u64
    }

    fn error(&self, what: String) -> FileError {
        FileError::damaged(self.stream.file, Place::Line(self.line), what)
    }
}

/// Rows that follow one another, of one element.
pub(super) type Visit<'a> = dyn FnMut(&ElementHeader, Element) -> Result<(), FileError> + 'a;

/// Hands over the rows of all elements in their order, at most `at_once` at a time.
pub(super) fn read(
    stream: Stream<'_>,
    header: &Header,
    at_once: usize,
    visit: &mut Visit<'_>,
) -> Result<(), FileError> {
    match header.format {
        Format::Ascii => read_elements(&mut Ascii { stream, line: header.body_line }, header, at_once, visit),
        format => read_elements(&mut Binary { stream, big: format == Format::BigEndian }, header, at_once, visit),
    }
}

fn read_elements(
    source: &mut impl Numbers,
    header: &Header,
    at_once: usize,
    visit: &mut Visit<'_>,
) -> Result<(), FileError> {
    for element in &header.elements {
        let bytes_each = element.properties.iter().map(|p| p.list.unwrap_or(p.scalar).bytes()).sum();
        let room = source.room(bytes_each, element.properties.len());
        if element.count > room && !element.properties.is_empty() {
            let (count, name) = (element.count, &element.name);
            return Err(source.error(format!("{count} rows of {name} are announced, there is room for {room} at most")));
        }
        let mut left = if element.properties.is_empty() { 0 } else { element.count as usize };
        loop {
            let count = left.min(at_once);
            visit(element, read_rows(source, element, count)?)?;
            left -= count;
            if left == 0 {
                break;
            }
        }
    }
    Ok(())
}

fn read_rows(source: &mut impl Numbers, header: &ElementHeader, count: usize) -> Result<Element, FileError> {
    let mut columns: Vec<Column> = header.properties.iter().map(|property| empty_column(property, count)).collect();
    for _ in 0..count {
        for (property, column) in header.properties.iter().zip(&mut columns) {
            read_value(source, property, column)?;
        }
    }
    let names = header.properties.iter().map(|property| property.name.clone());
    let properties = names.zip(columns).map(|(name, column)| Property { name, column }).collect();
    Ok(Element { name: header.name.clone(), count, properties })
}

fn empty_column(property: &PropertyHeader, count: usize) -> Column {
    match (property.list, property.scalar) {
        (None, Scalar::F32) => Column::F32(Vec::with_capacity(count)),
        (None, Scalar::F64) => Column::F64(Vec::with_capacity(count)),
        (None, _) => Column::Int(Vec::with_capacity(count)),
        (Some(_), scalar) if scalar.is_float() => {
            Column::FloatList { ends: Vec::with_capacity(count), values: Vec::new() }
        }
        (Some(_), _) => Column::IntList { ends: Vec::with_capacity(count), values: Vec::with_capacity(count) },
    }
}

fn read_value(source: &mut impl Numbers, property: &PropertyHeader, column: &mut Column) -> Result<(), FileError> {
    match column {
        Column::F32(values) => values.push(float(source.next(property.scalar)?) as f32),
        Column::F64(values) => values.push(float(source.next(property.scalar)?)),
        Column::Int(values) => values.push(int(source.next(property.scalar)?)),
        Column::IntList { ends, values } => {
            for _ in 0..list_length(source, property)? {
                values.push(int(source.next(property.scalar)?));
            }
            ends.push(values.len());
        }
        Column::FloatList { ends, values } => {
            for _ in 0..list_length(source, property)? {
                values.push(float(source.next(property.scalar)?));
            }
            ends.push(values.len());
        }
    }
    Ok(())
}

fn list_length(source: &mut impl Numbers, property: &PropertyHeader) -> Result<u64, FileError> {
    let length = int(source.next(property.list.unwrap_or(Scalar::U8))?);
    let room = source.room(property.scalar.bytes(), 1);
    match u64::try_from(length) {
        Ok(length) if length <= room => Ok(length),
        _ => Err(source.error(format!("a list '{}' of {length} entries does not fit", property.name))),
    }
}

fn float(number: Number) -> f64 {
    match number {
        Number::Int(value) => value as f64,
        Number::Float(value) => value,
    }
}

fn int(number: Number) -> i64 {
    match number {
        Number::Int(value) => value,
        Number::Float(value) => value as i64,
    }
}
