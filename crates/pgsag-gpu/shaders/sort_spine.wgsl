// One workgroup per digit: prefix sums over the blocks, and the digit's total.

@group(0) @binding(0) var<storage, read> sizes: array<u32>;
@group(0) @binding(1) var<storage, read_write> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> totals: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, at: Lanes) {
    let blocks = block_count(sizes[COUNT]);
    var total = 0u;
    for (var first = 0u; first < blocks; first += GROUP) {
        let i = first + at.lane;
        var count = 0u;
        if i < blocks {
            count = counts[group.x * blocks + i];
        }
        let scanned = group_scan(count, at);
        if i < blocks {
            counts[group.x * blocks + i] = total + scanned.x;
        }
        total += scanned.y;
    }
    if at.lane == 0u {
        totals[group.x] = total;
    }
}
