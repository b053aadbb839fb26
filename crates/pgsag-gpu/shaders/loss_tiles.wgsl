// The list of tiles with something to do. Needs `tiles`.

// Upper left pixel of a tile of the list.
fn listed_tile(group: u32) -> vec2<i32> {
    return frame_tile(tiles[group]);
}
