//! PLY: the Stanford polygon format, read in all three encodings, written binary little-endian.
//!
//! [`Ply::parse`] reads any elements and properties into columns; meshes, clouds and float tables (the layout of
//! Gaussian splats) are views of those columns. Format: G. Turk, "The PLY Polygon File Format", 1994.

use std::io::{self, Read, Write};

use crate::error::{FileError, Place};
use crate::mesh::Mesh;
use body::Stream;

mod body;
mod header;
mod shapes;

/// What a property's column holds. Integers of every width are widened.
#[derive(Clone, Debug, PartialEq)]
pub enum Column {
    /// `float`, one per row.
    F32(Vec<f32>),
    /// `double`, one per row.
    F64(Vec<f64>),
    /// `char` … `uint`, one per row.
    Int(Vec<i64>),
    /// A list per row; row `i` is `values[ends[i - 1]..ends[i]]`.
    IntList {
        /// Where each row's list ends in `values`.
        ends: Vec<usize>,
        /// All lists, one after the other.
        values: Vec<i64>,
    },
    /// A list of numbers per row, as [`Column::IntList`].
    FloatList {
        /// Where each row's list ends in `values`.
        ends: Vec<usize>,
        /// All lists, one after the other.
        values: Vec<f64>,
    },
}

/// A named column.
#[derive(Clone, Debug, PartialEq)]
pub struct Property {
    /// As in the header.
    pub name: String,
    /// One entry per row of the element.
    pub column: Column,
}

/// A table of the file: `vertex`, `face`, ….
#[derive(Clone, Debug, PartialEq)]
pub struct Element {
    /// As in the header.
    pub name: String,
    /// Rows.
    pub count: usize,
    /// In the order of the header.
    pub properties: Vec<Property>,
}

/// A whole file.
#[derive(Clone, Debug, PartialEq)]
pub struct Ply {
    /// The comment lines, without the word `comment`.
    pub comments: Vec<String>,
    /// In the order of the header.
    pub elements: Vec<Element>,
}

/// Points with optional colours and whole-number attributes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// `[N]`, world frame.
    pub positions: Vec<[f64; 3]>,
    /// `[N]` RGB, or empty.
    pub colors: Vec<[u8; 3]>,
    /// Named columns of `[N]`, such as `building`.
    pub attributes: Vec<(String, Vec<u32>)>,
}

impl Cloud {
    /// The attribute of that name.
    #[must_use]
    pub fn attribute(&self, name: &str) -> Option<&[u32]> {
        self.attributes.iter().find(|(known, _)| known == name).map(|(_, values)| values.as_slice())
    }
}

/// Rows of named floats: the layout of Gaussian splats.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FloatTable {
    /// Column names.
    pub names: Vec<String>,
    /// Row-major, `names.len()` a row.
    pub values: Vec<f32>,
    /// The comment lines, such as `origin_world x y z`.
    pub comments: Vec<String>,
}

impl FloatTable {
    /// Rows.
    #[must_use]
    pub fn row_count(&self) -> usize {
        self.values.len().checked_div(self.names.len()).unwrap_or(0)
    }

    /// The place of a column in a row.
    #[must_use]
    pub fn column(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|known| known == name)
    }
}

/// The three numbers of the comment `origin_world x y z`, if there is one.
#[must_use]
pub fn origin_world(comments: &[String]) -> Option<[f64; 3]> {
    let words = comments.iter().find_map(|line| line.trim().strip_prefix("origin_world "))?;
    let numbers: Vec<f64> = words.split_ascii_whitespace().map_while(|word| word.parse().ok()).collect();
    let numbers = <[f64; 3]>::try_from(numbers).ok()?;
    numbers.iter().all(|value| value.is_finite()).then_some(numbers)
}

impl Ply {
    /// Reads any PLY file. No count of the header is believed beyond the bytes that follow it.
    ///
    /// # Errors
    /// [`FileError`] with the line of the header or the byte (binary) or line (ascii) of the body.
    pub fn parse(file: &str, bytes: &[u8]) -> Result<Self, FileError> {
        let (mut input, length) = (bytes, bytes.len() as u64);
        let mut stream = Stream::new(file, &mut input, length);
        let header = stream.header()?;
        let mut elements = Vec::with_capacity(header.elements.len().min(64));
        body::read(stream, &header, usize::MAX, &mut |_, rows| {
            elements.push(rows);
            Ok(())
        })?;
        Ok(Self { comments: header.comments, elements })
    }

    /// The element of that name.
    #[must_use]
    pub fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|element| element.name == name)
    }
}

/// Reads a triangle mesh; polygons become fans, `building`, `group` and `closed` of the faces are kept.
///
/// # Errors
/// [`FileError`]: damaged, no vertices, an index that leads nowhere, a vertex that is not finite.
pub fn read_mesh(file: &str, mut bytes: &[u8]) -> Result<Mesh, FileError> {
    let length = bytes.len() as u64;
    read_mesh_from(file, &mut bytes, length)
}

/// Reads a mesh as [`read_mesh`] does, from a source of `length` bytes: besides the mesh little is held.
///
/// # Errors
/// Those of [`read_mesh`], and what the source says.
pub fn read_mesh_from(file: &str, input: &mut dyn Read, length: u64) -> Result<Mesh, FileError> {
    let mut stream = Stream::new(file, input, length);
    let header = stream.header()?;
    let mut rows = shapes::MeshRows::new(file, &header);
    body::read(stream, &header, ROWS_AT_ONCE, &mut |element, part| rows.take(element, &part))?;
    rows.finish()
}

/// Rows of a mesh that are held as columns.
const ROWS_AT_ONCE: usize = 1 << 14;

/// Reads the vertices of a file as a cloud; all whole-number properties but colours are kept as attributes.
///
/// # Errors
/// [`FileError`]: damaged, no vertices, a vertex that is not finite.
pub fn read_cloud(file: &str, bytes: &[u8]) -> Result<Cloud, FileError> {
    shapes::cloud(file, &Ply::parse(file, bytes)?)
}

/// Reads the vertices of a file as a table of floats; every property must be `float`.
///
/// # Errors
/// [`FileError`]: damaged, no vertices, a property of another type.
pub fn read_floats(file: &str, bytes: &[u8]) -> Result<FloatTable, FileError> {
    shapes::floats(file, Ply::parse(file, bytes)?)
}

/// Writes a mesh: `double x y z`, `uchar red green blue` where there are colours, `list uchar int vertex_indices`, and
/// `uint building`, `uint group`, `uint closed` where there are such.
///
/// # Errors
/// What the writer says.
pub fn write_mesh(out: &mut impl Write, mesh: &Mesh, comments: &[String]) -> io::Result<()> {
    header::write_start(out, comments)?;
    let colored = mesh.colors.len() == mesh.vertices.len() && !mesh.colors.is_empty();
    writeln!(out, "element vertex {}\nproperty double x\nproperty double y\nproperty double z", mesh.vertices.len())?;
    if colored {
        out.write_all(header::COLORS)?;
    }
    writeln!(out, "element face {}\nproperty list uchar int vertex_indices", mesh.faces.len())?;
    let numbers = [("building", &mesh.buildings), ("group", &mesh.groups), ("closed", &mesh.closed)];
    let numbers = numbers.map(|(name, values)| (name, (values.len() == mesh.faces.len()).then_some(values)));
    for (name, _) in numbers.iter().filter(|(_, values)| values.is_some_and(|values| !values.is_empty())) {
        writeln!(out, "property uint {name}")?;
    }
    out.write_all(b"end_header\n")?;
    for (i, vertex) in mesh.vertices.iter().enumerate() {
        vertex.iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))?;
        if colored {
            out.write_all(&mesh.colors[i])?;
        }
    }
    for (i, face) in mesh.faces.iter().enumerate() {
        out.write_all(&[3])?;
        face.iter().try_for_each(|index| out.write_all(&index.to_le_bytes()))?;
        for values in numbers.iter().filter_map(|(_, values)| *values) {
            out.write_all(&values[i].to_le_bytes())?;
        }
    }
    Ok(())
}

/// Writes a cloud: `double x y z`, `uchar red green blue` where there are colours, `uint` for every attribute.
///
/// # Errors
/// What the writer says.
pub fn write_cloud(out: &mut impl Write, cloud: &Cloud, comments: &[String]) -> io::Result<()> {
    header::write_start(out, comments)?;
    let colored = cloud.colors.len() == cloud.positions.len() && !cloud.colors.is_empty();
    let count = cloud.positions.len();
    writeln!(out, "element vertex {count}\nproperty double x\nproperty double y\nproperty double z")?;
    if colored {
        out.write_all(header::COLORS)?;
    }
    for (name, _) in &cloud.attributes {
        writeln!(out, "property uint {name}")?;
    }
    out.write_all(b"end_header\n")?;
    for (i, position) in cloud.positions.iter().enumerate() {
        position.iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))?;
        if colored {
            out.write_all(&cloud.colors[i])?;
        }
        for (_, values) in &cloud.attributes {
            out.write_all(&values[i].to_le_bytes())?;
        }
    }
    Ok(())
}

/// Writes a table of floats as vertices.
///
/// # Errors
/// What the writer says.
pub fn write_floats(out: &mut impl Write, table: &FloatTable) -> io::Result<()> {
    header::write_start(out, &table.comments)?;
    writeln!(out, "element vertex {}", table.row_count())?;
    table.names.iter().try_for_each(|name| writeln!(out, "property float {name}"))?;
    out.write_all(b"end_header\n")?;
    let whole_rows = table.row_count() * table.names.len();
    table.values[..whole_rows].iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))
}

/// An error at an element of a file.
fn element_error(file: &str, element: &str, what: impl Into<String>) -> FileError {
    FileError::damaged(file, Place::Part(format!("element {element}")), what)
}

#[cfg(test)]
mod tests;
