// Writes the pairs (Gaussian, tile), Gaussians front to back: as many as `cull` counted, whatever rounding says now.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> sizes: array<u32>;
@group(0) @binding(2) var<storage, read> before: array<u32>;
@group(0) @binding(3) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> order: array<u32>;
@group(0) @binding(5) var<storage, read> pair_counts: array<u32>;
// Where the pairs of each Gaussian begin, front to back.
@group(0) @binding(6) var<storage, read> starts: array<u32>;
// The same by slot.
@group(0) @binding(7) var<storage, read_write> first_pairs: array<u32>;
// Slot of the tile of each pair.
@group(0) @binding(8) var<storage, read_write> tile_keys: array<u32>;
// Slot of the Gaussian of each pair.
@group(0) @binding(9) var<storage, read_write> owners: array<u32>;
// What `forward` finds of each pair.
@group(0) @binding(10) var<storage, read_write> hits: array<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let rank = (group.y * groups.x + group.x) * 256u + lane;
    if rank >= sizes[1] {
        return;
    }
    let slot = order[rank];
    var pair = starts[rank];
    let end = min(pair + pair_counts[slot], frame.pairs);
    first_pairs[slot] = pair;
    let a = records[4u * slot];
    let e = ellipse_of(a.xy, records[4u * slot + 1u].xyz, a.z);
    for (var row = e.first.y; row <= e.last.y; row++) {
        let tiles = slots_of_row(e, row);
        for (var k = 0u; k < tiles.y && pair < end; k++) {
            tile_keys[pair] = tiles.x + k;
            owners[pair] = slot;
            hits[pair] = 0u;
            pair++;
        }
    }
    while pair < end {
        tile_keys[pair] = frame.tiles;
        owners[pair] = slot;
        hits[pair] = 0u;
        pair++;
    }
}
