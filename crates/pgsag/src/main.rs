//! The product: parse, plan, execute.

fn main() {}
