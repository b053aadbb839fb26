// Prefix sums of the blocks' sums, by one workgroup; the total, and how many workgroups it takes to visit them all.

override MODE: u32 = 0u;
override GROUP: u32 = 256u;
const EACH: u32 = 8u;
// Workgroups along x where there are too many for one dimension.
const ROW: u32 = 32768u;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read_write> sizes: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> launches: array<u32>;

fn set_launch(at: u32, groups: u32) {
    launches[at] = min(groups, ROW);
    launches[at + 1u] = (groups + ROW - 1u) / ROW;
    launches[at + 2u] = 1u;
}

@compute @workgroup_size(GROUP)
fn main(at: Lanes) {
    let block = GROUP * EACH;
    let blocks = (sizes[select(MODE, 6u, MODE == 2u)] + block - 1u) / block;
    var total = 0u;
    for (var first = 0u; first < blocks; first += GROUP) {
        let i = first + at.lane;
        var sum = 0u;
        if i < blocks {
            sum = sums[i];
        }
        let scanned = group_scan(sum, at);
        if i < blocks {
            sums[i] = total + scanned.x;
        }
        total += scanned.y;
    }
    if at.lane == 0u && MODE == 2u {
        sizes[7] = total;
        // A workgroup each.
        set_launch(12u, total);
    } else if at.lane == 0u {
        var kept = total;
        if MODE == 1u {
            kept = min(total, frame.pairs);
            sizes[3] = select(0u, total, total > frame.pairs);
        }
        sizes[MODE + 1u] = kept;
        // By 256 threads, and by blocks.
        set_launch(6u * MODE, (kept + 255u) / 256u);
        set_launch(6u * MODE + 3u, (kept + block - 1u) / block);
    }
}
