// How textured a photograph is. Needs `traits`.

// Image gradient in [0, 1] of full texture; `traits` ends with the level of full texture.
fn texture_of(index: u32) -> f32 {
    let full = max(f32(traits[params.size.z]) / LEVELS, 1.0 / 255.0);
    return min(f32(traits[index] & LEVEL) / LEVELS / full, 1.0);
}
