//! Point-to-point ICP in three stages, as the Tanks and Temples scripts run it (method 4.1), with or without scale;
//! the best motion of paired points by Horn's quaternions (1987).

use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

use super::crop::thinned;
use super::surface::{Cloud, Target};
use crate::error::MeshError;

/// Iterations per stage, and the change below which it stops.
const ITERATIONS: usize = 20;
const CONVERGED: f64 = 1e-6;
/// The last stage uses at most this many points.
const MAX_POINTS: usize = 4_000_000;
/// Pairs summed together; fixed, so that threads change nothing.
const CHUNK: usize = 4096;

/// `p -> scale * rotation * p + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// 1 unless scale was asked for.
    pub scale: f64,
    /// Unit quaternion.
    pub rotation: DQuat,
    /// Scene units.
    pub translation: DVec3,
}

impl Similarity {
    /// Moves nothing.
    pub const IDENTITY: Self = Self { scale: 1.0, rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// The moved point.
    #[must_use]
    pub fn apply(&self, point: [f64; 3]) -> [f64; 3] {
        (self.scale * (self.rotation * DVec3::from(point)) + self.translation).into()
    }

    /// Row-major 4 x 4.
    #[must_use]
    pub fn matrix(&self) -> [[f64; 4]; 4] {
        let r = DMat3::from_quat(self.rotation) * self.scale;
        let row = |i: usize| [r.x_axis[i], r.y_axis[i], r.z_axis[i], self.translation[i]];
        [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
    }
}

/// Moves `source` onto `target`; `tau` is the scale of the stages, scene units.
///
/// # Errors
/// A cloud without points.
pub fn icp(source: &[[f64; 3]], target: &[[f64; 3]], tau: f64, with_scale: bool) -> Result<Similarity, MeshError> {
    let mut motion = Similarity::IDENTITY;
    let every = |points: &[[f64; 3]]| {
        points.iter().copied().step_by(points.len().div_ceil(MAX_POINTS).max(1)).collect::<Vec<_>>()
    };
    for (voxel, reach) in [(Some(tau), 80.0 * tau), (Some(0.5 * tau), 20.0 * tau), (None, 2.0 * tau)] {
        let reduced = |points: &[[f64; 3]]| voxel.map_or_else(|| every(points), |voxel| thinned(points, voxel));
        let from = reduced(source);
        let to = Cloud::new(reduced(target), "the truth")?;
        motion = stage(&from, &to, reach, with_scale, motion);
    }
    Ok(motion)
}

fn stage(from: &[[f64; 3]], to: &Cloud, reach: f64, with_scale: bool, mut motion: Similarity) -> Similarity {
    let mut last = (0.0, f64::INFINITY);
    for _ in 0..ITERATIONS {
        let pairs: Vec<Vec<(DVec3, DVec3)>> = from
            .par_chunks(CHUNK)
            .map(|part| {
                part.iter()
                    .filter_map(|point| {
                        let hit = to.nearest_within(motion.apply(*point).into(), f64::MAX)?;
                        (hit.distance < reach).then_some((DVec3::from(*point), hit.place))
                    })
                    .collect()
            })
            .collect();
        let pairs = pairs.concat();
        if pairs.len() < 3 {
            return motion;
        }
        motion = best_motion(&pairs, with_scale);
        let squares: f64 = pairs.iter().map(|(p, q)| DVec3::from(motion.apply((*p).into())).distance_squared(*q)).sum();
        let now = (pairs.len() as f64 / from.len() as f64, (squares / pairs.len() as f64).sqrt());
        if f64::abs(now.0 - last.0) < CONVERGED && f64::abs(now.1 - last.1) < CONVERGED {
            return motion;
        }
        last = now;
    }
    motion
}

/// The motion with the least squared distances between moved first and second points.
pub(crate) fn best_motion(pairs: &[(DVec3, DVec3)], with_scale: bool) -> Similarity {
    let count = pairs.len() as f64;
    let (sum_p, sum_q) = pairs.iter().fold((DVec3::ZERO, DVec3::ZERO), |(p, q), pair| (p + pair.0, q + pair.1));
    let (mean_p, mean_q) = (sum_p / count, sum_q / count);
    let mut s = [[0.0; 3]; 3];
    let mut spread = 0.0;
    for (p, q) in pairs {
        let (p, q) = (*p - mean_p, *q - mean_q);
        spread += p.length_squared();
        for i in 0..3 {
            for j in 0..3 {
                s[i][j] += p[i] * q[j];
            }
        }
    }
    let n = [
        [s[0][0] + s[1][1] + s[2][2], s[1][2] - s[2][1], s[2][0] - s[0][2], s[0][1] - s[1][0]],
        [s[1][2] - s[2][1], s[0][0] - s[1][1] - s[2][2], s[0][1] + s[1][0], s[2][0] + s[0][2]],
        [s[2][0] - s[0][2], s[0][1] + s[1][0], s[1][1] - s[0][0] - s[2][2], s[1][2] + s[2][1]],
        [s[0][1] - s[1][0], s[2][0] + s[0][2], s[1][2] + s[2][1], s[2][2] - s[0][0] - s[1][1]],
    ];
    let (value, vector) = largest_eigenpair(n);
    let rotation = DQuat::from_xyzw(vector[1], vector[2], vector[3], vector[0]).normalize();
    let scale = if with_scale && spread > 0.0 { value / spread } else { 1.0 };
    Similarity { scale, rotation, translation: mean_q - scale * (rotation * mean_p) }
}

/// Largest eigenvalue and its vector of a symmetric matrix, by Jacobi rotations.
fn largest_eigenpair(mut m: [[f64; 4]; 4]) -> (f64, [f64; 4]) {
    let mut v = [[0.0; 4]; 4];
    (0..4).for_each(|i| v[i][i] = 1.0);
    for _ in 0..60 {
        let pivots = (0..4).flat_map(|i| (i + 1..4).map(move |j| (i, j)));
        let (i, j) = pivots.max_by(|a, b| m[a.0][a.1].abs().total_cmp(&m[b.0][b.1].abs())).unwrap_or((0, 1));
        if m[i][j] == 0.0 {
            break;
        }
        let theta = (m[j][j] - m[i][i]) / (2.0 * m[i][j]);
        let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
        let c = 1.0 / (t * t + 1.0).sqrt();
        let s = t * c;
        for k in 0..4 {
            let (a, b) = (m[k][i], m[k][j]);
            (m[k][i], m[k][j]) = (c * a - s * b, s * a + c * b);
        }
        for k in 0..4 {
            let (a, b) = (m[i][k], m[j][k]);
            (m[i][k], m[j][k]) = (c * a - s * b, s * a + c * b);
            let (a, b) = (v[k][i], v[k][j]);
            (v[k][i], v[k][j]) = (c * a - s * b, s * a + c * b);
        }
        m[i][j] = 0.0;
        m[j][i] = 0.0;
    }
    let best = (0..4).max_by(|a, b| m[*a][*a].total_cmp(&m[*b][*b])).unwrap_or(0);
    (m[best][best], std::array::from_fn(|k| v[k][best]))
}
