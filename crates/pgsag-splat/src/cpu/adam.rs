//! One Adam step of everything, streaming group by group; gradients are made on the way and stay in cache.

use fearless_simd::{Level, prelude::*};
use rayon::prelude::*;

use super::{
    bounds,
    cloud::{CpuCloud, plane},
    gradient::Pending,
    lanes::{LANES, Line, at_level},
    project::GROUPS,
    wide::{Carried, Wide},
};
use crate::backend::{BackendError, Rates, Result};
use crate::equations::{Number, adam, algebra::each};

/// Steps all parameters with the gradients of the last `backward`. Gaussians and parameters that never had one (harmonics
/// beyond the degree in use) are passed over: their moments are 0, and so is their step.
pub(crate) fn step(level: Level, cloud: &mut CpuCloud, rates: &Rates, step: u32) -> Result<()> {
    let planes = cloud.planes;
    let gradient_planes = cloud.pending.used_planes();
    cloud.moment_planes = cloud.moment_planes.max(gradient_planes);
    let sweep = Sweep {
        rates: rates_of_planes(rates, cloud.moment_planes),
        corrections: adam::corrections(step),
        pending: &cloud.pending,
        planes,
        gradient_planes,
        sparse: rates.sparse,
    };
    let chunk = GROUPS * planes;
    let finite = cloud
        .values
        .par_chunks_mut(chunk)
        .zip(cloud.first.par_chunks_mut(chunk))
        .zip(cloud.second.par_chunks_mut(chunk))
        .zip(cloud.touched.par_chunks(GROUPS))
        .zip(cloud.moving.par_chunks_mut(GROUPS))
        .zip(cloud.boxes.par_chunks_mut(GROUPS / LANES * bounds::PLANES))
        .with_max_len(1)
        .enumerate()
        .map(|(index, (((((values, first), second), touched), moving), boxes))| {
            let mut task = Task { index, values, first, second, touched, moving, boxes };
            at_level!(level, simd => sweep.task(simd, &mut task))
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

struct Sweep<'a> {
    rates: Vec<f32>,
    corrections: [f64; 2],
    pending: &'a Pending,
    /// Lines of a group.
    planes: usize,
    /// Planes that get a gradient.
    gradient_planes: usize,
    sparse: bool,
}

/// Some groups.
struct Task<'a> {
    index: usize,
    values: &'a mut [Line],
    first: &'a mut [Line],
    second: &'a mut [Line],
    touched: &'a [u16],
    moving: &'a mut [bool],
    boxes: &'a mut [Line],
}

impl Sweep<'_> {
    /// Steps the groups of a task and sets their boxes; whether all parameters are finite.
    #[inline(always)]
    fn task<S: Carried>(&self, simd: S, task: &mut Task<'_>) -> bool {
        simd.carry();
        let mut walk = self.pending.walk::<S>(task.index);
        let mut gradients = [Line::ZERO; PLANES_MAX];
        let mut finite = true;
        for group in 0..task.touched.len() {
            let at = group * self.planes..(group + 1) * self.planes;
            let lines = (&mut task.values[at.clone()], &mut task.first[at.clone()], &mut task.second[at]);
            let given = walk.next(group, lines.0, &mut gradients);
            if !given && (self.sparse || !task.moving[group]) {
                continue;
            }
            task.moving[group] = true;
            let gradients = &gradients[..if given { self.gradient_planes } else { 0 }];
            let stepped = if self.sparse { task.touched[group] } else { u16::MAX };
            finite &= self.group(simd, lines, gradients, stepped);
            bounds::set::<S>(task.boxes, group, &task.values[group * self.planes..][..self.planes]);
        }
        finite
    }

    /// Steps the Gaussians `stepped` of one group, with gradients of the first planes; whether all parameters are finite.
    #[inline(always)]
    fn group<S: Carried>(
        &self,
        simd: S,
        (values, first, second): (&mut [Line], &mut [Line], &mut [Line]),
        gradients: &[Line],
        stepped: u16,
    ) -> bool {
        let corrections = each(|k| Wide::<S>::from_f64(self.corrections[k]));
        let mut drift = Wide::<S>::zero();
        for (p, &rate) in self.rates.iter().enumerate() {
            let rate = Wide::<S>::from_f64(f64::from(rate));
            let gradient = gradients.get(p).unwrap_or(&Line::ZERO);
            for at in (0..LANES).step_by(Wide::<S>::LEN) {
                let load = |line: &Line| Wide::<S>::load(line, at);
                let before = [load(&values[p]), load(&first[p]), load(&second[p])];
                let after = adam::step(before[0], before[1], before[2], load(gradient), rate, corrections);
                let stepped = u64::from(stepped >> at) & u64::MAX >> (64 - Wide::<S>::LEN);
                let stepped = S::mask32s::from_bitmask(simd, stepped);
                let [x, m, v] = each(|k| Wide::select(stepped, after[k], before[k]));
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

/// Lines of a group at most: those of degree 3.
const PLANES_MAX: usize = plane::HARMONICS + 48;
