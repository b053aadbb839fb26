// L_mvrgb: marks the pixels whose patch lies in the mask and that passed the geometric gate.

@group(0) @binding(1) var<storage, read> traits: array<u32>;
@group(0) @binding(2) var<storage, read> gates: array<f32>;
@group(0) @binding(3) var<storage, read_write> marks: array<u32>;

var<workgroup> words: array<atomic<u32>, 8>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let block = group_index(id, groups);
    if (block >= params.draw.w) {
        return;
    }
    if (thread < 8u) {
        atomicStore(&words[thread], 0u);
    }
    workgroupBarrier();
    let index = block * THREADS + thread;
    if (index < params.size.z && (traits[index] & PATCH) != 0u && gates[index] > 0.0) {
        atomicOr(&words[thread / 32u], 1u << (thread % 32u));
    }
    workgroupBarrier();
    if (thread < 8u) {
        marks[block * 8u + thread] = atomicLoad(&words[thread]);
    }
    if (thread == 0u) {
        var count = 0u;
        for (var word = 0u; word < 8u; word += 1u) {
            count += countOneBits(atomicLoad(&words[word]));
        }
        marks[blocks_at() + block] = count;
    }
}
