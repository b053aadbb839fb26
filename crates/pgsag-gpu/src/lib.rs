//! The GPU wing: training on any graphics card, through wgpu and compute shaders in WGSL of our own.
//!
//! `device` (adapters, buffers, kernels) < `cloud`, `view`, `render` < `gpu` (the [`Backend`]).
//! What a step launches: `cull` and `shade` (cloud to records), `scan` and `sort` (lists of tiles, front to back),
//! `forward`, the losses, `backward`, `adam` (gradients are made where they are used). Results agree with the CPU's
//! within rounding, as `pgsag_splat::conformance` defines it; they are not the same bytes.
//!
//! [`Backend`]: pgsag_splat::Backend

mod adam;
mod backward;
mod cloud;
mod device;
mod gpu;
mod losses;
mod memory;
mod profile;
mod record;
mod render;
mod sort;
mod view;

pub use backward::Backward;
pub use cloud::GpuCloud;
pub use device::{Adapter, DeviceChoice, adapters};
pub use gpu::{Gpu, GpuOptions};
pub use profile::KernelTime;
pub use render::GpuRender;
pub use view::GpuView;

#[cfg(test)]
mod tests;
