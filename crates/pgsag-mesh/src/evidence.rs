//! How accurate a mesh is where there is no truth: four witnesses that do not depend on one another.
//!
//! `flow` asks two photographs whether the mesh carries one onto the other; `points` asks sparse points that the
//! reconstruction never saw; `halves` asks a second mesh, made of other photographs; `structure` asks the mesh itself how
//! flat its planes and how sharp its roof edges are. Signs are those of a score: positive = the mesh lies outside.

pub mod flow;
pub mod halves;
pub mod points;
mod spread;
pub mod structure;

pub use spread::{Spread, spread};
