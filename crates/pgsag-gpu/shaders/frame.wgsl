// One camera and what is drawn with it. Frames: group, camera (x right, y down, z forward), screen (pixels; the centre of
// pixel i is i + 0.5).

struct Frame {
    // Rows of camera_from_group: W | t.
    row_x: vec4<f32>,
    row_y: vec4<f32>,
    row_z: vec4<f32>,
    focal: vec2<f32>,
    inverse_focal: vec2<f32>,
    center: vec2<f32>,
    // Bounds of X/Z and Y/Z in the Jacobian.
    tangent_low: vec2<f32>,
    tangent_high: vec2<f32>,
    // log2 of the least alpha.
    alpha_cut: f32,
    // Least transmittance.
    stop: f32,
    // Camera centre, group frame.
    eye: vec3<f32>,
    near: f32,
    width: u32,
    height: u32,
    // Tiles per row, and rows of tiles.
    columns: u32,
    rows: u32,
    // Gaussians.
    count: u32,
    // Of the harmonics in use.
    degree: u32,
    // Drawn tiles.
    tiles: u32,
    // Pairs that there is room for.
    pairs: u32,
    // Which pixels are drawn: 0 all, 1 boundary and inside, 2 all but occluded.
    drawn: u32,
    pad_a: u32,
    pad_b: u32,
    pad_c: u32,
}

const TILE: u32 = 16u;
const LOG2_E: f32 = 1.44269504088896340736;
const LN_2: f32 = 0.69314718055994530942;

// Whether a pixel of this kind is drawn.
fn is_drawn(drawn: u32, packed: u32) -> bool {
    let kind = (packed >> 24u) & 3u;
    return drawn == 0u || (drawn == 1u && kind >= 2u) || (drawn == 2u && kind != 1u);
}
