// Who covers a pixel, and how thick they are. Zeroes the sums that `backward` adds to.

override OBSERVE: u32 = 0u;
override GRADIENT: u32 = 0u;
const SUMS: u32 = 18u;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> sizes: array<u32>;
@group(0) @binding(2) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> gaussians: array<u32>;
@group(0) @binding(4) var<storage, read> pair_counts: array<u32>;
@group(0) @binding(5) var<storage, read> first_pairs: array<u32>;
@group(0) @binding(6) var<storage, read> hits: array<u32>;
@group(0) @binding(7) var<storage, read_write> shown: array<u32>;
@group(0) @binding(8) var<storage, read_write> statistics: array<u32>;
@group(0) @binding(9) var<storage, read_write> sums: array<f32>;
// Per workgroup: smallest standard deviations of those shown, and their number.
@group(0) @binding(10) var<storage, read_write> block_sums: array<vec2<f32>>;

var<workgroup> parts: array<vec2<f32>, 64>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
    @builtin(subgroup_id) subgroup: u32,
    @builtin(subgroup_invocation_id) place: u32,
    @builtin(num_subgroups) subgroups: u32,
) {
    let block = group.y * groups.x + group.x;
    let slot = block * 256u + lane;
    var own = vec2(0.0);
    if slot < sizes[1] {
        var found = 0u;
        let first = first_pairs[slot];
        let end = min(first + pair_counts[slot], frame.pairs);
        for (var pair = first; pair < end && found != 3u; pair++) {
            found |= hits[pair];
        }
        let i = gaussians[slot];
        if found != 0u {
            shown[i] = slot + 1u;
            own = vec2(records[4u * slot].w, 1.0);
        }
        // A render in which pairs are missing is drawn again.
        if OBSERVE != 0u && (found & 2u) != 0u && sizes[3] == 0u {
            statistics[4u * frame.count + i] += 1u;
        }
        if GRADIENT != 0u {
            for (var k = 0u; k < SUMS; k++) {
                sums[SUMS * slot + k] = 0.0;
            }
        }
    }
    if GRADIENT == 0u {
        return;
    }
    let sum = subgroupAdd(own);
    if place == 0u {
        parts[subgroup] = sum;
    }
    workgroupBarrier();
    if lane == 0u {
        var total = vec2(0.0);
        for (var k = 0u; k < subgroups; k++) {
            total += parts[k];
        }
        block_sums[block] = total;
    }
}
