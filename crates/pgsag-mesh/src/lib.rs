//! Depth maps to surface to score: the paper's sections 4.4 and 5.
//!
//! `fuse` checks depth maps against one another, `tsdf` averages them into a sparse volume, `marching` takes the
//! surface out of it, `merge`, `components`, `gaps`, `holes` and `settle` make one tidy mesh of the
//! cubes, `score` judges it, `render` draws it.
//! Everything is in scene units; nothing here knows metres, paths or a run.

pub mod components;
pub mod error;
pub mod evidence;
pub mod fuse;
pub mod gaps;
pub mod holes;
pub mod identity;
pub mod marching;
pub mod merge;
pub mod render;
pub mod score;
pub mod seams;
pub mod settle;
pub mod tsdf;

pub use error::MeshError;
pub use fuse::{DepthMap, DepthView};
pub use tsdf::{CellBox, Lattice, TsdfOptions, Volume};
