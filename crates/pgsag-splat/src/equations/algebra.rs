//! Small vectors and matrices over any `Number`. Matrices are arrays of rows.

use super::number::Number;

/// `[3]`
pub type Vec3<T> = [T; 3];
/// `[3, 3]`, rows.
pub type Mat3<T> = [[T; 3]; 3];

/// `[f(0), f(1), …]`. Inlined for certain, unlike `std::array::from_fn`: a call would leave the vector unit. `f` itself
/// is inlined where it is small: what is large is a function of its own.
#[inline(always)]
pub fn each<V: Copy, const N: usize>(mut f: impl FnMut(usize) -> V) -> [V; N] {
    let mut out = [f(0); N];
    for i in 1..N {
        out[i] = f(i);
    }
    out
}

/// a · b
#[inline(always)]
pub fn dot<T: Number>(a: Vec3<T>, b: Vec3<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// a × b
#[inline(always)]
pub fn cross<T: Number>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// a + b
#[inline(always)]
pub fn add<T: Number>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// a − b
#[inline(always)]
pub fn sub<T: Number>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// s a
#[inline(always)]
pub fn scale<T: Number>(a: Vec3<T>, s: T) -> Vec3<T> {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// M a
#[inline(always)]
pub fn mat_vec<T: Number>(m: &Mat3<T>, a: Vec3<T>) -> Vec3<T> {
    [dot(m[0], a), dot(m[1], a), dot(m[2], a)]
}

/// Mᵀ a
#[inline(always)]
pub fn transpose_vec<T: Number>(m: &Mat3<T>, a: Vec3<T>) -> Vec3<T> {
    each(|j| m[0][j] * a[0] + m[1][j] * a[1] + m[2][j] * a[2])
}

/// A B
#[inline(always)]
pub fn mat_mul<T: Number>(a: &Mat3<T>, b: &Mat3<T>) -> Mat3<T> {
    [transpose_vec(b, a[0]), transpose_vec(b, a[1]), transpose_vec(b, a[2])]
}

/// Mᵀ
#[inline(always)]
pub fn transpose<T: Number>(m: &Mat3<T>) -> Mat3<T> {
    each(|i| each(|j| m[j][i]))
}

/// a / ‖a‖, and ‖a‖ ≥ `floor`.
#[inline(always)]
pub fn normalized<T: Number>(a: Vec3<T>, floor: f64) -> (Vec3<T>, T) {
    let length = dot(a, a).sqrt().max(T::from_f64(floor));
    (scale(a, T::one() / length), length)
}

/// Gradient of [`normalized`]: ĝa = (ĝ − (ĝ · n) n) / ‖a‖, with n = a / ‖a‖ and its length.
#[inline(always)]
pub fn normalized_grad<T: Number>(unit: Vec3<T>, length: T, d_unit: Vec3<T>) -> Vec3<T> {
    scale(sub(d_unit, scale(unit, dot(d_unit, unit))), T::one() / length)
}
