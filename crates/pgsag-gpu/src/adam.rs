//! One Adam step of everything; gradients of harmonics are made on the way and never stored.

use std::sync::Arc;

use bytemuck::Zeroable;
use pgsag_splat::SplatCloud;
use pgsag_splat::backend::{Rates, Result};
use pgsag_splat::equations::adam::corrections;
use pgsag_splat::equations::projection::Lens;

use crate::cloud::{Bands, GpuCloud, empty};
use crate::memory::Buffer;
use crate::record::{Groups, Kernel};
use crate::render::{Frame, Scene, leaves_color_out};

const SUMS: &str = include_str!("../shaders/sums.wgsl");
const HARMONICS: &str = include_str!("../shaders/harmonics.wgsl");

const ADAM: Kernel =
    Kernel { name: "adam", parts: &[HARMONICS, SUMS, include_str!("../shaders/adam.wgsl")], adds: &[] };

/// Kernels of this room.
#[cfg(test)]
pub(crate) const KERNELS: &[&Kernel] = &[&ADAM];

/// Gradients that wait for Adam: of the reference's render, and of the neighbour's where it has any.
#[derive(Default)]
pub(crate) struct Pending {
    pub(crate) renders: Vec<(Arc<Frame>, Scene)>,
}

/// `Step` in `adam.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, Zeroable)]
struct StepUniform {
    count: u32,
    sparse: u32,
    degree: u32,
    renders: u32,
    degrees: [i32; 2],
    corrections: [f32; 2],
    eyes: [[f32; 4]; 2],
    rates: [f32; 4],
    color_rates: [f32; 4],
}

impl Pending {
    /// The highest degree of harmonics with a gradient.
    fn degree(&self) -> u8 {
        let degrees = self.renders.iter().filter(|(_, scene)| !leaves_color_out(&scene.options));
        degrees.map(|(_, scene)| scene.options.sh_degree).max().unwrap_or_default()
    }

    fn uniform(&self, cloud: &GpuCloud) -> StepUniform {
        let of = |at: usize| self.renders.get(at).map(|(_, scene)| scene);
        let degree = |at: usize| match of(at) {
            Some(scene) if !leaves_color_out(&scene.options) => i32::from(scene.options.sh_degree),
            _ => -1,
        };
        let eye = |at: usize| {
            let [x, y, z] = of(at).map_or([0.0; 3], |scene| Lens::<f32>::new(&scene.camera).eye);
            [x, y, z, 0.0]
        };
        StepUniform {
            count: cloud.count as u32,
            renders: self.renders.len() as u32,
            degree: u32::from(cloud.moment_degree.max(self.degree())),
            degrees: [degree(0), degree(1)],
            eyes: [eye(0), eye(1)],
            ..StepUniform::zeroed()
        }
    }
}

/// One Adam step with the gradients of the last `backward`. Whether all parameters are finite is known to `losses`,
/// `download` and `statistics` afterwards.
pub(crate) fn step(cloud: &mut GpuCloud, rates: &Rates, step: u32) -> Result<()> {
    cloud.device.check()?;
    cloud.moment_degree = cloud.moment_degree.max(cloud.pending.degree());
    let uniform = StepUniform {
        sparse: u32::from(rates.sparse),
        corrections: corrections(step).map(|value| value as f32),
        rates: [rates.means, rates.scales, rates.rotations, rates.opacity],
        color_rates: [rates.color, rates.harmonics, 0.0, 0.0],
        ..cloud.pending.uniform(cloud)
    };
    launch(cloud, &uniform, 1, [&cloud.first, &cloud.second], &cloud.fault)
}

/// The gradients of the last `backward`.
pub(crate) fn gradients(cloud: &GpuCloud) -> Result<SplatCloud> {
    let out = empty(&cloud.device, cloud.sh_degree, cloud.count)?;
    let rest = [(); 4].map(|()| cloud.device.buffer("gradients", 0));
    let [a, b, c, d] = rest;
    let flags = cloud.device.buffer("flags", 4)?;
    let uniform = cloud.pending.uniform(cloud);
    launch(cloud, &uniform, 0, [&out, &[a?, b?, c?, d?]], &flags)?;
    cloud.read(&out)
}

fn launch(cloud: &GpuCloud, uniform: &StepUniform, step: u32, moments: [&Bands; 2], fault: &Buffer) -> Result<()> {
    let device = &cloud.device;
    let uniform = device.uniform(uniform)?;
    let nothing = device.buffer("gradients", 0)?;
    let of = |at: usize| cloud.pending.renders.get(at).map(|(frame, _)| frame);
    let mut bound: Vec<&Buffer> = vec![&uniform];
    bound.extend(cloud.values.iter());
    bound.extend(moments.into_iter().flatten());
    for at in 0..2 {
        bound.push(of(at).map_or(&nothing, |frame| &frame.shown));
        bound.push(of(at).map_or(&nothing, |frame| &frame.sums));
    }
    bound.push(fault);
    let mut record = device.record("adam");
    record.run_with(&ADAM, &[("STEP", step)], &bound, Groups::Count((cloud.count as u64).div_ceil(256)));
    record.submit();
    Ok(())
}
