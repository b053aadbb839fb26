// Gradient of the blending, one lane a Gaussian: a subgroup has a chunk of a tile's list, and the pixels of the tile move
// through its lanes, front to back. Every pair's sums are written once, by one lane: nothing is atomic.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> sizes: array<u32>;
@group(0) @binding(2) var<storage, read> tiles: array<u32>;
@group(0) @binding(3) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> pairs: array<u32>;
@group(0) @binding(5) var<storage, read> owners: array<u32>;
@group(0) @binding(6) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> grads: array<f32>;
@group(0) @binding(8) var<storage, read> lasts: array<u32>;
@group(0) @binding(9) var<storage, read> hits: array<u32>;
@group(0) @binding(10) var<storage, read> first_chunks: array<u32>;
@group(0) @binding(11) var<storage, read> chunk_tiles: array<u32>;
@group(0) @binding(12) var<storage, read> states: array<vec2<f32>>;
// By pair: `sums.wgsl`.
@group(0) @binding(13) var<storage, read_write> pair_sums: array<f32>;

// Lanes of every subgroup of this card; a workgroup is one of them.
override SUBGROUP: u32 = 32u;

@compute @workgroup_size(SUBGROUP)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(subgroup_invocation_id) lane: u32,
) {
    let chunk = group.y * groups.x + group.x;
    if chunk >= sizes[7] {
        return;
    }
    let slot = chunk_tiles[chunk];
    let tile = tiles[slot];
    let corner = vec2(tile % frame.columns, tile / frame.columns) * TILE;
    let size = frame.width * frame.height;
    let place = ranges[slot].x + (chunk - first_chunks[slot]) * SUBGROUP + lane;
    var pair = 0u;
    var a = vec4(0.0);
    var b = vec4(0.0);
    var c = vec4(0.0);
    var d = vec4(0.0);
    var is_hit = false;
    if place < ranges[slot].y {
        pair = pairs[place];
        let at_record = 4u * owners[pair];
        is_hit = hits[pair] != 0u;
        a = records[at_record];
        b = records[at_record + 1u];
        c = records[at_record + 2u];
        d = records[at_record + 3u];
    }
    var sum: Share;
    var walk = Walk(0.0, 0.0);
    for (var step = 0u; step < 255u + SUBGROUP; step++) {
        // The pixel that the lane before has done.
        walk.light = subgroupShuffleUp(walk.light, 1u);
        walk.rest = subgroupShuffleUp(walk.rest, 1u);
        let k = step - lane;
        if step >= lane && k < 256u {
            if lane == 0u {
                let state = states[chunk * 256u + k];
                walk = Walk(state.x, state.y);
            }
            let at = corner + vec2(k % TILE, k / TILE);
            if is_hit && at.x < frame.width && at.y < frame.height {
                let pixel = at.y * frame.width + at.x;
                let delta = vec2<f32>(at) + 0.5 - a.xy;
                let exponent = exponent_at(a, b, delta);
                if exponent >= frame.alpha_cut && place < lasts[pixel] {
                    let up = upstream_at(pixel, size);
                    let share = share_of(unblend(&walk, up, exponent, c, d), up, b, delta);
                    sum.a += share.a;
                    sum.b += share.b;
                    sum.color += share.color;
                    sum.plane += share.plane;
                    sum.c += share.c;
                }
            }
        }
    }
    if !is_hit {
        return;
    }
    let out = SUMS * pair;
    let row = array<f32, 18>(
        sum.a.x, sum.a.y, sum.a.z, sum.b.x, sum.b.y, sum.b.z,
        sum.color.x, sum.color.y, sum.color.z, sum.plane.x, sum.plane.y, sum.plane.z, sum.plane.w,
        sum.c.x, sum.c.y, sum.a.w, sum.c.z, sum.c.w,
    );
    for (var k = 0u; k < SUMS; k++) {
        pair_sums[out + k] = row[k];
    }
}
