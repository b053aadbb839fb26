// The window of SSIM: a normalised Gaussian of 1.5 pixels, eleven wide. Wang 2004. Needs `pixels` and `maps`.

const HALF: i32 = 5;
// Pixels along a side of a tile with its margin.
const WIDE: u32 = 26u;
// Normalised Gaussian of 1.5 pixels: centre and one side. Wang 2004.
const WINDOW = array<f32, 6>(0.2660117248617943, 0.21300553771125366, 0.1093606895097, 0.03600077212843082,
    0.007598758135239184, 0.0010283800844791099);

// The exposed render and the photograph, 0 where inactive.
fn pair_at(at: vec2<i32>, channel: u32) -> vec2<f32> {
    if (!in_frame(at)) {
        return vec2<f32>(0.0);
    }
    let index = index_of(at);
    let pixel = pixels[index];
    if (!is_active(pixel)) {
        return vec2<f32>(0.0);
    }
    let photo = f32((pixel >> (8u * channel)) & 0xffu) * (1.0 / 255.0);
    return vec2<f32>(params.gain[channel] * maps[channel * params.size.z + index] + params.bias[channel], photo);
}
