// One Adam step of everything, with the gradients that `pull` left of one or two renders; those of the harmonics are made
// here and never stored. Or, without STEP, the gradients themselves, into the first moments' place.

override STEP: u32 = 1u;

struct Step {
    count: u32,
    // 1: Gaussians without a gradient stay as they are.
    sparse: u32,
    // Bands whose moments are not all 0.
    degree: u32,
    renders: u32,
    // Of the harmonics in use, by render; no colours: -1.
    degrees: vec2<i32>,
    corrections: vec2<f32>,
    eye_a: vec4<f32>,
    eye_b: vec4<f32>,
    // Means, scales, rotations, opacity.
    rates: vec4<f32>,
    // Degree 0, higher degrees.
    color_rates: vec4<f32>,
}

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read_write> values_0: array<f32>;
@group(0) @binding(2) var<storage, read_write> values_1: array<f32>;
@group(0) @binding(3) var<storage, read_write> values_2: array<f32>;
@group(0) @binding(4) var<storage, read_write> values_3: array<f32>;
@group(0) @binding(5) var<storage, read_write> first_0: array<f32>;
@group(0) @binding(6) var<storage, read_write> first_1: array<f32>;
@group(0) @binding(7) var<storage, read_write> first_2: array<f32>;
@group(0) @binding(8) var<storage, read_write> first_3: array<f32>;
@group(0) @binding(9) var<storage, read_write> second_0: array<f32>;
@group(0) @binding(10) var<storage, read_write> second_1: array<f32>;
@group(0) @binding(11) var<storage, read_write> second_2: array<f32>;
@group(0) @binding(12) var<storage, read_write> second_3: array<f32>;
@group(0) @binding(13) var<storage, read> shown_a: array<u32>;
@group(0) @binding(14) var<storage, read> sums_a: array<f32>;
@group(0) @binding(15) var<storage, read> shown_b: array<u32>;
@group(0) @binding(16) var<storage, read> sums_b: array<f32>;
@group(0) @binding(17) var<storage, read_write> fault: array<atomic<u32>>;

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.999;
// 1 - BETA, not as a difference of rounded numbers.
const SHARE_1: f32 = 0.1;
const SHARE_2: f32 = 0.001;
const EPSILON: f32 = 1e-15;

fn moved(x: f32, m: f32, v: f32, g: f32, rate: f32) -> vec3<f32> {
    let first = BETA_1 * m + SHARE_1 * g;
    let second = BETA_2 * v + SHARE_2 * g * g;
    let next = x - rate * step.corrections.x * first / (step.corrections.y * sqrt(second) + EPSILON);
    // All bits of the exponent: not a finite number.
    if (bitcast<u32>(next) & 0x7f800000u) == 0x7f800000u {
        atomicStore(&fault[0], 1u);
    }
    return vec3(next, first, second);
}

fn step_0(at: u32, g: f32, rate: f32) {
    if STEP == 0u {
        first_0[at] = g;
        return;
    }
    let next = moved(values_0[at], first_0[at], second_0[at], g, rate);
    values_0[at] = next.x;
    first_0[at] = next.y;
    second_0[at] = next.z;
}

fn step_1(at: u32, g: f32) {
    if STEP == 0u {
        first_1[at] = g;
        return;
    }
    let next = moved(values_1[at], first_1[at], second_1[at], g, step.color_rates.y);
    values_1[at] = next.x;
    first_1[at] = next.y;
    second_1[at] = next.z;
}

fn step_2(at: u32, g: f32) {
    if STEP == 0u {
        first_2[at] = g;
        return;
    }
    let next = moved(values_2[at], first_2[at], second_2[at], g, step.color_rates.y);
    values_2[at] = next.x;
    first_2[at] = next.y;
    second_2[at] = next.z;
}

fn step_3(at: u32, g: f32) {
    if STEP == 0u {
        first_3[at] = g;
        return;
    }
    let next = moved(values_3[at], first_3[at], second_3[at], g, step.color_rates.y);
    values_3[at] = next.x;
    first_3[at] = next.y;
    second_3[at] = next.z;
}

fn sight(i: u32, eye: vec3<f32>) -> vec3<f32> {
    let n = step.count;
    let away = vec3(values_0[i], values_0[n + i], values_0[2u * n + i]) - eye;
    return away / max(length(away), 1e-12);
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let n = step.count;
    let i = (group.y * groups.x + group.x) * 256u + lane;
    if i >= n {
        return;
    }
    var row_a = 0u;
    var row_b = 0u;
    if step.renders >= 1u {
        row_a = shown_a[i];
    }
    if step.renders >= 2u {
        row_b = shown_b[i];
    }
    if step.sparse != 0u && row_a == 0u && row_b == 0u {
        return;
    }
    var g: array<f32, 14>;
    var d_a = vec3(0.0);
    var d_b = vec3(0.0);
    if row_a != 0u {
        let at = SUMS * (row_a - 1u);
        for (var k = 0u; k < 14u; k++) {
            g[k] = sums_a[at + k];
        }
        d_a = vec3(g[11], g[12], g[13]);
    }
    if row_b != 0u {
        let at = SUMS * (row_b - 1u);
        for (var k = 0u; k < 14u; k++) {
            g[k] += sums_b[at + k];
        }
        d_b = vec3(sums_b[at + 11u], sums_b[at + 12u], sums_b[at + 13u]);
    }
    let to_a = sight(i, step.eye_a.xyz);
    let to_b = sight(i, step.eye_b.xyz);
    for (var k = 0u; k < 14u; k++) {
        var rate = step.color_rates.x;
        if k < 3u {
            rate = step.rates.x;
        } else if k < 6u {
            rate = step.rates.y;
        } else if k < 10u {
            rate = step.rates.z;
        } else if k < 11u {
            rate = step.rates.w;
        }
        step_0(k * n + i, g[k] * select(1.0, SH_0, k >= 11u), rate);
    }
    if step.degree >= 1u {
        let d = mat2x3(select(vec3(0.0), d_a, step.degrees.x >= 1), select(vec3(0.0), d_b, step.degrees.y >= 1));
        let a = band_1(to_a);
        let b = band_1(to_b);
        for (var l = 0u; l < 3u; l++) {
            let slope = d * vec2(a[l], b[l]);
            for (var c = 0u; c < 3u; c++) {
                step_1((3u * l + c) * n + i, slope[c]);
            }
        }
    }
    if step.degree >= 2u {
        let d = mat2x3(select(vec3(0.0), d_a, step.degrees.x >= 2), select(vec3(0.0), d_b, step.degrees.y >= 2));
        let a = band_2(to_a);
        let b = band_2(to_b);
        for (var l = 0u; l < 5u; l++) {
            let slope = d * vec2(a[l], b[l]);
            for (var c = 0u; c < 3u; c++) {
                step_2((3u * l + c) * n + i, slope[c]);
            }
        }
    }
    if step.degree >= 3u {
        let d = mat2x3(select(vec3(0.0), d_a, step.degrees.x >= 3), select(vec3(0.0), d_b, step.degrees.y >= 3));
        let a = band_3(to_a);
        let b = band_3(to_b);
        for (var l = 0u; l < 7u; l++) {
            let slope = d * vec2(a[l], b[l]);
            for (var c = 0u; c < 3u; c++) {
                step_3((3u * l + c) * n + i, slope[c]);
            }
        }
    }
}
