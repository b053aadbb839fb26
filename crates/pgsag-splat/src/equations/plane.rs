//! A flat Gaussian is a plane: its normal (Eq. 2), its distance (Eq. 3) and the depth where a ray meets it (Eq. 4).

use super::algebra::{Mat3, Vec3, dot, scale};
use super::number::Number;

/// |N · r| below which a ray grazes the blended plane and has no depth.
pub const GRAZING: f64 = 1e-6;

/// Which signed axis of the Gaussian is its normal: ±1 in one place, 0 in the others.
///     j* = argmin_j s_j (the first of equals),   sign so that n · (c − μ) ≥ 0
/// Neither the choice nor the sign is differentiated. Columns of `rotation` are the axes, group frame;
/// `to_eye` = c − μ, from the mean to the camera centre, group frame.
#[inline(always)]
pub fn normal_axis<T: Number>(rotation: &Mat3<T>, scales: [T; 3], to_eye: Vec3<T>) -> [T; 3] {
    let (zero, one) = (T::zero(), T::one());
    let second = T::select(scales[1].less(scales[0]), one, zero);
    let third = T::select(scales[2].less(scales[0].min(scales[1])), one, zero);
    let axis = [(one - second) * (one - third), second * (one - third), third];
    let facing = dot(normal(rotation, axis), to_eye);
    let sign = T::select(facing.less(zero), -one, one);
    scale(axis, sign)
}

/// Unit normal, group frame. Eq. 2 before blending.
///     n = R a,   a the signed axis of [`normal_axis`]
#[inline(always)]
pub fn normal<T: Number>(rotation: &Mat3<T>, axis: [T; 3]) -> Vec3<T> {
    super::algebra::mat_vec(rotation, axis)
}

/// G_R = ĝn aᵀ
#[inline(always)]
pub fn normal_grad<T: Number>(axis: [T; 3], d_normal: Vec3<T>) -> Mat3<T> {
    super::algebra::each(|i| scale(axis, d_normal[i]))
}

/// Distance from the camera centre to the Gaussian's plane, scene units, ≥ 0. Eq. 3.
///     d = −n · p
/// `normal_camera` n faces the camera, `point_camera` p the mean, both camera frame.
#[inline(always)]
pub fn distance<T: Number>(normal_camera: Vec3<T>, point_camera: Vec3<T>) -> T {
    -dot(normal_camera, point_camera)
}

/// ĝn = −p ĝd,   ĝp = −n ĝd
#[inline(always)]
pub fn distance_grad<T: Number>(normal_camera: Vec3<T>, point_camera: Vec3<T>, d_distance: T) -> (Vec3<T>, Vec3<T>) {
    (scale(point_camera, -d_distance), scale(normal_camera, -d_distance))
}

/// Depth (z) where a pixel's ray meets the blended plane, scene units; 0 where the plane is grazed, seen from behind or
/// empty. Eq. 4.
///     depth = −D / (N · r)
/// `distance` D and `normal` N as blended, not normalised (their common factor cancels); `ray` r, camera frame, z = 1.
#[inline(always)]
pub fn depth<T: Number>(distance: T, normal: Vec3<T>, ray: Vec3<T>) -> T {
    let along = dot(normal, ray);
    let faces = along.less(T::from_f64(-GRAZING));
    let value = distance / T::select(faces, -along, T::one());
    T::select(faces, value.max(T::zero()), T::zero())
}

/// ∂depth/∂D = −1 / (N · r),   ∂depth/∂N = D r / (N · r)²; 0 where [`depth`] is.
#[inline(always)]
pub fn depth_grad<T: Number>(distance: T, normal: Vec3<T>, ray: Vec3<T>, d_depth: T) -> (T, Vec3<T>) {
    let along = dot(normal, ray);
    let faces = along.less(T::from_f64(-GRAZING));
    let inverse = T::one() / T::select(faces, along, T::one());
    let d_depth = T::select(faces, d_depth, T::zero());
    let d_depth = T::select(T::zero().less(distance), d_depth, T::zero());
    (-d_depth * inverse, scale(ray, d_depth * distance * inverse * inverse))
}
