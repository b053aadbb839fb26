// What the bits of a pixel say. Needs `pixels`.

// Bits of a pixel: class at 24 (2 and more: active), edge at 26.
const EDGE: u32 = 0x04000000u;

fn is_active(pixel: u32) -> bool {
    return ((pixel >> 24u) & 3u) >= 2u;
}

fn active_at(at: vec2<i32>) -> bool {
    return in_frame(at) && is_active(pixels[index_of(at)]);
}

// Whether a pixel is averaged over: all of the frame, or the active ones.
fn counts_at(at: vec2<i32>) -> bool {
    return in_frame(at) && (params.flags.z == 1u || is_active(pixels[index_of(at)]));
}
