// 1 - SSIM between the exposed render and the photograph, both black outside the mask: its value, and its derivatives by the
// sums of every window, for `loss_color`. One channel per run of groups.

@group(0) @binding(1) var<storage, read> pixels: array<u32>;
@group(0) @binding(2) var<storage, read> maps: array<f32>;
@group(0) @binding(3) var<storage, read> tiles: array<u32>;
@group(0) @binding(4) var<storage, read_write> scratch: array<f32>;
@group(0) @binding(5) var<storage, read_write> partials: array<vec4<f32>>;

const C1: f32 = 1e-4;
const C2: f32 = 9e-4;

var<workgroup> shown: array<vec2<f32>, 676>;
var<workgroup> rows: array<vec4<f32>, 416>;

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
    if (group >= params.regions[SSIM_SUM].y) {
        return;
    }
    let count = params.regions[SSIM_SUM].y / 3u;
    let channel = group / count;
    var corner = frame_tile(group % count);
    if (params.flags.z == 0u) {
        corner = listed_tile(group % count);
    }
    for (var i = thread; i < WIDE * WIDE; i += THREADS) {
        shown[i] = pair_at(corner + vec2<i32>(i32(i % WIDE), i32(i / WIDE)) - HALF, channel);
    }
    workgroupBarrier();
    for (var i = thread; i < WIDE * TILE; i += THREADS) {
        let first = i / TILE * WIDE + i % TILE;
        var sum = vec4<f32>(0.0);
        for (var tap = 0; tap <= 2 * HALF; tap += 1) {
            let pair = shown[first + u32(tap)];
            sum += WINDOW[abs(tap - HALF)] * vec4<f32>(pair, dot(pair, pair), pair.x * pair.y);
        }
        rows[i] = sum;
    }
    workgroupBarrier();
    var means = vec4<f32>(0.0);
    for (var tap = 0; tap <= 2 * HALF; tap += 1) {
        means += WINDOW[abs(tap - HALF)] * rows[thread + u32(tap) * TILE];
    }
    let at = pixel_of(corner, thread);
    var loss = 0.0;
    if (counts_at(at)) {
        let xy = means.x * means.y;
        let both = means.x * means.x + means.y * means.y;
        let a1 = 2.0 * xy + C1;
        let a2 = 2.0 * (means.w - xy) + C2;
        let b1 = both + C1;
        let b2 = means.z - both + C2;
        let inverse = 1.0 / (b1 * b2);
        let s = a1 * a2 * inverse;
        let d_square = -s * b1 * inverse;
        let d_product = 2.0 * a1 * inverse;
        let d_mean = 2.0 * means.y * a2 * inverse - 2.0 * means.x * s * b2 * inverse;
        loss = 1.0 - s;
        let place = 3u * channel * params.size.z + index_of(at);
        scratch[place] = d_mean - 2.0 * means.x * d_square - means.y * d_product;
        scratch[place + params.size.z] = d_square;
        scratch[place + 2u * params.size.z] = d_product;
    }
    store_sum(SSIM_SUM, group, vec4<f32>(loss, 0.0, 0.0, 0.0), thread, vec3<u32>(subgroup, lane, subgroups));
}
