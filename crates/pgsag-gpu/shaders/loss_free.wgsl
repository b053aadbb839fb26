// Opacity costs where the background is seen.

@group(0) @binding(1) var<storage, read> pixels: array<u32>;
@group(0) @binding(2) var<storage, read> maps: array<f32>;
@group(0) @binding(3) var<storage, read_write> grads: array<f32>;
@group(0) @binding(4) var<storage, read_write> partials: array<vec4<f32>>;

// Opacity costs where the background is seen.
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
    if (group >= params.regions[FREE_SUM].y) {
        return;
    }
    let at = pixel_of(frame_tile(group), thread);
    var sum = 0.0;
    if (in_frame(at)) {
        let index = index_of(at);
        if (((pixels[index] >> 24u) & 3u) == 0u) {
            sum = maps[3u * params.size.z + index];
            grads[3u * params.size.z + index] += params.extra.y;
        }
    }
    store_sum(FREE_SUM, group, vec4<f32>(sum, 0.0, 0.0, 0.0), thread, vec3<u32>(subgroup, lane, subgroups));
}
