//! The nearest place on a mesh, in a cloud, or on a set of edges.

use std::num::NonZero;

use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQueryWithLocation;
use parry3d_f64::shape::TriMesh;
use pgsag_scene::Mesh;
use rayon::prelude::*;

use super::sample::area;
use crate::error::MeshError;

/// What lies nearest to a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    /// Scene units.
    pub distance: f64,
    /// Whether the point lies on the back of the nearest face.
    pub behind: bool,
    /// Nearest face, or nearest point of a cloud.
    pub index: u32,
    /// Nearest place.
    pub place: DVec3,
}

/// Something that distances can be measured to.
pub(crate) trait Target: Sync {
    /// The nearest place, if it is nearer than `bound`.
    fn nearest_within(&self, point: DVec3, bound: f64) -> Option<Hit>;
}

/// Remembers the last answer: the next point of a walk over a surface is at most its own step farther away, which
/// prunes nearly all of the tree.
#[derive(Clone, Copy, Default)]
pub(crate) struct Walk(Option<(DVec3, f64)>);

impl Walk {
    pub(crate) fn nearest(&mut self, target: &dyn Target, point: DVec3) -> Option<Hit> {
        let bound = self.0.map_or(f64::MAX, |(last, distance)| (distance + point.distance(last)) * 1.000_001 + 1e-9);
        let hit = target.nearest_within(point, bound).or_else(|| target.nearest_within(point, f64::MAX))?;
        self.0 = Some((point, hit.distance));
        Some(hit)
    }
}

/// A mesh without its degenerate faces, in a bounding-volume tree.
pub(crate) struct Surface {
    tree: TriMesh,
    faces: Vec<u32>,
    normals: Vec<DVec3>,
}

impl Surface {
    pub(crate) fn new(mesh: &Mesh, name: &str) -> Result<Self, MeshError> {
        let faces: Vec<u32> = (0..mesh.faces.len()).filter(|f| area(mesh, *f) > 0.0).map(|f| f as u32).collect();
        let empty = || MeshError::Geometry { what: format!("{name} has no surface"), cure: "give a mesh with faces" };
        if faces.is_empty() {
            return Err(empty());
        }
        let normals = faces
            .par_iter()
            .map(|f| {
                let [a, b, c] = mesh.triangle(*f as usize).map(DVec3::from);
                (b - a).cross(c - a).normalize()
            })
            .collect();
        let vertices = mesh.vertices.iter().map(|v| Vector::new(v[0], v[1], v[2])).collect();
        let indices = faces.iter().map(|f| mesh.faces[*f as usize]).collect();
        let tree = TriMesh::new(vertices, indices).map_err(|_| empty())?;
        Ok(Self { tree, faces, normals })
    }

    /// Unit normal of an original face that is not degenerate.
    pub(crate) fn normal(&self, face: u32) -> DVec3 {
        self.faces.binary_search(&face).map_or(DVec3::Z, |at| self.normals[at])
    }
}

impl Target for Surface {
    fn nearest_within(&self, point: DVec3, bound: f64) -> Option<Hit> {
        let at = Vector::new(point.x, point.y, point.z);
        let (projection, (face, _)) = self.tree.project_local_point_and_get_location_with_max_dist(at, true, bound)?;
        let place = DVec3::new(projection.point.x, projection.point.y, projection.point.z);
        let behind = (point - place).dot(self.normals[face as usize]) < 0.0;
        Some(Hit { distance: point.distance(place), behind, index: self.faces[face as usize], place })
    }
}

/// Unit normal of a face; up where it has none.
pub(crate) fn face_normal(mesh: &Mesh, face: u32) -> DVec3 {
    let [a, b, c] = mesh.triangle(face as usize).map(DVec3::from);
    (b - a).cross(c - a).normalize_or(DVec3::Z)
}

/// A cloud in a k-d tree.
pub(crate) struct Cloud {
    tree: ImmutableKdTree<f64, 3>,
    points: Vec<[f64; 3]>,
}

impl Cloud {
    pub(crate) fn new(points: Vec<[f64; 3]>, name: &str) -> Result<Self, MeshError> {
        if points.is_empty() || points.iter().flatten().any(|v| !v.is_finite()) {
            let what = format!("{name} has no points, or points that are not numbers");
            return Err(MeshError::Geometry { what, cure: "give a cloud of finite points" });
        }
        let tree = ImmutableKdTree::new_from_slice(&points).map_err(|error| MeshError::Geometry {
            what: format!("{name} cannot be searched ({error})"),
            cure: "give a smaller cloud",
        })?;
        Ok(Self { tree, points })
    }

    /// Distance of every point to its nearest neighbour.
    pub(crate) fn neighbour_distances(&self) -> Vec<f64> {
        let two = NonZero::new(2).expect("2 is not 0");
        self.points
            .par_iter()
            .filter_map(|point| {
                let near = self.tree.query(point).nearest_n::<SquaredEuclidean<f64>>(two).execute();
                near.iter().map(|item| item.distance).max_by(f64::total_cmp).map(f64::sqrt)
            })
            .collect()
    }

    pub(crate) fn points(&self) -> &[[f64; 3]] {
        &self.points
    }
}

impl Target for Cloud {
    fn nearest_within(&self, point: DVec3, _: f64) -> Option<Hit> {
        let near = self.tree.query(&point.to_array()).nearest_one::<SquaredEuclidean<f64>>().execute();
        let place = DVec3::from(*self.points.get(near.item as usize)?);
        Some(Hit { distance: point.distance(place), behind: false, index: near.item, place })
    }
}
