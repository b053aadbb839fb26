//! Columns of a PLY file as meshes, clouds and tables.

use super::header::{ElementHeader, Header};
use super::{Cloud, Column, Element, FloatTable, Ply, element_error};
use crate::error::FileError;
use crate::mesh::Mesh;

impl Element {
    fn column(&self, name: &str) -> Option<&Column> {
        self.properties.iter().find(|property| property.name == name).map(|property| &property.column)
    }

    fn integers(&self, names: &[&str]) -> Option<&[i64]> {
        names.iter().find_map(|name| match self.column(name) {
            Some(Column::Int(values)) => Some(values.as_slice()),
            _ => None,
        })
    }
}

fn number(column: &Column, row: usize) -> Option<f64> {
    match column {
        Column::F32(values) => Some(f64::from(values[row])),
        Column::F64(values) => Some(values[row]),
        Column::Int(values) => Some(values[row] as f64),
        Column::IntList { .. } | Column::FloatList { .. } => None,
    }
}

fn vertices<'a>(file: &str, ply: &'a Ply) -> Result<&'a Element, FileError> {
    ply.element("vertex").ok_or_else(|| element_error(file, "vertex", "the file has no vertices"))
}

/// Of rows that begin at `first`.
fn positions(file: &str, element: &Element, first: usize) -> Result<Vec<[f64; 3]>, FileError> {
    let [x, y, z] = ["x", "y", "z"].map(|name| element.column(name));
    let (Some(x), Some(y), Some(z)) = (x, y, z) else {
        return Err(element_error(file, "vertex", "x, y or z is missing"));
    };
    let mut positions = Vec::with_capacity(element.count);
    for row in 0..element.count {
        let at = [number(x, row), number(y, row), number(z, row)].map(|value| value.unwrap_or(f64::NAN));
        if !at.iter().all(|value| value.is_finite()) {
            let row = first + row;
            return Err(element_error(file, "vertex", format!("vertex {row} lies at {at:?}, which is no place")));
        }
        positions.push(at);
    }
    Ok(positions)
}

/// RGB from bytes, or from floats in 0..1; empty where there is none.
fn colors(element: &Element) -> Vec<[u8; 3]> {
    let channel = |names: [&str; 3]| names.iter().find_map(|name| element.column(name));
    let red = channel(["red", "r", "diffuse_red"]);
    let green = channel(["green", "g", "diffuse_green"]);
    let blue = channel(["blue", "b", "diffuse_blue"]);
    let (Some(red), Some(green), Some(blue)) = (red, green, blue) else {
        return Vec::new();
    };
    let byte = |column: &Column, row: usize| match column {
        Column::Int(values) => values[row].clamp(0, 255) as u8,
        _ => (number(column, row).unwrap_or(0.0) * 255.0).round().clamp(0.0, 255.0) as u8,
    };
    (0..element.count).map(|row| [byte(red, row), byte(green, row), byte(blue, row)]).collect()
}

/// Whole numbers that fit 32 bits without sign.
fn unsigned(values: &[i64]) -> Option<Vec<u32>> {
    values.iter().map(|&value| u32::try_from(value).ok()).collect()
}

/// A mesh that grows by rows.
pub(super) struct MeshRows<'a> {
    file: &'a str,
    mesh: Mesh,
    /// As the header announces them; `None` where there is no such element.
    vertex_count: Option<usize>,
    face_count: Option<usize>,
    faces_read: usize,
}

impl<'a> MeshRows<'a> {
    pub(super) fn new(file: &'a str, header: &Header) -> Self {
        let count = |name: &str| header.elements.iter().find(|e| e.name == name).map(|element| element.count as usize);
        let (vertex_count, face_count) = (count("vertex"), count("face"));
        Self { file, mesh: Mesh::default(), vertex_count, face_count, faces_read: 0 }
    }

    /// Takes rows; those of other elements mean nothing here.
    pub(super) fn take(&mut self, header: &ElementHeader, rows: &Element) -> Result<(), FileError> {
        let is_first = |name: &str, count: Option<usize>, read: usize| {
            header.name == name && count.is_some_and(|count| read + rows.count <= count)
        };
        if is_first("vertex", self.vertex_count, self.mesh.vertices.len()) {
            let first = self.mesh.vertices.len();
            reserve(&mut self.mesh.vertices, header.count, rows.count);
            self.mesh.vertices.extend(positions(self.file, rows, first)?);
            let colors = colors(rows);
            reserve(&mut self.mesh.colors, header.count, colors.len());
            self.mesh.colors.extend(colors);
        } else if is_first("face", self.face_count, self.faces_read) {
            self.faces(header, rows)?;
        }
        Ok(())
    }

    fn faces(&mut self, header: &ElementHeader, rows: &Element) -> Result<(), FileError> {
        let file = self.file;
        let indices = ["vertex_indices", "vertex_index"].iter().find_map(|name| rows.column(name));
        let Some(Column::IntList { ends, values }) = indices else {
            return Err(element_error(file, "face", "the list vertex_indices is missing"));
        };
        let number = |name: &str| match rows.integers(&[name]) {
            None => Ok(None),
            Some(values) => {
                let what = || element_error(file, "face", format!("a {name} number is negative or too large"));
                unsigned(values).map(Some).ok_or_else(what)
            }
        };
        let (buildings, groups, closed) = (number("building")?, number("group")?, number("closed")?);
        let (mesh, vertex_count) = (&mut self.mesh, self.vertex_count.unwrap_or(0));
        reserve(&mut mesh.faces, header.count, rows.count);
        for (to, numbers) in
            [(&mut mesh.buildings, &buildings), (&mut mesh.groups, &groups), (&mut mesh.closed, &closed)]
        {
            reserve(to, header.count, numbers.as_ref().map_or(0, Vec::len));
        }
        let mut start = 0;
        for (row, &end) in ends.iter().enumerate() {
            let polygon = &values[start..end];
            start = end;
            if let Some(index) = polygon.iter().find(|&&index| index < 0 || index as usize >= vertex_count) {
                let row = self.faces_read + row;
                return Err(element_error(
                    file,
                    "face",
                    format!("face {row} leads to vertex {index}, which is not there"),
                ));
            }
            for pair in polygon.get(1..).unwrap_or_default().windows(2) {
                mesh.faces.push([polygon[0] as u32, pair[0] as u32, pair[1] as u32]);
                mesh.buildings.extend(buildings.as_ref().map(|numbers| numbers[row]));
                mesh.groups.extend(groups.as_ref().map(|numbers| numbers[row]));
                mesh.closed.extend(closed.as_ref().map(|numbers| numbers[row]));
            }
        }
        self.faces_read += rows.count;
        Ok(())
    }

    pub(super) fn finish(self) -> Result<Mesh, FileError> {
        if self.vertex_count.is_none() {
            return Err(element_error(self.file, "vertex", "the file has no vertices"));
        }
        if self.face_count.is_none() {
            return Err(element_error(self.file, "face", "the file has no faces; it is a cloud of points"));
        }
        Ok(self.mesh)
    }
}

/// Makes room for all rows when the first come, so that no list is grown by copying it.
fn reserve<T>(list: &mut Vec<T>, announced: u64, coming: usize) {
    if list.is_empty() && coming > 0 {
        list.reserve_exact(announced as usize);
    }
}

pub(super) fn cloud(file: &str, ply: &Ply) -> Result<Cloud, FileError> {
    const COLORS: [&str; 6] = ["red", "green", "blue", "r", "g", "b"];
    let vertex = vertices(file, ply)?;
    let mut cloud = Cloud { positions: positions(file, vertex, 0)?, colors: colors(vertex), attributes: Vec::new() };
    for property in vertex.properties.iter().filter(|property| !COLORS.contains(&property.name.as_str())) {
        let known = ["x", "y", "z"].contains(&property.name.as_str());
        if let (false, Column::Int(values)) = (known, &property.column)
            && let Some(values) = unsigned(values)
        {
            cloud.attributes.push((property.name.clone(), values));
        }
    }
    Ok(cloud)
}

pub(super) fn floats(file: &str, mut ply: Ply) -> Result<FloatTable, FileError> {
    let index = ply.elements.iter().position(|element| element.name == "vertex");
    let index = index.ok_or_else(|| element_error(file, "vertex", "the file has no vertices"))?;
    let vertex = ply.elements.swap_remove(index);
    let (mut names, mut columns) = (Vec::new(), Vec::new());
    for property in vertex.properties {
        let Column::F32(values) = property.column else {
            return Err(element_error(file, "vertex", format!("property {} is not float", property.name)));
        };
        names.push(property.name);
        columns.push(values);
    }
    let mut values = Vec::with_capacity(vertex.count * names.len());
    for row in 0..vertex.count {
        values.extend(columns.iter().map(|column| column[row]));
    }
    Ok(FloatTable { names, values, comments: ply.comments })
}
