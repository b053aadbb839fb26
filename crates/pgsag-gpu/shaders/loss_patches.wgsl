// L_mvrgb: scales the gradients of the patches and adds them to N and D of their centres, no two of which are the same.

@group(0) @binding(1) var<storage, read_write> grads: array<f32>;
@group(0) @binding(2) var<storage, read> terms: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> centers: array<u32>;
@group(0) @binding(4) var<storage, read> patches: array<vec4<f32>>;

const NONE: u32 = 0xffffffffu;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let group = group_index(id, groups);
    if (group >= params.regions[NCC_SUM].y) {
        return;
    }
    let patch_index = group * 64u + thread;
    let index = centers[patch_index];
    if (index != NONE) {
        let d = patches[patch_index] * (params.multi.z / max(terms[NCC_SUM].y, 1.0));
        let plane = params.size.z;
        grads[4u * plane + index] += d.x;
        grads[5u * plane + index] += d.y;
        grads[6u * plane + index] += d.z;
        grads[7u * plane + index] += d.w;
    }
}
