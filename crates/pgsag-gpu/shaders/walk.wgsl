// What the way back by Gaussians starts from: light and rest of every pixel before each chunk of its tile's list, and the
// tile of each chunk.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> tiles: array<u32>;
@group(0) @binding(2) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> pairs: array<u32>;
@group(0) @binding(4) var<storage, read> owners: array<u32>;
@group(0) @binding(5) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> maps: array<f32>;
@group(0) @binding(7) var<storage, read> grads: array<f32>;
@group(0) @binding(8) var<storage, read> lasts: array<u32>;
@group(0) @binding(9) var<storage, read> first_chunks: array<u32>;
@group(0) @binding(10) var<storage, read_write> chunk_tiles: array<u32>;
@group(0) @binding(11) var<storage, read_write> states: array<vec2<f32>>;

override SUBGROUP: u32 = 32u;
const BATCH: u32 = 256u;

var<workgroup> batch: array<vec4<f32>, 1024>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let slot = group.y * groups.x + group.x;
    if slot >= frame.tiles {
        return;
    }
    let tile = tiles[slot];
    let x = (tile % frame.columns) * TILE + lane % TILE;
    let y = (tile / frame.columns) * TILE + lane / TILE;
    let pixel = y * frame.width + x;
    let center = vec2(f32(x), f32(y)) + 0.5;
    let size = frame.width * frame.height;
    var walk = Walk(1.0, 0.0);
    var up: Upstream;
    var last = 0u;
    if x < frame.width && y < frame.height {
        last = lasts[pixel];
        up = upstream_at(pixel, size);
        walk.rest = rest_at(pixel, size, up);
    }
    let range = ranges[slot];
    let first = first_chunks[slot];
    for (var start = range.x; start < range.y; start += BATCH) {
        let count = min(BATCH, range.y - start);
        workgroupBarrier();
        if lane < count {
            let at_record = 4u * owners[pairs[start + lane]];
            batch[4u * lane] = records[at_record];
            batch[4u * lane + 1u] = records[at_record + 1u];
            batch[4u * lane + 2u] = records[at_record + 2u];
            batch[4u * lane + 3u] = records[at_record + 3u];
        }
        workgroupBarrier();
        for (var k = 0u; k < count; k++) {
            let at = start - range.x + k;
            if at % SUBGROUP == 0u {
                let chunk = first + at / SUBGROUP;
                states[chunk * 256u + lane] = vec2(walk.light, walk.rest);
                if lane == 0u {
                    chunk_tiles[chunk] = slot;
                }
            }
            if start + k < last {
                let a = batch[4u * k];
                let exponent = exponent_at(a, batch[4u * k + 1u], center - a.xy);
                if exponent >= frame.alpha_cut {
                    unblend(&walk, up, exponent, batch[4u * k + 2u], batch[4u * k + 3u]);
                }
            }
        }
    }
}
