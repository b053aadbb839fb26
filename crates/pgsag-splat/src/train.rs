//! When to do what: schedules, density control, neighbours, checkpoints. Names no backend.
//!
//! The host decides, the device computes: everything here is generic over [`crate::Backend`] and reads only what the
//! waist hands back. All choices are functions of (seed, iteration, index), so a resumed run repeats them.

use crate::backend::BackendError;

pub mod checkpoint;
pub mod density;
pub mod depth;
mod exposure;
pub mod footprint;
pub mod initialise;
pub mod metrics;
pub mod neighbors;
mod plateau;
mod prefetch;
pub mod schedule;
pub mod trainer;
mod view_cache;

pub use checkpoint::Checkpoint;
pub use density::DensityOptions;
pub use depth::{DepthOptions, DepthWithWeight, render_depth, valid_depth};
pub use initialise::{InitialPoint, InitialiseOptions, initialise};
pub use metrics::{ImageMetrics, evaluate_view, image_metrics};
pub use neighbors::{Neighbor, NeighborOptions, neighbors_of};
pub use schedule::{RateOptions, TrainOptions};
pub use trainer::{Progress, Trainer, ViewSource};

/// What training can fail at.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The device failed.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// A loss or parameter stopped being finite.
    #[error(
        "training diverged: {what} is not finite at iteration {iteration}, view {view}; \
         check that view's camera and image, or lower the rates"
    )]
    NotFinite {
        /// Iteration in progress, from 1.
        iteration: u32,
        /// Index of the reference view.
        view: usize,
        /// Which value.
        what: String,
    },
    /// A view could not be brought; the source says why.
    #[error("view {view}: {source}")]
    View {
        /// Index of the view.
        view: usize,
        /// What the source of the views says: the file's name and the cure.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// Nothing to train on or with.
    #[error("nothing to train: {0}")]
    Empty(&'static str),
    /// Options contradict each other or the inputs.
    #[error("{0}")]
    Options(String),
    /// Bytes are not an undamaged checkpoint of this version.
    #[error("checkpoint: {0}")]
    Checkpoint(String),
}

/// Shorthand of training's results.
pub type Result<T> = std::result::Result<T, TrainError>;

/// A stream of its own for every (seed, iteration, index): choices do not depend on what was drawn before.
pub(crate) fn stream(seed: u64, iteration: u32, index: u64) -> pgsag_scene::numbers::SplitMix64 {
    let mut mix = pgsag_scene::numbers::SplitMix64::new(seed ^ (u64::from(iteration) << 32));
    let salted = mix.next_u64() ^ index.wrapping_mul(0xD1B5_4A32_D192_ED03);
    pgsag_scene::numbers::SplitMix64::new(pgsag_scene::numbers::SplitMix64::new(salted).next_u64())
}
