//! Values that travel into and out of a graph: a shape and its elements, row-major.

use crate::error::{ModelError, RUN_FAILED};

/// Elements of a tensor.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// 32-bit floats.
    F32(Vec<f32>),
    /// 64-bit integers; runtimes may hold them narrower.
    I64(Vec<i64>),
    /// Truth values.
    Bool(Vec<bool>),
}

/// A dense tensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Sizes, outermost first.
    pub shape: Vec<usize>,
    /// `[product of shape]`, row-major.
    pub values: Values,
}

impl Tensor {
    /// A tensor of floats. The shape must have as many places as there are values.
    #[must_use]
    pub fn floats(shape: &[usize], values: Vec<f32>) -> Self {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "a tensor as large as its shape says");
        Self { shape: shape.to_vec(), values: Values::F32(values) }
    }

    /// A tensor of integers. The shape must have as many places as there are values.
    #[must_use]
    pub fn integers(shape: &[usize], values: Vec<i64>) -> Self {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "a tensor as large as its shape says");
        Self { shape: shape.to_vec(), values: Values::I64(values) }
    }

    /// A tensor of truth values. The shape must have as many places as there are values.
    #[must_use]
    pub fn truths(shape: &[usize], values: Vec<bool>) -> Self {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "a tensor as large as its shape says");
        Self { shape: shape.to_vec(), values: Values::Bool(values) }
    }

    /// The floats of an output that must have `rank` dimensions.
    ///
    /// # Errors
    /// [`ModelError::Runtime`] where the graph gave something else.
    pub fn as_floats(&self, name: &str, rank: usize) -> Result<&[f32], ModelError> {
        match &self.values {
            // Half precision that overflows ends so; every comparison with it is false, and the mask would be empty.
            Values::F32(values) if values.iter().any(|value| value.is_nan()) => Err(ModelError::runtime(
                "graph",
                format!("{RUN_FAILED}: output `{name}` is not a number"),
                "take a bundle of full precision; `pgsag models verify` shows which bundle is broken",
            )),
            Values::F32(values) if self.shape.len() == rank => Ok(values),
            _ => Err(ModelError::runtime(
                "graph",
                format!(
                    "{RUN_FAILED}: output `{name}` has shape {:?}, expected {rank} dimensions of floats",
                    self.shape
                ),
                "`pgsag models verify` shows which bundle is broken",
            )),
        }
    }
}

/// Type of a tensor's elements, as ONNX numbers them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Element {
    /// 32-bit float.
    F32,
    /// 16-bit float.
    F16,
    /// 64-bit float.
    F64,
    /// 32-bit integer.
    I32,
    /// 64-bit integer.
    I64,
    /// Truth value.
    Bool,
    /// Anything else, by its ONNX number.
    Other(u64),
}

impl Element {
    pub(crate) fn from_onnx(number: u64) -> Self {
        match number {
            1 => Self::F32,
            6 => Self::I32,
            7 => Self::I64,
            9 => Self::Bool,
            10 => Self::F16,
            11 => Self::F64,
            other => Self::Other(other),
        }
    }
}

/// An input or output of a graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TensorInfo {
    /// Its name in the graph.
    pub name: String,
    /// Type of its elements.
    pub element: Element,
    /// Fixed sizes; `None` where the graph leaves one open.
    pub shape: Vec<Option<usize>>,
}

impl std::fmt::Display for TensorInfo {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let sizes: Vec<String> =
            self.shape.iter().map(|size| size.map_or("?".to_owned(), |size| size.to_string())).collect();
        write!(out, "{} {:?}[{}]", self.name, self.element, sizes.join(","))
    }
}
