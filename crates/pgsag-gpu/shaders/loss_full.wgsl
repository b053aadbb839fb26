// One thread: the 99th percentile of the levels of the image gradient, after the last pixel's traits.

struct View {
    // Columns, rows, pixels, rank of the percentile.
    size: vec4<u32>,
}

const LEVEL_COUNT: u32 = 766u;

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read_write> traits: array<u32>;
@group(0) @binding(2) var<storage, read> counts: array<u32>;

@compute @workgroup_size(1)
fn main() {
    var below = 0u;
    var level = 0u;
    for (; level < LEVEL_COUNT; level += 1u) {
        below += counts[level];
        if (below > view.size.w) {
            break;
        }
    }
    traits[view.size.z] = min(level, LEVEL_COUNT - 1u);
}
