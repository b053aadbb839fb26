// How many values of each block have each digit: `counts[digit * blocks + block]`.

@group(0) @binding(0) var<storage, read> sizes: array<u32>;
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> counts: array<u32>;

var<workgroup> local: array<atomic<u32>, 256>;

@compute @workgroup_size(GROUP)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = group.y * groups.x + group.x;
    let count = sizes[COUNT];
    for (var digit = lane; digit < DIGITS; digit += GROUP) {
        atomicStore(&local[digit], 0u);
    }
    workgroupBarrier();
    for (var k = 0u; k < EACH; k++) {
        let i = (block * EACH + k) * GROUP + lane;
        if i < count {
            atomicAdd(&local[digit_of(keys[i])], 1u);
        }
    }
    workgroupBarrier();
    let blocks = block_count(count);
    if block >= blocks {
        return;
    }
    for (var digit = lane; digit < DIGITS; digit += GROUP) {
        counts[digit * blocks + block] = atomicLoad(&local[digit]);
    }
}
