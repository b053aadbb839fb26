// Counts the drawn tiles that each Gaussian touches.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> base: array<f32>;
@group(0) @binding(2) var<storage, read> before: array<u32>;
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;
// Row of each Gaussian's sums plus one, set by `tally`; 0: it covers no pixel.
@group(0) @binding(4) var<storage, read_write> shown: array<u32>;
@group(0) @binding(5) var<storage, read_write> ranges: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> sizes: array<u32>;

fn tiles_of(i: u32) -> u32 {
    let point = to_camera(mean_of(i));
    if point.z <= frame.near {
        return 0u;
    }
    let rows = jacobian(point, clamped_tangent(point));
    let conic = conic_of(screen_covariance(rows, stretched(shape_of(i))));
    let exponent = conic * vec3(-0.5 * LOG2_E, -LOG2_E, -0.5 * LOG2_E);
    let e = ellipse_of(screen_of(point), exponent, peak_of(i));
    var count = 0u;
    for (var row = e.first.y; row <= e.last.y; row++) {
        count += slots_of_row(e, row).y;
    }
    return count;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = (group.y * groups.x + group.x) * 256u + lane;
    if i == 0u {
        sizes[0] = frame.count;
        sizes[6] = frame.tiles;
    }
    for (var tile = i; tile < frame.tiles; tile += groups.x * groups.y * 256u) {
        ranges[tile] = vec2(0u);
    }
    if i < frame.count {
        counts[i] = tiles_of(i);
        shown[i] = 0u;
    }
}
