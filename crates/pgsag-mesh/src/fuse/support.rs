//! Sky, water, woods in the wind: what no photograph could match has no points, and where such a place is open to the
//! border of a view it belongs to no surface. Training still paints it, on sheets that all views agree upon, so
//! agreement alone does not remove them. Plain roofs and walls have no points either, but points all around.

use glam::DVec3;
use pgsag_scene::numbers::median;
use pgsag_scene::{Map, Pinhole, RigidTransform};
use serde::{Deserialize, Serialize};

/// What counts as support of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SupportOptions {
    /// A point supports the square around its pixel: this many times the mean spacing of the view's points to each
    /// side. 0 takes every pixel as supported.
    pub reach_spacings: f32,
    /// The least reach of a point, pixels.
    pub min_reach_px: u32,
    /// So many points support a pixel: single ones stray.
    pub min_points: u32,
}

impl Default for SupportOptions {
    fn default() -> Self {
        Self { reach_spacings: 3.0, min_reach_px: 8, min_points: 3 }
    }
}

/// Side of a chunk of [`Points`], in mean distances between points of a surface.
const CHUNK_SPACINGS: f64 = 32.0;

/// Points of a surface in chunks with bounding balls, so that a view looks at what lies before it alone.
pub struct Points {
    positions: Vec<DVec3>,
    /// First member, one past the last, centre and radius of the ball.
    chunks: Vec<(usize, usize, DVec3, f64)>,
}

impl Points {
    /// Of points in any order, world frame; strays far away cost nothing.
    #[must_use]
    pub fn new(mut positions: Vec<DVec3>) -> Self {
        let middle = |axis: usize| median(&mut positions.iter().map(|at| at[axis]).collect::<Vec<_>>()).unwrap_or(0.0);
        let middle = DVec3::new(middle(0), middle(1), middle(2));
        let off = median(&mut positions.iter().map(|at| at.distance(middle)).collect::<Vec<_>>()).unwrap_or(0.0);
        // Half of them lie on a disc of this radius.
        let side = (CHUNK_SPACINGS * off * (2.0 / positions.len().max(1) as f64).sqrt()).max(f64::MIN_POSITIVE);
        let key = |at: &DVec3| (*at / side).floor().as_i64vec3().to_array();
        positions.sort_by_cached_key(key);
        let mut chunks = Vec::new();
        let mut first = 0;
        for members in positions.chunk_by(|a, b| key(a) == key(b)) {
            let center = members.iter().sum::<DVec3>() / members.len() as f64;
            let radius = members.iter().map(|at| at.distance(center)).fold(0.0, f64::max);
            chunks.push((first, first + members.len(), center, radius));
            first += members.len();
        }
        Self { positions, chunks }
    }

    /// Those that may lie in a view.
    fn before<'a>(&'a self, camera: &Pinhole, pose: &RigidTransform) -> impl Iterator<Item = DVec3> + use<'a> {
        let (camera, pose) = (*camera, *pose);
        let near = self.chunks.iter().filter(move |(.., center, radius)| {
            let at = pose.transform_point(*center);
            let is_inside = |a: f64, f: f64, c: f64| a * f + at.z * c >= -radius * (f * f + c * c).sqrt();
            at.z + radius > 0.0
                && is_inside(at.x, camera.fx, camera.cx)
                && is_inside(-at.x, camera.fx, f64::from(camera.width) - camera.cx)
                && is_inside(at.y, camera.fy, camera.cy)
                && is_inside(-at.y, camera.fy, f64::from(camera.height) - camera.cy)
        });
        near.flat_map(|(first, last, ..)| self.positions[*first..*last].iter().copied())
    }
}

/// Which pixels of a whole view are not open: supported by points, or enclosed by pixels that are. Points behind a
/// surface support it as well; what is asked is whether anything is there at all.
#[must_use]
pub fn supported(
    camera: &Pinhole,
    camera_from_world: &RigidTransform,
    points_world: &Points,
    options: &SupportOptions,
) -> Map<bool> {
    let (width, height) = (camera.width as usize, camera.height as usize);
    if options.reach_spacings <= 0.0 {
        return Map::filled(camera.width, camera.height, true);
    }
    let mut occupied = vec![false; width * height];
    for point in points_world.before(camera, camera_from_world) {
        let Some(at) = camera.project(camera_from_world.transform_point(point)) else { continue };
        if camera.contains(at) {
            occupied[at.y as usize * width + at.x as usize] = true;
        }
    }
    let count = occupied.iter().filter(|is_occupied| **is_occupied).count().max(1);
    let spacing_px = (occupied.len() as f32 / count as f32).sqrt();
    let reach = ((options.reach_spacings * spacing_px) as usize).max(options.min_reach_px as usize);
    let around = window_sums(&occupied, width, height, reach);
    let is_bare: Vec<bool> = around.iter().map(|count| *count < options.min_points).collect();
    let is_open = reached_from_border(&is_bare, width, height);
    // The reach bridges gaps; where it sticks out into the open half of it is taken back.
    let beside = window_sums(&is_open, width, height, reach / 2);
    let near = window_sums(&occupied, width, height, (spacing_px as usize).max(options.min_reach_px as usize / 4));
    let kept = (0..occupied.len()).map(|at| !is_open[at] && (beside[at] == 0 || near[at] > 1)).collect();
    Map { width: camera.width, height: camera.height, values: kept }
}

/// Per pixel, how many are set in the square of `reach` pixels to each side.
fn window_sums(set: &[bool], width: usize, height: usize, reach: usize) -> Vec<u32> {
    // sums[y][x]: of all pixels above and left of (x, y).
    let stride = width + 1;
    let mut sums = vec![0_u32; stride * (height + 1)];
    for y in 0..height {
        let mut row = 0;
        for x in 0..width {
            row += u32::from(set[y * width + x]);
            sums[(y + 1) * stride + x + 1] = sums[y * stride + x + 1] + row;
        }
    }
    let mut counts = Vec::with_capacity(width * height);
    for y in 0..height {
        let (top, bottom) = (y.saturating_sub(reach) * stride, (y + reach + 1).min(height) * stride);
        for x in 0..width {
            let (left, right) = (x.saturating_sub(reach), (x + reach + 1).min(width));
            counts.push(sums[bottom + right] + sums[top + left] - sums[top + right] - sums[bottom + left]);
        }
    }
    counts
}

/// What of a set can be reached from the border without leaving it.
fn reached_from_border(set: &[bool], width: usize, height: usize) -> Vec<bool> {
    let mut is_reached = vec![false; set.len()];
    let sides = (0..height).flat_map(|y| [y * width, y * width + width - 1]);
    let mut stack: Vec<usize> = (0..width).chain((height - 1) * width..height * width).chain(sides).collect();
    while let Some(at) = stack.pop() {
        if !set[at] || is_reached[at] {
            continue;
        }
        is_reached[at] = true;
        let x = at % width;
        let columns = [(x > 0, at.wrapping_sub(1)), (x + 1 < width, at + 1)];
        let rows = [(at >= width, at.wrapping_sub(width)), (at + width < set.len(), at + width)];
        stack.extend(columns.into_iter().chain(rows).filter(|(is_inside, _)| *is_inside).map(|(_, next)| next));
    }
    is_reached
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 60, height: 40, fx: 50.0, fy: 50.0, cx: 30.0, cy: 20.0 };
    const OPTIONS: SupportOptions = SupportOptions { reach_spacings: 1.0, min_reach_px: 3, min_points: 3 };

    fn seen(is_point: impl Fn(u32, u32) -> bool) -> Map<bool> {
        let pixels = (0..40).flat_map(|y| (0..60).map(move |x| (x, y))).filter(|(x, y)| is_point(*x, *y));
        let points = pixels.map(|(x, y)| CAMERA.ray(f64::from(x) + 0.5, f64::from(y) + 0.5) * 7.0);
        supported(&CAMERA, &RigidTransform::IDENTITY, &Points::new(points.collect()), &OPTIONS)
    }

    #[test]
    fn the_sky_is_open_and_a_plain_wall_is_not() {
        let is_wall = |x: u32, y: u32| (20..40).contains(&x) && (20..32).contains(&y);
        let found = seen(|x, y| y >= 15 && !is_wall(x, y));
        assert!(!found.at(30, 4), "sky");
        assert!(found.at(30, 26), "a plain wall among textured ones");
        assert!(found.at(5, 30) && found.at(30, 14), "points, and what is beside them");
        assert!(!found.at(30, 12), "what bridges gaps does not stick out");
    }

    #[test]
    fn what_may_lie_in_a_view_holds_all_that_does() {
        let grid = (-60..60).flat_map(|x| (-60..60).map(move |y| DVec3::new(f64::from(x), f64::from(y), 40.0)));
        let points = Points::new(grid.chain([DVec3::new(0.0, 0.0, -5.0), DVec3::new(9e5, 0.0, 1.0)]).collect());
        let found: Vec<DVec3> = points.before(&CAMERA, &RigidTransform::IDENTITY).collect();
        let is_seen = |at: &&DVec3| CAMERA.project(**at).is_some_and(|px| CAMERA.contains(px));
        let seen = points.positions.iter().filter(is_seen).count();
        assert_eq!(found.iter().filter(|at| is_seen(at)).count(), seen);
        assert!(seen > 1000 && found.len() < points.positions.len() / 2, "{} of {seen}", found.len());
    }

    #[test]
    fn strays_in_the_sky_support_nothing() {
        let found = seen(|x, y| y >= 20 || (x == 30 && (5..7).contains(&y)));
        assert!(!found.at(30, 5));
        let cluster = seen(|x, y| y >= 20 || (x == 30 && (5..8).contains(&y)));
        assert!(cluster.at(30, 6));
    }

    #[test]
    fn a_plain_wall_that_the_border_cuts_is_open() {
        let found = seen(|x, y| y >= 15 && !(x < 20 && (22..34).contains(&y)));
        assert!(!found.at(4, 28) && found.at(40, 28));
    }

    #[test]
    fn sums_equal_counting_and_switching_it_off_keeps_all() {
        let set: Vec<bool> = (0..7 * 5).map(|at| at * at % 3 == 1).collect();
        let sums = window_sums(&set, 7, 5, 2);
        for (at, sum) in sums.iter().enumerate() {
            let (x, y) = (at as i32 % 7, at as i32 / 7);
            let inside = |other: usize| (other as i32 % 7 - x).abs() <= 2 && (other as i32 / 7 - y).abs() <= 2;
            assert_eq!(*sum as usize, (0..35).filter(|other| set[*other] && inside(*other)).count());
        }
        let off = SupportOptions { reach_spacings: 0.0, ..OPTIONS };
        let all = supported(&CAMERA, &RigidTransform::IDENTITY, &Points::new(Vec::new()), &off);
        assert!(all.values.iter().all(|kept| *kept));
        let none = supported(&CAMERA, &RigidTransform::IDENTITY, &Points::new(Vec::new()), &OPTIONS);
        assert!(none.values.iter().all(|kept| !kept));
    }
}
