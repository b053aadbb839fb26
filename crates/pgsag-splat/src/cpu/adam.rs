//! One Adam step of everything, streaming group by group.

use fearless_simd::Level;
use rayon::prelude::*;

use super::{
    cloud::{CpuCloud, plane},
    lanes::{Line, at_level},
    wide::{Carried, Wide},
};
use crate::backend::{BackendError, Rates, Result};
use crate::equations::{Number, adam};

/// Groups that a task takes at a time.
const GROUPS: usize = 64;

/// Steps all parameters with the gradients at hand. Parameters that never had a gradient (harmonics beyond the degree
/// in use) are passed over: their moments are 0, and so is their step.
pub(crate) fn step(level: Level, cloud: &mut CpuCloud, rates: &Rates, step: u32) -> Result<()> {
    let (planes, gradient_planes) = (cloud.planes, cloud.gradient_planes);
    cloud.moment_planes = cloud.moment_planes.max(gradient_planes);
    let sweep = Sweep {
        rates: rates_of_planes(rates, cloud.moment_planes),
        corrections: adam::corrections(step),
        gradient_planes,
    };
    let chunk = GROUPS * planes;
    let finite = cloud
        .values
        .par_chunks_mut(chunk)
        .zip(cloud.first.par_chunks_mut(chunk))
        .zip(cloud.second.par_chunks_mut(chunk))
        .zip(cloud.gradients.par_chunks(chunk))
        .zip(cloud.touched.par_chunks(GROUPS))
        .map(|((((values, first), second), gradients), touched)| {
            let mut finite = true;
            for (group, &touched) in touched.iter().enumerate() {
                let at = group * planes..(group + 1) * planes;
                let lines = (&mut values[at.clone()], &mut first[at.clone()], &mut second[at.clone()]);
                let gradients = touched.then_some(&gradients[at]);
                finite &= at_level!(level, simd => sweep.group(simd, lines, gradients));
            }
            finite
        })
        .reduce(|| true, |a, b| a & b);
    if finite { Ok(()) } else { Err(BackendError::NotFinite("a parameter after the Adam step")) }
}

/// Step size of every parameter in use.
fn rates_of_planes(rates: &Rates, planes: usize) -> Vec<f32> {
    (0..planes)
        .map(|p| match p {
            0..plane::LOG_SCALE => rates.means,
            plane::LOG_SCALE..plane::ROTATION => rates.scales,
            plane::ROTATION..plane::OPACITY => rates.rotations,
            plane::OPACITY => rates.opacity,
            _ if p < plane::HARMONICS + 3 => rates.color,
            _ => rates.harmonics,
        })
        .collect()
}

struct Sweep {
    rates: Vec<f32>,
    corrections: [f64; 2],
    gradient_planes: usize,
}

impl Sweep {
    /// Steps one group; whether all its parameters are finite.
    #[inline(always)]
    fn group<S: Carried>(
        &self,
        simd: S,
        (values, first, second): (&mut [Line], &mut [Line], &mut [Line]),
        gradients: Option<&[Line]>,
    ) -> bool {
        simd.carry();
        let corrections = self.corrections.map(Wide::<S>::from_f64);
        let mut drift = Wide::<S>::zero();
        for (p, &rate) in self.rates.iter().enumerate() {
            let rate = Wide::<S>::from_f64(f64::from(rate));
            let gradient = gradients.filter(|_| p < self.gradient_planes).map_or(&Line::ZERO, |lines| &lines[p]);
            for at in (0..16).step_by(Wide::<S>::LEN) {
                let load = |line: &Line| Wide::<S>::load(line, at);
                let [x, m, v] =
                    adam::step(load(&values[p]), load(&first[p]), load(&second[p]), load(gradient), rate, corrections);
                x.store(&mut values[p], at);
                m.store(&mut first[p], at);
                v.store(&mut second[p], at);
                // 0 for a finite number, else not a number, and stays so.
                drift += x * Wide::<S>::zero();
            }
        }
        let mut last = Line::ZERO;
        drift.store(&mut last, 0);
        last.0.iter().all(|value| *value == 0.0)
    }
}
