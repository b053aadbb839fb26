//! Planar Gaussians that learn: the paper's sections 3, 4.2 and 4.3.
//!
//! `lanes`, `equations`, `losses`, `cloud` < `backend` < `train` | `cpu` | `reference` < `conformance`.
//! The narrow waist is `backend.rs`: a device renders, differentiates and steps; the host decides.

pub mod backend;
pub mod cloud;
pub mod conformance;
pub mod cpu;
pub mod equations;
pub(crate) mod lanes;
pub mod losses;
#[cfg(test)]
pub(crate) mod proof;
pub mod reference;
pub mod stereo;
pub mod train;

pub use backend::Backend;
pub use cloud::SplatCloud;
