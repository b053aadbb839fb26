//! The terms of Eq. 10-11, one file each: value and gradient with respect to the rendered maps.
//!
//! Generic over the scalar, so that the f64 reference and the f32 backend call the same functions. Maps are row-major
//! slices of `[height * width]`, one per channel; kernels take a vector's worth of pixels at a time
//! ([`crate::equations::number::Pixels`]). Sums run in row order whatever the number of threads; values are summed in f64.
//! [`total::evaluate`] is the front door: it combines the terms and costs nothing for those without weight.

pub mod boundary_normal;
pub mod flatness;
pub mod free_opacity;
pub mod geometric;
pub mod image_gradient;
pub mod load_balance;
pub mod ncc;
pub mod photometric;
mod rows;
pub mod spare;
pub mod total;
pub mod view;

#[cfg(test)]
pub(crate) mod tests;

pub use total::{Evaluation, Inputs, MapGradients, RenderedMaps, evaluate, evaluate_into};
pub use view::LossView;
