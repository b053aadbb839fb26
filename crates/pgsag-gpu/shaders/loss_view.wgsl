// What the losses need of a photograph and its mask, once per view: the level of the image gradient (right - left, below - above,
// absolute, over R G B; the larger axis), and whether windows are active throughout. Counts the levels.

struct View {
    // Columns, rows, pixels, rank of the percentile.
    size: vec4<u32>,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> pixels: array<u32>;
@group(0) @binding(2) var<storage, read_write> traits: array<u32>;
@group(0) @binding(3) var<storage, read_write> counts: array<atomic<u32>>;

fn difference(a: u32, b: u32) -> u32 {
    let x = vec3<i32>(vec3<u32>(a, a >> 8u, a >> 16u) & vec3<u32>(0xffu));
    let y = vec3<i32>(vec3<u32>(b, b >> 8u, b >> 16u) & vec3<u32>(0xffu));
    let d = abs(x - y);
    return u32(d.x + d.y + d.z);
}

// Whether all pixels from `first` to `last` beyond (x, y) are inside the frame and active.
fn fits(x: i32, y: i32, first: i32, last: i32) -> bool {
    let size = vec2<i32>(view.size.xy);
    if (x + first < 0 || y + first < 0 || x + last >= size.x || y + last >= size.y) {
        return false;
    }
    for (var v = y + first; v <= y + last; v += 1) {
        for (var u = x + first; u <= x + last; u += 1) {
            if (((pixels[v * size.x + u] >> 24u) & 3u) < 2u) {
                return false;
            }
        }
    }
    return true;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let index = (id.y * groups.x + id.x) * 256u + thread;
    if (index >= view.size.z) {
        return;
    }
    let width = view.size.x;
    let x = index % width;
    let y = index / width;
    let left = pixels[y * width + max(x, 1u) - 1u];
    let right = pixels[y * width + min(x + 1u, width - 1u)];
    let above = pixels[(max(y, 1u) - 1u) * width + x];
    let below = pixels[min(y + 1u, view.size.y - 1u) * width + x];
    let level = max(difference(left, right), difference(above, below));
    atomicAdd(&counts[level], 1u);
    var bits = level;
    if (fits(i32(x), i32(y), 0, 1)) {
        bits |= 0x400u;
    }
    if (fits(i32(x), i32(y), -3, 3)) {
        bits |= 0x800u;
    }
    traits[index] = bits;
}
