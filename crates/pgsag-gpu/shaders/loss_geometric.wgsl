// L_mvgeo: a pixel lifted by its depth, seen by the neighbour, lifted again by the neighbour's depth there and seen by
// the reference comes back to where it started. Leaves the weights, from which NCC draws, and the gradients of both depths
// before division by the number of valid pixels. The neighbour's are added atomically, so their order is not fixed.

@group(0) @binding(1) var<storage, read> pixels: array<u32>;
@group(0) @binding(2) var<storage, read> maps: array<f32>;
@group(0) @binding(3) var<storage, read> other_traits: array<u32>;
@group(0) @binding(4) var<storage, read> other_maps: array<f32>;
@group(0) @binding(5) var<storage, read> tiles: array<u32>;
@group(0) @binding(6) var<storage, read_write> partials: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> d_depth: array<f32>;
@group(0) @binding(8) var<storage, read_write> gates: array<f32>;
@group(0) @binding(9) var<storage, read_write> links: array<FloatCell>;

// Error below which the distance turns into a parabola (Huber), pixels.
const SOFTENING_PX: f32 = 1e-2;

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
    if (group >= params.regions[GEOMETRIC_SUM].y) {
        return;
    }
    let at = pixel_of(listed_tile(group), thread);
    var sums = vec2<f32>(0.0);
    if (active_at(at)) {
        let index = index_of(at);
        gates[index] = 0.0;
        d_depth[index] = 0.0;
        sums = trip_of(at, index);
    }
    store_sum(GEOMETRIC_SUM, group, vec4<f32>(sums, 0.0, 0.0), thread, vec3<u32>(subgroup, lane, subgroups));
}

fn rotated(p: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        dot(params.between[0].xyz, p),
        dot(params.between[1].xyz, p),
        dot(params.between[2].xyz, p),
    );
}

fn rotated_back(p: vec3<f32>) -> vec3<f32> {
    return params.between[0].xyz * p.x + params.between[1].xyz * p.y + params.between[2].xyz * p.z;
}

fn translation() -> vec3<f32> {
    return vec3<f32>(params.between[0].w, params.between[1].w, params.between[2].w);
}

// Gradient of the screen position of `p` under a lens, carried to `p`.
fn screen_grad(focal: vec2<f32>, p: vec3<f32>, d_screen: vec2<f32>) -> vec3<f32> {
    let d = d_screen * focal / p.z;
    return vec3<f32>(d, -(d.x * p.x + d.y * p.y) / p.z);
}

// w times the error, and 1, of a valid pixel.
fn trip_of(at: vec2<i32>, index: u32) -> vec2<f32> {
    let nothing = vec2<f32>(0.0);
    let depth = maps[8u * params.size.z + index];
    let ray = ray_of(vec2<f32>(at));
    let there = rotated(ray * depth) + translation();
    if (!(depth > 0.0 && there.z > params.other_inverse.z)) {
        return nothing;
    }
    let place = params.other_lens.xy * there.xy / there.z + params.other_lens.zw - 0.5;
    let size = vec2<f32>(params.other_size.xy);
    if (!(all(place >= vec2<f32>(0.0)) && all(place < size - 1.0))) {
        return nothing;
    }
    let corner = vec2<u32>(place);
    let tap = corner.y * params.other_size.x + corner.x;
    if ((other_traits[tap] & QUAD) == 0u) {
        return nothing;
    }
    let base = 8u * params.other_size.z + tap;
    let below = base + params.other_size.x;
    let four = vec4<f32>(other_maps[base], other_maps[base + 1u], other_maps[below], other_maps[below + 1u]);
    if (!all(four > vec4<f32>(0.0))) {
        return nothing;
    }
    return back(at, index, ray, there, tap, place - vec2<f32>(corner), four);
}

// The way back, from the neighbour's depths about where the point fell, and the gradients along the whole trip.
fn back(
    at: vec2<i32>,
    index: u32,
    ray: vec3<f32>,
    there: vec3<f32>,
    tap: u32,
    fraction: vec2<f32>,
    four: vec4<f32>,
) -> vec2<f32> {
    let top = four.x + fraction.x * (four.y - four.x);
    let bottom = four.z + fraction.x * (four.w - four.z);
    let found = top + fraction.y * (bottom - top);
    let across = four.y - four.x;
    let slope = vec2<f32>(across + fraction.y * ((four.w - four.z) - across), bottom - top);
    let direction = there / there.z;
    let home = rotated_back(direction * found - translation());
    if (!(home.z > params.inverse.z)) {
        return vec2<f32>(0.0);
    }
    let end = params.lens.xy * home.xy / home.z + params.lens.zw;
    let miss = end - (vec2<f32>(at) + 0.5);
    let distance = sqrt(dot(miss, miss));
    let gate = params.multi.y;
    if (!(distance < gate)) {
        return vec2<f32>(0.0);
    }
    let weight = exp(-distance / gate);
    let error = select(distance - 0.5 * SOFTENING_PX, 0.5 * distance * distance / SOFTENING_PX, distance < SOFTENING_PX);
    gates[index] = weight;
    if (params.multi.x != 0.0) {
        let d_miss = miss * (weight / max(distance, SOFTENING_PX));
        let d_end = rotated(screen_grad(params.lens.xy, home, d_miss));
        let d_neighbor = dot(d_end, direction);
        let d_direction = d_end * found;
        let along = d_direction.x * direction.x + d_direction.y * direction.y;
        let d_there = screen_grad(params.other_lens.xy, there, slope * d_neighbor)
            + vec3<f32>(d_direction.xy, -along) / there.z;
        d_depth[index] = dot(rotated_back(d_there), ray);
        let rest = 1.0 - fraction;
        let below = tap + params.other_size.x;
        links_add(tap, d_neighbor * rest.x * rest.y);
        links_add(tap + 1u, d_neighbor * fraction.x * rest.y);
        links_add(below, d_neighbor * rest.x * fraction.y);
        links_add(below + 1u, d_neighbor * fraction.x * fraction.y);
    }
    return vec2<f32>(weight * error, 1.0);
}
