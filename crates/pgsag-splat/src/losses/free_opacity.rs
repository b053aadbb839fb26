//! Nothing floats past the silhouette: opacity costs where the background is seen. Ours; the paper has no such term.

use pgsag_scene::PixelClass;

use super::rows::sum_rows;
use super::view::LossView;
use crate::equations::Scalar;

/// Mean opacity over `Free` pixels, with its gradient times `d_loss` added to `d_opacity`; 0 where there are none.
/// `opacity` `[H * W]` sum of blending weights; the render must draw free pixels (`RenderOptions::free_pixels`).
///     L = 1/|F| Σ_{i ∈ F} (1 − T_i)
pub fn free_opacity<T: Scalar>(view: &LossView, opacity: &[T], d_loss: f64, d_opacity: &mut [T]) -> f64 {
    if view.free_count == 0 {
        return 0.0;
    }
    let share = 1.0 / view.free_count as f64;
    let slope = T::from_f64(d_loss * share);
    let sum = sum_rows(d_opacity, view.width, |y, d_row| {
        let mut sum = 0.0;
        for (x, d) in d_row.iter_mut().enumerate() {
            let index = y * view.width + x;
            if view.classes[index] == PixelClass::Free {
                sum += opacity[index].to_f64();
                *d += slope;
            }
        }
        sum
    });
    sum * share
}
