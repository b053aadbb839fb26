// L_mvrgb: which pixel a patch is centred on: all that are marked, or a random one from each of as many equal runs as patches
// are allowed. 64-bit arithmetic on pairs of words (high, low). Needs `marks`.

const NONE: u32 = 0xffffffffu;

// High and low word of a product.
fn product(a: u32, b: u32) -> vec2<u32> {
    let low = (a & 0xffffu) * (b & 0xffffu);
    let left = (a >> 16u) * (b & 0xffffu) + (low >> 16u);
    let right = (a & 0xffffu) * (b >> 16u) + (left & 0xffffu);
    return vec2<u32>((a >> 16u) * (b >> 16u) + (left >> 16u) + (right >> 16u), (right << 16u) | (low & 0xffffu));
}

fn sum64(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let low = a.y + b.y;
    return vec2<u32>(a.x + b.x + select(0u, 1u, low < a.y), low);
}

// Low 64 bits of a product.
fn product64(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    return product(a.y, b.y) + vec2<u32>(a.x * b.y + a.y * b.x, 0u);
}

fn shifted64(a: vec2<u32>, bits: u32) -> vec2<u32> {
    return vec2<u32>(a.x >> bits, (a.y >> bits) | (a.x << (32u - bits)));
}

// The number at a place of the stream SplitMix64 (Steele, Lea, Flood 2014), below n.
fn random_below(place: u32, n: u32) -> u32 {
    let step = product64(vec2<u32>(0u, place + 1u), vec2<u32>(0x9e3779b9u, 0x7f4a7c15u));
    var z = sum64(vec2<u32>(params.draw.z, params.draw.y), step);
    z = product64(z ^ shifted64(z, 30u), vec2<u32>(0xbf58476du, 0x1ce4e5b9u));
    z = product64(z ^ shifted64(z, 27u), vec2<u32>(0x94d049bbu, 0x133111ebu));
    z = z ^ shifted64(z, 31u);
    return sum64(product(z.x, n), vec2<u32>(0u, product(z.y, n).x)).x;
}

// floor(a b / c) where it fits one word and a < c or b < c.
fn scaled(a: u32, b: u32, c: u32) -> u32 {
    let whole = product(a, b);
    var rest = whole.x;
    var result = 0u;
    for (var bit = 31; bit >= 0; bit -= 1) {
        let carry = rest >> 31u;
        rest = (rest << 1u) | ((whole.y >> u32(bit)) & 1u);
        if (carry == 1u || rest >= c) {
            rest -= c;
            result |= 1u << u32(bit);
        }
    }
    return result;
}

// The pixel of the bit with so many set before it.
fn pixel_of_rank(rank: u32) -> u32 {
    var low = 0u;
    var high = params.draw.w;
    // The last block with at most `rank` bits before it.
    while (high - low > 1u) {
        let middle = (low + high) / 2u;
        if (marks[blocks_at() + middle] <= rank) {
            low = middle;
        } else {
            high = middle;
        }
    }
    var rest = rank - marks[blocks_at() + low];
    var word = low * 8u;
    for (var i = 0u; i < 7u; i += 1u) {
        let count = countOneBits(marks[word]);
        if (rest < count) {
            break;
        }
        rest -= count;
        word += 1u;
    }
    var bits = marks[word];
    for (; rest > 0u; rest -= 1u) {
        bits &= bits - 1u;
    }
    return word * 32u + firstTrailingBit(bits);
}

// The pixel of a patch, or `NONE` past the last.
fn center_of(patch_index: u32) -> u32 {
    let count = marks[blocks_at() + params.draw.w];
    let limit = params.draw.x;
    if (patch_index >= min(count, limit)) {
        return NONE;
    }
    if (count <= limit) {
        return pixel_of_rank(patch_index);
    }
    let start = run_start(patch_index, count, limit);
    let end = run_start(patch_index + 1u, count, limit);
    return pixel_of_rank(start + random_below(patch_index, end - start));
}

// floor(run count / limit), in parts that fit.
fn run_start(run: u32, count: u32, limit: u32) -> u32 {
    return run * (count / limit) + scaled(run, count % limit, limit);
}
