//! One equation, its gradient, its proof; generic over the number.
//!
//! Every function is straight-line over [`number::Number`] (`select` in place of `if`), allocates nothing and knows no
//! buffer, so one source serves f64, f32 and SIMD lanes. A `_grad` function takes `d_<output>`, the gradient of a
//! scalar loss with respect to the output, and returns the gradients of the inputs.
//! Frames: group = world axes about the cloud's origin; camera = x right, y down, z forward; screen = pixels, the
//! centre of pixel `i` is `i + 0.5`. Angles and lengths: radians, scene units.

pub mod activation;
pub mod adam;
pub mod algebra;
pub mod blend;
pub mod covariance;
pub mod harmonics;
pub mod number;
pub mod plane;
pub mod projection;

#[cfg(test)]
mod tests;

pub use number::{Number, Scalar};
