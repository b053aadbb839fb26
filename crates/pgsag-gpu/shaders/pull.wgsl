// From the sums of a Gaussian to the gradients of its parameters, in the same place; its density statistics.

override COLOR: u32 = 1u;
override PLANES: u32 = 1u;
override LOAD: u32 = 1u;
override STATISTICS: u32 = 1u;
// 1: the sums of a Gaussian's pairs are added up first.
override ROWS: u32 = 0u;

struct Pull {
    // Weight of the flattening term over the scene scale; 0 for a neighbour's render.
    d_flatness: f32,
    // Pixels over which the photometric term averages.
    mean_pixels: f32,
    pad_a: u32,
    pad_b: u32,
}

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> pull: Pull;
@group(0) @binding(2) var<storage, read> sizes: array<u32>;
@group(0) @binding(3) var<storage, read> base: array<f32>;
@group(0) @binding(4) var<storage, read> sh_1: array<f32>;
@group(0) @binding(5) var<storage, read> sh_2: array<f32>;
@group(0) @binding(6) var<storage, read> sh_3: array<f32>;
@group(0) @binding(7) var<storage, read> gaussians: array<u32>;
@group(0) @binding(8) var<storage, read> shown: array<u32>;
@group(0) @binding(9) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(10) var<storage, read_write> sums: array<f32>;
@group(0) @binding(11) var<storage, read_write> statistics: array<u32>;
@group(0) @binding(12) var<storage, read> pair_counts: array<u32>;
@group(0) @binding(13) var<storage, read> first_pairs: array<u32>;
@group(0) @binding(14) var<storage, read> hits: array<u32>;
@group(0) @binding(15) var<storage, read> pair_sums: array<f32>;

// In the order of the pairs, so that the sums are the same in every run.
fn add_pairs(slot: u32) {
    var own: array<f32, 18>;
    let first = first_pairs[slot];
    let end = min(first + pair_counts[slot], frame.pairs);
    for (var pair = first; pair < end; pair++) {
        if hits[pair] != 0u {
            for (var k = 0u; k < SUMS; k++) {
                own[k] += pair_sums[SUMS * pair + k];
            }
        }
    }
    for (var k = 0u; k < SUMS; k++) {
        sums[SUMS * slot + k] = own[k];
    }
}

fn add_statistic(plane: u32, i: u32, value: f32) {
    let at = plane * frame.count + i;
    statistics[at] = bitcast<u32>(bitcast<f32>(statistics[at]) + value);
}

fn gather(i: u32, at: u32, b: vec4<f32>) {
    let covered = sums[at + 15u];
    if covered == 0.0 {
        return;
    }
    var plain = vec2(sums[at + 1u], sums[at + 2u]);
    if LOAD != 0u {
        plain = vec2(sums[at + 16u], sums[at + 17u]);
    }
    let signed = LN_2 * vec2(2.0 * b.x * plain.x + b.y * plain.y, b.y * plain.x + 2.0 * b.z * plain.y);
    let absolute = LN_2 * vec2(sums[at + 13u], sums[at + 14u]);
    let share = pull.mean_pixels / covered;
    add_statistic(0u, i, length(signed) * share);
    add_statistic(1u, i, length(absolute) * share);
    statistics[2u * frame.count + i] += 1u;
    let radius = 3u * frame.count + i;
    statistics[radius] = bitcast<u32>(max(bitcast<f32>(statistics[radius]), b.w));
}

// Gradient of the direction of sight through the harmonics.
fn direction_grad(i: u32, v: vec3<f32>, d: vec3<f32>) -> vec3<f32> {
    var out = vec3(0.0);
    if frame.degree >= 1u {
        out += SH_1 * vec3(-dot(d, triple_1(2u, i)), -dot(d, triple_1(0u, i)), dot(d, triple_1(1u, i)));
    }
    if frame.degree >= 2u {
        out += SH_2A * dot(d, triple_2(0u, i)) * vec3(v.y, v.x, 0.0);
        out -= SH_2A * dot(d, triple_2(1u, i)) * vec3(0.0, v.z, v.y);
        out += SH_2B * dot(d, triple_2(2u, i)) * vec3(-2.0 * v.x, -2.0 * v.y, 4.0 * v.z);
        out -= SH_2A * dot(d, triple_2(3u, i)) * vec3(v.z, 0.0, v.x);
        out += SH_2C * dot(d, triple_2(4u, i)) * vec3(2.0 * v.x, -2.0 * v.y, 0.0);
    }
    if frame.degree >= 3u {
        let s = v * v;
        let xy = v.x * v.y;
        let yz = v.y * v.z;
        let xz = v.x * v.z;
        out += SH_3A * dot(d, triple_3(0u, i)) * vec3(-6.0 * xy, -3.0 * (s.x - s.y), 0.0);
        out += SH_3B * dot(d, triple_3(1u, i)) * vec3(yz, xz, xy);
        out += SH_3C * dot(d, triple_3(2u, i)) * vec3(2.0 * xy, -(4.0 * s.z - s.x - 3.0 * s.y), -8.0 * yz);
        out += SH_3D * dot(d, triple_3(3u, i)) * vec3(-6.0 * xz, -6.0 * yz, 3.0 * (2.0 * s.z - s.x - s.y));
        out += SH_3C * dot(d, triple_3(4u, i)) * vec3(-(4.0 * s.z - 3.0 * s.x - s.y), 2.0 * xy, -8.0 * xz);
        out += SH_3E * dot(d, triple_3(5u, i)) * vec3(2.0 * xz, -2.0 * yz, s.x - s.y);
        out += SH_3A * dot(d, triple_3(6u, i)) * vec3(-3.0 * (s.x - s.y), 6.0 * xy, 0.0);
    }
    return out;
}

// Gradient of the point through the Jacobian of the projection; where the clamp holds, the tangent does not move.
fn jacobian_grad(point: vec3<f32>, tangent: vec2<f32>, d_x: vec3<f32>, d_y: vec3<f32>) -> vec3<f32> {
    let inverse = 1.0 / point.z;
    let ratio = point.xy * inverse;
    let slope = frame.focal * inverse;
    let own = vec2(dot(frame.row_x.xyz, d_x), dot(frame.row_y.xyz, d_y));
    let deep = vec2(dot(frame.row_z.xyz, d_x), dot(frame.row_z.xyz, d_y));
    let moves = (ratio >= frame.tangent_low) & (ratio <= frame.tangent_high);
    let d_ratio = select(vec2(0.0), -slope * deep, moves);
    let d_depth = slope * (own - tangent * deep) + d_ratio * ratio;
    return inverse * vec3(d_ratio, -d_depth.x - d_depth.y);
}

// Gradient of the unit quaternion w x y z; columns of g as those of the rotation.
fn rotation_grad(u: vec4<f32>, g: mat3x3<f32>) -> vec4<f32> {
    let p = g[1][2] - g[2][1];
    let q = g[2][0] - g[0][2];
    let r = g[0][1] - g[1][0];
    let a = g[1][0] + g[0][1];
    let b = g[2][0] + g[0][2];
    let c = g[2][1] + g[1][2];
    return 2.0 * vec4(
        u.y * p + u.z * q + u.w * r,
        u.x * p + u.z * a + u.w * b - 2.0 * u.y * (g[1][1] + g[2][2]),
        u.x * q + u.y * a + u.w * c - 2.0 * u.z * (g[0][0] + g[2][2]),
        u.x * r + u.y * b + u.z * c - 2.0 * u.w * (g[0][0] + g[1][1]),
    );
}

fn put(at: u32, value: vec3<f32>) {
    sums[at] = value.x;
    sums[at + 1u] = value.y;
    sums[at + 2u] = value.z;
}

fn pull_back(i: u32, slot: u32) {
    let at = SUMS * slot;
    let mean = mean_of(i);
    let point = to_camera(mean);
    let shape = shape_of(i);
    let tangent = clamped_tangent(point);
    let rows = jacobian(point, tangent);
    let m = stretched(shape);
    let conic = conic_of(screen_covariance(rows, m));
    let d_conic = vec3(-0.5 * sums[at + 3u], -sums[at + 4u], -0.5 * sums[at + 5u]);
    let g = -vec3(
        dot(vec3(conic.x * conic.x, conic.x * conic.y, conic.y * conic.y), d_conic),
        dot(vec3(2.0 * conic.x * conic.y, conic.x * conic.z + conic.y * conic.y, 2.0 * conic.y * conic.z), d_conic),
        dot(vec3(conic.y * conic.y, conic.y * conic.z, conic.z * conic.z), d_conic),
    );
    // Through (J W M)(J W M)^T.
    let first = rows[0] * m;
    let second = rows[1] * m;
    let d_first = 2.0 * g.x * first + g.y * second;
    let d_second = g.y * first + 2.0 * g.z * second;
    var d_rotation: mat3x3<f32>;
    var d_scales: vec3<f32>;
    for (var j = 0u; j < 3u; j++) {
        let d_column = d_first[j] * rows[0] + d_second[j] * rows[1];
        d_rotation[j] = d_column * shape.scales[j];
        d_scales[j] = dot(shape.rotation[j], d_column) * shape.scales[j];
    }
    var d_point = jacobian_grad(point, tangent, m * d_first, m * d_second);
    let v = vec2(sums[at + 1u], sums[at + 2u]);
    let d_screen = vec2(conic.x * v.x + conic.y * v.y, conic.y * v.x + conic.z * v.y) * frame.focal / point.z;
    d_point += vec3(d_screen, -dot(d_screen, point.xy) / point.z);
    let axis = flat_axis(shape.scales);
    if PLANES != 0u {
        let normal = records[4u * slot + 3u].xyz;
        let d_distance = sums[at + 12u];
        let d_normal = vec3(sums[at + 9u], sums[at + 10u], sums[at + 11u]) - point * d_distance;
        d_point -= normal * d_distance;
        d_rotation[axis] += to_group(d_normal) * facing(shape.rotation[axis], mean);
    }
    var d_mean = to_group(d_point);
    var d_color = vec3(0.0);
    if COLOR != 0u {
        let rgb = records[4u * slot + 2u].xyz;
        d_color = select(vec3(0.0), vec3(sums[at + 6u], sums[at + 7u], sums[at + 8u]), rgb > vec3(0.0));
        let reach = max(length(mean - frame.eye), 1e-12);
        let sight = (mean - frame.eye) / reach;
        let d_sight = direction_grad(i, sight, d_color);
        d_mean += (d_sight - sight * dot(d_sight, sight)) / reach;
    }
    d_scales[axis] += pull.d_flatness / max(f32(sizes[5]), 1.0) * shape.scales[axis];
    let d_unit = rotation_grad(shape.unit, d_rotation);
    let d_quaternion = (d_unit - shape.unit * dot(d_unit, shape.unit)) / shape.norm;
    let d_logit = sums[at] * (1.0 - exp2(records[4u * slot].z));
    put(at, d_mean);
    put(at + 3u, d_scales);
    put(at + 6u, d_quaternion.xyz);
    put(at + 9u, vec3(d_quaternion.w, d_logit, d_color.x));
    sums[at + 12u] = d_color.y;
    sums[at + 13u] = d_color.z;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let slot = (group.y * groups.x + group.x) * 256u + lane;
    if slot >= sizes[1] {
        return;
    }
    let i = gaussians[slot];
    if shown[i] == 0u {
        return;
    }
    if ROWS != 0u {
        add_pairs(slot);
    }
    if STATISTICS != 0u {
        gather(i, SUMS * slot, records[4u * slot + 1u]);
    }
    pull_back(i, slot);
}
