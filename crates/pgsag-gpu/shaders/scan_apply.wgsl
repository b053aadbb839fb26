// The sum before each value; every thread has a run of them.

@group(0) @binding(3) var<storage, read> sums: array<u32>;
@group(0) @binding(4) var<storage, read_write> prefixes: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, at: Lanes) {
    let block = group.y * groups.x + group.x;
    let first = (block * GROUP + at.lane) * EACH;
    var own: array<u32, EACH>;
    var sum = 0u;
    for (var k = 0u; k < EACH; k++) {
        own[k] = value_at(first + k);
        sum += own[k];
    }
    let scanned = group_scan(sum, at);
    if block * GROUP * EACH >= value_count() {
        return;
    }
    var before = sums[block] + scanned.x;
    for (var k = 0u; k < EACH; k++) {
        if first + k < value_count() {
            prefixes[first + k] = before;
        }
        before += own[k];
    }
}
