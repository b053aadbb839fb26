// One group per region: adds its parts. Of the load: count, sum and squared deviations from the common mean.

@group(0) @binding(1) var<storage, read> partials: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> terms: array<vec4<f32>>;

var<workgroup> shared_sums: array<vec4<f32>, 256>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let region = params.regions[id.x];
    let sum = summed(region, thread, -1.0);
    if (id.x != LOAD_SUM) {
        if (thread == 0u) {
            terms[id.x] = sum;
        }
        return;
    }
    workgroupBarrier();
    let mean = sum.y / max(sum.x, 1.0);
    let squares = summed(region, thread, mean);
    if (thread == 0u) {
        terms[LOAD_SUM] = vec4<f32>(sum.xy, squares.z, 0.0);
    }
}

// Sum over a region; with a mean, z also takes what a group's own mean differs from it.
fn summed(region: vec4<u32>, thread: u32, mean: f32) -> vec4<f32> {
    var sum = vec4<f32>(0.0);
    for (var i = thread; i < region.y; i += THREADS) {
        var part = partials[region.x + i];
        if (mean >= 0.0) {
            let off = part.y / max(part.x, 1.0) - mean;
            part.z += part.x * off * off;
        }
        sum += part;
    }
    shared_sums[thread] = sum;
    for (var half = THREADS / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if (thread < half) {
            shared_sums[thread] += shared_sums[thread + half];
        }
    }
    workgroupBarrier();
    return shared_sums[0];
}
