//! The cloud on a card: parameters, moments and statistics as planes of one number per Gaussian.
//!
//! Planes are cut into four *bands*, one buffer each, so that no binding grows past what cards allow and harmonics that
//! are not stored cost nothing: 0 = mean 3, log scales 3, quaternion 4, logit 1, degree-0 colour 3; 1, 2, 3 = harmonics of
//! that degree, function by function, R G B. Number `i` of plane `p` lies at `p · N + i`.

use std::sync::Arc;

use bytemuck::Zeroable;
use pgsag_splat::SplatCloud;
use pgsag_splat::backend::{BackendError, DensityPlan, DensityStatistics, OptimizerState, Result};
use rayon::prelude::*;

use crate::adam::Pending;
use crate::device::Device;
use crate::memory::Buffer;
use crate::record::{Groups, Kernel};

/// Planes of each band.
pub(crate) const BANDS: [usize; 4] = [14, 9, 15, 21];
/// First harmonics function of each band.
const FIRST_FUNCTION: [usize; 4] = [0, 1, 4, 9];
/// Planes of `statistics`: gradient, absolute gradient, visible count, radius, observed count.
const STATISTICS: usize = 5;
/// Place of the opacity logit in band 0.
const OPACITY: usize = 10;

/// Everything of one kind (values, first moments, second moments), by band; bands beyond the degree hold nothing.
pub(crate) type Bands = [Buffer; 4];

/// Parameters, moments and statistics of a cloud, for [`crate::Gpu`].
pub struct GpuCloud {
    pub(crate) device: Arc<Device>,
    pub(crate) origin_world: [f64; 3],
    pub(crate) sh_degree: u8,
    pub(crate) count: usize,
    pub(crate) values: Arc<Bands>,
    pub(crate) first: Bands,
    pub(crate) second: Bands,
    /// [`STATISTICS`] planes of 4 bytes.
    pub(crate) statistics: Arc<Buffer>,
    /// One number, not 0 once a parameter is not finite.
    pub(crate) fault: Buffer,
    /// What `backward` left for `adam`.
    pub(crate) pending: Pending,
    /// Moments of harmonics beyond this degree are 0.
    pub(crate) moment_degree: u8,
}

impl std::fmt::Debug for GpuCloud {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GpuCloud")
            .field("count", &self.count)
            .field("sh_degree", &self.sh_degree)
            .finish_non_exhaustive()
    }
}

impl GpuCloud {
    /// Of a state; moments and statistics that are missing are 0.
    pub(crate) fn new(device: &Arc<Device>, state: &OptimizerState) -> Result<Self> {
        let count = state.cloud.len();
        let degree = state.cloud.sh_degree;
        let has_moments = state.first.len() == count;
        let moments = |cloud: &SplatCloud| match cloud.len() == count {
            true => uploaded(device, cloud),
            false => empty(device, degree, count),
        };
        Ok(Self {
            origin_world: state.cloud.origin_world,
            sh_degree: degree,
            count,
            values: Arc::new(uploaded(device, &state.cloud)?),
            first: moments(&state.first)?,
            second: moments(&state.second)?,
            statistics: Arc::new(device.buffer_with("statistics", &statistics_planes(&state.statistics, count))?),
            fault: device.buffer("flags", 4)?,
            pending: Pending::default(),
            moment_degree: if has_moments { degree } else { 0 },
            device: Arc::clone(device),
        })
    }

    /// Reads everything back.
    pub(crate) fn state(&self) -> Result<OptimizerState> {
        self.check_finite()?;
        Ok(OptimizerState {
            cloud: self.read(&self.values)?,
            first: self.read(&self.first)?,
            second: self.read(&self.second)?,
            statistics: self.statistics_now()?,
        })
    }

    /// Bands laid out as the parameters, as a cloud.
    pub(crate) fn read(&self, bands: &Bands) -> Result<SplatCloud> {
        let count = self.count;
        let mut cloud = SplatCloud {
            origin_world: self.origin_world,
            sh_degree: self.sh_degree,
            harmonics: vec![0.0; count * 3 * basis_count(self.sh_degree)],
            ..SplatCloud::default()
        };
        let width = 3 * basis_count(self.sh_degree);
        for (band, buffer) in bands.iter().enumerate().take(usize::from(self.sh_degree) + 1) {
            let planes: Vec<f32> = self.device.read(buffer, 0, count * BANDS[band])?;
            let at = |plane: usize, i: usize| planes[plane * count + i];
            if band == 0 {
                cloud.means = (0..count).into_par_iter().map(|i| [at(0, i), at(1, i), at(2, i)]).collect();
                cloud.log_scales = (0..count).into_par_iter().map(|i| [at(3, i), at(4, i), at(5, i)]).collect();
                cloud.rotations = (0..count).into_par_iter().map(|i| [6, 7, 8, 9].map(|p| at(p, i))).collect();
                cloud.opacity_logits = (0..count).into_par_iter().map(|i| at(OPACITY, i)).collect();
            }
            let (skipped, kept) = if band == 0 { (11, 3) } else { (0, BANDS[band]) };
            let first = 3 * FIRST_FUNCTION[band];
            cloud.harmonics.par_chunks_mut(width.max(1)).enumerate().for_each(|(i, row)| {
                for k in 0..kept {
                    row[first + k] = at(skipped + k, i);
                }
            });
        }
        Ok(cloud)
    }

    pub(crate) fn statistics_now(&self) -> Result<DensityStatistics> {
        let words: Vec<u32> = self.device.read(&self.statistics, 0, STATISTICS * self.count)?;
        let plane = |k: usize| &words[k * self.count..(k + 1) * self.count];
        let floats = |k: usize| plane(k).iter().map(|&bits| f32::from_bits(bits)).collect();
        Ok(DensityStatistics {
            gradient: floats(0),
            absolute_gradient: floats(1),
            visible_count: plane(2).to_vec(),
            radius_px: floats(3),
            observed_count: plane(4).to_vec(),
        })
    }

    pub(crate) fn reset_statistics(&mut self) {
        let mut record = self.device.record("reset statistics");
        record.clear(&self.statistics, (STATISTICS * self.count * 4) as u64);
        record.submit();
    }

    /// Whether all parameters are finite, as far as the steps that are done say.
    pub(crate) fn check_finite(&self) -> Result<()> {
        let fault: Vec<u32> = self.device.read(&self.fault, 0, 1)?;
        if fault == [0] { Ok(()) } else { Err(BackendError::NotFinite("a parameter after the Adam step")) }
    }

    /// Clone, split, prune. The moments of births are 0; statistics begin anew.
    pub(crate) fn reshape(&mut self, plan: &DensityPlan) -> Result<()> {
        let count = plan.keep.len() + plan.births.len();
        let parents: Vec<u32> = plan.keep.iter().copied().chain(plan.births.iter().map(|birth| birth.parent)).collect();
        if let Some(parent) = parents.iter().find(|&&parent| parent as usize >= self.count) {
            return Err(BackendError::Device(format!("there is no Gaussian {parent} among {}", self.count)));
        }
        self.pending = Pending::default();
        self.device.trim();
        let moves = Moves {
            parents: self.device.buffer_with("parents", &parents)?,
            births: self.device.buffer_with("births", &births(plan))?,
            counts: [self.count as u32, count as u32, plan.keep.len() as u32],
            ceiling: plan.opacity_ceiling,
        };
        self.values = Arc::new(self.moved(&self.values, &moves, false)?);
        self.first = self.moved(&self.first, &moves, true)?;
        self.second = self.moved(&self.second, &moves, true)?;
        self.statistics = Arc::new(self.device.buffer("statistics", (STATISTICS * count * 4) as u64)?);
        self.count = count;
        Ok(())
    }

    fn moved(&self, bands: &Bands, moves: &Moves, moments: bool) -> Result<Bands> {
        let [_, count, _] = moves.counts;
        let out = empty(&self.device, self.sh_degree, count as usize)?;
        let mut record = self.device.record("reshape");
        for (band, planes) in BANDS.iter().enumerate().take(usize::from(self.sh_degree) + 1) {
            let uniform = self.device.uniform(&moves.uniform(band, moments))?;
            let buffers = [&uniform, &moves.parents, &moves.births, &bands[band], &out[band]];
            record.run(&RESHAPE, &buffers, Groups::Count((*planes as u64 * u64::from(count)).div_ceil(256)));
        }
        record.submit();
        Ok(out)
    }
}

/// A density plan on the card.
struct Moves {
    parents: Buffer,
    births: Buffer,
    /// Gaussians before, after, kept.
    counts: [u32; 3],
    ceiling: Option<f32>,
}

/// `Reshape` in `reshape.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, Zeroable)]
struct ReshapeUniform {
    before: u32,
    after: u32,
    kept: u32,
    planes: u32,
    band: u32,
    moments: u32,
    has_ceiling: u32,
    ceiling: f32,
}

impl Moves {
    fn uniform(&self, band: usize, moments: bool) -> ReshapeUniform {
        let [before, after, kept] = self.counts;
        ReshapeUniform {
            before,
            after,
            kept,
            planes: BANDS[band] as u32,
            band: band as u32,
            moments: u32::from(moments),
            has_ceiling: u32::from(self.ceiling.is_some()),
            ceiling: self.ceiling.map_or(0.0, ceiling_logit),
        }
    }
}

/// Opacity logit that a ceiling on opacity allows.
fn ceiling_logit(opacity: f32) -> f32 {
    let opacity = f64::from(opacity).clamp(1e-6, 1.0 - 1e-6);
    libm::log(opacity / (1.0 - opacity)) as f32
}

/// Six numbers per birth: offset, shift, whether there is a logit, the logit.
fn births(plan: &DensityPlan) -> Vec<[f32; 6]> {
    let row = |birth: &pgsag_splat::backend::Birth| {
        let [x, y, z] = birth.offset;
        let has_logit = f32::from(u8::from(birth.opacity_logit.is_some()));
        [x, y, z, birth.log_scale_shift, has_logit, birth.opacity_logit.unwrap_or_default()]
    };
    plan.births.iter().map(row).collect()
}

/// Functions of a degree.
fn basis_count(degree: u8) -> usize {
    (usize::from(degree) + 1).pow(2)
}

/// Buffers of zeros for `count` Gaussians.
pub(crate) fn empty(device: &Device, degree: u8, count: usize) -> Result<Bands> {
    let band = |b: usize| {
        device.buffer("parameters", if b <= usize::from(degree) { 4 * (BANDS[b] * count) as u64 } else { 0 })
    };
    Ok([band(0)?, band(1)?, band(2)?, band(3)?])
}

fn uploaded(device: &Device, cloud: &SplatCloud) -> Result<Bands> {
    let bands = empty(device, cloud.sh_degree, cloud.len())?;
    let count = cloud.len();
    let width = 3 * cloud.basis_count();
    for (band, buffer) in bands.iter().enumerate().take(usize::from(cloud.sh_degree) + 1) {
        let mut planes = vec![0.0f32; BANDS[band] * count];
        planes.par_chunks_mut(count.max(1)).enumerate().for_each(|(plane, out)| {
            for (i, out) in out.iter_mut().enumerate() {
                *out = match (band, plane) {
                    (0, 0..3) => cloud.means[i][plane],
                    (0, 3..6) => cloud.log_scales[i][plane - 3],
                    (0, 6..10) => cloud.rotations[i][plane - 6],
                    (0, OPACITY) => cloud.opacity_logits[i],
                    (0, _) => cloud.harmonics[i * width + plane - 11],
                    _ => cloud.harmonics[i * width + 3 * FIRST_FUNCTION[band] + plane],
                };
            }
        });
        device.write(buffer, 0, &planes);
    }
    Ok(bands)
}

/// As [`GpuCloud::statistics`] holds them; lists of another length count as empty.
fn statistics_planes(statistics: &DensityStatistics, count: usize) -> Vec<u32> {
    if statistics.gradient.len() != count {
        return vec![0; STATISTICS * count];
    }
    let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<u32>>();
    [
        bits(&statistics.gradient),
        bits(&statistics.absolute_gradient),
        statistics.visible_count.clone(),
        bits(&statistics.radius_px),
        statistics.observed_count.clone(),
    ]
    .concat()
}

const RESHAPE: Kernel = Kernel { name: "reshape", parts: &[include_str!("../shaders/reshape.wgsl")], adds: &[] };

/// Kernels of this room.
#[cfg(test)]
pub(crate) const KERNELS: &[&Kernel] = &[&RESHAPE];
