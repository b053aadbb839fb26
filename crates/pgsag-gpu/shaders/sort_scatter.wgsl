// Moves every value to its place. Subgroups rank their values by votes; a subgroup's runs of one digit follow one another.

// 1: values are their own positions.
override FIRST: u32 = 0u;

@group(0) @binding(0) var<storage, read> sizes: array<u32>;
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read> values: array<u32>;
@group(0) @binding(3) var<storage, read> counts: array<u32>;
@group(0) @binding(4) var<storage, read> totals: array<u32>;
@group(0) @binding(5) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(6) var<storage, read_write> values_out: array<u32>;

// Where each subgroup writes its next value of each digit: eight subgroups at most.
var<workgroup> cursors: array<atomic<u32>, 2048>;

// Lanes before this one, as the bits of a ballot.
fn bits_before(place: u32) -> vec2<u32> {
    if place >= 32u {
        return vec2(0xffffffffu, (1u << (place - 32u)) - 1u);
    }
    return vec2((1u << place) - 1u, 0u);
}

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, at: Lanes) {
    let block = group.y * groups.x + group.x;
    let count = sizes[COUNT];
    let blocks = block_count(count);
    let run = block * GROUP * EACH + at.subgroup * at.width * EACH;
    for (var k = at.lane; k < at.subgroups * DIGITS; k += GROUP) {
        atomicStore(&cursors[k], 0u);
    }
    workgroupBarrier();
    for (var k = 0u; k < EACH; k++) {
        let i = run + k * at.width + at.place;
        if i < count {
            atomicAdd(&cursors[at.subgroup * DIGITS + digit_of(keys[i])], 1u);
        }
    }
    workgroupBarrier();
    // Every thread has a run of digits.
    let each = DIGITS / GROUP;
    var sum = 0u;
    for (var k = 0u; k < each; k++) {
        sum += totals[at.lane * each + k];
    }
    var start = group_scan(sum, at).x;
    for (var k = 0u; k < each; k++) {
        let digit = at.lane * each + k;
        var cursor = start;
        if block < blocks {
            cursor += counts[digit * blocks + block];
        }
        for (var subgroup = 0u; subgroup < at.subgroups; subgroup++) {
            let own = atomicLoad(&cursors[subgroup * DIGITS + digit]);
            atomicStore(&cursors[subgroup * DIGITS + digit], cursor);
            cursor += own;
        }
        start += totals[digit];
    }
    workgroupBarrier();
    for (var k = 0u; k < EACH; k++) {
        let i = run + k * at.width + at.place;
        let is_there = i < count;
        var key = 0u;
        if is_there {
            key = keys[i];
        }
        let digit = digit_of(key);
        var same = subgroupBallot(is_there).xy;
        for (var bit = 0u; bit < 8u; bit++) {
            let is_set = ((digit >> bit) & 1u) != 0u;
            let vote = subgroupBallot(is_set).xy;
            same &= select(~vote, vote, is_set);
        }
        let before_bits = same & bits_before(at.place);
        let before = countOneBits(before_bits.x) + countOneBits(before_bits.y);
        var cursor = 0u;
        if is_there && before == 0u {
            let all = countOneBits(same.x) + countOneBits(same.y);
            cursor = atomicAdd(&cursors[at.subgroup * DIGITS + digit], all);
        }
        var leader = at.place;
        if is_there {
            leader = select(32u + firstTrailingBit(same.y), firstTrailingBit(same.x), same.x != 0u);
        }
        let place = subgroupShuffle(cursor, leader) + before;
        if is_there {
            keys_out[place] = key;
            if FIRST != 0u {
                values_out[place] = i;
            } else {
                values_out[place] = values[i];
            }
        }
    }
}
