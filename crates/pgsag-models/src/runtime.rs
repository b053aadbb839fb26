//! What a runtime must do: load a graph, say what it takes and gives, run it. Two implementers: `rten`, pure Rust, and
//! `ort`, ONNX Runtime loaded from a shared library. Which one is a choice of the caller's; nothing falls back by itself.

use std::path::Path;
use std::sync::Arc;

use crate::error::ModelError;
use crate::guard;
use crate::onnx::Graph;
use crate::tensor::Tensor;

#[cfg(feature = "ort")]
mod ort;
#[cfg(feature = "rten")]
mod rten;

/// Which runtime.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RuntimeKind {
    /// Pure Rust, on the CPU.
    #[default]
    Rten,
    /// ONNX Runtime, from a shared library; CPU or GPU.
    Ort,
}

impl RuntimeKind {
    /// Its name, as typed.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Rten => "rten",
            Self::Ort => "ort",
        }
    }
}

/// What computes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Device {
    /// The processor.
    #[default]
    Cpu,
    /// The graphics card of this number.
    Cuda(u32),
}

/// How a graph is loaded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SessionOptions {
    /// Threads of one computation; 0: all.
    pub threads: usize,
    /// Where it runs. A device that is not there is an error, never another device.
    pub device: Device,
}

/// Loads graphs.
pub trait Runtime: Send + Sync {
    /// Its name and version, for people.
    fn description(&self) -> String;

    /// Loads the graph of a file that the guards have passed.
    ///
    /// # Errors
    /// [`ModelError`] naming the file.
    fn load(&self, path: &Path, graph: Graph, options: &SessionOptions) -> Result<Box<dyn Session>, ModelError>;
}

/// A loaded graph. It may be used from several threads.
pub trait Session: Send + Sync {
    /// What the file says of it.
    fn graph(&self) -> &Graph;

    /// Computes the named outputs, in their order, from the named inputs.
    ///
    /// # Errors
    /// [`ModelError::Runtime`] with the runtime's words.
    fn run(&self, inputs: &[(&str, &Tensor)], outputs: &[&str]) -> Result<Vec<Tensor>, ModelError>;
}

/// The runtime of this kind.
///
/// # Errors
/// [`ModelError::Runtime`] where this build has none, or its library is missing.
pub fn runtime(kind: RuntimeKind) -> Result<Arc<dyn Runtime>, ModelError> {
    match kind {
        #[cfg(feature = "rten")]
        RuntimeKind::Rten => Ok(Arc::new(rten::Rten)),
        #[cfg(feature = "ort")]
        RuntimeKind::Ort => Ok(Arc::new(ort::Ort::new()?)),
        #[cfg(not(all(feature = "rten", feature = "ort")))]
        missing => Err(ModelError::runtime(
            missing.name(),
            "not part of this build",
            &format!("build with `--features {}`", missing.name()),
        )),
    }
}

/// Reads a graph, guards it and loads it.
///
/// # Errors
/// [`ModelError`] naming the file.
pub fn open(
    runtime: &dyn Runtime,
    kind: RuntimeKind,
    path: &Path,
    options: &SessionOptions,
) -> Result<Box<dyn Session>, ModelError> {
    let graph = Graph::open(path)?;
    guard::check(path, &graph, kind)?;
    runtime.load(path, graph, options)
}
