//! Planes of a mesh: pieces that grow over faces of like normals, fitted without their outliers.

use std::collections::BTreeMap;

use glam::DVec3;
use pgsag_scene::Mesh;
use pgsag_scene::frame::eigen::symmetric_eigen;
use pgsag_scene::numbers::median;

use super::StructureOptions;
use crate::components::pick_faces;

/// Faces farther from the fitted plane than so many of its robust standard deviations do not pull at it.
const MAX_SIGMAS: f64 = 2.5;
/// Fits after the first.
const REFITS: u32 = 3;
/// Rounds in which normals are averaged with those of their neighbours: the lattice leaves steps in them.
const ROUNDS: u32 = 3;
/// No face, no plane.
const NONE: u32 = u32::MAX;

/// A flat piece of a building.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Building of its faces; 0 where none are known.
    pub building: u32,
    /// Surface, scene units squared.
    pub area: f64,
    /// Root mean square distance of its faces' middles from the plane, weighed by area, scene units.
    pub rms: f64,
    /// Cosine of its steepness: 1 = level.
    pub level: f64,
}

/// A face as it is asked again and again.
#[derive(Clone, Copy)]
struct Facet {
    middle: DVec3,
    normal: DVec3,
    area: f64,
}

/// The planes of building surface, building by building, or of all surface where the mesh knows no building; of each in
/// the order in which they grew: the flattest begin.
#[must_use]
pub fn planes(mesh: &Mesh, up: DVec3, gsd: f64, options: &StructureOptions) -> Vec<Plane> {
    let mut buildings: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (face, building) in mesh.buildings.iter().enumerate().filter(|(_, building)| **building != 0) {
        buildings.entry(*building).or_default().push(face as u32);
    }
    if buildings.is_empty() {
        return planes_of(0, mesh, up, gsd, options);
    }
    let mut renamed = vec![u32::MAX; mesh.vertices.len()];
    let mut found = Vec::new();
    for (building, faces) in buildings {
        found.extend(planes_of(building, &pick_faces(mesh, faces, &mut renamed), up, gsd, options));
    }
    found
}

fn planes_of(building: u32, mesh: &Mesh, up: DVec3, gsd: f64, options: &StructureOptions) -> Vec<Plane> {
    let around = Around::new(mesh);
    let (facets, order) = smooth(mesh, &around);
    let (min_cos, max_off) = (libm::cos(options.max_turn_deg.to_radians()), options.max_off_gsd * gsd);
    let min_area = (options.min_side_gsd * gsd).powi(2);
    let mut owner = vec![NONE; facets.len()];
    let mut found = Vec::new();
    for (number, start) in order.into_iter().enumerate() {
        if owner[start as usize] != NONE {
            continue;
        }
        let piece = grow(start, number as u32, &facets, &around, &mut owner, [min_cos, max_off]);
        let area: f64 = piece.iter().map(|at| facets[*at as usize].area).sum();
        if area >= min_area
            && let Some((normal, rms)) = fitted(&piece, &facets)
        {
            found.push(Plane { building, area, rms, level: normal.dot(up.normalize_or(DVec3::Z)).abs() });
        }
    }
    found
}

/// The faces at every vertex.
struct Around<'a> {
    mesh: &'a Mesh,
    starts: Vec<u32>,
    at: Vec<u32>,
}

impl<'a> Around<'a> {
    fn new(mesh: &'a Mesh) -> Self {
        let mut starts = vec![0_u32; mesh.vertices.len() + 1];
        for vertex in mesh.faces.iter().flatten() {
            starts[*vertex as usize + 1] += 1;
        }
        for vertex in 0..mesh.vertices.len() {
            starts[vertex + 1] += starts[vertex];
        }
        let mut next = starts.clone();
        let mut at = vec![0; 3 * mesh.faces.len()];
        for (face, corners) in mesh.faces.iter().enumerate() {
            for vertex in corners {
                at[next[*vertex as usize] as usize] = face as u32;
                next[*vertex as usize] += 1;
            }
        }
        Self { mesh, starts, at }
    }

    fn vertices(&self, face: u32) -> [u32; 3] {
        self.mesh.faces[face as usize]
    }

    fn faces_at(&self, vertex: u32) -> &[u32] {
        &self.at[self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize]
    }
}

/// Facets with averaged normals, and their order: those whose neighbours agree most come first.
fn smooth(mesh: &Mesh, around: &Around<'_>) -> (Vec<Facet>, Vec<u32>) {
    let mut facets: Vec<Facet> = (0..mesh.faces.len())
        .map(|face| {
            let [a, b, c] = mesh.triangle(face).map(DVec3::from);
            let across = (b - a).cross(c - a);
            Facet { middle: (a + b + c) / 3.0, normal: across.normalize_or_zero(), area: 0.5 * across.length() }
        })
        .collect();
    let mut agreement = vec![0.0; facets.len()];
    let mut at_vertex = vec![DVec3::ZERO; mesh.vertices.len()];
    for _ in 0..ROUNDS {
        for (vertex, sum) in at_vertex.iter_mut().enumerate() {
            let near = around.faces_at(vertex as u32).iter().map(|at| facets[*at as usize]);
            let (weighed, area) = near
                .fold((DVec3::ZERO, 0.0), |(sum, area), facet| (sum + facet.normal * facet.area, area + facet.area));
            *sum = if area > 0.0 { weighed / area } else { DVec3::ZERO };
        }
        for (place, facet) in facets.iter_mut().enumerate() {
            let mean = around.vertices(place as u32).iter().map(|v| at_vertex[*v as usize]).sum::<DVec3>() / 3.0;
            agreement[place] = mean.length();
            facet.normal = mean.normalize_or_zero();
        }
    }
    let mut order: Vec<u32> = (0..facets.len() as u32).collect();
    order.sort_by(|a, b| agreement[*b as usize].total_cmp(&agreement[*a as usize]).then(a.cmp(b)));
    (facets, order)
}

/// The faces that belong to the plane about `start`, which follows them as it grows.
fn grow(
    start: u32,
    number: u32,
    facets: &[Facet],
    around: &Around<'_>,
    owner: &mut [u32],
    [min_cos, max_off]: [f64; 2],
) -> Vec<u32> {
    let (mut sum, mut middles, mut area) = (DVec3::ZERO, DVec3::ZERO, 0.0);
    let mut piece = vec![start];
    owner[start as usize] = number;
    let mut next = 0;
    while next < piece.len() {
        let facet = facets[piece[next] as usize];
        sum += facet.normal * facet.area;
        middles += facet.middle * facet.area;
        area += facet.area;
        let (normal, middle) = (sum.normalize_or(facet.normal), if area > 0.0 { middles / area } else { facet.middle });
        for vertex in around.vertices(piece[next]) {
            for &at in around.faces_at(vertex) {
                let other = facets[at as usize];
                let fits = owner[at as usize] == NONE
                    && other.normal.dot(normal) >= min_cos
                    && (other.middle - middle).dot(normal).abs() <= max_off;
                if fits {
                    owner[at as usize] = number;
                    piece.push(at);
                }
            }
        }
        next += 1;
    }
    piece
}

/// Normal, and root mean square distance of all faces from a plane through those that are no outliers.
fn fitted(piece: &[u32], facets: &[Facet]) -> Option<(DVec3, f64)> {
    let mut used: Vec<Facet> = piece.iter().map(|at| facets[*at as usize]).collect();
    let (mut middle, mut normal) = through(&used)?;
    let off = |facet: &Facet, middle: DVec3, normal: DVec3| (facet.middle - middle).dot(normal);
    for _ in 0..REFITS {
        let mut distances: Vec<f64> = piece.iter().map(|at| off(&facets[*at as usize], middle, normal).abs()).collect();
        let bound = MAX_SIGMAS * 1.4826 * median(&mut distances)? + f64::MIN_POSITIVE;
        used = piece.iter().map(|at| facets[*at as usize]).filter(|f| off(f, middle, normal).abs() <= bound).collect();
        (middle, normal) = through(&used)?;
    }
    let (squares, area) = piece.iter().map(|at| facets[*at as usize]).fold((0.0, 0.0), |(squares, area), facet| {
        let distance = off(&facet, middle, normal);
        (squares + facet.area * distance * distance, area + facet.area)
    });
    Some((normal, (squares / area).sqrt()))
}

/// Middle and normal of the plane of least squared distance.
fn through(facets: &[Facet]) -> Option<(DVec3, DVec3)> {
    let area: f64 = facets.iter().map(|facet| facet.area).sum();
    if facets.len() < 3 || area <= 0.0 {
        return None;
    }
    let middle = facets.iter().map(|facet| facet.middle * facet.area).sum::<DVec3>() / area;
    let mut moments = [[0.0; 3]; 3];
    for facet in facets {
        let at = (facet.middle - middle).to_array();
        (0..9).for_each(|k| moments[k / 3][k % 3] += facet.area * at[k / 3] * at[k % 3]);
    }
    let (_, vectors) = symmetric_eigen(moments);
    Some((middle, DVec3::from(vectors[0])))
}
