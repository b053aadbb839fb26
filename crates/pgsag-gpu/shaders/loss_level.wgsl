// Eq. 9: the gradient of the load, in a plane of its own.

@group(0) @binding(1) var<storage, read> pixels: array<u32>;
@group(0) @binding(2) var<storage, read> traits: array<u32>;
@group(0) @binding(3) var<storage, read> maps: array<f32>;
@group(0) @binding(4) var<storage, read_write> grads: array<f32>;
@group(0) @binding(5) var<storage, read> terms: array<vec4<f32>>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let group = group_index(id, groups);
    if (group >= params.regions[LOAD_SUM].y) {
        return;
    }
    let at = pixel_of(frame_tile(group), thread);
    if (counts_at(at)) {
        let index = index_of(at);
        let term = terms[LOAD_TERM];
        grads[9u * params.size.z + index] += term.y * load_weight(index) * (load_at(index) - term.x);
    }
}
