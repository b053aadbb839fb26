// What blending reads of a Gaussian: four vectors a slot. The exponent of alpha, base 2, at (dx, dy) from the centre is
// XX dx^2 + XY dx dy + YY dy^2 + PEAK.
//   0: centre x, y; PEAK; smallest standard deviation (scene units)
//   1: XX, XY, YY; radius (3 sigma, pixels)
//   2: R, G, B; plane distance
//   3: normal, camera frame; unused

const ALPHA_MAX: f32 = 0.99;

fn exponent_at(a: vec4<f32>, b: vec4<f32>, at: vec2<f32>) -> f32 {
    let along = fma(b.x, at.x, at.y * b.y);
    return fma(along, at.x, fma(at.y * b.z, at.y, a.z));
}
