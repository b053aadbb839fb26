//! The similarity that carries one set of points to another, despite outliers.
//!
//! Least squares by unit quaternions (Horn, JOSA A 1987), inside a least-median-of-squares search over triples
//! (Rousseeuw 1984) from a fixed random stream, so that the same input gives the same result.

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::eigen::symmetric_eigen;
use crate::numbers::{SplitMix64, median};

/// `p_b = scale * (rotation * p_a) + translation`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Similarity {
    /// Length of b per length of a.
    pub scale: f64,
    /// From the axes of a to those of b.
    pub rotation: DQuat,
    /// In the units of b.
    pub translation: DVec3,
}

impl Similarity {
    /// Carries a point from frame a to frame b.
    #[must_use]
    pub fn transform_point(&self, point: DVec3) -> DVec3 {
        self.scale * (self.rotation * point) + self.translation
    }

    /// The least-squares similarity of point pairs `(a, b)`; `None` of fewer than three, or of points on a line.
    #[must_use]
    pub fn least_squares(pairs: &[(DVec3, DVec3)]) -> Option<Self> {
        let count = pairs.len() as f64;
        let mean_a = pairs.iter().map(|(a, _)| *a).sum::<DVec3>() / count;
        let mean_b = pairs.iter().map(|(_, b)| *b).sum::<DVec3>() / count;
        let (mut cross, mut scatter) = ([[0.0; 3]; 3], [[0.0; 3]; 3]);
        for (a, b) in pairs {
            let (a, b) = ((*a - mean_a).to_array(), (*b - mean_b).to_array());
            for i in 0..3 {
                for j in 0..3 {
                    cross[i][j] += a[i] * b[j];
                    scatter[i][j] += a[i] * a[j];
                }
            }
        }
        let spread = scatter[0][0] + scatter[1][1] + scatter[2][2];
        let (eigenvalues, _) = symmetric_eigen(scatter);
        if pairs.len() < 3 || !spread.is_finite() || eigenvalues[1] <= 1e-6 * spread {
            return None;
        }
        let rotation = horn(&cross);
        let turned: f64 = pairs.iter().map(|(a, b)| (*b - mean_b).dot(rotation * (*a - mean_a))).sum();
        let scale = turned / spread;
        let translation = mean_b - scale * (rotation * mean_a);
        (scale > 0.0 && translation.is_finite()).then_some(Self { scale, rotation, translation })
    }

    /// The similarity that most pairs agree on, and which pairs those are.
    #[must_use]
    pub fn robust(pairs: &[(DVec3, DVec3)]) -> Option<(Self, Vec<bool>)> {
        const TRIALS: usize = 500;
        let spread = pairs.iter().map(|(_, b)| (*b - pairs[0].1).length()).fold(0.0, f64::max);
        let mut stream = SplitMix64::new(0x5EED);
        let mut best: Option<(f64, Self)> = Self::least_squares(pairs).map(|fit| (fit.median_miss(pairs), fit));
        for _ in 0..TRIALS {
            let triple = [0; 3].map(|_| pairs[stream.below(pairs.len())]);
            let Some(fit) = Self::least_squares(&triple) else { continue };
            let miss = fit.median_miss(pairs);
            if best.is_none_or(|(least, _)| miss < least) {
                best = Some((miss, fit));
            }
        }
        let (_, mut fit) = best?;
        let mut kept = vec![true; pairs.len()];
        for _ in 0..5 {
            // 1.4826 makes a deviation of a median (normal errors); misses are in three dimensions.
            let limit = (3.0 * 1.4826 * fit.median_miss(pairs)).max(1e-9 * spread);
            kept = pairs.iter().map(|pair| fit.miss(pair) <= limit).collect();
            let inliers: Vec<_> = pairs.iter().zip(&kept).filter(|(_, kept)| **kept).map(|(pair, _)| *pair).collect();
            fit = Self::least_squares(&inliers)?;
        }
        Some((fit, kept))
    }

    fn miss(&self, (a, b): &(DVec3, DVec3)) -> f64 {
        (self.transform_point(*a) - *b).length()
    }

    fn median_miss(&self, pairs: &[(DVec3, DVec3)]) -> f64 {
        let mut misses: Vec<f64> = pairs.iter().map(|pair| self.miss(pair)).collect();
        median(&mut misses).unwrap_or(f64::INFINITY)
    }
}

/// The rotation that makes the sum of `b . R a` largest; `s[i][j]` is the sum of `a_i b_j`.
fn horn(s: &[[f64; 3]; 3]) -> DQuat {
    let n = [
        [s[0][0] + s[1][1] + s[2][2], s[1][2] - s[2][1], s[2][0] - s[0][2], s[0][1] - s[1][0]],
        [s[1][2] - s[2][1], s[0][0] - s[1][1] - s[2][2], s[0][1] + s[1][0], s[2][0] + s[0][2]],
        [s[2][0] - s[0][2], s[0][1] + s[1][0], s[1][1] - s[0][0] - s[2][2], s[1][2] + s[2][1]],
        [s[0][1] - s[1][0], s[2][0] + s[0][2], s[1][2] + s[2][1], s[2][2] - s[0][0] - s[1][1]],
    ];
    let (_, vectors) = symmetric_eigen(n);
    let [w, x, y, z] = vectors[3];
    DQuat::from_xyzw(x, y, z, w).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs(truth: &Similarity, count: usize, flat: f64, noise: f64) -> Vec<(DVec3, DVec3)> {
        let mut stream = SplitMix64::new(11);
        let mut normal = || DVec3::new(stream.normal(), stream.normal(), stream.normal());
        (0..count)
            .map(|_| {
                let a = normal() * DVec3::new(1.0, 1.0, flat);
                (a, truth.transform_point(a) + normal() * noise)
            })
            .collect()
    }

    fn truth() -> Similarity {
        let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -2.0, 1.1);
        Similarity { scale: 37.5, rotation, translation: DVec3::new(4.5e5, 5.1e6, 300.0) }
    }

    #[test]
    fn exact_pairs_give_the_truth_even_in_a_plane() {
        for flat in [1.0, 0.0] {
            let fit = Similarity::least_squares(&pairs(&truth(), 10, flat, 0.0)).unwrap();
            assert!((fit.scale - 37.5).abs() < 1e-7);
            assert!(fit.rotation.angle_between(truth().rotation) < 1e-7);
            assert!((fit.translation - truth().translation).length() < 1e-6);
        }
    }

    #[test]
    fn a_third_of_outliers_changes_nothing() {
        let mut pairs = pairs(&truth(), 30, 0.1, 0.01);
        pairs.iter_mut().step_by(3).for_each(|(_, b)| *b += DVec3::new(200.0, -90.0, 40.0));
        let (fit, kept) = Similarity::robust(&pairs).unwrap();
        assert!((fit.scale / 37.5 - 1.0).abs() < 1e-3);
        assert!(fit.rotation.angle_between(truth().rotation) < 5e-3);
        assert!(kept.iter().step_by(3).all(|kept| !kept));
        assert!(kept.iter().filter(|kept| **kept).count() >= 17);
    }

    #[test]
    fn lines_and_pairs_have_no_answer() {
        let line: Vec<_> = (0..9).map(|i| (DVec3::X * f64::from(i), DVec3::Y * f64::from(i))).collect();
        assert_eq!(Similarity::least_squares(&line), None);
        assert_eq!(Similarity::robust(&line), None);
        assert_eq!(Similarity::least_squares(&pairs(&truth(), 2, 1.0, 0.0)), None);
    }
}
