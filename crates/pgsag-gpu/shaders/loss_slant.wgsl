// Collects what the neighbours of a pixel give to its depth in L_ban, and carries it to N and D.

@group(0) @binding(1) var<storage, read> pixels: array<u32>;
@group(0) @binding(2) var<storage, read> maps: array<f32>;
@group(0) @binding(3) var<storage, read_write> grads: array<f32>;
@group(0) @binding(4) var<storage, read> tiles: array<u32>;
@group(0) @binding(5) var<storage, read> scratch: array<f32>;

// What the pixel at `from` gives in direction `k`.
fn given(from_pixel: vec2<i32>, k: u32) -> f32 {
    if (!active_at(from_pixel)) {
        return 0.0;
    }
    return scratch[k * params.size.z + index_of(from_pixel)];
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let group = group_index(id, groups);
    if (group >= params.regions[NORMAL_SUM].y) {
        return;
    }
    let at = pixel_of(listed_tile(group), thread);
    if (active_at(at)) {
        let sides = given(at - vec2<i32>(1, 0), 0u) + given(at + vec2<i32>(1, 0), 1u);
        let ends = given(at + vec2<i32>(0, 1), 2u) + given(at - vec2<i32>(0, 1), 3u);
        carry_depth(index_of(at), ray_of(vec2<f32>(at)), sides + ends);
    }
}
