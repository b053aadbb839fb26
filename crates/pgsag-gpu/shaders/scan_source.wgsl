// What is added up: 0 whether a Gaussian touches any tile; 1 pairs of the Gaussians, front to back.

override MODE: u32 = 0u;
override GROUP: u32 = 256u;
// Values per thread.
const EACH: u32 = 8u;

@group(0) @binding(0) var<storage, read> sizes: array<u32>;
@group(0) @binding(1) var<storage, read> values: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;

fn value_at(i: u32) -> u32 {
    if i >= sizes[MODE] {
        return 0u;
    }
    if MODE == 0u {
        return min(values[i], 1u);
    }
    return values[order[i]];
}
