// L_mvgeo: scales the gradient of one view's depth and carries it to N and D.

@group(0) @binding(1) var<storage, read> pixels: array<u32>;
@group(0) @binding(2) var<storage, read> maps: array<f32>;
@group(0) @binding(3) var<storage, read_write> grads: array<f32>;
@group(0) @binding(4) var<storage, read> tiles: array<u32>;
@group(0) @binding(5) var<storage, read> terms: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> d_depth: array<f32>;

// One view's gradients, of which `d_depth` has those of its depth.
@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let group = group_index(id, groups);
    if (group >= params.regions[GEOMETRIC_SUM].y) {
        return;
    }
    let at = pixel_of(listed_tile(group), thread);
    if (active_at(at)) {
        let index = index_of(at);
        let factor = params.multi.x / max(terms[GEOMETRIC_SUM].y, 1.0);
        carry_depth(index, ray_of(vec2<f32>(at)), d_depth[index] * factor);
    }
}
