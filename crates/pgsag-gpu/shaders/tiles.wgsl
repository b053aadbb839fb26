// Which drawn tiles an ellipse touches, exactly: some pixel centre in it may reach the alpha cut. Needs `frame`, `before`.

// Kept beyond the alpha cut (log2 of alpha), so that rounding never culls what the pixel test keeps.
const CULL_MARGIN: f32 = 0.02;

struct Ellipse {
    center: vec2<f32>,
    // p dx^2 + q dx dy + s dy^2 <= level
    form: vec3<f32>,
    level: f32,
    determinant: f32,
    // Half widths.
    half: vec2<f32>,
    // First and last column and row of tiles; none where last < first.
    first: vec2<i32>,
    last: vec2<i32>,
}

// Tiles with a pixel centre in [middle - half, middle + half], within 0..=last.
fn tile_span(middle: vec2<f32>, half: vec2<f32>, last: vec2<f32>) -> vec4<i32> {
    let size = f32(TILE);
    let low = max(ceil((middle - half - (size - 0.5)) / size), vec2(0.0));
    let high = min(floor((middle + half - 0.5) / size), last);
    // Numbers far outside do not fit an integer.
    return vec4<i32>(vec2<i32>(min(low, last + 1.0)), vec2<i32>(max(high, vec2(-1.0))));
}

fn ellipse_of(center: vec2<f32>, exponent: vec3<f32>, peak: f32) -> Ellipse {
    var e: Ellipse;
    e.center = center;
    e.form = -exponent;
    e.level = peak - frame.alpha_cut + CULL_MARGIN;
    e.determinant = 4.0 * e.form.x * e.form.z - e.form.y * e.form.y;
    e.first = vec2<i32>(0);
    e.last = vec2<i32>(-1);
    if e.level > 0.0 && e.determinant > 0.0 {
        e.half = sqrt(4.0 * e.form.zx * e.level / e.determinant);
        let span = tile_span(center, e.half, vec2(f32(frame.columns) - 1.0, f32(frame.rows) - 1.0));
        e.first = span.xy;
        e.last = select(span.zw, vec2<i32>(-1), any(span.zw < span.xy));
    }
    return e;
}

// First slot and number of the drawn tiles of one row of tiles.
fn slots_of_row(e: Ellipse, row: i32) -> vec2<u32> {
    var columns = vec2(e.first.x, e.last.x);
    if columns.x != columns.y {
        let p = e.form.x;
        let q = e.form.y;
        let above = f32(row) * f32(TILE) + 0.5 - e.center.y;
        let low = max(above, -e.half.y);
        let high = min(above + f32(TILE - 1u), e.half.y);
        let turn = 0.5 * q / e.form.z * e.half.x;
        // The ellipse is widest to the left at y = turn, to the right at y = -turn, or nearest to it in the row.
        let at = vec2(max(min(turn, high), low), max(min(-turn, high), low));
        let root = sqrt(max(4.0 * p * e.level - e.determinant * at * at, vec2(0.0)));
        let edges = (vec2(-root.x, root.y) - q * at) / (2.0 * p);
        let middle = 0.5 * (edges.x + edges.y) + e.center.x;
        let span = tile_span(vec2(middle), vec2(0.5 * (edges.y - edges.x)), vec2(f32(frame.columns) - 1.0));
        columns = span.xz;
    }
    if columns.y < columns.x {
        return vec2(0u);
    }
    let row_start = u32(row) * frame.columns;
    let first = before[row_start + u32(columns.x)];
    return vec2(first, before[row_start + u32(columns.y) + 1u] - first);
}
