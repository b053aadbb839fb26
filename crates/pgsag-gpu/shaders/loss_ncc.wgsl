// L_mvrgb: what the plane under a pixel shows looks the same to a neighbour. A patch of 7 x 7 pixels of grey is carried by the
// homography of the blended plane at its centre and compared by squared normalised cross-correlation. Leaves the gradients of
// N and D before division by the number of patches kept, for `loss_patches`.

@group(0) @binding(1) var<storage, read> pixels: array<u32>;
@group(0) @binding(2) var<storage, read> maps: array<f32>;
@group(0) @binding(3) var<storage, read> other_pixels: array<u32>;
@group(0) @binding(4) var<storage, read> other_traits: array<u32>;
@group(0) @binding(5) var<storage, read_write> partials: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> marks: array<u32>;
@group(0) @binding(7) var<storage, read> gates: array<f32>;
@group(0) @binding(8) var<storage, read_write> centers: array<u32>;
@group(0) @binding(9) var<storage, read_write> patches: array<vec4<f32>>;

const PATCH_HALF: i32 = 3;
const SIDE: u32 = 7u;
const SAMPLES: f32 = 49.0;
// Mean squared deviation of grey below which a patch is flat, of 49 samples.
const FLAT: f32 = 49e-4;
const KEEP_BELOW: f32 = 0.9;
const EPSILON: f32 = 1e-8;

fn grey(pixel: u32) -> f32 {
    let r = f32(pixel & 0xffu);
    let g = f32((pixel >> 8u) & 0xffu);
    let b = f32((pixel >> 16u) & 0xffu);
    return (0.299 * r + 0.587 * g + 0.114 * b) / 255.0;
}

// The homography of a patch, y = A r - b (N . r) / D, linear in column and row of the sample.
struct Warp {
    corner: vec2<i32>,
    start: vec3<f32>,
    column: vec3<f32>,
    row: vec3<f32>,
}

struct Sample {
    point: vec3<f32>,
    grey: f32,
    slope: vec2<f32>,
    found: bool,
}

fn carried(normal: vec3<f32>, inverse: f32, ray: vec3<f32>) -> vec3<f32> {
    let k = dot(normal, ray) * inverse;
    return vec3<f32>(
        dot(params.between[0].xyz, ray) - params.between[0].w * k,
        dot(params.between[1].xyz, ray) - params.between[1].w * k,
        dot(params.between[2].xyz, ray) - params.between[2].w * k,
    );
}

fn warp_of(index: u32) -> Warp {
    let normal = normal_at(index);
    let inverse = 1.0 / maps[7u * params.size.z + index];
    let corner = vec2<i32>(i32(index % params.size.x), i32(index / params.size.x)) - PATCH_HALF;
    return Warp(
        corner,
        carried(normal, inverse, ray_of(vec2<f32>(corner))),
        carried(normal, inverse, vec3<f32>(params.inverse.x, 0.0, 0.0)),
        carried(normal, inverse, vec3<f32>(0.0, params.inverse.y, 0.0)),
    );
}

// What the neighbour shows at a sample of a patch.
fn sample_of(warp: Warp, column: u32, row: u32) -> Sample {
    var sample = Sample(warp.start + f32(column) * warp.column + f32(row) * warp.row, 0.0, vec2<f32>(0.0), false);
    if (!(sample.point.z >= 1e-6)) {
        return sample;
    }
    let place = params.other_lens.xy * sample.point.xy / sample.point.z + params.other_lens.zw - 0.5;
    let size = vec2<f32>(params.other_size.xy);
    if (!(all(place >= vec2<f32>(0.0)) && all(place < size - 1.0))) {
        return sample;
    }
    let corner = vec2<u32>(place);
    let tap = corner.y * params.other_size.x + corner.x;
    if ((other_traits[tap] & QUAD) == 0u) {
        return sample;
    }
    let below = tap + params.other_size.x;
    let a = grey(other_pixels[tap]);
    let b = grey(other_pixels[tap + 1u]);
    let c = grey(other_pixels[below]);
    let d = grey(other_pixels[below + 1u]);
    let fraction = place - vec2<f32>(corner);
    let top = a + fraction.x * (b - a);
    let bottom = c + fraction.x * (d - c);
    sample.grey = top + fraction.y * (bottom - top);
    sample.slope = vec2<f32>((b - a) + fraction.y * ((d - c) - (b - a)), bottom - top);
    sample.found = true;
    return sample;
}

// Both patches relative to their first grey: means, then the products own own, other other, own other of the deviations.
struct Products {
    first: vec2<f32>,
    means: vec2<f32>,
    own: f32,
    other: f32,
    both: f32,
    found: bool,
}

fn own_grey(warp: Warp, column: u32, row: u32) -> f32 {
    return grey(pixels[index_of(warp.corner + vec2<i32>(i32(column), i32(row)))]);
}

fn products_of(warp: Warp) -> Products {
    var result = Products(vec2<f32>(0.0), vec2<f32>(0.0), 0.0, 0.0, 0.0, false);
    for (var row = 0u; row < SIDE; row += 1u) {
        for (var column = 0u; column < SIDE; column += 1u) {
            let sample = sample_of(warp, column, row);
            if (!sample.found) {
                return result;
            }
            let pair = vec2<f32>(own_grey(warp, column, row), sample.grey);
            if (row + column == 0u) {
                result.first = pair;
            }
            let less = pair - result.first;
            result.means += less;
            result.own += less.x * less.x;
            result.other += less.y * less.y;
            result.both += less.x * less.y;
        }
    }
    result.means /= SAMPLES;
    result.own -= SAMPLES * result.means.x * result.means.x;
    result.other -= SAMPLES * result.means.y * result.means.y;
    result.both -= SAMPLES * result.means.x * result.means.y;
    result.found = true;
    return result;
}

// Gradient of N: moments of what pulls along the ray over the patch, since rays are linear in column and row. In w the
// squared rest of the neighbour's patch that the own one does not explain.
fn pull_of(index: u32, warp: Warp, products: Products, pull: vec2<f32>) -> vec4<f32> {
    let translation = vec3<f32>(params.between[0].w, params.between[1].w, params.between[2].w);
    let gain = products.both / products.own;
    var moments = vec3<f32>(0.0);
    var rest = 0.0;
    for (var row = 0u; row < SIDE; row += 1u) {
        for (var column = 0u; column < SIDE; column += 1u) {
            let sample = sample_of(warp, column, row);
            let pair = vec2<f32>(own_grey(warp, column, row), sample.grey) - products.first - products.means;
            let off = pair.y - gain * pair.x;
            rest += off * off;
            let d_screen = sample.slope * dot(pull, pair) * params.other_lens.xy / sample.point.z;
            let back = dot(d_screen, sample.point.xy) / sample.point.z;
            let along = -dot(vec3<f32>(d_screen, -back), translation);
            moments += along * vec3<f32>(1.0, f32(column), f32(row));
        }
    }
    let first = ray_of(vec2<f32>(warp.corner)) * moments.x;
    let steps = vec3<f32>(moments.yz * params.inverse.xy, 0.0);
    return vec4<f32>((first + steps) / maps[7u * params.size.z + index], rest);
}

// Weighted loss and 1 of a patch that is kept; its gradients are left for `apply`.
fn compare_patch(patch_index: u32, index: u32) -> vec2<f32> {
    let distance = maps[7u * params.size.z + index];
    if (!(distance > 0.0)) {
        return vec2<f32>(0.0);
    }
    let warp = warp_of(index);
    let products = products_of(warp);
    if (!products.found || products.own < FLAT || products.other < FLAT || products.both <= 0.0) {
        return vec2<f32>(0.0);
    }
    let both = products.own * products.other + EPSILON;
    if (!(1.0 - products.both * products.both / both < KEEP_BELOW)) {
        return vec2<f32>(0.0);
    }
    let weight = gates[index];
    let own_pull = -2.0 * products.both / both * weight;
    let other_pull = 2.0 * products.both * products.both * products.own / (both * both) * weight;
    let pull = pull_of(index, warp, products, vec2<f32>(own_pull, other_pull));
    patches[patch_index] = vec4<f32>(pull.xyz, -dot(normal_at(index), pull.xyz) / distance);
    centers[patch_index] = index;
    // 1 - (r x)^2 / P without the difference of nearly equal numbers.
    let loss = (products.own * pull.w + EPSILON) / both;
    return vec2<f32>(weight * loss, 1.0);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
    @builtin(subgroup_id) subgroup: u32,
    @builtin(subgroup_invocation_id) lane: u32,
    @builtin(num_subgroups) subgroups: u32,
) {
    let group = group_index(id, groups);
    if (group >= params.regions[NCC_SUM].y) {
        return;
    }
    let patch_index = group * 64u + thread;
    let index = center_of(patch_index);
    centers[patch_index] = NONE;
    var result = vec2<f32>(0.0);
    if (index != NONE) {
        result = compare_patch(patch_index, index);
    }
    store_sum(NCC_SUM, group, vec4<f32>(result, 0.0, 0.0), thread, vec3<u32>(subgroup, lane, subgroups));
}
