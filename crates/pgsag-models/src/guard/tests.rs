use super::*;
use crate::golden;

fn graph(nodes: Vec<Node>) -> Graph {
    Graph { opset: 17, nodes, ..Graph::default() }
}

fn node(operator: &str) -> Node {
    Node { operator: operator.into(), ..Node::default() }
}

fn refusal(graph: &Graph) -> String {
    check(Path::new("x.onnx"), graph, RuntimeKind::Rten).expect_err("refused").to_string()
}

#[test]
fn a_cubic_resize_is_refused_by_rten_only() {
    let path = golden::folder().join("bundles/cubic-sam2/encoder.onnx");
    let cubic = Graph::open(&path).expect("a graph");
    let text = check(&path, &cubic, RuntimeKind::Rten).expect_err("cubic").to_string();
    assert!(text.contains("mode cubic") && text.contains("--runtime ort"), "{text}");
    check(&path, &cubic, RuntimeKind::Ort).expect("ONNX Runtime computes it");
    let mut linear = node("Resize");
    linear.texts.insert("mode".into(), "linear".into());
    check(Path::new("x.onnx"), &graph(vec![linear]), RuntimeKind::Rten).expect("linear is fine");
}

#[test]
fn foreign_operators_old_opsets_and_doubles_are_refused() {
    let foreign = Node { domain: "acme".into(), ..node("Magic") };
    assert!(refusal(&graph(vec![foreign])).contains("unknown operator `acme.Magic`"));
    let mut old = graph(vec![node("GridSample")]);
    old.opset = 15;
    assert!(refusal(&old).contains("needs opset 16"));
    let sampled = Node { inputs: vec!["grid".into()], ..node("GridSample") };
    let mut double = graph(vec![sampled]);
    double.elements.insert("grid".into(), Element::F64);
    assert!(refusal(&double).contains("64 bits"));
    assert!(
        refusal(&Graph { external_files: ["../w".into()].into(), ..Graph::default() })
            .contains("outside of its folder")
    );
    assert!(refusal(&Graph { external_files: ["w".into()].into(), ..Graph::default() }).contains("not beside it"));
}

#[test]
fn golden_graphs_are_read_whole() {
    let graph = Graph::open(&golden::folder().join("bundles/tiny-dino/detector.onnx")).expect("a graph");
    assert_eq!(graph.opset, 17);
    let names: Vec<&str> = graph.inputs.iter().map(|info| info.name.as_str()).collect();
    assert_eq!(names, ["pixel_values", "input_ids", "token_type_ids", "attention_mask", "pixel_mask"]);
    assert_eq!(graph.inputs[0].shape, [None, Some(3), None, None]);
    assert_eq!(graph.inputs[1].element, Element::I64);
    let census = census(&graph);
    assert_eq!(census["GridSample"], 16, "{census:?}");
}
