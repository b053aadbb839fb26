// Writes the records of the Gaussians that touch a drawn tile, packed, in the order of the cloud.

override COLOR: u32 = 1u;
override PLANES: u32 = 1u;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> base: array<f32>;
@group(0) @binding(2) var<storage, read> sh_1: array<f32>;
@group(0) @binding(3) var<storage, read> sh_2: array<f32>;
@group(0) @binding(4) var<storage, read> sh_3: array<f32>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;
@group(0) @binding(6) var<storage, read> slots: array<u32>;
@group(0) @binding(7) var<storage, read_write> records: array<vec4<f32>>;
// Bits of the depth, which order as depths do.
@group(0) @binding(8) var<storage, read_write> keys: array<u32>;
@group(0) @binding(9) var<storage, read_write> gaussians: array<u32>;
@group(0) @binding(10) var<storage, read_write> pair_counts: array<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = (group.y * groups.x + group.x) * 256u + lane;
    if i >= frame.count || counts[i] == 0u {
        return;
    }
    let slot = slots[i];
    let mean = mean_of(i);
    let point = to_camera(mean);
    let shape = shape_of(i);
    let covariance = screen_covariance(jacobian(point, clamped_tangent(point)), stretched(shape));
    let conic = conic_of(covariance);
    let middle = 0.5 * (covariance.x + covariance.z);
    let det = covariance.x * covariance.z - covariance.y * covariance.y;
    let radius = 3.0 * sqrt(middle + sqrt(max(middle * middle - det, 0.0)));
    let axis = flat_axis(shape.scales);
    records[4u * slot] = vec4(screen_of(point), peak_of(i), shape.scales[axis]);
    records[4u * slot + 1u] = vec4(conic * vec3(-0.5 * LOG2_E, -LOG2_E, -0.5 * LOG2_E), radius);
    var rgb = vec3(0.0);
    if COLOR != 0u {
        rgb = max(color_of(i, (mean - frame.eye) / max(length(mean - frame.eye), 1e-12)), vec3(0.0));
    }
    var normal = vec3(0.0);
    var distance = 0.0;
    if PLANES != 0u {
        let direction = shape.rotation[axis] * facing(shape.rotation[axis], mean);
        normal = vec3(dot(frame.row_x.xyz, direction), dot(frame.row_y.xyz, direction), dot(frame.row_z.xyz, direction));
        distance = -dot(normal, point);
    }
    records[4u * slot + 2u] = vec4(rgb, distance);
    records[4u * slot + 3u] = vec4(normal, 0.0);
    keys[slot] = bitcast<u32>(point.z);
    gaussians[slot] = i;
    pair_counts[slot] = counts[i];
}
