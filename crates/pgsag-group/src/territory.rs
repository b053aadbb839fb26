//! Whose pixel is whose: the depth buffer's points, spread over the pixels between them without crossing a mask's edge.
//! The result names a point of the surface at every pixel, so that groups, halos and blocks all follow from it.

use std::collections::VecDeque;

use pgsag_scene::{Map, Mask, Pinhole, PixelClass, RigidTransform};

use crate::refine::{RefineOptions, background_classes, building_classes};
use crate::surface::{NO_POINT, Seen, Surface};

/// The point whose surface every pixel of `domain` shows. Only points for which `is_source` holds are spread, and only
/// inside the domain; [`NO_POINT`] outside, and where no point can be reached.
#[must_use]
pub fn territory(seen: &Seen, domain: &Map<bool>, is_source: impl Fn(u32) -> bool) -> Map<u32> {
    let (width, height) = (domain.width as usize, domain.height as usize);
    let mut found = seen.point.resized_nearest(domain.width, domain.height);
    let mut open = VecDeque::new();
    for (at, point) in found.values.iter_mut().enumerate() {
        if *point != NO_POINT && domain.values[at] && is_source(*point) {
            open.push_back(at as u32);
        } else {
            *point = NO_POINT;
        }
    }
    while let Some(at) = open.pop_front() {
        let point = found.values[at as usize];
        let (x, y) = (at as usize % width, at as usize / width);
        let beside = [
            (x > 0).then(|| at as usize - 1),
            (x + 1 < width).then(|| at as usize + 1),
            (y > 0).then(|| at as usize - width),
            (y + 1 < height).then(|| at as usize + width),
        ];
        for other in beside.into_iter().flatten() {
            if domain.values[other] && found.values[other] == NO_POINT {
                found.values[other] = point;
                open.push_back(other as u32);
            }
        }
    }
    found
}

/// What one view shows of one group: classes of a window, and which of its active pixels belong to the group's halo.
#[derive(Clone, Debug, PartialEq)]
pub struct Share {
    /// Left, top, width, height of the window, pixels of the training image.
    pub window_px: [u32; 4],
    /// Classes of the window.
    pub mask: Mask,
    /// Active pixels that another group owns.
    pub halo: Map<bool>,
    /// Edges between buildings and at height steps, where normals count less.
    pub inner_edges: Map<bool>,
}

/// How a pixel stands to a group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// Not its own.
    Outside,
    /// Its own.
    Core,
    /// Of its halo.
    Halo,
}

/// A window of pixels around a group's active ones, widened by `margin_px`; `None` where there are none.
#[must_use]
pub fn window_of(active: &Map<bool>, margin_px: u32) -> Option<[u32; 4]> {
    let width = active.width as usize;
    let (mut left, mut right, mut top, mut bottom) = (active.width, 0, active.height, 0);
    for (y, row) in active.values.chunks(width.max(1)).enumerate() {
        let Some(first) = row.iter().position(|is_active| *is_active) else { continue };
        let last = row.iter().rposition(|is_active| *is_active).unwrap_or(first);
        (left, right) = (left.min(first as u32), right.max(last as u32 + 1));
        (top, bottom) = (top.min(y as u32), y as u32 + 1);
    }
    (right > left).then(|| {
        let (x0, y0) = (left.saturating_sub(margin_px), top.saturating_sub(margin_px));
        let (x1, y1) = ((right + margin_px).min(active.width), (bottom + margin_px).min(active.height));
        [x0, y0, x1 - x0, y1 - y0]
    })
}

/// The window of a map.
#[must_use]
pub fn cropped<T: Copy>(map: &Map<T>, [x0, y0, width, height]: [u32; 4]) -> Map<T> {
    let rows = (y0..y0 + height).map(|y| y as usize * map.width as usize + x0 as usize);
    let values = rows.flat_map(|start| &map.values[start..start + width as usize]).copied().collect();
    Map { width, height, values }
}

/// Classes of a building group in a window: `standing` tells its pixels; where `may_go_on` holds, something hides the
/// group or may hide it, elsewhere the ray is free of it.
#[must_use]
pub fn building_share(
    standing: &Map<Standing>,
    window_px: [u32; 4],
    may_go_on: &Map<bool>,
    options: &RefineOptions,
) -> Share {
    let window = cropped(standing, window_px);
    let (width, height) = (window.width, window.height);
    let active = Map { width, height, values: window.values.iter().map(|s| *s != Standing::Outside).collect() };
    let mut mask = building_classes(&active, options);
    for (class, hidden) in mask.classes.iter_mut().zip(&cropped(may_go_on, window_px).values) {
        if *class == PixelClass::Free && *hidden {
            *class = PixelClass::Occluded;
        }
    }
    let halo = Map { width, height, values: window.values.iter().map(|s| *s == Standing::Halo).collect() };
    Share { window_px, mask, halo, inner_edges: Map::filled(width, height, false) }
}

/// Classes of a background block in a window of its view: as [`background_classes`], where the block reaches; everything
/// else says nothing.
#[must_use]
pub fn background_share(
    building: &Map<bool>,
    standing: &Map<Standing>,
    window_px: [u32; 4],
    options: &RefineOptions,
) -> Share {
    let whole = background_classes(building, options);
    let [x0, y0, width, height] = window_px;
    let mut mask = whole.cropped(x0, y0, width, height);
    let window = cropped(standing, window_px);
    for (class, standing) in mask.classes.iter_mut().zip(&window.values) {
        if *standing == Standing::Outside {
            *class = PixelClass::Occluded;
        }
    }
    let halo = Map { width, height, values: window.values.iter().map(|s| *s == Standing::Halo).collect() };
    Share { window_px, mask, halo, inner_edges: Map::filled(width, height, false) }
}

/// Where a group's points would be drawn if nothing hid them, at the size of `camera`.
#[must_use]
pub fn coverage(surface: &Surface, points: &[u32], seen: &Seen, pose: &RigidTransform, camera: &Pinhole) -> Map<bool> {
    let small = seen.camera;
    let mut covered = Map::filled(small.width, small.height, false);
    for &point in points {
        let at = pose.transform_point(surface.position(point));
        let Some(center) = small.project(at).filter(|center| small.contains(*center)) else { continue };
        let (x, y) = (center.x as u32, center.y as u32);
        for v in y.saturating_sub(1)..(y + 2).min(small.height) {
            for u in x.saturating_sub(1)..(x + 2).min(small.width) {
                covered.set(u, v, true);
            }
        }
    }
    covered.resized_nearest(camera.width, camera.height)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(points: &[(u32, u32, u32)]) -> Seen {
        let camera = Pinhole { width: 20, height: 10, fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0 };
        let mut seen = Seen { camera, point: Map::filled(20, 10, NO_POINT), depth: Map::filled(20, 10, f32::INFINITY) };
        points.iter().for_each(|(x, y, point)| seen.point.set(*x, *y, *point));
        seen
    }

    #[test]
    fn territory_fills_the_mask_and_stops_at_its_edge() {
        let mut domain = Map::filled(20, 10, false);
        (0..10).for_each(|y| (4..16).for_each(|x| domain.set(x, y, true)));
        let found = territory(&seen(&[(5, 5, 1), (14, 5, 2), (0, 0, 3), (8, 8, 9)]), &domain, |point| point != 9);
        assert_eq!((found.at(4, 0), found.at(15, 9), found.at(0, 0)), (1, 2, NO_POINT));
        assert_eq!((found.at(9, 5), found.at(10, 5)), (1, 2));
        assert!((0..10).all(|y| (4..16).all(|x| found.at(x, y) != NO_POINT)));
    }

    #[test]
    fn window_is_the_box_of_active_pixels_with_margin() {
        let mut active = Map::filled(30, 20, false);
        active.set(7, 5, true);
        active.set(3, 9, true);
        assert_eq!(window_of(&active, 0), Some([3, 5, 5, 5]));
        assert_eq!(window_of(&active, 4), Some([0, 1, 12, 13]));
        assert_eq!(window_of(&Map::filled(30, 20, false), 4), None);
    }

    #[test]
    fn a_share_tells_core_halo_hidden_and_free() {
        let mut standing = Map::filled(20, 10, Standing::Outside);
        (0..10).for_each(|y| (0..8).for_each(|x| standing.set(x, y, Standing::Core)));
        (0..10).for_each(|y| (8..12).for_each(|x| standing.set(x, y, Standing::Halo)));
        let mut behind = Map::filled(20, 10, false);
        (0..10).for_each(|y| (12..15).for_each(|x| behind.set(x, y, true)));
        let share = building_share(&standing, [4, 0, 16, 10], &behind, &RefineOptions::default());
        let at = |x: u32| share.mask.at(x, 5);
        use PixelClass::{Boundary, Free, Inside, Occluded};
        assert_eq!([at(0), at(4), at(6), at(7), at(8), at(11)], [Inside, Inside, Boundary, Boundary, Occluded, Free]);
        assert!(!share.halo.at(3, 5) && share.halo.at(4, 5) && share.halo.at(7, 5) && !share.halo.at(8, 5));
    }
}
