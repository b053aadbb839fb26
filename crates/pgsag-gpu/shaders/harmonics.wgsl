// Real spherical harmonics up to degree 3 at a unit direction, band by band.

const SH_0: f32 = 0.28209479177387814;
const SH_1: f32 = 0.4886025119029199;
const SH_2A: f32 = 1.0925484305920792;
const SH_2B: f32 = 0.31539156525252005;
const SH_2C: f32 = 0.5462742152960396;
const SH_3A: f32 = 0.5900435899266435;
const SH_3B: f32 = 2.890611442640554;
const SH_3C: f32 = 0.4570457994644658;
const SH_3D: f32 = 0.3731763325901154;
const SH_3E: f32 = 1.445305721320277;

fn band_1(v: vec3<f32>) -> array<f32, 3> {
    return array<f32, 3>(-SH_1 * v.y, SH_1 * v.z, -SH_1 * v.x);
}

fn band_2(v: vec3<f32>) -> array<f32, 5> {
    return array<f32, 5>(
        SH_2A * v.x * v.y,
        -SH_2A * v.y * v.z,
        SH_2B * (2.0 * v.z * v.z - v.x * v.x - v.y * v.y),
        -SH_2A * v.x * v.z,
        SH_2C * (v.x * v.x - v.y * v.y),
    );
}

fn band_3(v: vec3<f32>) -> array<f32, 7> {
    let xx = v.x * v.x;
    let yy = v.y * v.y;
    let zz = v.z * v.z;
    return array<f32, 7>(
        -SH_3A * v.y * (3.0 * xx - yy),
        SH_3B * v.x * v.y * v.z,
        -SH_3C * v.y * (4.0 * zz - xx - yy),
        SH_3D * v.z * (2.0 * zz - 3.0 * (xx + yy)),
        -SH_3C * v.x * (4.0 * zz - xx - yy),
        SH_3E * v.z * (xx - yy),
        -SH_3A * v.x * (xx - 3.0 * yy),
    );
}
