// One Gaussian at one pixel on the way back, front to back: all upstream gradients act through `along`, and what lies
// behind through `rest`.
//   d c_k = w g_k,   d alpha = T along - rest / (1 - alpha),   v = alpha d alpha   (0 where alpha is held)

override COLOR: u32 = 1u;
override PLANES: u32 = 1u;
override LOAD: u32 = 1u;
override STATISTICS: u32 = 1u;

const LOAD_STEEPNESS: f32 = 1000.0;
const LOAD_CENTER: f32 = 0.00392156862745098;

// Upstream gradients of a pixel.
struct Upstream {
    // R, G, B; opacity.
    color: vec4<f32>,
    // Normal; distance.
    plane: vec4<f32>,
    load: f32,
}

// What the walk keeps of a pixel.
struct Walk {
    light: f32,
    rest: f32,
}

struct Share {
    // v; v dx, v dy; pixel covered.
    a: vec4<f32>,
    // v dx^2, v dx dy, v dy^2.
    b: vec4<f32>,
    color: vec4<f32>,
    plane: vec4<f32>,
    // Absolute screen gradients; v dx, v dy without the load.
    c: vec4<f32>,
}

fn upstream_at(pixel: u32, size: u32) -> Upstream {
    var up: Upstream;
    if COLOR != 0u {
        up.color = vec4(grads[pixel], grads[size + pixel], grads[2u * size + pixel], 0.0);
    }
    up.color.w = grads[3u * size + pixel];
    if PLANES != 0u {
        up.plane = vec4(
            grads[4u * size + pixel],
            grads[5u * size + pixel],
            grads[6u * size + pixel],
            grads[7u * size + pixel],
        );
    }
    if LOAD != 0u {
        up.load = grads[9u * size + pixel];
    }
    return up;
}

fn load_slope(alpha: f32) -> f32 {
    let e = exp2(max((LOAD_CENTER - alpha) * LOAD_STEEPNESS * LOG2_E, -60.0));
    return LOAD_STEEPNESS * e / ((1.0 + e) * (1.0 + e));
}

// Weight and v of a Gaussian whose record is a, b, c, d at an exponent above the cut; moves the walk on.
fn unblend(walk: ptr<function, Walk>, up: Upstream, exponent: f32, c: vec4<f32>, d: vec4<f32>) -> vec3<f32> {
    let free = exp2(exponent);
    let alpha = min(free, ALPHA_MAX);
    let before = (*walk).light;
    let weight = alpha * before;
    var along = up.color.w;
    if COLOR != 0u {
        along += dot(up.color.xyz, c.xyz);
    }
    if PLANES != 0u {
        along += dot(up.plane, vec4(d.xyz, c.w));
    }
    let rest = (*walk).rest - weight * along;
    (*walk).light = before - weight;
    (*walk).rest = rest;
    if free >= ALPHA_MAX {
        return vec3(weight, 0.0, 0.0);
    }
    let d_alpha = before * along - rest / (1.0 - alpha);
    var d_load = 0.0;
    if LOAD != 0u {
        d_load = load_slope(alpha) * up.load;
    }
    return vec3(weight, alpha * d_alpha, alpha * (d_alpha + d_load));
}

// Its part in the Gaussian's sums; `found` as `unblend` returns it.
fn share_of(found: vec3<f32>, up: Upstream, b: vec4<f32>, delta: vec2<f32>) -> Share {
    var share: Share;
    let v = found.z * delta;
    share.a = vec4(found.z, v, 1.0);
    share.b = vec4(v.x * delta.x, v.x * delta.y, v.y * delta.y, 0.0);
    share.color = found.x * vec4(up.color.xyz, 0.0);
    share.plane = found.x * up.plane;
    if STATISTICS != 0u {
        let plain = found.y * delta;
        share.c = vec4(
            abs(2.0 * b.x * plain.x + b.y * plain.y),
            abs(2.0 * b.z * plain.y + b.y * plain.x),
            plain,
        );
    }
    return share;
}
