//! A small software rasteriser: what a mesh looks like from a pose. For reports, for looking, and for exact depth maps
//! of known meshes. Bands of rows are independent and take their faces in order, so threads change nothing.

use glam::{DVec2, DVec3};
use pgsag_scene::{Image, Map, Mesh, Pinhole, RigidTransform};
use rayon::prelude::*;

/// Rows per band.
const BAND: usize = 16;
/// The background's entry in `Visibility::face`.
pub const NO_FACE: u32 = u32::MAX;

/// How faces are coloured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Paint {
    /// Grey plaster in oblique light; backs of faces reddish.
    Shape,
    /// Vertex colours as they are; plaster where there are none.
    Color,
    /// By the normal as the camera sees it: right is red, up is green, towards the camera is blue.
    Normal,
    /// One colour per building in oblique light, plaster where there is none.
    Building,
}

/// What is seen at every pixel centre.
#[derive(Clone, Debug, PartialEq)]
pub struct Visibility {
    /// Face index, or [`NO_FACE`].
    pub face: Map<u32>,
    /// Depth along the optical axis, scene units; 0 where nothing is.
    pub depth: Map<f32>,
}

/// A face or a part of one, in front of the camera.
struct Triangle {
    face: u32,
    corners: [DVec2; 3],
    inverse_depths: [f64; 3],
}

/// The nearest face at every pixel centre. Anything nearer than a millionth of the farthest depth is cut away.
#[must_use]
pub fn visibility(mesh: &Mesh, camera: &Pinhole, camera_from_world: &RigidTransform) -> Visibility {
    let points: Vec<DVec3> =
        mesh.vertices.par_iter().map(|v| camera_from_world.transform_point(DVec3::from(*v))).collect();
    let far = points.iter().map(|p| p.z).filter(|z| z.is_finite()).fold(0.0, f64::max);
    let near = (far * 1e-6).max(f64::MIN_POSITIVE);
    let parts: Vec<Vec<Triangle>> = mesh
        .faces
        .par_chunks(8192)
        .enumerate()
        .map(|(chunk, faces)| {
            let mut triangles = Vec::new();
            for (at, face) in faces.iter().enumerate() {
                let corners = face.map(|v| points[v as usize]);
                add_clipped(&mut triangles, (chunk * 8192 + at) as u32, corners, camera, near);
            }
            triangles
        })
        .collect();
    let triangles: Vec<Triangle> = parts.into_iter().flatten().collect();
    let (width, height) = (camera.width as usize, camera.height as usize);
    let mut bands: Vec<Vec<u32>> = vec![Vec::new(); height.div_ceil(BAND)];
    for (at, triangle) in triangles.iter().enumerate() {
        let rows = rows(triangle, height);
        for band in rows.start / BAND..rows.end.div_ceil(BAND) {
            bands[band].push(at as u32);
        }
    }
    let mut seen = Visibility {
        face: Map::filled(camera.width, camera.height, NO_FACE),
        depth: Map::filled(camera.width, camera.height, 0.0),
    };
    let rows = (width * BAND).max(1);
    let faces = seen.face.values.par_chunks_mut(rows);
    faces.zip(seen.depth.values.par_chunks_mut(rows)).zip(&bands).enumerate().for_each(
        |(band, ((face, depth), list))| {
            let mut inverse = vec![0.0f64; face.len()];
            for at in list {
                draw(&triangles[*at as usize], band * BAND, width, face, &mut inverse);
            }
            for (depth, inverse) in depth.iter_mut().zip(inverse) {
                *depth = if inverse > 0.0 { (1.0 / inverse) as f32 } else { 0.0 };
            }
        },
    );
    seen
}

/// Rows whose centres a triangle may cover.
fn rows(triangle: &Triangle, height: usize) -> std::ops::Range<usize> {
    let ys = triangle.corners.map(|c| c.y);
    let low = (ys[0].min(ys[1]).min(ys[2]) - 0.5).ceil().clamp(0.0, height as f64) as usize;
    let high = (ys[0].max(ys[1]).max(ys[2]) - 0.5).floor().clamp(-1.0, height as f64 - 1.0) + 1.0;
    low..(high as usize).max(low)
}

/// Cuts a face at the near plane and projects what is left of it.
fn add_clipped(triangles: &mut Vec<Triangle>, face: u32, corners: [DVec3; 3], camera: &Pinhole, near: f64) {
    let mut kept: Vec<DVec3> = Vec::with_capacity(4);
    for at in 0..3 {
        let (a, b) = (corners[at], corners[(at + 1) % 3]);
        if a.z >= near {
            kept.push(a);
        }
        if (a.z >= near) != (b.z >= near) {
            kept.push(a + (b - a) * ((near - a.z) / (b.z - a.z)));
        }
    }
    if kept.len() < 3 || kept.iter().any(|p| !p.is_finite()) {
        return;
    }
    let project = |p: DVec3| DVec2::new(camera.fx * p.x / p.z + camera.cx, camera.fy * p.y / p.z + camera.cy);
    for at in 1..kept.len() - 1 {
        let part = [kept[0], kept[at], kept[at + 1]];
        let corners = part.map(project);
        if may_cover(&corners, camera) {
            triangles.push(Triangle { face, corners, inverse_depths: part.map(|p| 1.0 / p.z) });
        }
    }
}

/// Whether the centre of any pixel lies in the box of a triangle. Most faces of a city lie beside a picture or between its
/// pixels; what is not kept costs neither memory nor a second look.
fn may_cover(corners: &[DVec2; 3], camera: &Pinhole) -> bool {
    let low = corners[0].min(corners[1]).min(corners[2]) - DVec2::splat(0.5 + 1e-6);
    let high = corners[0].max(corners[1]).max(corners[2]) - DVec2::splat(0.5 - 1e-6);
    let last = DVec2::new(f64::from(camera.width), f64::from(camera.height)) - 1.0;
    low.ceil().max(DVec2::ZERO).cmple(high.floor().min(last)).all()
}

fn draw(triangle: &Triangle, first_row: usize, width: usize, faces: &mut [u32], inverse: &mut [f64]) {
    let [a, b, c] = triangle.corners;
    let area = (b - a).perp_dot(c - a);
    if area == 0.0 || !area.is_finite() {
        return;
    }
    let band_rows = faces.len() / width;
    let rows = rows(triangle, first_row + band_rows);
    for y in rows.start.max(first_row)..rows.end {
        // Shares of the corners are linear along a row; where all are positive is an interval.
        let at = |x: f64| {
            let p = DVec2::new(x, y as f64 + 0.5);
            [(c - b).perp_dot(p - b) / area, (a - c).perp_dot(p - c) / area, (b - a).perp_dot(p - a) / area]
        };
        let (start, step) = (at(0.5), at(1.5));
        let (mut low, mut high) = (0.0f64, width as f64 - 1.0);
        for k in 0..3 {
            let slope = step[k] - start[k];
            let root = -start[k] / slope;
            if slope > 0.0 {
                low = low.max((root - 1e-9).ceil());
            } else if slope < 0.0 {
                high = high.min((root + 1e-9).floor());
            } else if start[k] < 0.0 {
                high = -1.0;
            }
        }
        if low > high {
            continue;
        }
        for x in low as usize..=high as usize {
            let shares = at(x as f64 + 0.5);
            let value = (0..3).map(|k| shares[k] * triangle.inverse_depths[k]).sum();
            let pixel = (y - first_row) * width + x;
            if value > inverse[pixel] {
                inverse[pixel] = value;
                faces[pixel] = triangle.face;
            }
        }
    }
}

/// A picture of the mesh before a background of one colour.
#[must_use]
pub fn render(
    mesh: &Mesh,
    camera: &Pinhole,
    camera_from_world: &RigidTransform,
    paint: Paint,
    background: [u8; 3],
) -> Image {
    painted(mesh, &visibility(mesh, camera, camera_from_world), camera, camera_from_world, paint, background)
}

/// A picture of what is known to be seen from there.
#[must_use]
pub fn painted(
    mesh: &Mesh,
    seen: &Visibility,
    camera: &Pinhole,
    camera_from_world: &RigidTransform,
    paint: Paint,
    background: [u8; 3],
) -> Image {
    let mut image = Image::filled(camera.width, camera.height, background);
    let width = camera.width as usize;
    image.pixels.par_iter_mut().zip(&seen.face.values).enumerate().for_each(|(at, (pixel, face))| {
        if *face != NO_FACE {
            let (x, y) = ((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
            *pixel = color_of(mesh, *face as usize, camera.ray(x, y), camera_from_world, paint);
        }
    });
    image
}

fn color_of(mesh: &Mesh, face: usize, ray: DVec3, camera_from_world: &RigidTransform, paint: Paint) -> [u8; 3] {
    let corners = mesh.triangle(face).map(|v| camera_from_world.transform_point(DVec3::from(v)));
    let [a, b, c] = corners;
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let back = normal.dot(ray) > 0.0;
    if paint == Paint::Color && !mesh.colors.is_empty() {
        // Where the ray meets the plane, in shares of the corners.
        let place = ray * (normal.dot(a) / normal.dot(ray));
        let total = normal.dot((b - a).cross(c - a));
        let share = |p: DVec3, q: DVec3| (normal.dot((p - place).cross(q - place)) / total).clamp(0.0, 1.0);
        let shares = [share(b, c), share(c, a), share(a, b)];
        let colors = mesh.faces[face].map(|v| mesh.colors[v as usize]);
        return std::array::from_fn(|k| {
            let value: f64 = (0..3).map(|i| shares[i] * f64::from(colors[i][k])).sum();
            (value + 0.5).clamp(0.0, 255.0) as u8
        });
    }
    let facing = if back { -normal } else { normal };
    if paint == Paint::Normal {
        return [facing.x, -facing.y, -facing.z].map(|v| (127.5 + 127.5 * v + 0.5) as u8);
    }
    // Light from over the left shoulder, and a little from everywhere.
    let light = 0.35 + 0.65 * facing.dot(DVec3::new(-0.45, -0.6, -0.66)).max(0.0);
    let base = match (paint, mesh.buildings.get(face)) {
        (Paint::Building, Some(building)) if *building != 0 => building_color(*building),
        _ if back => [190, 110, 100],
        _ => [225, 222, 214],
    };
    base.map(|v| (f64::from(v) * light) as u8)
}

/// A colour that differs from those of the neighbouring numbers.
#[must_use]
pub fn building_color(building: u32) -> [u8; 3] {
    // Steps of the golden ratio around the colour circle.
    let hue = (f64::from(building) * 0.618_033_988_749_895).fract() * 6.0;
    let channel = |shift: f64| {
        let at = (hue + shift) % 6.0;
        let value = if at < 1.0 {
            at
        } else if at < 3.0 {
            1.0
        } else if at < 4.0 {
            4.0 - at
        } else {
            0.0
        };
        (80.0 + 165.0 * value) as u8
    };
    [channel(2.0), channel(0.0), channel(4.0)]
}

#[cfg(test)]
mod tests;
