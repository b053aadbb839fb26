// L_ban (Eq. 8): the blended normal N agrees with the normal of the depth map times the opacity, less so at edges.
// Leaves what each pixel gives to the depths right, left, above and below, for `loss_slant`.

@group(0) @binding(1) var<storage, read> pixels: array<u32>;
@group(0) @binding(2) var<storage, read> traits: array<u32>;
@group(0) @binding(3) var<storage, read> maps: array<f32>;
@group(0) @binding(4) var<storage, read_write> grads: array<f32>;
@group(0) @binding(5) var<storage, read> tiles: array<u32>;
@group(0) @binding(6) var<storage, read_write> scratch: array<f32>;
@group(0) @binding(7) var<storage, read_write> partials: array<vec4<f32>>;

// Difference of normals below which the absolute value turns into a parabola (Huber).
const SOFTENING: f32 = 1e-3;
// Cross product of differences below which there is no normal, relative to squared depth.
const DEGENERATE: f32 = 1e-12;

fn depth_at(at: vec2<i32>) -> f32 {
    return select(0.0, maps[8u * params.size.z + index_of(at)], is_active(pixels[index_of(at)]));
}

fn weight_of(index: u32) -> f32 {
    var weight = 1.0;
    if ((pixels[index] & EDGE) != 0u) {
        weight -= params.normal.y;
    }
    if (params.flags.y == 1u) {
        let smooth_part = 1.0 - texture_of(index);
        weight *= smooth_part * smooth_part;
    }
    return weight;
}

// Norm of a difference in w and its gradient: softened L1, or squared L2 as printed.
fn norm_of(difference: vec3<f32>) -> vec4<f32> {
    if (params.flags.x == 1u) {
        return vec4<f32>(2.0 * difference, dot(difference, difference));
    }
    let size = abs(difference);
    let inner = 0.5 * size * size / SOFTENING;
    let part = select(size - 0.5 * SOFTENING, inner, size < vec3<f32>(SOFTENING));
    return vec4<f32>(clamp(difference / SOFTENING, vec3<f32>(-1.0), vec3<f32>(1.0)), part.x + part.y + part.z);
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
    @builtin(subgroup_id) subgroup: u32,
    @builtin(subgroup_invocation_id) lane: u32,
    @builtin(num_subgroups) subgroups: u32,
) {
    let group = group_index(id, groups);
    if (group >= params.regions[NORMAL_SUM].y) {
        return;
    }
    let at = pixel_of(listed_tile(group), thread);
    var loss = 0.0;
    if (active_at(at)) {
        loss = compare_pixel(at);
    }
    store_sum(NORMAL_SUM, group, vec4<f32>(loss, 0.0, 0.0, 0.0), thread, vec3<u32>(subgroup, lane, subgroups));
}

fn compare_pixel(at: vec2<i32>) -> f32 {
    let index = index_of(at);
    let plane = params.size.z;
    var gives = vec4<f32>(0.0);
    var loss = 0.0;
    let last = vec2<i32>(params.size.xy) - 1;
    if (all(at > vec2<i32>(0)) && all(at < last)) {
        let middle = depth_at(at);
        let depths = vec4<f32>(
            depth_at(at + vec2<i32>(1, 0)),
            depth_at(at - vec2<i32>(1, 0)),
            depth_at(at - vec2<i32>(0, 1)),
            depth_at(at + vec2<i32>(0, 1)),
        );
        let place = vec2<f32>(at);
        let right = ray_of(place + vec2<f32>(1.0, 0.0));
        let left = ray_of(place - vec2<f32>(1.0, 0.0));
        let above = ray_of(place - vec2<f32>(0.0, 1.0));
        let below = ray_of(place + vec2<f32>(0.0, 1.0));
        let across = right * depths.x - left * depths.y;
        let upward = above * depths.z - below * depths.w;
        let raw = cross(across, upward);
        let size = sqrt(dot(raw, raw));
        let least = min(middle, min(min(depths.x, depths.y), min(depths.z, depths.w)));
        if (least > 0.0 && size > DEGENERATE * middle * middle) {
            let unit = raw / size;
            let opacity = maps[3u * plane + index];
            let weight = weight_of(index);
            let norm = norm_of(unit * opacity - normal_at(index));
            loss = weight * norm.w;
            let d_difference = norm.xyz * (weight * params.normal.x);
            let d_unit = d_difference * opacity;
            let d_raw = (d_unit - unit * dot(d_unit, unit)) / size;
            let d_across = cross(upward, d_raw);
            let d_upward = cross(d_raw, across);
            gives = vec4<f32>(dot(d_across, right), -dot(d_across, left), dot(d_upward, above), -dot(d_upward, below));
            grads[4u * plane + index] -= d_difference.x;
            grads[5u * plane + index] -= d_difference.y;
            grads[6u * plane + index] -= d_difference.z;
        }
    }
    scratch[index] = gives.x;
    scratch[plane + index] = gives.y;
    scratch[2u * plane + index] = gives.z;
    scratch[3u * plane + index] = gives.w;
    return loss;
}
