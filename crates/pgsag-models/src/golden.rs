//! What Python wrote for the tests: `tests/golden/`, made by `make.py` there.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use crate::bundle::{Bundle, Engine};
use crate::runtime::{RuntimeKind, SessionOptions};

pub(crate) fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden")
}

pub(crate) fn read<T: DeserializeOwned>(name: &str) -> T {
    let text = std::fs::read_to_string(folder().join(name)).expect("a golden file");
    serde_json::from_str(&text).expect("golden JSON")
}

pub(crate) fn bundle(name: &str) -> Bundle {
    Bundle::open(&folder().join("bundles").join(name)).expect("a golden bundle")
}

/// `PGSAG_TEST_RUNTIME=ort` runs every test on the other runtime, where its library is installed.
pub(crate) fn engine() -> Engine {
    let kind = match std::env::var("PGSAG_TEST_RUNTIME").as_deref() {
        Ok("ort") => RuntimeKind::Ort,
        _ => RuntimeKind::Rten,
    };
    Engine::new(kind, SessionOptions { threads: 1, ..SessionOptions::default() }).expect("a runtime")
}
