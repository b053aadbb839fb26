// From the gradient of depth to those of N and D. Needs `maps` and `grads`.

// |N . r| below which a ray grazes the plane.
const GRAZING: f32 = 1e-6;

// Depth gradient to N and D (Eq. 4), added to the gradient planes of one pixel.
fn carry_depth(index: u32, ray: vec3<f32>, d_depth: f32) {
    let plane = params.size.z;
    let distance = maps[7u * plane + index];
    let along = dot(normal_at(index), ray);
    if (along < -GRAZING && distance > 0.0) {
        let inverse = 1.0 / along;
        let d_normal = ray * (d_depth * distance * inverse * inverse);
        grads[4u * plane + index] += d_normal.x;
        grads[5u * plane + index] += d_normal.y;
        grads[6u * plane + index] += d_normal.z;
        grads[7u * plane + index] -= d_depth * inverse;
    }
}
