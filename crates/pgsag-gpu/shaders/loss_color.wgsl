// L_rgb: L1, and 1 - SSIM by its derivatives of every window that a pixel is in. Gradient of the colour.

@group(0) @binding(1) var<storage, read> pixels: array<u32>;
@group(0) @binding(2) var<storage, read> maps: array<f32>;
@group(0) @binding(3) var<storage, read_write> grads: array<f32>;
@group(0) @binding(4) var<storage, read> tiles: array<u32>;
@group(0) @binding(5) var<storage, read> scratch: array<f32>;
@group(0) @binding(6) var<storage, read_write> partials: array<vec4<f32>>;

var<workgroup> pulls: array<vec3<f32>, 676>;
var<workgroup> pull_rows: array<vec3<f32>, 416>;

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
    let count = params.regions[PHOTO_SUM].y;
    if (group >= 3u * count) {
        return;
    }
    let channel = group / count;
    let corner = listed_tile(group % count);
    var d_window = vec3<f32>(0.0);
    if (params.flags.w == 1u) {
        for (var i = thread; i < WIDE * WIDE; i += THREADS) {
            let at = corner + vec2<i32>(i32(i % WIDE), i32(i / WIDE)) - HALF;
            var pull = vec3<f32>(0.0);
            if (counts_at(at)) {
                let place = 3u * channel * params.size.z + index_of(at);
                pull = vec3<f32>(
                    scratch[place],
                    scratch[place + params.size.z],
                    scratch[place + 2u * params.size.z],
                );
            }
            pulls[i] = pull;
        }
        workgroupBarrier();
        for (var i = thread; i < WIDE * TILE; i += THREADS) {
            let first = i / TILE * WIDE + i % TILE;
            var sum = vec3<f32>(0.0);
            for (var tap = 0; tap <= 2 * HALF; tap += 1) {
                sum += WINDOW[abs(tap - HALF)] * pulls[first + u32(tap)];
            }
            pull_rows[i] = sum;
        }
        workgroupBarrier();
        for (var tap = 0; tap <= 2 * HALF; tap += 1) {
            d_window += WINDOW[abs(tap - HALF)] * pull_rows[thread + u32(tap) * TILE];
        }
    }
    let at = pixel_of(corner, thread);
    var sums = vec4<f32>(0.0);
    if (active_at(at)) {
        let place = channel * params.size.z + index_of(at);
        let pair = pair_at(at, channel);
        let d_ssim = d_window.x + 2.0 * pair.x * d_window.y + pair.y * d_window.z;
        let d = params.gain.w * sign(pair.x - pair.y) - params.bias.w * d_ssim;
        grads[place] += params.gain[channel] * d;
        sums = vec4<f32>(abs(pair.x - pair.y), d * maps[place], d, 0.0);
    }
    store_sum(PHOTO_SUM + channel, group % count, sums, thread, vec3<u32>(subgroup, lane, subgroups));
}
