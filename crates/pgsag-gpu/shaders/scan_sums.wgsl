// Sum of each block.

@group(0) @binding(3) var<storage, read_write> sums: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, at: Lanes) {
    let block = group.y * groups.x + group.x;
    var sum = 0u;
    for (var k = 0u; k < EACH; k++) {
        sum += value_at((block * EACH + k) * GROUP + at.lane);
    }
    let total = group_scan(sum, at).y;
    if at.lane == 0u {
        sums[block] = total;
    }
}
