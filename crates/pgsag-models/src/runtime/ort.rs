//! The runtime `ort`: ONNX Runtime from a shared library, on the CPU or a graphics card.
//!
//! The library is the one that `ORT_DYLIB_PATH` names, else the system's. A device that was asked for and cannot be had
//! is an error: ONNX Runtime itself would go on with the CPU and say so in a log.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use ort::session::builder::SessionBuilder;
use ort::session::{Session as OrtSession, SessionInputValue};
use ort::value::{DynValue, Tensor as OrtTensor};

use super::{Device, Runtime, Session, SessionOptions};
use crate::error::{ModelError, RUN_FAILED};
use crate::onnx::Graph;
use crate::tensor::{Tensor, Values};

const NAME: &str = "ort";
const CURE: &str = "install ONNX Runtime and set ORT_DYLIB_PATH to its shared library, or choose --runtime rten";

/// The library's name where nobody says where it is.
const LIBRARY: &str = if cfg!(windows) {
    "onnxruntime.dll"
} else if cfg!(target_os = "macos") {
    "libonnxruntime.dylib"
} else {
    "libonnxruntime.so"
};

/// ONNX Runtime has one environment per process, and says so.
static ENVIRONMENT: Mutex<Option<ort::environment::Environment>> = Mutex::new(None);

/// The runtime, its library loaded.
pub(super) struct Ort {
    environment: ort::environment::Environment,
    library: PathBuf,
}

impl Ort {
    /// Loads the library.
    pub(super) fn new() -> Result<Self, ModelError> {
        let named = std::env::var_os("ORT_DYLIB_PATH").filter(|path| !path.is_empty());
        let library = named.map_or_else(|| PathBuf::from(LIBRARY), PathBuf::from);
        let missing = |cause: &dyn std::fmt::Display| {
            ModelError::runtime(NAME, format!("{} cannot be loaded ({cause})", library.display()), CURE)
        };
        let mut kept = ENVIRONMENT.lock().map_err(|cause| missing(&cause))?;
        let environment = match kept.as_ref() {
            Some(environment) => environment.clone(),
            None => {
                let builder = ort::init_from(&library).map_err(|cause| missing(&cause))?;
                let made = builder.with_telemetry(false).build().map_err(|cause| missing(&cause))?;
                kept.insert(made).clone()
            }
        };
        Ok(Self { environment, library })
    }
}

fn stopped(what: impl std::fmt::Display) -> ModelError {
    ModelError::runtime(NAME, format!("{RUN_FAILED}: {what}"), "`pgsag models verify` shows which bundle is broken")
}

impl Ort {
    fn builder(&self, options: &SessionOptions) -> Result<SessionBuilder, ModelError> {
        let mut builder = OrtSession::builder(&self.environment).map_err(stopped)?;
        if options.threads > 0 {
            builder = builder.with_intra_threads(options.threads).map_err(stopped)?;
        }
        match options.device {
            Device::Cpu => Ok(builder),
            Device::Cuda(number) => with_cuda(builder, number),
        }
    }
}

fn no_cuda(number: u32, why: impl std::fmt::Display) -> ModelError {
    let cure = "take the library of onnxruntime-gpu and build with `--features ort-cuda`, or --device cpu";
    ModelError::runtime(NAME, format!("cuda:{number} is not to be had ({why})"), cure)
}

#[cfg(feature = "ort-cuda")]
fn with_cuda(builder: SessionBuilder, number: u32) -> Result<SessionBuilder, ModelError> {
    let device = ort::ep::CUDA::default().with_device_id(number.cast_signed()).build().error_on_failure();
    builder.with_execution_providers([device]).map_err(|cause| no_cuda(number, cause))
}

#[cfg(not(feature = "ort-cuda"))]
fn with_cuda(_: SessionBuilder, number: u32) -> Result<SessionBuilder, ModelError> {
    Err(no_cuda(number, "not part of this build"))
}

impl Runtime for Ort {
    fn description(&self) -> String {
        format!("ONNX Runtime ({})", self.library.display())
    }

    fn load(&self, path: &Path, graph: Graph, options: &SessionOptions) -> Result<Box<dyn Session>, ModelError> {
        let mut builder = self.builder(options)?;
        let session = builder.commit_from_file(path).map_err(|cause| {
            let what = format!("ONNX Runtime cannot load it ({cause})");
            ModelError::refused(path, what, "export it with tools/export_models.py")
        })?;
        Ok(Box::new(Loaded { graph, session: Mutex::new(session) }))
    }
}

struct Loaded {
    graph: Graph,
    session: Mutex<OrtSession>,
}

impl Session for Loaded {
    fn graph(&self) -> &Graph {
        &self.graph
    }

    fn run(&self, inputs: &[(&str, &Tensor)], outputs: &[&str]) -> Result<Vec<Tensor>, ModelError> {
        let inputs = inputs
            .iter()
            .map(|(name, tensor)| Ok(((*name).to_owned(), value_of(tensor)?)))
            .collect::<Result<Vec<(String, SessionInputValue<'_>)>, ModelError>>()?;
        let mut session = self.session.lock().map_err(stopped)?;
        let found = session.run(inputs).map_err(stopped)?;
        let output = |name: &&str| {
            let value = found.get(*name).ok_or_else(|| stopped(format!("no output `{name}`")))?;
            tensor_of(value)
        };
        outputs.iter().map(output).collect()
    }
}

fn value_of(tensor: &Tensor) -> Result<SessionInputValue<'static>, ModelError> {
    let shape = tensor.shape.clone();
    Ok(match &tensor.values {
        Values::F32(values) => OrtTensor::from_array((shape, values.clone())).map_err(stopped)?.into(),
        Values::I64(values) => OrtTensor::from_array((shape, values.clone())).map_err(stopped)?.into(),
        Values::Bool(values) => OrtTensor::from_array((shape, values.clone())).map_err(stopped)?.into(),
    })
}

fn tensor_of(value: &DynValue) -> Result<Tensor, ModelError> {
    let sizes = |shape: &ort::value::Shape| shape.iter().map(|&size| size.max(0) as usize).collect::<Vec<_>>();
    if let Ok((shape, values)) = value.try_extract_tensor::<f32>() {
        return Ok(Tensor::floats(&sizes(shape), values.to_vec()));
    }
    let (shape, values) = value.try_extract_tensor::<i64>().map_err(stopped)?;
    Ok(Tensor::integers(&sizes(shape), values.to_vec()))
}
