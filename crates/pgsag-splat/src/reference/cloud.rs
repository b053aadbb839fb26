//! Parameters as rows of f64: one Gaussian, one row, whatever the kind of parameter.

use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering};

use super::ceiling_logit;
use crate::backend::{Birth, DensityPlan, DensityStatistics, OptimizerState, Rates};
use crate::cloud::SplatCloud;
use crate::equations::harmonics::{BASIS_MAX, basis_count};

/// Places of a row: mean.
pub(super) const MEAN: usize = 0;
/// Three log scales.
pub(super) const SCALES: usize = 3;
/// Quaternion w x y z.
pub(super) const ROTATION: usize = 6;
/// Opacity logit.
pub(super) const OPACITY: usize = 10;
/// Sixteen coefficients of R G B.
pub(super) const HARMONICS: usize = 11;
/// Numbers of a row.
pub(super) const WIDTH: usize = HARMONICS + 3 * BASIS_MAX;

/// One Gaussian's parameters, gradients or moments; harmonics beyond the cloud's degree are 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Row(pub(super) [f64; WIDTH]);

impl Row {
    pub(super) const ZERO: Self = Self([0.0; WIDTH]);

    pub(super) fn get<const K: usize>(&self, start: usize) -> [f64; K] {
        std::array::from_fn(|i| self.0[start + i])
    }

    pub(super) fn add<const K: usize>(&mut self, start: usize, values: [f64; K]) {
        for (place, value) in self.0[start..].iter_mut().zip(values) {
            *place += value;
        }
    }

    pub(super) fn harmonics(&self) -> [[f64; 3]; BASIS_MAX] {
        std::array::from_fn(|l| self.get(HARMONICS + 3 * l))
    }
}

/// Sums of one Gaussian since the last reset.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Tally {
    pub(super) gradient: f64,
    pub(super) absolute_gradient: f64,
    pub(super) visible_count: u32,
    pub(super) radius_px: f64,
}

/// A cloud in f64 with gradients, moments and statistics, `[N]` each.
#[derive(Debug)]
pub struct Cloud {
    origin_world: [f64; 3],
    pub(super) sh_degree: u8,
    pub(super) rows: Vec<Row>,
    pub(super) first: Vec<Row>,
    pub(super) second: Vec<Row>,
    pub(super) gradients: Vec<Row>,
    pub(super) tallies: Vec<Tally>,
    /// Renders count here through a shared reference.
    pub(super) observed: Vec<AtomicU32>,
}

impl Cloud {
    pub(super) fn new(state: &OptimizerState) -> Self {
        let count = state.cloud.len();
        let statistics = &state.statistics;
        let tally = |i: usize| Tally {
            gradient: f64::from(statistics.gradient[i]),
            absolute_gradient: f64::from(statistics.absolute_gradient[i]),
            visible_count: statistics.visible_count[i],
            radius_px: f64::from(statistics.radius_px[i]),
        };
        let known = statistics.gradient.len() == count;
        Self {
            origin_world: state.cloud.origin_world,
            sh_degree: state.cloud.sh_degree,
            rows: rows(&state.cloud),
            first: moments(&state.first, count),
            second: moments(&state.second, count),
            gradients: vec![Row::ZERO; count],
            tallies: (0..count).map(|i| if known { tally(i) } else { Tally::default() }).collect(),
            observed: (0..count)
                .map(|i| AtomicU32::new(if known { statistics.observed_count[i] } else { 0 }))
                .collect(),
        }
    }

    /// Rows as a cloud of f32.
    pub(super) fn splats(&self, rows: &[Row]) -> SplatCloud {
        let basis = basis_count(self.sh_degree);
        let narrow = |value: f64| value as f32;
        SplatCloud {
            origin_world: self.origin_world,
            sh_degree: self.sh_degree,
            means: rows.iter().map(|row| row.get(MEAN).map(narrow)).collect(),
            log_scales: rows.iter().map(|row| row.get(SCALES).map(narrow)).collect(),
            rotations: rows.iter().map(|row| row.get(ROTATION).map(narrow)).collect(),
            opacity_logits: rows.iter().map(|row| narrow(row.0[OPACITY])).collect(),
            harmonics: rows
                .iter()
                .flat_map(|row| row.0[HARMONICS..][..3 * basis].iter().copied().map(narrow))
                .collect(),
        }
    }

    pub(super) fn statistics(&self) -> DensityStatistics {
        DensityStatistics {
            gradient: self.tallies.iter().map(|tally| tally.gradient as f32).collect(),
            absolute_gradient: self.tallies.iter().map(|tally| tally.absolute_gradient as f32).collect(),
            visible_count: self.tallies.iter().map(|tally| tally.visible_count).collect(),
            radius_px: self.tallies.iter().map(|tally| tally.radius_px as f32).collect(),
            observed_count: self.observed.iter().map(|count| count.load(Ordering::Relaxed)).collect(),
        }
    }

    pub(super) fn reset_statistics(&mut self) {
        self.tallies = vec![Tally::default(); self.rows.len()];
        self.observed = (0..self.rows.len()).map(|_| AtomicU32::new(0)).collect();
    }

    pub(super) fn reshape(&mut self, plan: &DensityPlan) {
        let kept = |rows: &[Row]| plan.keep.iter().map(|&index| rows[index as usize]).collect::<Vec<_>>();
        let births: Vec<Row> = plan.births.iter().map(|birth| born(&self.rows[birth.parent as usize], birth)).collect();
        let empty = vec![Row::ZERO; births.len()];
        self.rows = [kept(&self.rows), births].concat();
        self.first = [kept(&self.first), empty.clone()].concat();
        self.second = [kept(&self.second), empty].concat();
        self.gradients = vec![Row::ZERO; self.rows.len()];
        if let Some(ceiling) = plan.opacity_ceiling {
            let logit = ceiling_logit(ceiling);
            self.rows.iter_mut().for_each(|row| row.0[OPACITY] = row.0[OPACITY].min(logit));
            self.first.iter_mut().chain(&mut self.second).for_each(|row| row.0[OPACITY] = 0.0);
        }
        self.reset_statistics();
    }
}

/// The child of a row.
fn born(parent: &Row, birth: &Birth) -> Row {
    let mut row = *parent;
    row.add(MEAN, birth.offset.map(f64::from));
    row.add(SCALES, [f64::from(birth.log_scale_shift); 3]);
    row.0[OPACITY] = birth.opacity_logit.map_or(row.0[OPACITY], f64::from);
    row
}

/// Step size of every place of a row.
pub(super) fn rates(rates: &Rates) -> [f64; WIDTH] {
    std::array::from_fn(|i| {
        f64::from(match i {
            MEAN..SCALES => rates.means,
            SCALES..ROTATION => rates.scales,
            ROTATION..OPACITY => rates.rotations,
            OPACITY => rates.opacity,
            _ if DEGREE_0.contains(&i) => rates.color,
            _ => rates.harmonics,
        })
    })
}

const DEGREE_0: Range<usize> = HARMONICS..HARMONICS + 3;

/// Moments of `count` Gaussians: those given, or none yet.
fn moments(cloud: &SplatCloud, count: usize) -> Vec<Row> {
    if cloud.len() == count { rows(cloud) } else { vec![Row::ZERO; count] }
}

fn rows(cloud: &SplatCloud) -> Vec<Row> {
    let basis = cloud.basis_count();
    (0..cloud.len())
        .map(|i| {
            let mut row = Row::ZERO;
            row.add(MEAN, cloud.means[i].map(f64::from));
            row.add(SCALES, cloud.log_scales[i].map(f64::from));
            row.add(ROTATION, cloud.rotations[i].map(f64::from));
            row.0[OPACITY] = f64::from(cloud.opacity_logits[i]);
            let coefficients = &cloud.harmonics[i * 3 * basis..(i + 1) * 3 * basis];
            row.0[HARMONICS..].iter_mut().zip(coefficients).for_each(|(place, &value)| *place = f64::from(value));
            row
        })
        .collect()
}
