// Colour along a direction. Needs `frame`, `base` and the harmonics of degree 1 to 3 in `sh_1`, `sh_2`, `sh_3`.

fn triple_1(l: u32, i: u32) -> vec3<f32> {
    let n = frame.count;
    let at = 3u * l * n + i;
    return vec3(sh_1[at], sh_1[at + n], sh_1[at + 2u * n]);
}

fn triple_2(l: u32, i: u32) -> vec3<f32> {
    let n = frame.count;
    let at = 3u * l * n + i;
    return vec3(sh_2[at], sh_2[at + n], sh_2[at + 2u * n]);
}

fn triple_3(l: u32, i: u32) -> vec3<f32> {
    let n = frame.count;
    let at = 3u * l * n + i;
    return vec3(sh_3[at], sh_3[at + n], sh_3[at + 2u * n]);
}

// Before it is held at 0 from below.
fn color_of(i: u32, v: vec3<f32>) -> vec3<f32> {
    var rgb = vec3(0.5) + SH_0 * vec3(base_at(11u, i), base_at(12u, i), base_at(13u, i));
    if frame.degree >= 1u {
        let values = band_1(v);
        for (var l = 0u; l < 3u; l++) {
            rgb += values[l] * triple_1(l, i);
        }
    }
    if frame.degree >= 2u {
        let values = band_2(v);
        for (var l = 0u; l < 5u; l++) {
            rgb += values[l] * triple_2(l, i);
        }
    }
    if frame.degree >= 3u {
        let values = band_3(v);
        for (var l = 0u; l < 7u; l++) {
            rgb += values[l] * triple_3(l, i);
        }
    }
    return rgb;
}
