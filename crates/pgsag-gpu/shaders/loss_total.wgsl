// One thread: values of all terms, their weighted sum (Eq. 10-11), and how the load's gradient is scaled.

@group(0) @binding(1) var<storage, read_write> terms: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> sizes: array<u32>;

// Standard deviation of the load below which there is nothing to balance.
const LEAST_SIGMA: f32 = 1e-6;

@compute @workgroup_size(1)
fn main() {
    let red = terms[PHOTO_SUM];
    let green = terms[PHOTO_SUM + 1u];
    let blue = terms[PHOTO_SUM + 2u];
    let l1 = (red.x + green.x + blue.x) * params.shares.x;
    let dssim = terms[SSIM_SUM].x * params.shares.x;
    // Sum of the smallest scales and number of the Gaussians that are visible.
    let flat = bitcast<f32>(sizes[4]) / max(f32(sizes[5]), 1.0) * params.extra.w;
    let normal = terms[NORMAL_SUM].x * params.shares.y;
    let geometric = terms[GEOMETRIC_SUM].x / max(terms[GEOMETRIC_SUM].y, 1.0);
    let ncc = terms[NCC_SUM].x / max(terms[NCC_SUM].y, 1.0);
    let free = terms[FREE_SUM].x * params.shares.w;
    var weighted = params.weights.x * l1 + params.weights.y * dssim + params.weights.z * normal;
    weighted += params.multi.x * geometric + params.multi.z * ncc + params.extra.x * free + params.extra.z * flat;
    let load = terms[LOAD_SUM];
    var sigma = 0.0;
    if (load.x >= 2.0) {
        sigma = sqrt(max(load.z / (load.x - 1.0), 0.0));
    }
    var whole = weighted;
    terms[LOAD_TERM] = vec4<f32>(0.0);
    if (sigma >= LEAST_SIGMA) {
        let factor = params.multi.w * weighted / (sigma * (load.x - 1.0) * sigma);
        terms[LOAD_TERM] = vec4<f32>(load.y / load.x, factor, 0.0, 0.0);
        whole += params.multi.w * weighted;
    } else {
        sigma = 0.0;
    }
    terms[VALUES] = vec4<f32>(whole, l1, dssim, flat);
    terms[VALUES + 1u] = vec4<f32>(normal, geometric, terms[GEOMETRIC_SUM].y * params.shares.z, ncc);
    terms[VALUES + 2u] = vec4<f32>(terms[NCC_SUM].y, sigma, free, 0.0);
    terms[VALUES + 3u] = vec4<f32>(red.y, green.y, blue.y, 0.0);
    terms[VALUES + 4u] = vec4<f32>(red.z, green.z, blue.z, 0.0);
}
