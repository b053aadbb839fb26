//! The words every part of pgsag speaks, in f64 and without unsafe code.
//!
//! Frames: world = the scene's own (f64); camera = COLMAP axes (x right, y down, z forward).
//! Pixel `i` covers `[i, i + 1)` and its centre is `i + 0.5`, in every function of every crate.
//! Transforms are named by where they lead: `camera_from_world`.
//! No function here but those of `files` touches bytes, and none knows a path of a run.

pub mod camera;
pub mod error;
pub mod files;
pub mod frame;
pub mod image;
pub mod maps;
pub mod mask;
pub mod mesh;
pub mod numbers;
pub mod points;
pub mod pose;
pub mod scene;
pub mod synthetic;

pub use camera::Pinhole;
pub use error::FileError;
pub use frame::Frame;
pub use image::Image;
pub use maps::Map;
pub use mask::{Mask, PixelClass};
pub use mesh::Mesh;
pub use points::{SparsePoint, TrackElement};
pub use pose::RigidTransform;
pub use scene::{Scene, View};
