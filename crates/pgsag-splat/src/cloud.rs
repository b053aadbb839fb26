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
}
