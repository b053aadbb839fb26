//! Boxes about groups of 16 Gaussians, so that groups that no drawn tile can see are passed over unread.
//!
//! A box holds the means of a group and its largest standard deviation. It is set when the cloud is made and by every
//! Adam step, where the values are at hand. What is passed over would have found no tile: results are the same bytes.

use fearless_simd::Level;
use rayon::prelude::*;

use super::{
    bins::{CULL_MARGIN, tile_span},
    cloud::plane,
    lanes::{LANES, Line, at_level},
    layout::Layout,
    wide::{Carried, Wide},
};
use crate::equations::{
    Number,
    algebra::{Vec3, add, each, mat_vec, scale, sub},
    projection::{DILATION_PX2, Lens},
};

/// Lines of 16 boxes: least means 3, greatest means 3, greatest logarithm of a scale.
pub(crate) const PLANES: usize = 7;
/// Pixels added on every side, and the factor on every length: more than rounding takes.
const MARGIN_PX: f64 = 1.0;
/// See [`MARGIN_PX`].
const MARGIN: f64 = 1.001;

/// Boxes of all groups of `planes` lines, 16 boxes to [`PLANES`] lines; what is beyond the last group is 0.
pub(crate) fn boxes(level: Level, values: &[Line], planes: usize) -> Vec<Line> {
    let mut boxes = vec![Line::ZERO; (values.len() / planes).div_ceil(LANES) * PLANES];
    boxes.par_chunks_exact_mut(PLANES).zip(values.par_chunks(LANES * planes)).for_each(|(boxes, values)| {
        at_level!(level, simd => set_block(simd, boxes, values, planes));
    });
    boxes
}

#[inline(always)]
fn set_block<S: Carried>(simd: S, boxes: &mut [Line], values: &[Line], planes: usize) {
    simd.carry();
    for (place, values) in values.chunks_exact(planes).enumerate() {
        set::<S>(boxes, place, values);
    }
}

/// Sets the box of the group at `place` of `boxes` (whole blocks of [`PLANES`]) from the group's values.
#[inline(always)]
pub(crate) fn set<S: Carried>(boxes: &mut [Line], place: usize, values: &[Line]) {
    let boxes = &mut boxes[place / LANES * PLANES..][..PLANES];
    let lane = place % LANES;
    for axis in 0..3 {
        let (low, high) = spread::<S>(&values[plane::MEAN + axis]);
        boxes[axis].0[lane] = low;
        boxes[3 + axis].0[lane] = high;
    }
    let mut largest = values[plane::LOG_SCALE];
    for axis in 1..3 {
        for at in (0..LANES).step_by(Wide::<S>::LEN) {
            let (a, b) = (Wide::<S>::load(&largest, at), Wide::<S>::load(&values[plane::LOG_SCALE + axis], at));
            a.max(b).store(&mut largest, at);
        }
    }
    boxes[6].0[lane] = spread::<S>(&largest).1;
}

/// Least and greatest value of a line. Whoever has a value that is not a number is told so by Adam.
#[inline(always)]
fn spread<S: Carried>(line: &Line) -> (f32, f32) {
    let (mut low, mut high) = (Wide::<S>::load(line, 0), Wide::<S>::load(line, 0));
    for at in (Wide::<S>::LEN..LANES).step_by(Wide::<S>::LEN) {
        let value = Wide::<S>::load(line, at);
        low = low.min(value);
        high = high.max(value);
    }
    (low.least(), high.greatest())
}

/// Which groups a drawn tile may see.
pub(crate) struct Sight<'a, P> {
    layout: &'a Layout,
    lens: &'a Lens<P>,
    near: P,
    /// Standard deviations from the mean to the alpha cut of an opaque Gaussian.
    reach: P,
}

impl<'a, S: Carried> Sight<'a, Wide<S>> {
    /// Of a camera whose drawn tiles are those of `layout`; `cut` is the log2 of the alpha cut.
    #[inline(always)]
    pub(crate) fn new(layout: &'a Layout, lens: &'a Lens<Wide<S>>, near: f64, cut: f32) -> Self {
        let level = 2.0 * std::f64::consts::LN_2 * f64::from(CULL_MARGIN - cut).max(0.0);
        Self { layout, lens, near: Wide::from_f64(near), reach: Wide::from_f64(MARGIN * level.sqrt()) }
    }

    /// One bit for each of 16 groups: 0 where no drawn pixel can be reached.
    #[inline(always)]
    pub(crate) fn seen(&self, boxes: &[Line]) -> u16 {
        let mut spans = [Line::ZERO; 4];
        let mut ahead = Line::ZERO;
        for at in (0..LANES).step_by(Wide::<S>::LEN) {
            let (sides, before) = self.rectangle(boxes, at);
            for (line, side) in spans.iter_mut().zip(sides) {
                side.store(line, at);
            }
            before.store(&mut ahead, at);
        }
        let last = |pixels: u32| (pixels - 1) as f32;
        let (right, bottom) = (last(self.layout.columns), last(self.layout.rows));
        let mut bits = 0;
        for lane in 0..LANES {
            let [u, half_u, v, half_v] = [0, 1, 2, 3].map(|k| spans[k].0[lane]);
            let span = (tile_span(u, half_u, right), tile_span(v, half_v, bottom));
            if let (Some((x0, x1)), Some((y0, y1)), true) = (span.0, span.1, ahead.0[lane] > 0.0) {
                bits |= u16::from(self.layout.any_drawn(x0, x1, y0, y1)) << lane;
            }
        }
        bits
    }

    /// Centre and half width of the rectangle on the screen, along u, then v; and positive where a part lies beyond
    /// the near plane. From a depth z on an ellipse reaches at most
    ///     k √(σ² (f/z)² (1 + t²) + 0.3)
    /// from its centre, t the greatest tangent to which the Jacobian's is clamped.
    #[inline(always)]
    fn rectangle(&self, boxes: &[Line], at: usize) -> ([Wide<S>; 4], Wide<S>) {
        let load = |k: usize| Wide::<S>::load(&boxes[k], at);
        let half = Wide::from_f64(0.5);
        let (low, high): (Vec3<Wide<S>>, Vec3<Wide<S>>) = (each(load), each(|k| load(3 + k)));
        let middle = mat_vec(&self.lens.rotation, scale(add(low, high), half));
        let middle = add(middle, self.lens.translation);
        let sides = scale(sub(high, low), half * Wide::from_f64(MARGIN));
        let extent = mat_vec(&each(|i| each(|j| self.lens.rotation[i][j].abs())), sides);
        let deepest = middle[2] + extent[2];
        let nearest = (middle[2] - extent[2]).max(self.near);
        let deepest_or = deepest.max(nearest);
        let sigma = load(6).exp();
        let mut spans = [Wide::zero(); 4];
        for i in 0..2 {
            let (a, b) = (middle[i] - extent[i], middle[i] + extent[i]);
            let zero = Wide::zero();
            let low = a.min(zero) / nearest + a.max(zero) / deepest_or;
            let high = b.max(zero) / nearest + b.min(zero) / deepest_or;
            let tangent = self.lens.tangent_low[i].abs().max(self.lens.tangent_high[i].abs());
            let slope = self.lens.focal[i].abs() / nearest;
            let spread = sigma * sigma * slope * slope * (Wide::one() + tangent * tangent);
            let reach = self.reach * (spread + Wide::from_f64(DILATION_PX2)).sqrt() + Wide::from_f64(MARGIN_PX);
            spans[2 * i] = self.lens.focal[i] * (low + high) * half + self.lens.center[i];
            spans[2 * i + 1] = self.lens.focal[i].abs() * (high - low) * half * Wide::from_f64(MARGIN) + reach;
        }
        (spans, deepest - self.near)
    }
}

#[cfg(test)]
mod tests;
