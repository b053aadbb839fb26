// Adds up what `tally` found, by one workgroup, in a fixed order.

@group(0) @binding(0) var<storage, read_write> sizes: array<u32>;
@group(0) @binding(1) var<storage, read> block_sums: array<vec2<f32>>;

var<workgroup> parts: array<vec2<f32>, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32) {
    let blocks = (sizes[1] + 255u) / 256u;
    var sum = vec2(0.0);
    for (var i = lane; i < blocks; i += 256u) {
        sum += block_sums[i];
    }
    parts[lane] = sum;
    workgroupBarrier();
    for (var step = 128u; step > 0u; step /= 2u) {
        if lane < step {
            parts[lane] += parts[lane + step];
        }
        workgroupBarrier();
    }
    if lane == 0u {
        sizes[4] = bitcast<u32>(parts[0].x);
        sizes[5] = u32(parts[0].y);
    }
}
