// What all Gaussians of a pixel do together.
fn rest_at(pixel: u32, size: u32, up: Upstream) -> f32 {
    var rest = up.color.w * maps[3u * size + pixel];
    if COLOR != 0u {
        rest += up.color.x * maps[pixel] + up.color.y * maps[size + pixel] + up.color.z * maps[2u * size + pixel];
    }
    if PLANES != 0u {
        rest += up.plane.x * maps[4u * size + pixel] + up.plane.y * maps[5u * size + pixel];
        rest += up.plane.z * maps[6u * size + pixel] + up.plane.w * maps[7u * size + pixel];
    }
    return rest;
}
