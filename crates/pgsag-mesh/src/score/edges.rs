//! The sharp edges of the true buildings: sides of two building faces that meet at more than 30 degrees.

use std::collections::HashMap;

use glam::DVec3;
use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQueryWithLocation;
use parry3d_f64::shape::Polyline;
use pgsag_scene::Mesh;

/// Cosine of the smallest fold that counts as an edge.
const MAX_COS: f64 = 0.866_025_403_784_438_6;

/// Edges in a bounding-volume tree.
pub(crate) struct Edges(Option<Polyline>);

impl Edges {
    /// Of the building faces of `mesh`, or of all faces where it knows no buildings. Vertices that lie on one another
    /// count as one.
    pub(crate) fn new(mesh: &Mesh) -> Self {
        let mut known: HashMap<[u64; 3], u32> = HashMap::new();
        let welded: Vec<u32> = mesh
            .vertices
            .iter()
            .enumerate()
            .map(|(at, v)| *known.entry(v.map(|c| (c + 0.0).to_bits())).or_insert(at as u32))
            .collect();
        let mut sides: Vec<([u32; 2], u32)> = Vec::new();
        for (f, face) in mesh.faces.iter().enumerate() {
            if mesh.buildings.get(f).is_some_and(|building| *building == 0) {
                continue;
            }
            for k in 0..3 {
                let (a, b) = (welded[face[k] as usize], welded[face[(k + 1) % 3] as usize]);
                if a != b {
                    sides.push(([a.min(b), a.max(b)], f as u32));
                }
            }
        }
        sides.sort_unstable();
        let normal = |face: u32| {
            let [a, b, c] = mesh.triangle(face as usize).map(DVec3::from);
            (b - a).cross(c - a).normalize_or_zero()
        };
        let sharp: Vec<[u32; 2]> = sides
            .chunk_by(|one, other| one.0 == other.0)
            .filter(|faces| {
                let normals: Vec<DVec3> = faces.iter().map(|(_, f)| normal(*f)).filter(|n| *n != DVec3::ZERO).collect();
                normals.iter().enumerate().any(|(i, one)| normals[..i].iter().any(|other| one.dot(*other) < MAX_COS))
            })
            .map(|faces| faces[0].0)
            .collect();
        if sharp.is_empty() {
            return Self(None);
        }
        let vertices = mesh.vertices.iter().map(|v| Vector::new(v[0], v[1], v[2])).collect();
        Self(Some(Polyline::new(vertices, Some(sharp))))
    }

    /// Whether an edge passes within `band`.
    pub(crate) fn within(&self, point: DVec3, band: f64) -> bool {
        let at = Vector::new(point.x, point.y, point.z);
        self.0
            .as_ref()
            .is_some_and(|edges| edges.project_local_point_and_get_location_with_max_dist(at, true, band).is_some())
    }
}
