// Sums over a workgroup. Needs `partials`.

var<workgroup> lane_sums: array<vec4<f32>, 64>;

// Adds over the threads of a group and stores the sum as its part of a region.
fn store_sum(region: u32, group: u32, value: vec4<f32>, thread: u32, subgroup: vec3<u32>) {
    let sum = subgroupAdd(value);
    if (subgroup.y == 0u) {
        lane_sums[subgroup.x] = sum;
    }
    workgroupBarrier();
    if (thread == 0u) {
        var total = vec4<f32>(0.0);
        for (var i = 0u; i < subgroup.z; i += 1u) {
            total += lane_sums[i];
        }
        partials[params.regions[region].x + group] = total;
    }
}
