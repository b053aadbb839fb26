//! The vector functions against scalar arithmetic, at every level of this machine.

use super::*;

#[test]
fn exp2_is_accurate_at_every_level() {
    for level in SimdLevel::available() {
        let level = level.detected().expect("available levels are detected");
        let mut worst = [0.0f64; 2];
        for step in 0..20_000 {
            let x = -9.0 + 10.0 * step as f32 / 20_000.0;
            let line = Line([x; LANES]);
            let mut out = [Line::ZERO; 2];
            at_level!(level, simd => {
                out[0].store(simd, 0, exp2(simd, line.load(simd, 0)));
                out[1].store(simd, 0, exp2_near(simd, line.load(simd, 0)));
            });
            let exact = libm::exp2(f64::from(x));
            for (worst, out) in worst.iter_mut().zip(out) {
                *worst = worst.max((f64::from(out.0[0]) / exact - 1.0).abs());
            }
        }
        assert!(worst[0] < 3e-7 && worst[1] < 3e-6, "relative errors {worst:?}");
    }
}

#[test]
fn tree_sums_every_vector() {
    #[inline(always)]
    fn run<S: Simd>(simd: S, out: &mut Line) {
        let vectors = std::array::from_fn(|i| S::f32s::from_fn(simd, |lane| (i * 100 + lane) as f32));
        sums(simd, vectors, out);
    }
    for (level, width) in [(SimdLevel::Avx512, 16), (SimdLevel::Avx2, 8), (SimdLevel::Neon, 4), (SimdLevel::Scalar, 4)]
    {
        let Some(level) = level.detected() else { continue };
        let mut out = Line::ZERO;
        at_level!(level, simd => run(simd, &mut out));
        for i in 0..16 {
            assert_eq!(out.0[i], (0..width).map(|lane| (i * 100 + lane) as f32).sum::<f32>());
        }
    }
}
