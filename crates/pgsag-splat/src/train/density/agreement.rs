//! Whether several views show an error at a Gaussian (FastGS's births, told by views; method.md, appendix C).
//!
//! FastGS counts the pixels with an error that a Gaussian is blended into. With a dense start Gaussians are about a pixel
//! large, so the pixel of the mean stands for them all, and a share of views for the count.

use crate::backend::ViewCamera;
use crate::train::footprint::locate;

/// Views drawn before a decision. FastGS: 10.
pub(in crate::train) const VIEWS: usize = 10;
/// Errors above this share of a view's largest count. FastGS: 0.1.
const HIGH_ERROR: f32 = 0.1;
/// A Gaussian is seen where its depth is within this share of the rendered one.
const SAME_DEPTH: f64 = 0.02;

/// Per Gaussian: views that see it, and those of them that show an error there.
#[derive(Clone, Debug, Default)]
pub struct Agreement {
    seen: Vec<u32>,
    wrong: Vec<u32>,
}

impl Agreement {
    /// Of so many Gaussians, before any view.
    #[must_use]
    pub fn of(count: usize) -> Self {
        Self { seen: vec![0; count], wrong: vec![0; count] }
    }

    /// Takes in one view: `depth` `[H, W]` as rendered, scene units, and `error` `[H, W]`, `None` where nothing is trained.
    pub fn note(&mut self, means: &[[f32; 3]], camera: &ViewCamera, depth: &[f32], error: &[Option<f32>]) {
        let most = error.iter().flatten().copied().fold(0.0, f32::max);
        let least = error.iter().flatten().copied().fold(most, f32::min);
        for (i, mean) in means.iter().enumerate() {
            let Some((z, at)) = locate(camera, *mean) else { continue };
            let pixel = at[1] as usize * camera.pinhole.width as usize + at[0] as usize;
            let Some(error) = error[pixel] else { continue };
            if (z - f64::from(depth[pixel])).abs() < SAME_DEPTH * z {
                self.seen[i] += 1;
                self.wrong[i] += u32::from(error - least > HIGH_ERROR * (most - least));
            }
        }
    }

    /// Whether at least this share of the views that see Gaussian `i`, and one at all, show an error there.
    #[must_use]
    pub fn is_wrong(&self, i: usize, share: f32) -> bool {
        self.wrong[i] > 0 && self.wrong[i] as f32 >= share * self.seen[i] as f32
    }
}
