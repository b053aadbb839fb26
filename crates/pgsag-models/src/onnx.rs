//! What stands in an ONNX file, weights left out: inputs, outputs, operators with the attributes that the guards ask for.
//!
//! ONNX is protocol buffers; a few field numbers of its published schema are all that is needed here. Large tensors are
//! skipped, and no length from the file is believed beyond the message that holds it.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufReader, Read, Seek};
use std::path::Path;

use crate::error::ModelError;
use crate::tensor::{Element, TensorInfo};

mod wire;

use wire::{Field, Message, Wire};

/// One operation.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Node {
    /// Its name; may be empty.
    pub name: String,
    /// What it computes, such as `Resize`.
    pub operator: String,
    /// Whose operator it is; empty for ONNX's own.
    pub domain: String,
    /// Names of the values that it reads.
    pub inputs: Vec<String>,
    /// Attributes that are text, such as `mode = cubic`.
    pub texts: BTreeMap<String, String>,
}

/// A graph, without its weights.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Graph {
    /// Version of ONNX's own operators.
    pub opset: u64,
    /// What must be given.
    pub inputs: Vec<TensorInfo>,
    /// What comes out.
    pub outputs: Vec<TensorInfo>,
    /// In the file's order.
    pub nodes: Vec<Node>,
    /// Types of inner values, where the file states them.
    pub elements: BTreeMap<String, Element>,
    /// Files beside this one that hold weights.
    pub external_files: BTreeSet<String>,
}

impl Graph {
    /// Reads a file's graph.
    ///
    /// # Errors
    /// [`ModelError::File`] where the file cannot be read or is not ONNX.
    pub fn open(path: &Path) -> Result<Self, ModelError> {
        let unreadable = |cause| ModelError::file(path, format!("cannot be read ({cause})"), "check the path");
        let file = std::fs::File::open(path).map_err(unreadable)?;
        let length = file.metadata().map_err(unreadable)?.len();
        Self::read(&mut BufReader::with_capacity(1 << 16, file), length).map_err(|what| {
            ModelError::file(path, format!("not a whole ONNX file ({what})"), "copy or export it again")
        })
    }

    /// Reads a graph of `length` bytes.
    fn read(source: &mut (impl Read + Seek), length: u64) -> Result<Self, String> {
        let mut wire = Wire::new(source);
        let mut graph = Self::default();
        let mut is_found = false;
        let mut file = Message::whole(length);
        while let Some(field) = wire.next(&mut file)? {
            match field {
                Field { number: 7, length: Some(length), .. } => {
                    is_found = true;
                    graph.read_graph(&mut wire, length)?;
                }
                Field { number: 8, length: Some(length), .. } => {
                    let (domain, version) = read_opset(&mut wire, length)?;
                    if domain.is_empty() || domain == "ai.onnx" {
                        graph.opset = version;
                    }
                }
                other => wire.skip(&other)?,
            }
        }
        if is_found && !graph.outputs.is_empty() { Ok(graph) } else { Err("it holds no graph".into()) }
    }

    fn read_graph<R: Read + Seek>(&mut self, wire: &mut Wire<'_, R>, length: u64) -> Result<(), String> {
        let mut message = wire.message(length);
        let mut weights = BTreeSet::new();
        while let Some(field) = wire.next(&mut message)? {
            match (field.number, field.length) {
                (1, Some(length)) => self.read_node(wire, length)?,
                (5, Some(length)) => drop(weights.insert(self.read_tensor(wire, length)?)),
                (11, Some(length)) => self.inputs.extend(read_info(wire, length)?),
                (12, Some(length)) => self.outputs.extend(read_info(wire, length)?),
                (13, Some(length)) => {
                    self.elements.extend(read_info(wire, length)?.map(|info| (info.name, info.element)));
                }
                _ => wire.skip(&field)?,
            }
        }
        // Old exporters list weights among the inputs as well.
        self.inputs.retain(|input| !weights.contains(&input.name));
        Ok(())
    }

    fn read_node<R: Read + Seek>(&mut self, wire: &mut Wire<'_, R>, length: u64) -> Result<(), String> {
        let mut node = Node::default();
        let mut message = wire.message(length);
        while let Some(field) = wire.next(&mut message)? {
            match (field.number, field.length) {
                (1, Some(length)) => node.inputs.push(wire.text(length)?),
                (3, Some(length)) => node.name = wire.text(length)?,
                (4, Some(length)) => node.operator = wire.text(length)?,
                (7, Some(length)) => node.domain = wire.text(length)?,
                (5, Some(length)) => self.read_attribute(wire, length, &mut node)?,
                _ => wire.skip(&field)?,
            }
        }
        self.nodes.push(node);
        Ok(())
    }

    fn read_attribute<R: Read + Seek>(
        &mut self,
        wire: &mut Wire<'_, R>,
        length: u64,
        node: &mut Node,
    ) -> Result<(), String> {
        let (mut name, mut text) = (String::new(), None);
        let mut message = wire.message(length);
        while let Some(field) = wire.next(&mut message)? {
            match (field.number, field.length) {
                (1, Some(length)) => name = wire.text(length)?,
                (4, Some(length)) if length <= LONGEST_TEXT => text = Some(wire.text(length)?),
                (5 | 10, Some(length)) => drop(self.read_tensor(wire, length)?),
                // Branches of `If` and bodies of `Loop` hold operators and weights too; inputs and outputs are their own.
                (6 | 11, Some(length)) => {
                    let mut inner = Self::default();
                    wire.deeper()?;
                    inner.read_graph(wire, length)?;
                    wire.depth -= 1;
                    self.nodes.append(&mut inner.nodes);
                    self.elements.append(&mut inner.elements);
                    self.external_files.append(&mut inner.external_files);
                }
                _ => wire.skip(&field)?,
            }
        }
        if let Some(text) = text {
            node.texts.insert(name, text);
        }
        Ok(())
    }

    /// A weight's name; its type and its file are kept.
    fn read_tensor<R: Read + Seek>(&mut self, wire: &mut Wire<'_, R>, length: u64) -> Result<String, String> {
        let (mut name, mut element) = (String::new(), Element::Other(0));
        let mut message = wire.message(length);
        while let Some(field) = wire.next(&mut message)? {
            match (field.number, field.length) {
                (2, None) => element = Element::from_onnx(field.value),
                (8, Some(length)) => name = wire.text(length)?,
                (13, Some(length)) => {
                    let (key, value) = read_pair(wire, length)?;
                    if key == "location" {
                        self.external_files.insert(value);
                    }
                }
                _ => wire.skip(&field)?,
            }
        }
        if !name.is_empty() {
            self.elements.insert(name.clone(), element);
        }
        Ok(name)
    }

    /// The input of this name.
    #[must_use]
    pub fn input(&self, name: &str) -> Option<&TensorInfo> {
        self.inputs.iter().find(|info| info.name == name)
    }

    /// The output of this name.
    #[must_use]
    pub fn output(&self, name: &str) -> Option<&TensorInfo> {
        self.outputs.iter().find(|info| info.name == name)
    }
}

/// Texts of attributes are words; longer ones are compiled code of other runtimes.
const LONGEST_TEXT: u64 = 4096;

fn read_opset<R: Read + Seek>(wire: &mut Wire<'_, R>, length: u64) -> Result<(String, u64), String> {
    let (mut domain, mut version) = (String::new(), 0);
    let mut message = wire.message(length);
    while let Some(field) = wire.next(&mut message)? {
        match (field.number, field.length) {
            (1, Some(length)) => domain = wire.text(length)?,
            (2, None) => version = field.value,
            _ => wire.skip(&field)?,
        }
    }
    Ok((domain, version))
}

fn read_pair<R: Read + Seek>(wire: &mut Wire<'_, R>, length: u64) -> Result<(String, String), String> {
    let (mut key, mut value) = (String::new(), String::new());
    let mut message = wire.message(length);
    while let Some(field) = wire.next(&mut message)? {
        match (field.number, field.length) {
            (1, Some(length)) => key = wire.text(length)?,
            (2, Some(length)) => value = wire.text(length)?,
            _ => wire.skip(&field)?,
        }
    }
    Ok((key, value))
}

/// Name, element type and shape of a value; `None` where it is not a tensor.
fn read_info<R: Read + Seek>(wire: &mut Wire<'_, R>, length: u64) -> Result<Option<TensorInfo>, String> {
    let (mut name, mut found) = (String::new(), None);
    let mut message = wire.message(length);
    while let Some(field) = wire.next(&mut message)? {
        match (field.number, field.length) {
            (1, Some(length)) => name = wire.text(length)?,
            (2, Some(length)) => {
                let mut kind = wire.message(length);
                while let Some(field) = wire.next(&mut kind)? {
                    match (field.number, field.length) {
                        (1, Some(length)) => found = Some(read_tensor_type(wire, length)?),
                        _ => wire.skip(&field)?,
                    }
                }
            }
            _ => wire.skip(&field)?,
        }
    }
    Ok(found.map(|(element, shape)| TensorInfo { name, element, shape }))
}

fn read_tensor_type<R: Read + Seek>(
    wire: &mut Wire<'_, R>,
    length: u64,
) -> Result<(Element, Vec<Option<usize>>), String> {
    let (mut element, mut shape) = (Element::Other(0), Vec::new());
    let mut message = wire.message(length);
    while let Some(field) = wire.next(&mut message)? {
        match (field.number, field.length) {
            (1, None) => element = Element::from_onnx(field.value),
            (2, Some(length)) => {
                let mut sizes = wire.message(length);
                while let Some(field) = wire.next(&mut sizes)? {
                    match (field.number, field.length) {
                        (1, Some(length)) => shape.push(read_size(wire, length)?),
                        _ => wire.skip(&field)?,
                    }
                }
            }
            _ => wire.skip(&field)?,
        }
    }
    Ok((element, shape))
}

fn read_size<R: Read + Seek>(wire: &mut Wire<'_, R>, length: u64) -> Result<Option<usize>, String> {
    let mut size = None;
    let mut message = wire.message(length);
    while let Some(field) = wire.next(&mut message)? {
        match (field.number, field.length) {
            (1, None) => size = usize::try_from(field.value).ok().filter(|size| *size > 0 && *size < 1 << 40),
            _ => wire.skip(&field)?,
        }
    }
    Ok(size)
}

#[cfg(test)]
mod tests;
