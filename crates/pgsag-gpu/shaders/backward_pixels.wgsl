// Gradient of the blending, one thread a pixel: subgroups add up before anything is added in memory.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> tiles: array<u32>;
@group(0) @binding(2) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> pairs: array<u32>;
@group(0) @binding(4) var<storage, read> owners: array<u32>;
@group(0) @binding(5) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> maps: array<f32>;
@group(0) @binding(7) var<storage, read> grads: array<f32>;
@group(0) @binding(8) var<storage, read> lasts: array<u32>;
@group(0) @binding(9) var<storage, read> hits: array<u32>;
@group(0) @binding(10) var<storage, read_write> sums: array<FloatCell>;

const BATCH: u32 = 256u;

var<workgroup> batch: array<vec4<f32>, 1024>;
// Slot plus one; 0 where the pair covers no pixel.
var<workgroup> batch_slots: array<u32, 256>;

fn add(slot: u32, share: Share) {
    let at = SUMS * slot;
    sums_add(at, share.a.x);
    sums_add(at + 1u, share.a.y);
    sums_add(at + 2u, share.a.z);
    sums_add(at + 3u, share.b.x);
    sums_add(at + 4u, share.b.y);
    sums_add(at + 5u, share.b.z);
    if COLOR != 0u {
        sums_add(at + 6u, share.color.x);
        sums_add(at + 7u, share.color.y);
        sums_add(at + 8u, share.color.z);
    }
    if PLANES != 0u {
        sums_add(at + 9u, share.plane.x);
        sums_add(at + 10u, share.plane.y);
        sums_add(at + 11u, share.plane.z);
        sums_add(at + 12u, share.plane.w);
    }
    if STATISTICS != 0u {
        sums_add(at + 13u, share.c.x);
        sums_add(at + 14u, share.c.y);
        sums_add(at + 15u, share.a.w);
        sums_add(at + 16u, share.c.z);
        sums_add(at + 17u, share.c.w);
    }
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
    @builtin(subgroup_invocation_id) place: u32,
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
    for (var start = range.x; start < range.y; start += BATCH) {
        let count = min(BATCH, range.y - start);
        if lane < count {
            let pair = pairs[start + lane];
            let owner = owners[pair];
            batch[4u * lane] = records[4u * owner];
            batch[4u * lane + 1u] = records[4u * owner + 1u];
            batch[4u * lane + 2u] = records[4u * owner + 2u];
            batch[4u * lane + 3u] = records[4u * owner + 3u];
            batch_slots[lane] = select(0u, owner + 1u, hits[pair] != 0u);
        }
        workgroupBarrier();
        for (var k = 0u; k < count; k++) {
            if batch_slots[k] == 0u {
                continue;
            }
            let a = batch[4u * k];
            let b = batch[4u * k + 1u];
            let exponent = exponent_at(a, b, center - a.xy);
            let covers = start + k < last && exponent >= frame.alpha_cut;
            if !subgroupAny(covers) {
                continue;
            }
            var share: Share;
            if covers {
                let found = unblend(&walk, up, exponent, batch[4u * k + 2u], batch[4u * k + 3u]);
                share = share_of(found, up, b, center - a.xy);
            }
            share.a = subgroupAdd(share.a);
            share.b = subgroupAdd(share.b);
            if COLOR != 0u {
                share.color = subgroupAdd(share.color);
            }
            if PLANES != 0u {
                share.plane = subgroupAdd(share.plane);
            }
            if STATISTICS != 0u {
                share.c = subgroupAdd(share.c);
            }
            if place == 0u {
                add(batch_slots[k] - 1u, share);
            }
        }
        workgroupBarrier();
    }
}
