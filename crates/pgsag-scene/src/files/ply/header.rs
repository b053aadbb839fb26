//! The header of a PLY file.

use std::io::{self, Write};

use crate::error::{FileError, Place};

/// The colour properties as this crate writes them.
pub(super) const COLORS: &[u8] = b"property uchar red\nproperty uchar green\nproperty uchar blue\n";

/// Headers beyond this are refused, bytes.
const LONGEST_HEADER: usize = 1 << 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// A number type of PLY.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    pub(super) fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }
}

#[derive(Clone, Debug)]
pub(super) struct PropertyHeader {
    pub(super) name: String,
    pub(super) scalar: Scalar,
    /// The type of the count, for lists.
    pub(super) list: Option<Scalar>,
}

#[derive(Clone, Debug)]
pub(super) struct ElementHeader {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<PropertyHeader>,
}

pub(super) struct Header {
    pub(super) format: Format,
    pub(super) comments: Vec<String>,
    pub(super) elements: Vec<ElementHeader>,
    /// First byte and first line of the body.
    pub(super) body: usize,
    pub(super) body_line: u64,
}

pub(super) fn parse(file: &str, bytes: &[u8]) -> Result<Header, FileError> {
    let mut header =
        Header { format: Format::Ascii, comments: Vec::new(), elements: Vec::new(), body: 0, body_line: 1 };
    let mut format = None;
    loop {
        let number = header.body_line;
        let error = |what: String| FileError::damaged(file, Place::Line(number), what);
        let window = &bytes[header.body..bytes.len().min(LONGEST_HEADER)];
        let Some(len) = window.iter().position(|&byte| byte == b'\n') else {
            return Err(error("the header has no end (end_header)".into()));
        };
        let line = String::from_utf8_lossy(&window[..len]);
        let line = line.trim_end_matches('\r');
        header.body += len + 1;
        header.body_line += 1;
        if number == 1 {
            if line.trim() != "ply" {
                return Err(error("not a PLY file: the first line is not 'ply'".into()));
            }
            continue;
        }
        let (keyword, rest) = line.split_once(' ').unwrap_or((line, ""));
        match keyword {
            "comment" => header.comments.push(rest.to_owned()),
            "obj_info" | "" => {}
            "format" => format = Some(parse_format(rest).ok_or_else(|| error(format!("unknown format '{rest}'")))?),
            "element" => header.elements.push(parse_element(rest).map_err(error)?),
            "property" => {
                let property = parse_property(rest).map_err(error)?;
                let element = header.elements.last_mut();
                element.ok_or_else(|| error("a property before any element".into()))?.properties.push(property);
            }
            "end_header" => break,
            _ => return Err(error(format!("unknown keyword '{keyword}'"))),
        }
    }
    let missing = || FileError::damaged(file, Place::Line(2), "the format line is missing");
    header.format = format.ok_or_else(missing)?;
    Ok(header)
}

fn parse_format(words: &str) -> Option<Format> {
    match words.split_ascii_whitespace().next()? {
        "ascii" => Some(Format::Ascii),
        "binary_little_endian" => Some(Format::LittleEndian),
        "binary_big_endian" => Some(Format::BigEndian),
        _ => None,
    }
}

fn parse_element(words: &str) -> Result<ElementHeader, String> {
    let mut words = words.split_ascii_whitespace();
    let (name, count) = (words.next().ok_or("an element without a name")?, words.next());
    let count = count.and_then(|word| word.parse().ok()).ok_or_else(|| format!("element {name} has no count"))?;
    Ok(ElementHeader { name: name.into(), count, properties: Vec::new() })
}

fn parse_property(words: &str) -> Result<PropertyHeader, String> {
    let words: Vec<&str> = words.split_ascii_whitespace().collect();
    let scalar = |name: &str| Scalar::named(name).ok_or_else(|| format!("unknown type '{name}'"));
    match words[..] {
        ["list", count, value, name] => {
            let count = scalar(count)?;
            if count.is_float() {
                return Err(format!("the length of list '{name}' is not a whole number"));
            }
            Ok(PropertyHeader { name: name.into(), scalar: scalar(value)?, list: Some(count) })
        }
        [value, name] => Ok(PropertyHeader { name: name.into(), scalar: scalar(value)?, list: None }),
        _ => Err("a property needs a type and a name".into()),
    }
}

/// Writes the first lines; comments are made one line each.
pub(super) fn write_start(out: &mut impl Write, comments: &[String]) -> io::Result<()> {
    out.write_all(b"ply\nformat binary_little_endian 1.0\n")?;
    for comment in comments {
        let comment: String = comment.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        writeln!(out, "comment {comment}")?;
    }
    Ok(())
}
