//! Exact Euclidean distance to the edge of a mask (Felzenszwalb and Huttenlocher 2012), in time linear in the pixels.

use pgsag_scene::Map;
use rayon::prelude::*;

/// Larger than any squared distance in an image, and still exact in f32 sums.
const FAR: f32 = 1e12;

/// Signed distance to the mask's edge, pixels: negative inside, positive outside; ± 0.5 next to the edge, since the edge
/// runs between pixels. A mask of one value has no edge: every pixel is ± infinity.
#[must_use]
pub fn signed_distance(mask: &Map<bool>) -> Map<f32> {
    let to_inside = squared_distance_to(mask, true);
    let to_outside = squared_distance_to(mask, false);
    let signed = |(inside, (a, b)): (&bool, (&f32, &f32))| {
        let (squared, sign) = if *inside { (*b, -1.0) } else { (*a, 1.0) };
        if squared >= FAR { sign * f32::INFINITY } else { sign * (squared.sqrt() - 0.5) }
    };
    let values =
        mask.values.par_iter().zip(to_inside.par_iter().zip(to_outside.par_iter())).map(signed).collect::<Vec<f32>>();
    Map { width: mask.width, height: mask.height, values }
}

/// Squared distance of every pixel centre to the nearest pixel whose mask value is `target`.
fn squared_distance_to(mask: &Map<bool>, target: bool) -> Vec<f32> {
    let (width, height) = (mask.width as usize, mask.height as usize);
    if width == 0 || height == 0 {
        return Vec::new();
    }
    let mut columns = vec![FAR; width * height]; // transposed: [width, height]
    columns.par_chunks_mut(height).enumerate().for_each(|(x, column)| {
        let seed: Vec<f32> =
            (0..height).map(|y| if mask.values[y * width + x] == target { 0.0 } else { FAR }).collect();
        lower_envelope(&seed, column);
    });
    let mut rows = vec![FAR; width * height];
    rows.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        let seed: Vec<f32> = (0..width).map(|x| columns[x * height + y]).collect();
        lower_envelope(&seed, row);
    });
    rows
}

/// `out[q] = min over p of (q − p)² + seed[p]`, by the lower envelope of parabolas.
fn lower_envelope(seed: &[f32], out: &mut [f32]) {
    let n = seed.len();
    let mut apex = vec![0usize; n];
    let mut start = vec![f64::NEG_INFINITY; n];
    let mut top = 0;
    let meet = |p: usize, q: usize| {
        let (fp, fq) = (f64::from(seed[p]), f64::from(seed[q]));
        ((fq + (q * q) as f64) - (fp + (p * p) as f64)) / (2.0 * (q as f64 - p as f64))
    };
    for q in 1..n {
        let mut at = meet(apex[top], q);
        while top > 0 && at <= start[top] {
            top -= 1;
            at = meet(apex[top], q);
        }
        top += 1;
        apex[top] = q;
        start[top] = at;
    }
    let mut k = 0;
    for (q, value) in out.iter_mut().enumerate() {
        while k < top && start[k + 1] < q as f64 {
            k += 1;
        }
        let d = q as f32 - apex[k] as f32;
        *value = (d * d + seed[apex[k]]).min(FAR);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pgsag_scene::numbers::SplitMix64;

    fn brute_force(mask: &Map<bool>, x: i64, y: i64) -> f32 {
        let inside = mask.at(x as u32, y as u32);
        let mut best = f32::INFINITY;
        for v in 0..i64::from(mask.height) {
            for u in 0..i64::from(mask.width) {
                if mask.at(u as u32, v as u32) != inside {
                    best = best.min((((u - x).pow(2) + (v - y).pow(2)) as f32).sqrt() - 0.5);
                }
            }
        }
        if inside { -best } else { best }
    }

    #[test]
    fn distance_equals_brute_force_on_random_masks() {
        let mut stream = SplitMix64::new(3);
        for density in [0.02, 0.5, 0.98] {
            let mut mask = Map::filled(23, 17, false);
            mask.values.iter_mut().for_each(|v| *v = stream.uniform() < density);
            let signed = signed_distance(&mask);
            for y in 0..17 {
                for x in 0..23 {
                    let expected = brute_force(&mask, x, y);
                    let got = signed.at(x as u32, y as u32);
                    assert!((got - expected).abs() < 1e-4 || got == expected, "{x} {y}: {got} {expected}");
                }
            }
        }
    }

    #[test]
    fn mask_of_one_value_has_no_edge() {
        assert!(signed_distance(&Map::filled(4, 3, true)).values.iter().all(|d| *d == f32::NEG_INFINITY));
        assert!(signed_distance(&Map::filled(4, 3, false)).values.iter().all(|d| *d == f32::INFINITY));
    }
}
