// What is added up: 0 whether a Gaussian touches any tile; 1 pairs of the Gaussians, front to back; 2 chunks of the lists.

override MODE: u32 = 0u;
override GROUP: u32 = 256u;
// Pairs of a chunk.
override SUBGROUP: u32 = 32u;
// Values per thread.
const EACH: u32 = 8u;

@group(0) @binding(0) var<storage, read> sizes: array<u32>;
@group(0) @binding(1) var<storage, read> values: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;

fn value_count() -> u32 {
    return sizes[select(MODE, 6u, MODE == 2u)];
}

fn value_at(i: u32) -> u32 {
    if i >= value_count() {
        return 0u;
    }
    if MODE == 0u {
        return min(values[i], 1u);
    }
    if MODE == 2u {
        // A list's begin and end.
        return (values[2u * i + 1u] - values[2u * i] + SUBGROUP - 1u) / SUBGROUP;
    }
    return values[order[i]];
}
