//! Every gradient against differences, and the identities that the equations promise.

use std::cell::Cell;

use pgsag_scene::Pinhole;
use pgsag_scene::numbers::SplitMix64;

use super::algebra::{Mat3, cross, dot, mat_mul, normalized, normalized_grad, transpose};
use super::{activation, adam, blend, covariance, harmonics, plane, projection};
use crate::backend::ViewCamera;
use crate::proof::{gradient, numbers};
use projection::Lens;

const ROUNDS: usize = 12;
const TOLERANCE: f64 = 1e-6;

/// Calls a proof with fresh random numbers.
fn rounds(proof: impl Fn(&mut SplitMix64)) {
    let mut random = SplitMix64::new(2025);
    for _ in 0..ROUNDS {
        proof(&mut random);
    }
}

fn array<const K: usize>(values: &[f64]) -> [f64; K] {
    std::array::from_fn(|i| values[i])
}

fn matrix(values: &[f64]) -> Mat3<f64> {
    std::array::from_fn(|i| array(&values[3 * i..]))
}

/// Σ a b of flat arrays: turns a function with many outputs into a scalar one.
fn inner(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn lens() -> Lens<f64> {
    let (sin, cos) = (libm::sin(0.4), libm::cos(0.4));
    Lens::new(&ViewCamera {
        pinhole: Pinhole { width: 640, height: 480, fx: 700.0, fy: 650.0, cx: 300.0, cy: 255.0 },
        rotation: [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]],
        translation: [0.3, -0.2, 0.5],
        near: 0.1,
    })
}

/// A random rotation and three scales of different sizes.
fn ellipsoid(random: &mut SplitMix64) -> (Mat3<f64>, [f64; 3]) {
    let (unit, _) = activation::unit_quaternion(array(&numbers(random, 4, -1.0, 1.0)));
    (covariance::rotation(unit), array(&numbers(random, 3, 0.1, 0.9)))
}

#[test]
fn opacity_grad_matches_differences() {
    rounds(|random| {
        let at = numbers(random, 1, -4.0, 4.0);
        let d = activation::opacity_grad(activation::opacity(at[0]), 1.7);
        gradient(|x| 1.7 * activation::opacity(x[0]), &at, &[d], TOLERANCE);
    });
}

#[test]
fn scales_grad_matches_differences() {
    rounds(|random| {
        let (at, d) = (numbers(random, 3, -3.0, 1.0), numbers(random, 3, -1.0, 1.0));
        let formula = activation::scales_grad(activation::scales(array(&at)), array(&d));
        gradient(|x| inner(&activation::scales(array(x)), &d), &at, &formula, TOLERANCE);
    });
}

#[test]
fn unit_quaternion_grad_matches_differences() {
    rounds(|random| {
        let (at, d) = (numbers(random, 4, 0.2, 1.5), numbers(random, 4, -1.0, 1.0));
        let (unit, norm) = activation::unit_quaternion(array(&at));
        let formula = activation::unit_quaternion_grad(unit, norm, array(&d));
        gradient(|x| inner(&activation::unit_quaternion(array(x)).0, &d), &at, &formula, TOLERANCE);
    });
}

#[test]
fn normalized_grad_matches_differences() {
    rounds(|random| {
        let (at, d) = (numbers(random, 3, 0.2, 1.5), numbers(random, 3, -1.0, 1.0));
        let (unit, length) = normalized(array(&at), 1e-12);
        let formula = normalized_grad(unit, length, array(&d));
        gradient(|x| inner(&normalized(array(x), 1e-12).0, &d), &at, &formula, TOLERANCE);
    });
}

#[test]
fn rotation_grad_matches_differences() {
    rounds(|random| {
        let (at, d) = (numbers(random, 4, -1.0, 1.0), numbers(random, 9, -1.0, 1.0));
        // The formula is that of a unit quaternion: it is proven together with the normalisation.
        let (unit, norm) = activation::unit_quaternion(array(&at));
        let d_unit = covariance::rotation_grad(unit, &matrix(&d));
        let formula = activation::unit_quaternion_grad(unit, norm, d_unit);
        let value = |x: &[f64]| inner(covariance::rotation(activation::unit_quaternion(array(x)).0).as_flattened(), &d);
        gradient(value, &at, &formula, TOLERANCE);
    });
}

#[test]
fn rotation_is_orthogonal_and_right_handed() {
    rounds(|random| {
        let (r, _) = ellipsoid(random);
        let product = mat_mul(&r, &transpose(&r));
        for (i, j) in (0..9).map(|k| (k / 3, k % 3)) {
            assert!((product[i][j] - f64::from(u8::from(i == j))).abs() < 1e-14);
        }
        assert!((dot(cross(r[0], r[1]), r[2]) - 1.0).abs() < 1e-14);
    });
}

#[test]
fn covariance_is_symmetric_and_positive() {
    rounds(|random| {
        let (r, s) = ellipsoid(random);
        let sigma = covariance::covariance(&r, s);
        for axis in 0..3 {
            // A column of R is an eigenvector with the eigenvalue s².
            let column: [f64; 3] = std::array::from_fn(|i| r[i][axis]);
            let image: [f64; 3] = std::array::from_fn(|i| dot(sigma[i], column));
            for i in 0..3 {
                assert!((image[i] - s[axis] * s[axis] * column[i]).abs() < 1e-14);
                assert!((sigma[i][axis] - sigma[axis][i]).abs() < 1e-16);
            }
        }
    });
}

#[test]
fn covariance_grad_matches_differences() {
    rounds(|random| {
        let at = numbers(random, 12, -1.0, 1.0);
        let half = matrix(&numbers(random, 9, -1.0, 1.0));
        let d: Mat3<f64> = std::array::from_fn(|i| std::array::from_fn(|j| half[i][j] + half[j][i]));
        let (d_rotation, d_scales) = covariance::covariance_grad(&matrix(&at), array(&at[9..]), &d);
        let value =
            |x: &[f64]| inner(covariance::covariance(&matrix(x), array(&x[9..])).as_flattened(), d.as_flattened());
        gradient(value, &at, &[d_rotation.as_flattened(), &d_scales].concat(), TOLERANCE);
    });
}

/// Points within the clamp, beyond it to each side, and beyond two at once. Limits are about ±0.6.
const POINTS: [[f64; 3]; 6] =
    [[0.3, -0.2, 2.0], [2.6, 0.1, 2.0], [-2.4, 0.4, 2.0], [0.2, 1.9, 2.0], [0.1, -2.1, 2.0], [3.0, 2.2, 2.5]];

#[test]
fn screen_grad_matches_differences() {
    let lens = lens();
    for point in POINTS {
        let d = [0.7, -0.4];
        let formula = projection::screen_grad(&lens, point, d);
        gradient(|x| inner(&projection::screen(&lens, array(x)), &d), &point, &formula, TOLERANCE);
    }
}

#[test]
fn to_camera_grad_matches_differences() {
    let lens = lens();
    let d = [0.7, -0.4, 0.2];
    let formula = projection::to_camera_grad(&lens, d);
    gradient(|x| inner(&projection::to_camera(&lens, array(x)), &d), &[0.5, -1.0, 2.0], &formula, TOLERANCE);
}

#[test]
fn screen_covariance_grad_matches_differences_also_beyond_the_clamp() {
    let lens = lens();
    let clamped = Cell::new(0);
    for point in POINTS {
        rounds(|random| {
            let (r, s) = ellipsoid(random);
            let sigma = covariance::covariance(&r, s);
            let d = numbers(random, 3, -1.0, 1.0);
            let tangent = point[0] / point[2];
            clamped.set(clamped.get() + usize::from(tangent > lens.tangent_high[0] || tangent < lens.tangent_low[0]));
            let (d_point, d_sigma) = projection::screen_covariance_grad(&lens, point, &sigma, array(&d));
            let symmetric = |x: &[f64]| -> Mat3<f64> {
                let m = matrix(x);
                std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (m[i][j] + m[j][i])))
            };
            let value = |x: &[f64]| inner(&projection::screen_covariance(&lens, array(x), &symmetric(&x[3..])), &d);
            let at = [&point[..], sigma.as_flattened()].concat();
            // The two gradients differ in size by orders: each is measured by its own.
            let fixed = |x: &[f64]| value(&[x, sigma.as_flattened()].concat());
            gradient(fixed, &point, &d_point, TOLERANCE);
            gradient(|x| value(&[&point[..], x].concat()), &at[3..], d_sigma.as_flattened(), TOLERANCE);
        });
    }
    assert!(clamped.get() >= 3 * ROUNDS);
}

#[test]
fn screen_covariance_is_the_jacobian_of_the_screen_position() {
    let lens = lens();
    rounds(|random| {
        let mean: [f64; 3] = array(&numbers(random, 3, -0.2, 0.2));
        let mean = [mean[0], mean[1], mean[2] + 2.5];
        let (r, s) = ellipsoid(random);
        let point = projection::to_camera(&lens, mean);
        let found = projection::screen_covariance(&lens, point, &covariance::covariance(&r, s));
        // By differences of the exact projection along the ellipsoid's axes.
        let mut sum = [projection::DILATION_PX2, 0.0, projection::DILATION_PX2];
        for axis in 0..3 {
            let step = 1e-6;
            let at = |by: f64| {
                let moved = std::array::from_fn(|i| mean[i] + by * r[i][axis] * s[axis]);
                projection::screen(&lens, projection::to_camera(&lens, moved))
            };
            let (a, b) = (at(step), at(-step));
            let slope = [(a[0] - b[0]) / (2.0 * step), (a[1] - b[1]) / (2.0 * step)];
            sum = [sum[0] + slope[0] * slope[0], sum[1] + slope[0] * slope[1], sum[2] + slope[1] * slope[1]];
        }
        for i in 0..3 {
            assert!((found[i] - sum[i]).abs() < 1e-4 * found[0].max(found[2]), "{found:?} {sum:?}");
        }
    });
}

#[test]
fn conic_grad_matches_differences() {
    rounds(|random| {
        let at = [random.range(1.0, 2.0), random.range(-0.8, 0.8), random.range(1.0, 2.0)];
        let d = numbers(random, 3, -1.0, 1.0);
        let formula = projection::conic_grad(projection::conic(at), array(&d));
        gradient(|x| inner(&projection::conic(array(x)), &d), &at, &formula, TOLERANCE);
    });
}

#[test]
fn extent_is_the_box_of_the_level_set() {
    rounds(|random| {
        let covariance = [random.range(1.0, 9.0), random.range(-0.9, 0.9), random.range(1.0, 9.0)];
        let conic = projection::conic(covariance);
        let (opacity, cut) = (0.8, 1.0 / 255.0);
        let [ex, ey] = projection::extent(covariance, 2.0 * libm::log(opacity / cut));
        let alpha = |x: f64, y: f64| opacity * blend::falloff(conic, [x, y]);
        // The extreme point in x lies at y = −B x / C, that in y at x = −B y / A; both have exactly the cut.
        assert!((alpha(ex, -conic[1] / conic[2] * ex) - cut).abs() < 1e-12);
        assert!((alpha(-conic[1] / conic[0] * ey, ey) - cut).abs() < 1e-12);
        for i in -20..=20 {
            assert!(alpha(ex * 1.0001, 0.5 * f64::from(i)) < cut && alpha(0.5 * f64::from(i), ey * 1.0001) < cut);
        }
        assert!(projection::radius(covariance) >= 3.0 * covariance[0].max(covariance[2]).sqrt() - 1e-12);
    });
}

#[test]
fn harmonics_are_orthonormal() {
    // Gauss-Legendre would be finer; midpoints in cos θ and φ are enough for degree 6 at 1e-4.
    let (rows, columns) = (400, 64);
    let mut sums = [[0.0; 16]; 16];
    for i in 0..rows {
        let z = -1.0 + (2.0 * f64::from(i) + 1.0) / f64::from(rows);
        let ring = (1.0 - z * z).sqrt();
        for j in 0..columns {
            let angle = std::f64::consts::TAU * f64::from(j) / f64::from(columns);
            let y = harmonics::basis([ring * libm::cos(angle), ring * libm::sin(angle), z], 3);
            for (a, b) in (0..256).map(|k| (k / 16, k % 16)) {
                sums[a][b] += y[a] * y[b] * 4.0 * std::f64::consts::PI / f64::from(rows * columns);
            }
        }
    }
    for (a, b) in (0..256).map(|k| (k / 16, k % 16)) {
        assert!((sums[a][b] - f64::from(u8::from(a == b))).abs() < 1e-4, "{a} {b}: {}", sums[a][b]);
    }
}

#[test]
fn color_grad_matches_differences_for_every_degree() {
    for degree in 0..=3u8 {
        let count = harmonics::basis_count(degree);
        rounds(|random| {
            let d = numbers(random, 3, -1.0, 1.0);
            let at = [numbers(random, 3, -1.0, 1.0), numbers(random, 3 * count, -0.15, 0.15)].concat();
            let coefficients = |x: &[f64]| x[3..].chunks(3).map(array).collect::<Vec<[f64; 3]>>();
            // The gradient of the direction takes its three coordinates as independent, as the basis does.
            let value = |x: &[f64]| inner(&harmonics::color(&coefficients(x), array(x), degree), &d);
            let rgb = harmonics::color(&coefficients(&at), array(&at), degree);
            let (d_coefficients, d_direction) =
                harmonics::color_grad(&coefficients(&at), array(&at), degree, rgb, array(&d));
            let formula = [&d_direction[..], d_coefficients[..count].as_flattened()].concat();
            gradient(value, &at, &formula, TOLERANCE);
        });
    }
}

#[test]
fn color_below_black_has_no_gradient() {
    let coefficients = [[-3.0, 0.5, 0.0]];
    let rgb = harmonics::color(&coefficients, [0.0, 0.0, 1.0], 0);
    assert_eq!(rgb[0], 0.0);
    let (d, _) = harmonics::color_grad(&coefficients, [0.0, 0.0, 1.0], 0, rgb, [1.0; 3]);
    assert_eq!(d[0], [0.0, harmonics::C0, harmonics::C0]);
}

#[test]
fn direction_grad_matches_differences() {
    rounds(|random| {
        let (at, d) = (numbers(random, 3, 1.0, 2.0), numbers(random, 3, -1.0, 1.0));
        let eye = [0.1, -0.3, 0.2];
        let (direction, distance) = harmonics::direction(array(&at), eye);
        let formula = harmonics::direction_grad(direction, distance, array(&d));
        gradient(|x| inner(&harmonics::direction(array(x), eye).0, &d), &at, &formula, TOLERANCE);
    });
}

#[test]
fn normal_grad_matches_differences_and_faces_the_eye() {
    rounds(|random| {
        let (r, s) = ellipsoid(random);
        let to_eye = array(&numbers(random, 3, -1.0, 1.0));
        let axis = plane::normal_axis(&r, s, to_eye);
        let normal = plane::normal(&r, axis);
        assert!(dot(normal, to_eye) >= 0.0 && (dot(normal, normal) - 1.0).abs() < 1e-12);
        let smallest = (0..3).min_by(|&a, &b| s[a].total_cmp(&s[b])).unwrap();
        assert_eq!(axis.map(f64::abs)[smallest], 1.0);
        let d = array(&numbers(random, 3, -1.0, 1.0));
        let formula = plane::normal_grad(axis, d);
        let value = |x: &[f64]| dot(plane::normal(&matrix(x), plane::normal_axis(&matrix(x), s, to_eye)), d);
        gradient(value, r.as_flattened(), formula.as_flattened(), TOLERANCE);
    });
}

#[test]
fn normal_of_equal_scales_is_the_first_axis() {
    let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let axis = |scales| plane::normal_axis(&identity, scales, [1.0, 1.0, 1.0]);
    assert_eq!(axis([0.5, 0.5, 0.5]), [1.0, 0.0, 0.0]);
    assert_eq!(axis([0.9, 0.5, 0.5]), [0.0, 1.0, 0.0]);
    assert_eq!(axis([0.5, 0.9, 0.5]), [1.0, 0.0, 0.0]);
    assert_eq!(axis([0.5, 0.5, 0.4]), [0.0, 0.0, 1.0]);
}

#[test]
fn distance_grad_matches_differences() {
    rounds(|random| {
        let at = numbers(random, 6, -1.0, 1.0);
        let (d_n, d_p) = plane::distance_grad(array(&at), array(&at[3..]), 1.3);
        gradient(|x| 1.3 * plane::distance(array(x), array(&x[3..])), &at, &[d_n, d_p].concat(), TOLERANCE);
    });
}

#[test]
fn depth_grad_matches_differences() {
    let ray = [0.2, -0.1, 1.0];
    rounds(|random| {
        let at = [random.range(1.0, 3.0), random.range(-0.3, 0.3), random.range(-0.3, 0.3), random.range(-0.9, -0.5)];
        let (d_d, d_n) = plane::depth_grad(at[0], array(&at[1..]), ray, 0.8);
        let value = |x: &[f64]| 0.8 * plane::depth(x[0], array(&x[1..]), ray);
        gradient(value, &at, &[&[d_d], &d_n[..]].concat(), TOLERANCE);
    });
}

#[test]
fn depth_meets_the_plane_and_is_guarded() {
    let (normal, ray): ([f64; 3], [f64; 3]) = ([0.1, 0.2, -0.7], [0.2, -0.1, 1.0]);
    let depth = plane::depth(2.0, normal, ray);
    assert!((dot(normal, ray) * depth + 2.0).abs() < 1e-14);
    for (distance, normal) in [(2.0, [0.0, 0.0, -1e-7]), (2.0, [0.1, 0.2, 0.7]), (0.0, [0.0; 3])] {
        assert_eq!(plane::depth(distance, normal, ray), 0.0);
        assert_eq!(plane::depth_grad(distance, normal, ray, 1.0).1, [0.0; 3]);
    }
}

#[test]
fn falloff_grad_matches_differences() {
    rounds(|random| {
        let at = [
            random.range(0.3, 1.0),
            random.range(-0.2, 0.2),
            random.range(0.3, 1.0),
            random.range(-1.5, 1.5),
            random.range(-1.5, 1.5),
        ];
        let falloff = blend::falloff(array(&at), array(&at[3..]));
        let (d_screen, d_conic) = blend::falloff_grad(array(&at), array(&at[3..]), falloff, 0.9);
        let value = |x: &[f64]| 0.9 * blend::falloff(array(x), array(&x[3..]));
        gradient(value, &at, &[&d_conic[..], &d_screen].concat(), TOLERANCE);
    });
}

#[test]
fn alpha_grad_matches_differences_and_ends_at_the_ceiling() {
    let (d_opacity, d_falloff) = blend::alpha_grad(0.7, 0.6, 1.1);
    gradient(|x| 1.1 * blend::alpha(x[0], x[1]), &[0.7, 0.6], &[d_opacity, d_falloff], TOLERANCE);
    assert_eq!(blend::alpha(0.999, 0.999), blend::ALPHA_MAX);
    assert_eq!(blend::alpha_grad(0.999, 0.999, 1.0), (0.0, 0.0));
}

#[test]
fn over_grad_matches_differences() {
    const LAYERS: usize = 5;
    rounds(|random| {
        // Three channels and an alpha per layer, blended front to back over a grey background.
        let at: Vec<f64> =
            (0..LAYERS).flat_map(|_| [numbers(random, 3, -1.0, 1.0), numbers(random, 1, 0.1, 0.8)].concat()).collect();
        let (d, ground) = ([0.4, -0.7, 0.9], [0.2, 0.3, -0.1]);
        let forward = |x: &[f64]| {
            let (mut out, mut transmittance, mut before) = ([0.0; 3], 1.0, Vec::new());
            for layer in x.chunks(4) {
                before.push(transmittance);
                transmittance = blend::over(&mut out, &array(layer), layer[3], transmittance);
            }
            blend::over(&mut out, &ground, 1.0, transmittance);
            (inner(&out, &d), before)
        };
        let (_, before) = forward(&at);
        let (mut behind, mut formula) = (ground, vec![0.0; at.len()]);
        for i in (0..LAYERS).rev() {
            let layer = &at[4 * i..];
            let (d_color, d_alpha) = blend::over_grad(&array(layer), layer[3], before[i], &mut behind, &d);
            formula[4 * i..4 * i + 3].copy_from_slice(&d_color);
            formula[4 * i + 3] = d_alpha;
        }
        gradient(|x| forward(x).0, &at, &formula, TOLERANCE);
    });
}

#[test]
fn blending_weights_are_a_partition_of_unity() {
    rounds(|random| {
        let (mut out, mut transmittance) = ([0.0], 1.0);
        for alpha in numbers(random, 20, 0.0, 0.99) {
            transmittance = blend::over(&mut out, &[1.0], alpha, transmittance);
        }
        assert!((out[0] + transmittance - 1.0).abs() < 1e-14);
    });
}

#[test]
fn load_grad_matches_differences_and_peaks_at_the_cut() {
    for alpha in [0.0005, 1.0 / 255.0, 0.006, 0.009] {
        let formula = blend::load_grad(alpha, 0.5);
        // In units of a thousandth, where the sigmoid is of order 1.
        gradient(|x| 0.5 * blend::load(1e-3 * x[0]), &[1e3 * alpha], &[1e-3 * formula], TOLERANCE);
    }
    assert!((blend::load_grad(1.0 / 255.0, 1.0_f64) - 250.0).abs() < 1e-9);
}

#[test]
fn adam_finds_the_bottom_of_a_bowl() {
    let (mut x, mut first, mut second) = (3.0, 0.0, 0.0);
    for count in 1..=4000 {
        let rate = 0.05 * (1.0 - f64::from(count) / 4001.0);
        [x, first, second] = adam::step(x, first, second, 2.0 * (x - 1.0), rate, adam::corrections(count));
    }
    assert!((x - 1.0).abs() < 1e-3, "{x}");
}

#[test]
fn single_precision_agrees_with_double() {
    // The same source in f32: no constant or guard may be lost on the way.
    let lens = lens();
    let narrow = Lens::<f32>::new(&ViewCamera {
        pinhole: Pinhole { width: 640, height: 480, fx: 700.0, fy: 650.0, cx: 300.0, cy: 255.0 },
        rotation: lens.rotation,
        translation: lens.translation,
        near: 0.1,
    });
    rounds(|random| {
        let (r, s) = ellipsoid(random);
        let point: [f64; 3] = [random.range(-0.5, 0.5), random.range(-0.5, 0.5), 2.0];
        let wide = projection::conic(projection::screen_covariance(&lens, point, &covariance::covariance(&r, s)));
        let (r, s) = (r.map(|row| row.map(|v| v as f32)), s.map(|v| v as f32));
        let sigma = covariance::covariance(&r, s);
        let found = projection::conic(projection::screen_covariance(&narrow, point.map(|v| v as f32), &sigma));
        for i in 0..3 {
            assert!((f64::from(found[i]) - wide[i]).abs() < 1e-4 * wide[0].max(wide[2]), "{found:?} {wide:?}");
        }
    });
}
