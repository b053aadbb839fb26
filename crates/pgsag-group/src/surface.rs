//! Points on surfaces as something that hides what is behind: a depth buffer of small discs, one view at a time.
//!
//! Points are kept in chunks with bounding spheres, so that a view looks only at what may lie in front of it and the
//! work grows with the flight, not with flight times city.

use glam::DVec3;
use pgsag_scene::numbers::median;
use pgsag_scene::{Map, Pinhole, RigidTransform};

/// Marks a pixel that shows no point.
pub const NO_POINT: u32 = u32::MAX;
/// Half the side of a point's square, in spacings: neighbours just touch.
const SPLAT_SPACINGS: f64 = 0.6;
/// Distance between points in a depth buffer, pixels: fine enough for edges, coarse enough to leave no holes.
const BUFFER_SPACING_PX: f64 = 1.5;
/// Largest half side of a square in the buffer.
const MAX_SPLAT_PX: f64 = 4.0;
/// Points in a chunk, about.
const CHUNK_POINTS: f64 = 512.0;
/// Wanted points per voxel when the spacing is measured.
const VOXEL_POINTS: f64 = 6.0;

/// Points that lie together.
struct Chunk {
    start: usize,
    end: usize,
    center: DVec3,
    radius: f64,
}

/// Points on surfaces, world frame.
pub struct Surface {
    positions: Vec<DVec3>,
    /// Local distance between points, scene units.
    spacings: Vec<f32>,
    order: Vec<u32>,
    chunks: Vec<Chunk>,
    /// Typical distance between neighbouring points, scene units.
    pub spacing: f64,
}

/// What a view sees of a surface, at the size of its buffer.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    /// Of the buffer.
    pub camera: Pinhole,
    /// Index of the nearest point at every pixel, or [`NO_POINT`].
    pub point: Map<u32>,
    /// Its z-depth; infinite where there is none.
    pub depth: Map<f32>,
}

impl Surface {
    /// Of points on surfaces.
    #[must_use]
    pub fn new(positions: Vec<DVec3>) -> Self {
        let (voxel, spacing) = measure(&positions);
        let spacings = local_spacings(&positions, voxel, spacing);
        let side = spacing * CHUNK_POINTS.sqrt();
        let mut order: Vec<u32> = (0..positions.len() as u32).collect();
        let key = |at: &u32| cell_of(positions[*at as usize], side);
        order.sort_by_cached_key(|at| (key(at), *at));
        let mut chunks = Vec::new();
        let mut start = 0;
        for members in order.chunk_by(|a, b| key(a) == key(b)) {
            let at = |member: &u32| positions[*member as usize];
            let center = members.iter().map(at).sum::<DVec3>() / members.len() as f64;
            let radius = members.iter().map(|member| at(member).distance(center)).fold(0.0, f64::max);
            chunks.push(Chunk { start, end: start + members.len(), center, radius });
            start += members.len();
        }
        Self { positions, spacings, order, chunks, spacing }
    }

    /// Where a point lies.
    #[must_use]
    pub fn position(&self, index: u32) -> DVec3 {
        self.positions[index as usize]
    }

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there is no point.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Points that may lie in a view, hidden or not.
    pub fn candidates<'a>(&'a self, camera: &Pinhole, pose: &RigidTransform) -> impl Iterator<Item = u32> + use<'a> {
        let (camera, pose) = (*camera, *pose);
        let chunks =
            self.chunks.iter().filter(move |chunk| may_see(&camera, pose.transform_point(chunk.center), chunk.radius));
        chunks.flat_map(|chunk| self.order[chunk.start..chunk.end].iter().copied())
    }

    /// The camera of a buffer in which neighbouring points of this surface are one to two pixels apart.
    #[must_use]
    pub fn buffer_camera(&self, camera: &Pinhole, pose: &RigidTransform) -> Pinhole {
        let depth = |chunk: &Chunk| Some(pose.transform_point(chunk.center)).filter(|at| may_see(camera, *at, 0.0));
        let mut depths: Vec<f64> = self.chunks.iter().filter_map(depth).map(|at| at.z).collect();
        let spacing_px = median(&mut depths).map_or(1.0, |depth| self.spacing * camera.focal_px() / depth);
        let shrink = (BUFFER_SPACING_PX / spacing_px).min(1.0);
        let side = |length: u32| ((f64::from(length) * shrink).round() as u32).clamp(length.min(16), length);
        camera.resized(side(camera.width), side(camera.height))
    }

    /// Distance between points in an image, pixels, at its median depth.
    #[must_use]
    pub fn spacing_px(&self, camera: &Pinhole, seen: &Seen) -> f64 {
        let known = seen.depth.values.iter().filter(|z| z.is_finite());
        let mut depths: Vec<f64> = known.step_by(7).map(|z| f64::from(*z)).collect();
        median(&mut depths).map_or(1.0, |depth| self.spacing * camera.focal_px() / depth)
    }

    /// The nearest of the points for which `is_shown` holds, at every pixel of `camera`; of two at one depth, the first.
    #[must_use]
    pub fn render(&self, camera: &Pinhole, pose: &RigidTransform, is_shown: impl Fn(u32) -> bool) -> Seen {
        let mut seen = Seen {
            camera: *camera,
            point: Map::filled(camera.width, camera.height, NO_POINT),
            depth: Map::filled(camera.width, camera.height, f32::INFINITY),
        };
        for index in self.candidates(camera, pose).filter(|index| is_shown(*index)) {
            let at = pose.transform_point(self.positions[index as usize]);
            let Some(center) = camera.project(at) else { continue };
            let spacing = f64::from(self.spacings[index as usize]);
            let reach = (SPLAT_SPACINGS * spacing * camera.focal_px() / at.z).clamp(0.5, MAX_SPLAT_PX);
            let range = |middle: f64, size: u32| {
                let (low, high) = ((middle - reach).round().max(0.0), (middle + reach).round().min(f64::from(size)));
                low as u32..(high as u32).max(low as u32)
            };
            let z = at.z as f32;
            for y in range(center.y, camera.height) {
                for x in range(center.x, camera.width) {
                    let (depth, point) = (seen.depth.at(x, y), seen.point.at(x, y));
                    if z < depth || (z == depth && index < point) {
                        seen.depth.set(x, y, z);
                        seen.point.set(x, y, index);
                    }
                }
            }
        }
        seen
    }

    /// Whether a view sees a place of the surface: nothing lies clearly in front of it.
    #[must_use]
    pub fn is_seen(&self, seen: &Seen, point_camera: DVec3, depth_tolerance: f64) -> bool {
        let Some(at) = seen.camera.project(point_camera).filter(|at| seen.camera.contains(*at)) else { return false };
        let nearest = f64::from(seen.depth.at(at.x as u32, at.y as u32));
        point_camera.z <= nearest * (1.0 + depth_tolerance) + 1.5 * self.spacing
    }
}

fn cell_of(at: DVec3, side: f64) -> [i64; 3] {
    (at / side).floor().to_array().map(|v| v as i64)
}

/// Whether a sphere about a place in the camera frame may touch the view.
fn may_see(camera: &Pinhole, center: DVec3, radius: f64) -> bool {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let beyond = |a: f64, f: f64, c: f64| a * f + center.z * c >= -radius * (f * f + c * c).sqrt();
    center.z + radius > 0.0
        && beyond(center.x, camera.fx, camera.cx)
        && beyond(-center.x, camera.fx, width - camera.cx)
        && beyond(center.y, camera.fy, camera.cy)
        && beyond(-center.y, camera.fy, height - camera.cy)
}

/// Side of a voxel that holds a few points, and the distance between them, from how many voxels are occupied.
fn measure(positions: &[DVec3]) -> (f64, f64) {
    let count = positions.len().max(1) as f64;
    let bound = |axis: usize, q: f64| {
        pgsag_scene::numbers::quantile(&mut positions.iter().map(|p| p[axis]).collect::<Vec<_>>(), q).unwrap_or(0.0)
    };
    let size = DVec3::from_array(std::array::from_fn(|axis| bound(axis, 0.95) - bound(axis, 0.05)));
    let mut side = (size.max_element() / count.sqrt()).max(1e-9) * VOXEL_POINTS.sqrt();
    for _ in 0..8 {
        let mut cells: Vec<[i64; 3]> = positions.iter().map(|at| cell_of(*at, side)).collect();
        cells.sort_unstable();
        cells.dedup();
        let mean = count / cells.len().max(1) as f64;
        if cells.len() < 8 {
            break; // a handful of points has no voxels to count
        }
        if (0.6 * VOXEL_POINTS..1.6 * VOXEL_POINTS).contains(&mean) {
            return (side, side / mean.sqrt());
        }
        side *= (VOXEL_POINTS / mean).sqrt().clamp(0.25, 4.0);
    }
    (side, size.max_element().max(1e-9) / count.sqrt())
}

/// Distance of each point to its neighbours, from how many share its voxel.
fn local_spacings(positions: &[DVec3], voxel: f64, spacing: f64) -> Vec<f32> {
    let mut cells: Vec<([i64; 3], u32)> = (0..).zip(positions).map(|(i, at)| (cell_of(*at, voxel), i)).collect();
    cells.sort_unstable();
    let mut spacings = vec![spacing as f32; positions.len()];
    for members in cells.chunk_by(|a, b| a.0 == b.0) {
        let local = (voxel / (members.len() as f64).sqrt()).clamp(0.6 * spacing, 2.0 * spacing);
        members.iter().for_each(|(_, index)| spacings[*index as usize] = local as f32);
    }
    spacings
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    fn camera() -> (Pinhole, RigidTransform) {
        let camera = Pinhole { width: 100, height: 80, fx: 100.0, fy: 100.0, cx: 50.0, cy: 40.0 };
        (camera, RigidTransform { rotation: DQuat::IDENTITY, translation: DVec3::ZERO })
    }

    /// A wall of points at a depth, `step` apart.
    fn wall(z: f64, half: f64, step: f64) -> Vec<DVec3> {
        let count = (2.0 * half / step) as i32;
        let at = |i: i32| -half + (f64::from(i) + 0.5) * step;
        (0..count * count).map(|i| DVec3::new(at(i % count), at(i / count), z)).collect()
    }

    #[test]
    fn the_spacing_is_that_of_the_points() {
        let surface = Surface::new(wall(10.0, 3.0, 0.1));
        assert!((0.08..0.13).contains(&surface.spacing), "{}", surface.spacing);
    }

    #[test]
    fn what_is_in_front_hides_what_is_behind_without_holes() {
        let (camera, pose) = camera();
        let mut points = wall(20.0, 8.0, 0.2);
        let far_count = points.len() as u32;
        points.extend(wall(10.0, 1.5, 0.2));
        let surface = Surface::new(points);
        let buffer = surface.buffer_camera(&camera, &pose);
        let seen = surface.render(&buffer, &pose, |_| true);
        let scale = f64::from(buffer.width) / 100.0;
        for y in 4..76 {
            for x in 14..86 {
                let point = seen.point.at((f64::from(x) * scale) as u32, (f64::from(y) * scale) as u32);
                let is_deep_inside = (38..62).contains(&x) && (28..52).contains(&y);
                assert!(point != NO_POINT, "hole at {x} {y}");
                assert!(!is_deep_inside || point >= far_count, "{x} {y} shows the far wall");
            }
        }
        assert!(!surface.is_seen(&seen, DVec3::new(0.0, 0.0, 20.0), 0.01));
        assert!(surface.is_seen(&seen, DVec3::new(0.0, 0.0, 10.0), 0.01));
        assert!(surface.is_seen(&seen, DVec3::new(6.0, 0.0, 20.0), 0.01));
    }

    #[test]
    fn points_behind_or_beside_are_no_candidates() {
        let (camera, pose) = camera();
        let mut points = wall(10.0, 0.5, 0.1);
        points.extend(wall(-10.0, 0.5, 0.1));
        points.extend(wall(10.0, 0.5, 0.1).iter().map(|p| *p + DVec3::X * 40.0));
        let surface = Surface::new(points);
        assert!(surface.candidates(&camera, &pose).all(|index| index < 100));
        assert_eq!(surface.candidates(&camera, &pose).count(), 100);
    }
}
