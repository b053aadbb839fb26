// From stored parameters to the screen: the equations of `pgsag_splat::equations`. Needs `frame` and `base`.

const DILATION: f32 = 0.3;
const DETERMINANT_FLOOR: f32 = 1e-12;

fn base_at(plane: u32, i: u32) -> f32 {
    return base[plane * frame.count + i];
}

fn mean_of(i: u32) -> vec3<f32> {
    return vec3(base_at(0u, i), base_at(1u, i), base_at(2u, i));
}

// p = W mu + t
fn to_camera(mean: vec3<f32>) -> vec3<f32> {
    return vec3(
        dot(frame.row_x.xyz, mean) + frame.row_x.w,
        dot(frame.row_y.xyz, mean) + frame.row_y.w,
        dot(frame.row_z.xyz, mean) + frame.row_z.w,
    );
}

// W^T a
fn to_group(a: vec3<f32>) -> vec3<f32> {
    return frame.row_x.xyz * a.x + frame.row_y.xyz * a.y + frame.row_z.xyz * a.z;
}

struct Shape {
    // Unit quaternion w x y z, and the norm of the stored one.
    unit: vec4<f32>,
    norm: f32,
    // Columns: axes, group frame.
    rotation: mat3x3<f32>,
    scales: vec3<f32>,
}

fn shape_of(i: u32) -> Shape {
    var shape: Shape;
    let raw = vec4(base_at(6u, i), base_at(7u, i), base_at(8u, i), base_at(9u, i));
    shape.norm = max(sqrt(dot(raw, raw)), 1e-12);
    shape.unit = raw / shape.norm;
    let w = shape.unit.x;
    let x = shape.unit.y;
    let y = shape.unit.z;
    let z = shape.unit.w;
    shape.rotation = mat3x3(
        vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        vec3(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        vec3(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    );
    shape.scales = exp(vec3(base_at(3u, i), base_at(4u, i), base_at(5u, i)));
    return shape;
}

// M = R diag(s)
fn stretched(shape: Shape) -> mat3x3<f32> {
    return mat3x3(
        shape.rotation[0] * shape.scales.x,
        shape.rotation[1] * shape.scales.y,
        shape.rotation[2] * shape.scales.z,
    );
}

fn clamped_tangent(point: vec3<f32>) -> vec2<f32> {
    return clamp(point.xy / point.z, frame.tangent_low, frame.tangent_high);
}

// Rows of J W at the clamped tangent.
fn jacobian(point: vec3<f32>, tangent: vec2<f32>) -> array<vec3<f32>, 2> {
    let slope = frame.focal / point.z;
    return array<vec3<f32>, 2>(
        slope.x * (frame.row_x.xyz - tangent.x * frame.row_z.xyz),
        slope.y * (frame.row_y.xyz - tangent.y * frame.row_z.xyz),
    );
}

// (a, b, c) of the screen covariance (J W M)(J W M)^T + 0.3 I.
fn screen_covariance(rows: array<vec3<f32>, 2>, m: mat3x3<f32>) -> vec3<f32> {
    let first = rows[0] * m;
    let second = rows[1] * m;
    return vec3(dot(first, first) + DILATION, dot(first, second), dot(second, second) + DILATION);
}

// Inverse (A, B, C); zeros where there is none.
fn conic_of(covariance: vec3<f32>) -> vec3<f32> {
    let det = covariance.x * covariance.z - covariance.y * covariance.y;
    if det > DETERMINANT_FLOOR {
        return vec3(covariance.z, -covariance.y, covariance.x) / det;
    }
    return vec3(0.0);
}

fn screen_of(point: vec3<f32>) -> vec2<f32> {
    return frame.focal * point.xy / point.z + frame.center;
}

// log2 of the opacity.
fn peak_of(i: u32) -> f32 {
    return -log2(1.0 + exp(-base_at(10u, i)));
}

// Index of the smallest scale, the first of equals.
fn flat_axis(scales: vec3<f32>) -> u32 {
    if scales.z < min(scales.x, scales.y) {
        return 2u;
    }
    return select(0u, 1u, scales.y < scales.x);
}

// +1 or -1: which way the axis faces the camera.
fn facing(axis: vec3<f32>, mean: vec3<f32>) -> f32 {
    return select(1.0, -1.0, dot(axis, frame.eye - mean) < 0.0);
}
