//! The shift along one line at which a patch of A looks most like B.

use glam::DVec2;
use pgsag_scene::Map;

use super::FlowOptions;

/// Distance between tried shifts, pixels.
const STEP_PX: f64 = 0.5;

/// A patch in both photographs.
pub(super) struct Line {
    /// Pixel of A, and where the mesh carries it in B.
    pub places: Vec<(DVec2, DVec2)>,
    /// Unit, in B: where the patch goes as it comes nearer.
    pub direction: DVec2,
    /// How far, for a relative change of depth by 1.
    pub parallax_px: f64,
}

/// What matching found.
pub(super) enum Match {
    Plain,
    Lost,
    Found { shift_px: f64, noise_px: f64 },
}

/// Brightness at a place: pixel `i` is that of `i + 0.5`; the border goes on outside.
fn bilinear(map: &Map<f32>, at: DVec2) -> f64 {
    let clamp = |v: f64, side: u32| (v - 0.5).clamp(0.0, f64::from(side) - 1.0);
    let (x, y) = (clamp(at.x, map.width), clamp(at.y, map.height));
    let (x0, y0) = (x as u32, y as u32);
    let (x1, y1) = ((x0 + 1).min(map.width - 1), (y0 + 1).min(map.height - 1));
    let (u, v) = (x - f64::from(x0), y - f64::from(y0));
    let row = |y: u32| f64::from(map.at(x0, y)) * (1.0 - u) + f64::from(map.at(x1, y)) * u;
    row(y0) * (1.0 - v) + row(y1) * v
}

/// The same by Keys' cubic (Catmull-Rom), which blurs by a fraction of what bilinear does; for where it counts.
fn cubic(map: &Map<f32>, at: DVec2) -> f64 {
    let weights = |t: f64| {
        [
            0.5 * t * (-1.0 + t * (2.0 - t)),
            1.0 + t * t * (-2.5 + 1.5 * t),
            0.5 * t * (1.0 + t * (4.0 - 3.0 * t)),
            0.5 * t * t * (t - 1.0),
        ]
    };
    let (x, y) = (at.x - 0.5, at.y - 0.5);
    let (x0, y0) = (x.floor(), y.floor());
    let (across, down) = (weights(x - x0), weights(y - y0));
    let pick = |start: f64, k: usize, side: u32| (start + k as f64 - 1.0).clamp(0.0, f64::from(side) - 1.0) as u32;
    let columns: [u32; 4] = std::array::from_fn(|k| pick(x0, k, map.width));
    (0..4)
        .map(|j| {
            let y = pick(y0, j, map.height);
            down[j] * (0..4).map(|i| across[i] * f64::from(map.at(columns[i], y))).sum::<f64>()
        })
        .sum()
}

/// Normalised cross-correlation, and the sum of squares of the second about its mean.
fn ncc(one: &[f64], other: &[f64]) -> (f64, f64) {
    let count = one.len() as f64;
    let (mean_one, mean_other) = (one.iter().sum::<f64>() / count, other.iter().sum::<f64>() / count);
    let (mut cross, mut square_one, mut square_other) = (0.0, 0.0, 0.0);
    for (a, b) in one.iter().zip(other) {
        let (a, b) = (a - mean_one, b - mean_other);
        cross += a * b;
        square_one += a * a;
        square_other += b * b;
    }
    (cross / (square_one * square_other).sqrt().max(1e-9), square_other)
}

/// Sum of squared differences of two sets of samples about the mean difference: the texture between them.
fn texture(plus: &[f64], minus: &[f64], distance_px: f64) -> f64 {
    let slope = |k: usize| (plus[k] - minus[k]) / distance_px;
    let mean = (0..plus.len()).map(slope).sum::<f64>() / plus.len() as f64;
    (0..plus.len()).map(|k| (slope(k) - mean) * (slope(k) - mean)).sum()
}

impl Line {
    fn samples(&self, b: &Map<f32>, shift_px: f64, sample: fn(&Map<f32>, DVec2) -> f64) -> Vec<f64> {
        self.places.iter().map(|(_, at)| sample(b, *at + self.direction * shift_px)).collect()
    }

    pub(super) fn best(&self, a: &Map<f32>, b: &Map<f32>, options: &FlowOptions) -> Match {
        let of_a: Vec<f64> = self.places.iter().map(|(at, _)| f64::from(a.at(at.x as u32, at.y as u32))).collect();
        let steps = (options.search_px / STEP_PX).round() as i32;
        let tried: Vec<Vec<f64>> =
            (-steps..=steps).map(|k| self.samples(b, f64::from(k) * STEP_PX, bilinear)).collect();
        let middle = steps as usize;
        if middle == 0 {
            return Match::Plain;
        }
        // Both photographs are noisy.
        let noise = 2.0 * options.image_noise * options.image_noise;
        let known = texture(&tried[middle + 1], &tried[middle - 1], 2.0 * STEP_PX);
        if known * options.max_noise_px * options.max_noise_px < noise {
            return Match::Plain;
        }
        let likeness: Vec<f64> = tried.iter().map(|of_b| ncc(&of_a, of_b).0).collect();
        let Some(best) = (0..likeness.len()).max_by(|i, j| likeness[*i].total_cmp(&likeness[*j])) else {
            return Match::Lost;
        };
        if best == 0 || best + 1 == likeness.len() || likeness[best] < options.min_ncc {
            return Match::Lost;
        }
        let shift = (best as f64 - f64::from(steps)) * STEP_PX;
        self.refined(&of_a, b, shift).unwrap_or(Match::Lost)
    }

    /// The top of the parabola through three correlations, and its standard deviation by the brightness that is left
    /// unexplained there.
    fn refined(&self, of_a: &[f64], b: &Map<f32>, shift: f64) -> Option<Match> {
        let three = [-STEP_PX, 0.0, STEP_PX].map(|by| self.samples(b, shift + by, cubic));
        let [(left, _), (top, squares), (right, _)] = [0, 1, 2].map(|k| ncc(of_a, &three[k]));
        let bend = left - 2.0 * top + right;
        if bend >= 0.0 {
            return None;
        }
        let by = 0.5 * (left - right) / bend * STEP_PX;
        if by.abs() > 1.5 * STEP_PX {
            return None;
        }
        let known = texture(&three[2], &three[0], 2.0 * STEP_PX);
        let unexplained = (1.0 - top * top).max(0.0) * squares / (of_a.len() as f64 - 3.0).max(1.0);
        Some(Match::Found { shift_px: shift + by, noise_px: (unexplained / known.max(1e-9)).sqrt() })
    }
}
