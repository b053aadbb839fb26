//! Plan view: the world seen along the up axis, and grids over it.

use glam::{DVec2, DVec3};
use pgsag_scene::numbers::quantile;

/// Share of the points that may lie outside of a grid on each side: outliers of the model.
const OUTLIER_SHARE: f64 = 0.005;
/// A grid never has more cells than this; its cells grow instead.
const MAX_CELLS: f64 = (1 << 22) as f64;

/// Axes of plan view. Scene units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanFrame {
    /// Away from the ground, world frame, unit.
    pub up: DVec3,
    east: DVec3,
    north: DVec3,
}

impl PlanFrame {
    /// The plan across an up axis.
    #[must_use]
    pub fn new(up_world: DVec3) -> Self {
        let up = up_world.normalize_or(DVec3::Z);
        let (east, north) = up.any_orthonormal_pair();
        Self { up, east, north }
    }

    /// Where a point lies in plan.
    #[must_use]
    pub fn plan(&self, point_world: DVec3) -> DVec2 {
        DVec2::new(point_world.dot(self.east), point_world.dot(self.north))
    }

    /// How high it lies along the up axis.
    #[must_use]
    pub fn height(&self, point_world: DVec3) -> f64 {
        point_world.dot(self.up)
    }

    /// The point at a place in plan and a height.
    #[must_use]
    pub fn world(&self, plan: DVec2, height: f64) -> DVec3 {
        self.east * plan.x + self.north * plan.y + self.up * height
    }
}

/// A grid of square cells over nearly all points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanGrid {
    /// Lowest corner.
    pub low: DVec2,
    /// Side of a cell, scene units.
    pub cell: f64,
    /// Cells along x.
    pub columns: usize,
    /// Cells along y.
    pub rows: usize,
}

impl PlanGrid {
    /// A grid with cells of at least `cell`; `None` without points.
    #[must_use]
    pub fn covering(points: &[DVec2], cell: f64) -> Option<Self> {
        let bound = |axis: usize, q: f64| quantile(&mut points.iter().map(|p| p[axis]).collect::<Vec<_>>(), q);
        let low = DVec2::new(bound(0, OUTLIER_SHARE)?, bound(1, OUTLIER_SHARE)?);
        let high = DVec2::new(bound(0, 1.0 - OUTLIER_SHARE)?, bound(1, 1.0 - OUTLIER_SHARE)?);
        let margin = DVec2::splat(0.05 * (high - low).max_element() + 2.0 * cell);
        let (low, size) = (low - margin, high - low + 2.0 * margin);
        let cell = cell.max((size.x * size.y / MAX_CELLS).sqrt());
        let (columns, rows) = ((size.x / cell).ceil() as usize, (size.y / cell).ceil() as usize);
        (cell > 0.0 && cell.is_finite()).then_some(Self { low, cell, columns: columns.max(1), rows: rows.max(1) })
    }

    /// Cells in all.
    #[must_use]
    pub fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// Whether there is no cell; never so for a grid that was made by [`Self::covering`].
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The cell of a place; `None` outside.
    #[must_use]
    pub fn index(&self, plan: DVec2) -> Option<usize> {
        let at = ((plan - self.low) / self.cell).floor();
        let is_inside = at.x >= 0.0 && at.y >= 0.0 && at.x < self.columns as f64 && at.y < self.rows as f64;
        is_inside.then(|| at.y as usize * self.columns + at.x as usize)
    }

    /// The middle of a cell.
    #[must_use]
    pub fn center(&self, index: usize) -> DVec2 {
        let at = DVec2::new((index % self.columns) as f64, (index / self.columns) as f64);
        self.low + (at + 0.5) * self.cell
    }

    /// The up to eight cells around a cell.
    pub fn around(&self, index: usize) -> impl Iterator<Item = usize> + use<> {
        let (columns, rows) = (self.columns as i64, self.rows as i64);
        let (x, y) = ((index % self.columns) as i64, (index / self.columns) as i64);
        let steps = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))).filter(|step| *step != (0, 0));
        steps.filter_map(move |(dx, dy)| {
            let (u, v) = (x + dx, y + dy);
            (u >= 0 && v >= 0 && u < columns && v < rows).then_some((v * columns + u) as usize)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_covers_its_points_but_not_outliers() {
        let mut points: Vec<DVec2> = (0..1000).map(|i| DVec2::new(f64::from(i % 40), f64::from(i / 40))).collect();
        points.push(DVec2::splat(1e6));
        let grid = PlanGrid::covering(&points, 1.0).expect("points");
        assert!(points[..1000].iter().all(|p| grid.index(*p).is_some()) && grid.index(points[1000]).is_none());
        let cell = grid.index(points[77]).expect("inside");
        assert!((grid.center(cell) - points[77]).abs().max_element() <= 0.5 * grid.cell);
        assert_eq!(grid.around(0).count(), 3);
        assert_eq!(PlanGrid::covering(&[], 1.0), None);
    }

    #[test]
    fn plan_and_height_make_the_point_again() {
        let frame = PlanFrame::new(DVec3::new(0.1, -0.3, 2.0));
        let point = DVec3::new(3.0, -4.0, 5.0);
        assert!(frame.world(frame.plan(point), frame.height(point)).distance(point) < 1e-12);
    }
}
