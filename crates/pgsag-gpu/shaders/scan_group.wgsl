// Exclusive prefix sum over a workgroup of full subgroups.

struct Lanes {
    @builtin(local_invocation_index) lane: u32,
    @builtin(subgroup_id) subgroup: u32,
    @builtin(subgroup_invocation_id) place: u32,
    @builtin(subgroup_size) width: u32,
    @builtin(num_subgroups) subgroups: u32,
}

var<workgroup> parts: array<u32, 64>;

// The sum before this lane, and that of all.
fn group_scan(x: u32, at: Lanes) -> vec2<u32> {
    let inside = subgroupExclusiveAdd(x);
    if at.place == at.width - 1u {
        parts[at.subgroup] = inside + x;
    }
    workgroupBarrier();
    var sum = 0u;
    var total = 0u;
    for (var k = 0u; k < at.subgroups; k++) {
        sum += select(0u, parts[k], k < at.subgroup);
        total += parts[k];
    }
    workgroupBarrier();
    return vec2(sum + inside, total);
}
