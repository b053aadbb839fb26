//! The runtime `rten`: pure Rust, on the CPU. Its integers have 32 bits and its truth values are integers.
//!
//! One computation of a graph at a time: it takes all threads anyway, and memory stays that of one.

use std::path::Path;
use std::sync::{Arc, Mutex};

use rten::{ModelOptions, NodeId, RunOptions, ThreadPool, Value, ValueOrView};
use rten_tensor::Tensor as RtenTensor;
use rten_tensor::prelude::*;

use super::{Device, Runtime, Session, SessionOptions};
use crate::error::{ModelError, RUN_FAILED};
use crate::onnx::Graph;
use crate::tensor::{Tensor, Values};

const NAME: &str = "rten";

/// The runtime.
pub(super) struct Rten;

impl Runtime for Rten {
    fn description(&self) -> String {
        "rten 0.27 (pure Rust, CPU)".into()
    }

    fn load(&self, path: &Path, graph: Graph, options: &SessionOptions) -> Result<Box<dyn Session>, ModelError> {
        if options.device != Device::Cpu {
            return Err(ModelError::runtime(NAME, "runs on the CPU only", "choose --runtime ort for a graphics card"));
        }
        let refused = |what: &dyn std::fmt::Display| {
            let what = format!("rten cannot load it ({what})");
            ModelError::refused(path, what, "export it with tools/export_models.py, or choose --runtime ort")
        };
        let load = || ModelOptions::with_all_ops().load_file(path);
        let model = apart(load).ok_or_else(|| refused(&"it panicked"))?.map_err(|error| refused(&error))?;
        let pool = (options.threads > 0).then(|| Arc::new(ThreadPool::with_num_threads(options.threads)));
        Ok(Box::new(Loaded { graph, model, pool, turn: Mutex::new(()) }))
    }
}

struct Loaded {
    graph: Graph,
    model: rten::Model,
    pool: Option<Arc<ThreadPool>>,
    turn: Mutex<()>,
}

/// On a thread of its own; `None` where it panics. A worker of another pool that waits for rten's would begin more work
/// meanwhile, one photograph within the other.
fn apart<T: Send>(work: impl FnOnce() -> T + Send) -> Option<T> {
    std::thread::scope(|scope| scope.spawn(work).join()).ok()
}

fn stopped(what: impl std::fmt::Display) -> ModelError {
    ModelError::runtime(NAME, format!("{RUN_FAILED}: {what}"), "`pgsag models verify` shows which bundle is broken")
}

impl Loaded {
    fn node(&self, name: &str) -> Result<NodeId, ModelError> {
        self.model.node_id(name).map_err(stopped)
    }
}

impl Session for Loaded {
    fn graph(&self) -> &Graph {
        &self.graph
    }

    fn run(&self, inputs: &[(&str, &Tensor)], outputs: &[&str]) -> Result<Vec<Tensor>, ModelError> {
        let inputs = inputs
            .iter()
            .map(|(name, tensor)| Ok((self.node(name)?, value_of(tensor)?)))
            .collect::<Result<Vec<_>, ModelError>>()?;
        let outputs = outputs.iter().map(|name| self.node(name)).collect::<Result<Vec<_>, _>>()?;
        let mut options = RunOptions::default();
        options.thread_pool.clone_from(&self.pool);
        let _turn = self.turn.lock().map_err(stopped)?;
        let run = || self.model.run(inputs, &outputs, Some(options));
        let values = apart(run).ok_or_else(|| stopped("it panicked"))?.map_err(stopped)?;
        values.into_iter().map(tensor_of).collect()
    }
}

fn value_of(tensor: &Tensor) -> Result<ValueOrView<'_>, ModelError> {
    let narrow = |value: i64| i32::try_from(value).map_err(stopped);
    let shape = tensor.shape.as_slice();
    Ok(match &tensor.values {
        Values::F32(values) => rten::ValueView::from_shape(shape, values).map_err(stopped)?.into(),
        Values::I64(values) => {
            let values = values.iter().map(|&value| narrow(value)).collect::<Result<Vec<i32>, _>>()?;
            Value::from(RtenTensor::from_data(shape, values)).into()
        }
        Values::Bool(values) => {
            let values: Vec<i32> = values.iter().map(|&value| i32::from(value)).collect();
            Value::from(RtenTensor::from_data(shape, values)).into()
        }
    })
}

fn tensor_of(value: Value) -> Result<Tensor, ModelError> {
    let shape = value.shape().to_vec();
    match value {
        Value::FloatTensor(tensor) => Ok(Tensor::floats(&shape, tensor.into_data())),
        Value::Int32Tensor(tensor) => {
            Ok(Tensor::integers(&shape, tensor.into_data().into_iter().map(i64::from).collect()))
        }
        other => Err(stopped(format!("an output of type {}", other.dtype()))),
    }
}
