// What Eq. 9 balances: the load of a pixel times its weight. Needs `maps` and `traits`.

// The printed form of Eq. 9 divides by the image gradient: this is the least it divides by, one grey level.
const GRADIENT_FLOOR: f32 = 1.0 / 255.0;

// Weight of a pixel's load: (1 - g)^2, or 1 / gradient as printed.
fn load_weight(index: u32) -> f32 {
    if (params.flags.x == 1u) {
        return 1.0 / max(f32(traits[index] & LEVEL) / LEVELS, GRADIENT_FLOOR);
    }
    let smooth_part = 1.0 - texture_of(index);
    return smooth_part * smooth_part;
}

fn load_at(index: u32) -> f32 {
    return maps[9u * params.size.z + index] * load_weight(index);
}
