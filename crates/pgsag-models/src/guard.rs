//! Graphs that would load and then compute something else than they say. Looked for before any runtime sees them.

use std::collections::BTreeMap;
use std::path::Path;

use crate::error::ModelError;
use crate::onnx::{Graph, Node};
use crate::runtime::RuntimeKind;
use crate::tensor::Element;

/// ONNX's `GridSample` came with this version of its operators.
const OPSET_OF_GRID_SAMPLE: u64 = 16;

/// Refuses a graph that `runtime` is known to compute wrongly.
///
/// # Errors
/// [`ModelError::Refused`] with what was found and the cure.
pub fn check(path: &Path, graph: &Graph, runtime: RuntimeKind) -> Result<(), ModelError> {
    let refused = |what: String, cure: &str| Err(ModelError::refused(path, what, cure));
    if let Some(node) = graph.nodes.iter().find(|node| is_foreign(node)) {
        let (name, domain) = (&node.operator, &node.domain);
        return refused(
            format!("unknown operator `{domain}.{name}`"),
            "export with ONNX's own operators (tools/export_models.py)",
        );
    }
    if runtime == RuntimeKind::Rten
        && let Some(node) = graph.nodes.iter().find(|node| is_cubic(node))
    {
        // rten 0.27 computes it as linear and says nothing.
        let what = format!("`{}` resizes with mode cubic, which the runtime rten computes as linear", node_name(node));
        return refused(what, "export with tools/export_models.py, which folds it away, or choose --runtime ort");
    }
    let sampled = graph.nodes.iter().find(|node| node.operator == "GridSample");
    if let Some(node) = sampled {
        if graph.opset < OPSET_OF_GRID_SAMPLE {
            let what = format!("GridSample needs opset {OPSET_OF_GRID_SAMPLE}, this is opset {}", graph.opset);
            return refused(what, "export again with a newer opset");
        }
        let is_double = |name: &String| graph.elements.get(name) == Some(&Element::F64);
        if node.inputs.iter().any(is_double) {
            let what = format!("`{}` samples in 64 bits, which no runtime can", node_name(node));
            return refused(what, "export again with tools/export_models.py");
        }
    }
    external_files_stay_beside(path, graph)
}

/// Weights outside of the bundle's folder are not read.
fn external_files_stay_beside(path: &Path, graph: &Graph) -> Result<(), ModelError> {
    let folder = path.parent().unwrap_or(Path::new(""));
    for name in &graph.external_files {
        let is_plain = Path::new(name).components().all(|part| matches!(part, std::path::Component::Normal(_)));
        if !is_plain {
            return Err(ModelError::refused(
                path,
                format!("weights in `{name}`, outside of its folder"),
                "export it again",
            ));
        }
        if !folder.join(name).is_file() {
            let what = format!("its weights are in `{name}`, which is not beside it");
            return Err(ModelError::refused(path, what, "copy that file next to it"));
        }
    }
    Ok(())
}

fn is_cubic(node: &Node) -> bool {
    let mode = node.texts.get("mode").map_or("", String::as_str);
    (node.operator == "Resize" || node.operator == "Upsample") && mode == "cubic"
}

/// Operators of neither ONNX nor the runtimes' shared extension.
fn is_foreign(node: &Node) -> bool {
    !matches!(node.domain.as_str(), "" | "ai.onnx" | "com.microsoft")
}

fn node_name(node: &Node) -> &str {
    if node.name.is_empty() { &node.operator } else { &node.name }
}

/// Refuses a graph whose image input has another fixed size than `width` x `height`.
///
/// # Errors
/// [`ModelError::Refused`] with both sizes.
pub fn check_size(path: &Path, graph: &Graph, input: &str, width: usize, height: usize) -> Result<(), ModelError> {
    let Some(info) = graph.input(input) else { return Ok(()) };
    let differs =
        |place: usize, wanted: usize| info.shape.len() == 4 && info.shape[place].is_some_and(|fixed| fixed != wanted);
    if differs(2, height) || differs(3, width) {
        let what = format!("made for another size: {info}, the manifest says {width} x {height}");
        return Err(ModelError::refused(path, what, "set `size` in manifest.toml to the graph's, or export it again"));
    }
    Ok(())
}

/// How often each operator occurs, for people.
#[must_use]
pub fn census(graph: &Graph) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for node in &graph.nodes {
        *counts.entry(node.operator.clone()).or_default() += 1;
    }
    counts
}

#[cfg(test)]
mod tests;
