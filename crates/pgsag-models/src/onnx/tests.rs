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
