//! The terms of Eq. 10-11 on the card: values, and gradients of the rendered maps.

use pgsag_splat::backend::{BackendError, LossValues, Result, Sample, TrainingView};

use crate::cloud::GpuCloud;
use crate::device::Device;
use crate::gpu::Gpu;
use crate::memory::Buffer;
use crate::record::Kernel;

/// What the losses derive of a view.
#[derive(Debug)]
pub(crate) struct View {
    active_count: usize,
    pixel_count: usize,
}

impl View {
    /// Over how many pixels the photometric and normal terms average, at least 1.
    pub(crate) fn mean_count(&self, mean_over_mask: bool) -> usize {
        if mean_over_mask { self.active_count.max(1) } else { self.pixel_count.max(1) }
    }
}

/// Derives weights of a view whose `pixels` are on the card.
pub(crate) fn prepare(_device: &Device, _pixels: &Buffer, view: &TrainingView) -> Result<View> {
    let pixel_count = view.image.pixels.len();
    let active_count = view.mask.as_ref().map_or(pixel_count, pgsag_scene::Mask::active_count);
    Ok(View { active_count, pixel_count })
}

/// Values of all terms with weight; adds the gradients of the total to the sample's renders.
pub(crate) fn evaluate(_gpu: &Gpu, _cloud: &GpuCloud, _sample: &mut Sample<'_, Gpu>) -> Result<LossValues> {
    Err(BackendError::Device("losses are not computed on this device".into()))
}

/// Kernels of this room.
pub(crate) const KERNELS: &[&Kernel] = &[];
