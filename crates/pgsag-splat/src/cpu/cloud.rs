//! The cloud on this device: parameters and Adam moments in groups of 16 Gaussians.
//!
//! A group is one line (16 lanes) per parameter, the parameters one after another: means 3, log scales 3,
//! quaternion 4, logit 1, then harmonics, basis-major, R G B. A group is contiguous, so that sweeps over everything
//! stream, and vectors of Gaussians load without shuffles. The last group is padded with zeros.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use fearless_simd::Level;
use rayon::prelude::*;

use crate::{
    backend::{DensityPlan, DensityStatistics, OptimizerState},
    cloud::SplatCloud,
};

use super::{
    bounds,
    gradient::Pending,
    lanes::{LANES, Line},
};

/// Places of parameters in a group.
pub(crate) mod plane {
    /// x y z
    pub(crate) const MEAN: usize = 0;
    /// Three.
    pub(crate) const LOG_SCALE: usize = 3;
    /// w x y z
    pub(crate) const ROTATION: usize = 6;
    /// One.
    pub(crate) const OPACITY: usize = 10;
    /// 3 K
    pub(crate) const HARMONICS: usize = 11;
}

/// Parameters, moments and statistics of a cloud, for [`super::Cpu`].
#[derive(Debug)]
pub struct CpuCloud {
    pub(crate) origin_world: [f64; 3],
    pub(crate) sh_degree: u8,
    pub(crate) count: usize,
    /// Lines per group.
    pub(crate) planes: usize,
    pub(crate) values: Vec<Line>,
    pub(crate) first: Vec<Line>,
    pub(crate) second: Vec<Line>,
    /// What `backward` left for Adam.
    pub(crate) pending: Pending,
    /// Per group, one bit for each Gaussian that covers a pixel; the others have no gradient.
    pub(crate) touched: Vec<u16>,
    /// Per group, whether some moment is not 0; where none is, a step without a gradient changes nothing.
    pub(crate) moving: Vec<bool>,
    /// Boxes about the groups: `bounds`.
    pub(crate) boxes: Vec<Line>,
    /// Moments of planes from here on are 0.
    pub(crate) moment_planes: usize,
    /// All but `observed_count`, which is empty here.
    pub(crate) statistics: DensityStatistics,
    /// `observed_count`: rendering counts it, and only borrows the cloud. One thread adds to one Gaussian once.
    pub(crate) observed: Vec<AtomicU32>,
}

impl CpuCloud {
    /// Of a state; moments and statistics that are missing are 0.
    pub(crate) fn new(level: Level, state: &OptimizerState) -> Self {
        let cloud = &state.cloud;
        let planes = plane::HARMONICS + 3 * cloud.basis_count();
        let lines = cloud.len().div_ceil(LANES) * planes;
        let (first, second) = (to_lines(&state.first, planes, lines), to_lines(&state.second, planes, lines));
        let moment_planes = if state.first.is_empty() { plane::HARMONICS + 3 } else { planes };
        let mut statistics = state.statistics.clone();
        resize(&mut statistics, cloud.len());
        let observed = std::mem::take(&mut statistics.observed_count).into_iter().map(AtomicU32::new).collect();
        let values = to_lines(cloud, planes, lines);
        Self {
            origin_world: cloud.origin_world,
            sh_degree: cloud.sh_degree,
            count: cloud.len(),
            planes,
            moving: moving(&first, &second, planes),
            boxes: bounds::boxes(level, &values, planes),
            values,
            first,
            second,
            touched: vec![0; cloud.len().div_ceil(LANES)],
            pending: Pending::default(),
            moment_planes,
            statistics,
            observed,
        }
    }

    /// Reads everything back.
    pub(crate) fn state(&self) -> OptimizerState {
        OptimizerState {
            cloud: self.to_cloud(&self.values),
            first: self.to_cloud(&self.first),
            second: self.to_cloud(&self.second),
            statistics: self.statistics_now(),
        }
    }

    /// The statistics, `observed_count` included.
    pub(crate) fn statistics_now(&self) -> DensityStatistics {
        let observed_count = self.observed.iter().map(|count| count.load(Relaxed)).collect();
        DensityStatistics { observed_count, ..self.statistics.clone() }
    }

    /// Begins the statistics anew.
    pub(crate) fn reset_statistics(&mut self) {
        self.statistics = DensityStatistics::default();
        resize(&mut self.statistics, self.count);
        self.statistics.observed_count = Vec::new();
        self.observed = (0..self.count).map(|_| AtomicU32::new(0)).collect();
    }

    /// Lines laid out as the parameters, as a cloud.
    pub(crate) fn to_cloud(&self, lines: &[Line]) -> SplatCloud {
        let at = |i: usize, plane: usize| lines[i / LANES * self.planes + plane].0[i % LANES];
        let rows = (0..self.count).into_par_iter();
        let width = self.planes - plane::HARMONICS;
        let mut harmonics = vec![0.0; self.count * width];
        harmonics.par_chunks_mut(LANES * width).enumerate().for_each(|(group, out)| {
            for p in 0..width {
                let line = &lines[group * self.planes + plane::HARMONICS + p];
                out.iter_mut().skip(p).step_by(width).zip(line.0).for_each(|(to, from)| *to = from);
            }
        });
        SplatCloud {
            origin_world: self.origin_world,
            sh_degree: self.sh_degree,
            means: rows.clone().map(|i| std::array::from_fn(|k| at(i, plane::MEAN + k))).collect(),
            log_scales: rows.clone().map(|i| std::array::from_fn(|k| at(i, plane::LOG_SCALE + k))).collect(),
            rotations: rows.clone().map(|i| std::array::from_fn(|k| at(i, plane::ROTATION + k))).collect(),
            opacity_logits: rows.map(|i| at(i, plane::OPACITY)).collect(),
            harmonics,
        }
    }

    /// Clone, split, prune. The moments of births are 0; statistics begin anew.
    pub(crate) fn reshape(&mut self, level: Level, plan: &DensityPlan) {
        let count = plan.keep.len() + plan.births.len();
        let parents: Vec<u32> = plan.keep.iter().copied().chain(plan.births.iter().map(|birth| birth.parent)).collect();
        self.values = self.gathered(&self.values, &parents);
        self.first = self.gathered(&self.first, &plan.keep);
        self.second = self.gathered(&self.second, &plan.keep);
        let groups = count.div_ceil(LANES);
        self.first.resize(groups * self.planes, Line::ZERO);
        self.second.resize(groups * self.planes, Line::ZERO);
        self.pending.clear();
        self.touched = vec![0; groups];
        self.count = count;
        for (i, birth) in plan.births.iter().enumerate() {
            let (group, lane) = ((plan.keep.len() + i) / LANES, (plan.keep.len() + i) % LANES);
            let lines = &mut self.values[group * self.planes..(group + 1) * self.planes];
            for axis in 0..3 {
                lines[plane::MEAN + axis].0[lane] += birth.offset[axis];
                lines[plane::LOG_SCALE + axis].0[lane] += birth.log_scale_shift;
            }
            if let Some(logit) = birth.opacity_logit {
                lines[plane::OPACITY].0[lane] = logit;
            }
        }
        if let Some(ceiling) = plan.opacity_ceiling {
            self.lower_opacities(ceiling);
        }
        self.moving = moving(&self.first, &self.second, self.planes);
        self.boxes = bounds::boxes(level, &self.values, self.planes);
        self.reset_statistics();
    }

    fn gathered(&self, lines: &[Line], from: &[u32]) -> Vec<Line> {
        let mut out = vec![Line::ZERO; from.len().div_ceil(LANES) * self.planes];
        out.par_chunks_exact_mut(self.planes).zip(from.par_chunks(LANES)).for_each(|(group, parents)| {
            for (lane, &parent) in parents.iter().enumerate() {
                let source = &lines[parent as usize / LANES * self.planes..][..self.planes];
                for (to, from) in group.iter_mut().zip(source) {
                    to.0[lane] = from.0[parent as usize % LANES];
                }
            }
        });
        out
    }

    fn lower_opacities(&mut self, ceiling: f32) {
        let ceiling = f64::from(ceiling);
        let logit = libm::log(ceiling / (1.0 - ceiling)) as f32;
        for group in 0..self.touched.len() {
            let at = group * self.planes + plane::OPACITY;
            self.first[at] = Line::ZERO;
            self.second[at] = Line::ZERO;
            for (lane, value) in self.values[at].0.iter_mut().enumerate() {
                if group * LANES + lane < self.count {
                    *value = value.min(logit);
                }
            }
        }
    }
}

/// Per group of `planes` lines, whether some moment is not 0.
fn moving(first: &[Line], second: &[Line], planes: usize) -> Vec<bool> {
    let any = |lines: &[Line]| lines.iter().any(|line| *line != Line::ZERO);
    first.par_chunks_exact(planes).zip(second.par_chunks_exact(planes)).map(|(a, b)| any(a) || any(b)).collect()
}

/// Makes every list as long as the cloud; what is new is 0.
fn resize(statistics: &mut DensityStatistics, count: usize) {
    statistics.gradient.resize(count, 0.0);
    statistics.absolute_gradient.resize(count, 0.0);
    statistics.visible_count.resize(count, 0);
    statistics.radius_px.resize(count, 0.0);
    statistics.observed_count.resize(count, 0);
}

/// Lays a cloud (or nothing) out in `lines` lines.
fn to_lines(cloud: &SplatCloud, planes: usize, lines: usize) -> Vec<Line> {
    let mut out = vec![Line::ZERO; lines];
    for i in 0..cloud.len() {
        let group = &mut out[i / LANES * planes..][..planes];
        let lane = i % LANES;
        let mut put = |plane: usize, values: &[f32]| {
            for (k, &value) in values.iter().enumerate() {
                group[plane + k].0[lane] = value;
            }
        };
        put(plane::MEAN, &cloud.means[i]);
        put(plane::LOG_SCALE, &cloud.log_scales[i]);
        put(plane::ROTATION, &cloud.rotations[i]);
        put(plane::OPACITY, &cloud.opacity_logits[i..=i]);
        let harmonics = planes - plane::HARMONICS;
        put(plane::HARMONICS, &cloud.harmonics[i * harmonics..(i + 1) * harmonics]);
    }
    out
}
