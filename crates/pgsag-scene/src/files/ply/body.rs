//! The rows of a PLY file, into columns.

use super::header::{ElementHeader, Format, Header, PropertyHeader, Scalar};
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

struct Binary<'a> {
    file: &'a str,
    bytes: &'a [u8],
    at: usize,
    big: bool,
}

impl Numbers for Binary<'_> {
    fn next(&mut self, scalar: Scalar) -> Result<Number, FileError> {
        let mut raw = [0u8; 8];
        let len = scalar.bytes();
        let Some(slice) = self.bytes.get(self.at..self.at + len) else {
            return Err(self.error("the file ends within the rows".into()));
        };
        raw[..len].copy_from_slice(slice);
        if self.big {
            raw[..len].reverse();
        }
        self.at += len;
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
        ((self.bytes.len() - self.at) / bytes_each.max(1)) as u64
    }

    fn error(&self, what: String) -> FileError {
        FileError::damaged(self.file, Place::Byte(self.at as u64), what)
    }
}

/// Numbers parted by white space; lines are counted for the errors only.
struct Ascii<'a> {
    file: &'a str,
    bytes: &'a [u8],
    at: usize,
    line: u64,
}

impl<'a> Ascii<'a> {
    fn word(&mut self) -> Option<&'a str> {
        while let Some(byte) = self.bytes.get(self.at).filter(|byte| byte.is_ascii_whitespace()) {
            self.line += u64::from(*byte == b'\n');
            self.at += 1;
        }
        let rest = &self.bytes[self.at..];
        let len = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        self.at += len;
        std::str::from_utf8(&rest[..len]).ok().filter(|word| !word.is_empty())
    }
}

impl Numbers for Ascii<'_> {
    fn next(&mut self, scalar: Scalar) -> Result<Number, FileError> {
        let Some(word) = self.word() else {
            return Err(self.error("a number is missing".into()));
        };
        let number =
            if scalar.is_float() { word.parse().ok().map(Number::Float) } else { word.parse().ok().map(Number::Int) };
        number.ok_or_else(|| self.error(format!("'{word}' is not a number of its kind")))
    }

    fn room(&self, _: usize, numbers_each: usize) -> u64 {
        ((self.bytes.len() - self.at).div_ceil(2) / numbers_each.max(1)) as u64
    }

    fn error(&self, what: String) -> FileError {
        FileError::damaged(self.file, Place::Line(self.line), what)
    }
}

pub(super) fn read(file: &str, bytes: &[u8], header: &Header) -> Result<Vec<Element>, FileError> {
    match header.format {
        Format::Ascii => {
            let mut source = Ascii { file, bytes, at: header.body, line: header.body_line };
            header.elements.iter().map(|element| read_element(&mut source, element)).collect()
        }
        format => {
            let mut source = Binary { file, bytes, at: header.body, big: format == Format::BigEndian };
            header.elements.iter().map(|element| read_element(&mut source, element)).collect()
        }
    }
}

fn read_element(source: &mut impl Numbers, header: &ElementHeader) -> Result<Element, FileError> {
    let bytes_each = header.properties.iter().map(|p| p.list.unwrap_or(p.scalar).bytes()).sum();
    let room = source.room(bytes_each, header.properties.len());
    if header.count > room && !header.properties.is_empty() {
        let (count, name) = (header.count, &header.name);
        return Err(source.error(format!("{count} rows of {name} are announced, there is room for {room} at most")));
    }
    let count = if header.properties.is_empty() { 0 } else { header.count as usize };
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
