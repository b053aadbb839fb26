// The blended plane of a pixel. Needs `maps`.

fn normal_at(index: u32) -> vec3<f32> {
    let plane = params.size.z;
    return vec3<f32>(maps[4u * plane + index], maps[5u * plane + index], maps[6u * plane + index]);
}
