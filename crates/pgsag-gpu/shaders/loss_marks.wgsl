// Where the marks of the pixels of possible patches are: words of one bit per pixel, then, per block of 256 pixels, how many
// bits are set before it, then their sum. Needs `marks`.

// Where the block counts begin.
fn blocks_at() -> u32 {
    return params.draw.w * 8u;
}
