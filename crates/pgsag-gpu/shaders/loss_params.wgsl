// The numbers of a step, and how threads find their pixels. First part of every kernel of the losses.
//
// Maps and their gradients are planes of `size.z` floats: 0..2 colour, 3 opacity, 4..6 normal N, 7 distance D, 8 depth,
// 9 load. One workgroup of 256 threads works on one tile of 16 x 16 pixels from a list of the tiles that matter.

struct Params {
    // Columns, rows, pixels, tiles across; of the view and of its neighbour.
    size: vec4<u32>,
    other_size: vec4<u32>,
    // Focal lengths and principal point, pixels.
    lens: vec4<f32>,
    other_lens: vec4<f32>,
    // Inverse focal lengths, near plane.
    inverse: vec4<f32>,
    other_inverse: vec4<f32>,
    // neighbor_from_reference: rows of A, b in w.
    between: array<vec4<f32>, 3>,
    // Exposure R G B; in w the weight of L1, and of 1 - SSIM, per pixel and channel.
    gain: vec4<f32>,
    bias: vec4<f32>,
    // Eq. 8: weight per pixel, 1 - weight of edges.
    normal: vec4<f32>,
    // Weight of L_mvgeo, its gate in pixels, weight of L_mvrgb, weight of the load term relative to the main loss.
    multi: vec4<f32>,
    // Free opacity: weight, weight per pixel; flatness: weight; 1 / scene scale.
    extra: vec4<f32>,
    // 1 / values averaged in the photometric term, 1 / pixels averaged, 1 / active pixels, 1 / free pixels.
    shares: vec4<f32>,
    // Weights of L1, 1 - SSIM and Eq. 8.
    weights: vec4<f32>,
    // Most patches, seed (low, high), blocks of 256 pixels.
    draw: vec4<u32>,
    // 1 or 0: reading of the paper, image-gradient weight, average over the frame, SSIM.
    flags: vec4<u32>,
    // First group and number of groups of every region of `partials`.
    regions: array<vec4<u32>, 9>,
}

const TILE: u32 = 16u;
const THREADS: u32 = 256u;
// 255 levels of three channels.
const LEVELS: f32 = 765.0;
// Bits of a trait: level of the image gradient in the lower ten, then whether 2 x 2 and 7 x 7 pixels are active.
const LEVEL: u32 = 0x3ffu;
const QUAD: u32 = 0x400u;
const PATCH: u32 = 0x800u;

// Regions of `partials` and the sums in `terms` with the same index.
const SSIM_SUM: u32 = 0u;
const PHOTO_SUM: u32 = 1u;
const NORMAL_SUM: u32 = 4u;
const GEOMETRIC_SUM: u32 = 5u;
const NCC_SUM: u32 = 6u;
const FREE_SUM: u32 = 7u;
const LOAD_SUM: u32 = 8u;
// Mean load and the factor of its gradient.
const LOAD_TERM: u32 = 9u;
// What the host reads: three of four numbers.
const VALUES: u32 = 10u;

@group(0) @binding(0) var<uniform> params: Params;

// Which group this is, where there may be more than one dimension holds, row by row.
fn group_index(id: vec3<u32>, groups: vec3<u32>) -> u32 {
    return id.y * groups.x + id.x;
}

// Upper left pixel of a tile of the frame, by its number.
fn frame_tile(group: u32) -> vec2<i32> {
    return vec2<i32>(i32(group % params.size.w), i32(group / params.size.w)) * i32(TILE);
}

fn pixel_of(corner: vec2<i32>, thread: u32) -> vec2<i32> {
    return corner + vec2<i32>(i32(thread % TILE), i32(thread / TILE));
}

fn in_frame(at: vec2<i32>) -> bool {
    return at.x >= 0 && at.y >= 0 && at.x < i32(params.size.x) && at.y < i32(params.size.y);
}

fn index_of(at: vec2<i32>) -> u32 {
    return u32(at.y) * params.size.x + u32(at.x);
}

// Ray through the centre of a pixel, camera frame, z = 1.
fn ray_of(at: vec2<f32>) -> vec3<f32> {
    return vec3<f32>((at + 0.5 - params.lens.zw) * params.inverse.xy, 1.0);
}
