use std::io::Cursor;

use super::*;
use crate::golden;

fn read(bytes: &[u8]) -> Result<Graph, String> {
    Graph::read(&mut Cursor::new(bytes), bytes.len() as u64)
}

#[test]
fn every_shortening_of_a_file_is_an_error_and_none_a_panic() {
    let bytes = std::fs::read(golden::folder().join("bundles/tiny-sam2/decoder.onnx")).expect("there");
    let whole = read(&bytes).expect("a graph");
    assert!(!whole.nodes.is_empty());
    for end in (0..bytes.len()).step_by(977) {
        assert!(read(&bytes[..end]).is_err(), "{end} of {} bytes", bytes.len());
    }
    for at in (0..bytes.len()).step_by(1013) {
        let mut changed = bytes.clone();
        changed[at] ^= 0x85;
        let _ = read(&changed);
    }
}

#[test]
fn lengths_are_not_believed() {
    let huge = [0x3a, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f];
    assert!(read(&huge).expect_err("too long").contains("does not fit"));
    assert!(read(b"").expect_err("empty").contains("no graph"));
    assert!(read(b"not an onnx file at all").is_err());
}

/// A field of a message: its number and its bytes.
fn field(number: u8, content: &[u8]) -> Vec<u8> {
    [&[number << 3 | 2, u8::try_from(content.len()).expect("short")], content].concat()
}

#[test]
fn weights_and_operators_inside_of_branches_are_seen() {
    let place = [field(1, b"location"), field(2, b"../secret")].concat();
    let attribute = [field(1, b"value"), field(5, &field(13, &place))].concat();
    let constant = [field(4, b"Constant"), field(5, &attribute)].concat();
    let branch = [field(1, b"then_branch"), field(6, &field(1, &constant))].concat();
    let choice = [field(4, b"If"), field(5, &branch)].concat();
    let output = field(12, &[field(1, b"y"), field(2, &field(1, &[]))].concat());
    let graph = read(&field(7, &[field(1, &choice), output].concat())).expect("a graph");
    assert_eq!(graph.external_files, ["../secret".to_owned()].into());
    assert_eq!(graph.nodes.iter().map(|node| node.operator.as_str()).collect::<Vec<_>>(), ["Constant", "If"]);
}
