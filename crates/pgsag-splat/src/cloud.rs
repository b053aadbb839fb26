//! The parameters of planar Gaussians, structure of arrays, as stored (before activation).

/// A cloud of Gaussians about its own origin. Activations: scale = exp, opacity = sigmoid, rotation = q / |q|.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SplatCloud {
    /// World coordinates of the group's origin; `means` are about it.
    pub origin_world: [f64; 3],
    /// Degree of the spherical harmonics that are stored, 0 to 3; K = (degree + 1)².
    pub sh_degree: u8,
    /// `[N]` scene units, group frame (world axes).
    pub means: Vec<[f32; 3]>,
    /// `[N]` natural logarithm of the three standard deviations, scene units.
    pub log_scales: Vec<[f32; 3]>,
    /// `[N]` quaternion w x y z, not normalised; world_from_gaussian.
    pub rotations: Vec<[f32; 4]>,
    /// `[N]` logit of the opacity.
    pub opacity_logits: Vec<f32>,
    /// `[N, K, 3]` coefficients, Gaussian-major, then basis function, then R G B.
    pub harmonics: Vec<f32>,
}

impl SplatCloud {
    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Basis functions per Gaussian, K = (degree + 1)².
    #[must_use]
    pub fn basis_count(&self) -> usize {
        (usize::from(self.sh_degree) + 1).pow(2)
    }

    /// The Gaussians at these places, in this order.
    #[must_use]
    pub fn reordered(&self, order: &[u32]) -> Self {
        fn pick<T: Copy>(values: &[T], order: &[u32]) -> Vec<T> {
            order.iter().map(|&i| values[i as usize]).collect()
        }
        let width = 3 * self.basis_count();
        Self {
            origin_world: self.origin_world,
            sh_degree: self.sh_degree,
            means: pick(&self.means, order),
            log_scales: pick(&self.log_scales, order),
            rotations: pick(&self.rotations, order),
            opacity_logits: pick(&self.opacity_logits, order),
            harmonics: order.iter().flat_map(|&i| &self.harmonics[i as usize * width..][..width]).copied().collect(),
        }
    }
}

/// Places of points along a space-filling curve (Morton), so that what is near in space is near in memory: blending
/// fetches Gaussians by tile. Points at one place of the curve keep their order.
#[must_use]
pub fn curve_order(points: &[[f32; 3]]) -> Vec<u32> {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for point in points.iter().filter(|point| point.iter().all(|value| value.is_finite())) {
        for axis in 0..3 {
            low[axis] = low[axis].min(point[axis]);
            high[axis] = high[axis].max(point[axis]);
        }
    }
    let cells = f64::from(1u32 << CURVE_BITS) - 1.0;
    let code = |point: &[f32; 3]| {
        (0..3).fold(0, |code, axis| {
            let span = f64::from(high[axis]) - f64::from(low[axis]);
            let share = (f64::from(point[axis]) - f64::from(low[axis])) / span;
            // Not a number becomes 0.
            code | spread((share * cells) as u64 & ((1 << CURVE_BITS) - 1)) << axis
        })
    };
    let codes: Vec<u64> = points.iter().map(code).collect();
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.sort_by_key(|&i| codes[i as usize]);
    order
}

/// Bits per axis of the curve.
const CURVE_BITS: u32 = 21;

/// Moves bit i to bit 3 i.
fn spread(value: u64) -> u64 {
    (0..CURVE_BITS).fold(0, |out, bit| out | (value >> bit & 1) << (3 * bit))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_visits_octants_one_after_another() {
        let points =
            [[0.9, 0.9, 0.9], [0.0, 0.0, 0.0], [0.1, 0.1, 0.1], [1.0, 1.0, 1.0], [0.9, 0.1, 0.1], [f32::NAN; 3]];
        let order = curve_order(&points);
        assert_eq!(order, [1, 5, 2, 4, 0, 3]);
        let cloud = SplatCloud {
            means: points.to_vec(),
            log_scales: vec![[0.0; 3]; 6],
            rotations: vec![[0.0; 4]; 6],
            opacity_logits: (0..6).map(|i| i as f32).collect(),
            harmonics: (0..18).map(|i| i as f32).collect(),
            ..SplatCloud::default()
        };
        let sorted = cloud.reordered(&order);
        assert_eq!(sorted.opacity_logits, [1.0, 5.0, 2.0, 4.0, 0.0, 3.0]);
        assert_eq!(sorted.harmonics[..3], [3.0, 4.0, 5.0]);
    }
}
