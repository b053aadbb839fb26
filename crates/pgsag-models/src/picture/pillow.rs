//! Bilinear resizing in bytes, bit for bit as Pillow does it: a triangle as wide as a new pixel, weights of 22 bits, along
//! rows first, rounded to bytes between the two passes.

/// Bits behind the point of a weight.
const BITS: u32 = 22;

/// Which old pixels a new one is made of: the first, and the weights from there on.
fn weights(old: u32, new: u32) -> Vec<(usize, Vec<i64>)> {
    let scale = f64::from(old) / f64::from(new);
    let support = scale.max(1.0);
    let of = |place: u32| {
        let center = (f64::from(place) + 0.5) * scale;
        let first = (center - support + 0.5).max(0.0) as u32;
        let last = ((center + support + 0.5) as u32).min(old);
        let triangle = |at: u32| (1.0 - ((f64::from(at) - center + 0.5) / support).abs()).max(0.0);
        let sum: f64 = (first..last).map(triangle).sum();
        let whole =
            |at: u32| (0.5 + triangle(at) / if sum == 0.0 { 1.0 } else { sum } * f64::from(1u32 << BITS)) as i64;
        (first as usize, (first..last).map(whole).collect())
    };
    (0..new).map(of).collect()
}

fn rounded(sum: i64) -> u8 {
    ((sum + (1 << (BITS - 1))) >> BITS).clamp(0, 255) as u8
}

/// Rows of `[u8; 3]`, `size` wide and high, at another size.
pub(super) fn resize(pixels: &[[u8; 3]], size: [u32; 2], new: [u32; 2]) -> Vec<u8> {
    let (old_width, height) = (size[0] as usize, size[1] as usize);
    let width = new[0] as usize;
    let mut narrow: Vec<[u8; 3]> = Vec::with_capacity(width * height);
    if size[0] == new[0] {
        narrow.extend_from_slice(pixels);
    } else {
        let across = weights(size[0], new[0]);
        for row in pixels.chunks_exact(old_width) {
            narrow.extend(across.iter().map(|(first, weights)| {
                let mut sums = [0i64; 3];
                for (pixel, weight) in row[*first..].iter().zip(weights) {
                    (0..3).for_each(|c| sums[c] += i64::from(pixel[c]) * weight);
                }
                sums.map(rounded)
            }));
        }
    }
    if size[1] == new[1] {
        return narrow.into_iter().flatten().collect();
    }
    let mut out = Vec::with_capacity(3 * width * new[1] as usize);
    let mut sums = vec![[0i64; 3]; width];
    for (first, weights) in weights(size[1], new[1]) {
        sums.fill([0; 3]);
        for (row, weight) in narrow[first * width..].chunks_exact(width).zip(&weights) {
            for (sum, pixel) in sums.iter_mut().zip(row) {
                (0..3).for_each(|c| sum[c] += i64::from(pixel[c]) * weight);
            }
        }
        out.extend(sums.iter().flat_map(|sums| sums.map(rounded)));
    }
    out
}
