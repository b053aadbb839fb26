//! The developer's one command: `cargo x`.

fn main() {}
