// Eq. 9: count, sum and squared deviations from the group's own mean.

@group(0) @binding(1) var<storage, read> pixels: array<u32>;
@group(0) @binding(2) var<storage, read> traits: array<u32>;
@group(0) @binding(3) var<storage, read> maps: array<f32>;
@group(0) @binding(4) var<storage, read_write> partials: array<vec4<f32>>;

var<workgroup> shared_mean: f32;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
    @builtin(subgroup_id) subgroup: u32,
    @builtin(subgroup_invocation_id) lane: u32,
    @builtin(num_subgroups) subgroups: u32,
) {
    let group = group_index(id, groups);
    if (group >= params.regions[LOAD_SUM].y) {
        return;
    }
    let at = pixel_of(frame_tile(group), thread);
    let counts = counts_at(at);
    var load = 0.0;
    if (counts) {
        load = load_at(index_of(at));
    }
    let one = select(0.0, 1.0, counts);
    let where_from = vec3<u32>(subgroup, lane, subgroups);
    store_sum(LOAD_SUM, group, vec4<f32>(one, load, 0.0, 0.0), thread, where_from);
    let slot = params.regions[LOAD_SUM].x + group;
    if (thread == 0u) {
        shared_mean = partials[slot].y / max(partials[slot].x, 1.0);
    }
    workgroupBarrier();
    let deviation = one * (load - shared_mean);
    let squares = subgroupAdd(deviation * deviation);
    if (lane == 0u) {
        lane_sums[subgroup] = vec4<f32>(squares);
    }
    workgroupBarrier();
    if (thread == 0u) {
        var sum = 0.0;
        for (var i = 0u; i < subgroups; i += 1u) {
            sum += lane_sums[i].x;
        }
        partials[slot].z = sum;
    }
}
