// Front-to-back blending (Eq. 1): one workgroup a tile, one thread a pixel, Gaussians by batches through shared memory.

override COLOR: u32 = 1u;
override PLANES: u32 = 1u;
override LOAD: u32 = 1u;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> tiles: array<u32>;
@group(0) @binding(2) var<storage, read> pixels: array<u32>;
// Lists of the tiles; their ends become those of what covers a pixel.
@group(0) @binding(3) var<storage, read_write> ranges: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> pairs: array<u32>;
@group(0) @binding(5) var<storage, read> owners: array<u32>;
@group(0) @binding(6) var<storage, read> records: array<vec4<f32>>;
// Planes: colour 3, opacity, normal 3, distance, depth, load.
@group(0) @binding(7) var<storage, read_write> maps: array<f32>;
// Per pixel, one past the place of the last pair that covers it.
@group(0) @binding(8) var<storage, read_write> lasts: array<u32>;
// Per pair: 1 it covers a pixel, 2 in the first half of its light.
@group(0) @binding(9) var<storage, read_write> hits: array<u32>;

const BATCH: u32 = 256u;
const GRAZING: f32 = 1e-6;

var<workgroup> batch: array<vec4<f32>, 1024>;
var<workgroup> batch_hits: array<atomic<u32>, 256>;
var<workgroup> alive: u32;
var<workgroup> tile_last: atomic<u32>;
var<workgroup> tile_range: vec2<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let slot = group.y * groups.x + group.x;
    if slot >= frame.tiles {
        return;
    }
    let tile = tiles[slot];
    let x = (tile % frame.columns) * TILE + lane % TILE;
    let y = (tile / frame.columns) * TILE + lane / TILE;
    let inside = x < frame.width && y < frame.height;
    let pixel = y * frame.width + x;
    let center = vec2(f32(x), f32(y)) + 0.5;
    var light = 0.0;
    if inside {
        if frame.drawn == 0u {
            light = 1.0;
        } else if is_drawn(frame.drawn, pixels[pixel]) {
            light = 1.0;
        }
    }
    var color = vec4(0.0);
    var plane = vec4(0.0);
    var load = 0.0;
    var last = 0u;
    if lane == 0u {
        tile_range = ranges[slot];
        atomicStore(&tile_last, tile_range.x);
    }
    let range = workgroupUniformLoad(&tile_range);
    for (var start = range.x; start < range.y; start += BATCH) {
        if lane == 0u {
            alive = 0u;
        }
        workgroupBarrier();
        if light >= frame.stop {
            // Whoever writes, writes the same.
            alive = 1u;
        }
        if workgroupUniformLoad(&alive) == 0u {
            break;
        }
        let count = min(BATCH, range.y - start);
        var pair = 0u;
        if lane < count {
            pair = pairs[start + lane];
            let at_record = 4u * owners[pair];
            batch[4u * lane] = records[at_record];
            batch[4u * lane + 1u] = records[at_record + 1u];
            batch[4u * lane + 2u] = records[at_record + 2u];
            batch[4u * lane + 3u] = records[at_record + 3u];
        }
        atomicStore(&batch_hits[lane], 0u);
        workgroupBarrier();
        for (var k = 0u; k < count; k++) {
            if light < frame.stop {
                break;
            }
            let a = batch[4u * k];
            let exponent = exponent_at(a, batch[4u * k + 1u], center - a.xy);
            if exponent < frame.alpha_cut {
                continue;
            }
            let alpha = min(exp2(exponent), ALPHA_MAX);
            let weight = alpha * light;
            let after = light - weight;
            if after >= frame.stop {
                let c = batch[4u * k + 2u];
                if COLOR != 0u {
                    color = vec4(fma(vec3(weight), c.xyz, color.xyz), color.w);
                }
                color.w += weight;
                if PLANES != 0u {
                    plane = fma(vec4(weight), vec4(batch[4u * k + 3u].xyz, c.w), plane);
                }
                load += 1.0;
                last = start + k + 1u;
                let found = select(1u, 3u, light > 0.5);
                if (atomicLoad(&batch_hits[k]) & found) != found {
                    atomicOr(&batch_hits[k], found);
                }
            }
            light = after;
        }
        workgroupBarrier();
        if lane < count {
            hits[pair] = atomicLoad(&batch_hits[lane]);
        }
    }
    workgroupBarrier();
    atomicMax(&tile_last, last);
    workgroupBarrier();
    if lane == 0u {
        ranges[slot].y = atomicLoad(&tile_last);
    }
    if !inside {
        return;
    }
    let size = frame.width * frame.height;
    if COLOR != 0u {
        maps[pixel] = color.x;
        maps[size + pixel] = color.y;
        maps[2u * size + pixel] = color.z;
    }
    maps[3u * size + pixel] = color.w;
    if PLANES != 0u {
        maps[4u * size + pixel] = plane.x;
        maps[5u * size + pixel] = plane.y;
        maps[6u * size + pixel] = plane.z;
        maps[7u * size + pixel] = plane.w;
        let ray = vec3((center - frame.center) * frame.inverse_focal, 1.0);
        let along = dot(plane.xyz, ray);
        var depth = 0.0;
        if along < -GRAZING {
            depth = max(plane.w / -along, 0.0);
        }
        maps[8u * size + pixel] = depth;
    }
    if LOAD != 0u {
        maps[9u * size + pixel] = load;
    }
    lasts[pixel] = last;
}
