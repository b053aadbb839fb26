//! The nearest places on a mesh that is larger than the tree that may be held of it: one part of the points after
//! another, each with a tree of the faces near it. The answers are those of a tree of all faces.

use glam::DVec3;
use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::Triangle;
use pgsag_scene::Mesh;
use rayon::prelude::*;

use super::surface::{Hit, Surface, Target, Walk, face_normal};
use crate::components::pick_faces;

/// Faces of a tree, as long as points can be parted: a tree takes about 600 bytes a face.
const MAX_FACES: usize = 1 << 18;
/// So few points are not parted further, and ask face after face: that is sooner done than a tree is made.
const MIN_POINTS: usize = 64;
/// Points judged together.
const CHUNK: usize = 2048;
/// Faces that are asked one after another.
const FACES_AT_ONCE: usize = 1 << 17;
/// Nothing was found within a margin: the next is so many times as wide.
const WIDER: f64 = 4.0;

/// `[N]` the nearest place on `mesh` for every point, if it lies within the point's limit (scene units, or infinite). Most are
/// expected to lie within `reach`.
pub(crate) fn nearest(
    mesh: &Mesh,
    points: &[DVec3],
    reach: f64,
    limit: impl Fn(usize) -> f64 + Sync,
) -> Vec<Option<Hit>> {
    Search::new(mesh, points, &limit, MAX_FACES).run(reach)
}

struct Search<'a> {
    mesh: &'a Mesh,
    points: &'a [DVec3],
    limit: &'a (dyn Fn(usize) -> f64 + Sync),
    max_faces: usize,
    /// Faces that lie anywhere.
    face_count: usize,
    found: Vec<Option<Hit>>,
    renamed: Vec<u32>,
}

impl<'a> Search<'a> {
    fn new(mesh: &'a Mesh, points: &'a [DVec3], limit: &'a (dyn Fn(usize) -> f64 + Sync), max_faces: usize) -> Self {
        let renamed = vec![u32::MAX; mesh.vertices.len()];
        let found = vec![None; points.len()];
        let mut search = Self { mesh, points, limit, max_faces, face_count: 0, found, renamed };
        search.face_count = search.near(None, [DVec3::NEG_INFINITY, DVec3::INFINITY]).len();
        search
    }

    fn run(mut self, reach: f64) -> Vec<Option<Hit>> {
        let asked: Vec<u32> = (0..self.points.len() as u32).filter(|at| self.point(*at).is_finite()).collect();
        let [low, high] = self.bounds(&asked);
        let side = (high - low).length();
        // A margin has to have a length, or it never grows.
        let spare = if side > 0.0 && side.is_finite() { 1e-3 * side } else { 1.0 };
        self.part(asked, None, if reach > 0.0 { reach } else { spare });
        self.found
    }

    fn point(&self, at: u32) -> DVec3 {
        self.points[at as usize]
    }

    fn bounds(&self, asked: &[u32]) -> [DVec3; 2] {
        let points = asked.iter().map(|at| self.point(*at));
        points.fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], point| [low.min(point), high.max(point)])
    }

    /// Answers the points of `asked`; `faces` holds all that lie within `margin` of any of them, or is not known.
    fn part(&mut self, asked: Vec<u32>, faces: Option<&[u32]>, margin: f64) {
        let [low, high] = self.bounds(&asked);
        let near = self.near(faces, [low - margin, high + margin]);
        if near.len() > self.max_faces
            && asked.len() > MIN_POINTS
            && let Some(halves) = self.halves(&asked, high - low)
        {
            drop(asked);
            halves.into_iter().for_each(|half| self.part(half, Some(&near), margin));
            return;
        }
        let farthest = self.ask(&asked, &near, margin);
        if near.len() == self.face_count {
            return;
        }
        // What was not in the tree lies beyond the margin.
        let is_open = |at: &u32| {
            (self.limit)(*at as usize) > margin && self.found[*at as usize].is_none_or(|hit| hit.distance > margin)
        };
        let open: Vec<u32> = asked.into_iter().filter(is_open).collect();
        if !open.is_empty() {
            drop(near);
            self.part(open, None, farthest * (1.0 + 1e-9));
        }
    }

    /// Faces whose boxes meet a box, in their order.
    fn near(&self, faces: Option<&[u32]>, [low, high]: [DVec3; 2]) -> Vec<u32> {
        let meets = |face: &u32| {
            let [a, b, c] = self.mesh.triangle(*face as usize).map(DVec3::from);
            // A corner that is not finite makes a comparison fail.
            let is_place = (a + b + c).is_finite();
            is_place && a.min(b).min(c).cmple(high).all() && a.max(b).max(c).cmpge(low).all()
        };
        match faces {
            Some(faces) => faces.par_iter().copied().filter(meets).collect(),
            None => (0..self.mesh.faces.len() as u32).into_par_iter().filter(meets).collect(),
        }
    }

    /// The points on either side of their middle along the longest side of their box, each in their order.
    fn halves(&self, asked: &[u32], size: DVec3) -> Option<[Vec<u32>; 2]> {
        let axis = size.to_array().iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?.0;
        let mut along: Vec<f64> = asked.iter().map(|at| self.point(*at)[axis]).collect();
        let middle = *along.select_nth_unstable_by(asked.len() / 2, f64::total_cmp).1;
        let (below, above): (Vec<u32>, Vec<u32>) = asked.iter().partition(|at| self.point(**at)[axis] < middle);
        (!below.is_empty()).then_some([below, above])
    }

    /// Asks these faces; returns the margin within which the places that remain unknown are looked for next.
    fn ask(&mut self, asked: &[u32], near: &[u32], margin: f64) -> f64 {
        let hits = if asked.len() > MIN_POINTS { self.by_tree(asked, near) } else { self.by_face(asked, near) };
        let mut farthest = margin;
        for (at, hit) in asked.iter().zip(hits) {
            let limit = (self.limit)(*at as usize).min(WIDER * margin);
            farthest = farthest.max(hit.map_or(limit, |hit| hit.distance));
            self.found[*at as usize] = hit;
        }
        farthest
    }

    fn by_tree(&mut self, asked: &[u32], near: &[u32]) -> Vec<Option<Hit>> {
        let sub = pick_faces(self.mesh, near.iter().copied(), &mut self.renamed);
        let Ok(surface) = Surface::new(&sub, "the mesh") else { return vec![None; asked.len()] };
        drop(sub);
        let answer = |walk: &mut Walk, at: u32| {
            let (point, limit) = (self.points[at as usize], (self.limit)(at as usize));
            let hit =
                if limit.is_finite() { surface.nearest_within(point, limit) } else { walk.nearest(&surface, point) };
            hit.map(|hit| Hit { index: near[hit.index as usize], ..hit })
        };
        let part = |part: &[u32]| {
            let mut walk = Walk::default();
            part.iter().map(|at| answer(&mut walk, *at)).collect::<Vec<_>>()
        };
        asked.par_chunks(CHUNK).map(part).collect::<Vec<_>>().concat()
    }

    fn by_face(&self, asked: &[u32], near: &[u32]) -> Vec<Option<Hit>> {
        let points: Vec<DVec3> = asked.iter().map(|at| self.points[*at as usize]).collect();
        let limits: Vec<f64> = asked.iter().map(|at| (self.limit)(*at as usize)).collect();
        let part = |faces: &[u32]| {
            let mut found: Vec<Option<(f64, u32, DVec3)>> = vec![None; points.len()];
            for face in faces {
                let corners = self.mesh.triangle(*face as usize).map(DVec3::from);
                for ((point, limit), found) in points.iter().zip(&limits).zip(&mut found) {
                    let bound = found.map_or(*limit, |(distance, ..)| distance);
                    if let Some(place) = place_on(&corners, *point, bound) {
                        *found = Some((point.distance(place), *face, place));
                    }
                }
            }
            found
        };
        let parts: Vec<Vec<Option<(f64, u32, DVec3)>>> = near.par_chunks(FACES_AT_ONCE).map(part).collect();
        let nearest = |(at, point): (usize, &DVec3)| {
            let places = parts.iter().filter_map(|found| found[at]);
            let (distance, index, place) = places.min_by(|a, b| a.0.total_cmp(&b.0))?;
            let behind = (point - place).dot(face_normal(self.mesh, index)) < 0.0;
            Some(Hit { distance, behind, index, place })
        };
        points.iter().enumerate().map(nearest).collect()
    }
}

/// The nearest place on a triangle that has an area, if it is nearer than `bound`.
fn place_on(corners: &[DVec3; 3], point: DVec3, bound: f64) -> Option<DVec3> {
    let [a, b, c] = *corners;
    let in_box = point.clamp(a.min(b).min(c), a.max(b).max(c));
    if point.distance_squared(in_box) >= bound * bound || (b - a).cross(c - a) == DVec3::ZERO {
        return None;
    }
    let [a, b, c, at] = [a, b, c, point].map(|p| Vector::new(p.x, p.y, p.z));
    let place = Triangle::new(a, b, c).project_local_point(at, true).point;
    let place = DVec3::new(place.x, place.y, place.z);
    (point.distance(place) < bound).then_some(place)
}

#[cfg(test)]
mod tests {
    use pgsag_scene::numbers::SplitMix64;

    use super::*;

    /// Hilly ground of `side` squares by as many, with a hole of a quarter of it.
    fn hills(side: u32) -> Mesh {
        let mut random = SplitMix64::new(3);
        let mut mesh = Mesh::default();
        for (i, j) in (0..side).flat_map(|i| (0..side).map(move |j| (i, j))) {
            mesh.vertices.push([f64::from(i), f64::from(j), random.normal()]);
            if i > 0 && j > 0 && !(i < side / 2 && j < side / 2) {
                let [a, b, c, d] = [(i - 1) * side + j - 1, i * side + j - 1, i * side + j, (i - 1) * side + j];
                mesh.faces.extend([[a, b, c], [a, c, d]]);
            }
        }
        mesh
    }

    #[test]
    fn parts_answer_as_the_whole_does() {
        let mesh = hills(60);
        let whole = Surface::new(&mesh, "hills").expect("a surface");
        let mut random = SplitMix64::new(5);
        let points: Vec<DVec3> = (0..6000)
            .map(|_| DVec3::new(70.0 * random.uniform() - 5.0, 70.0 * random.uniform() - 5.0, 4.0 * random.normal()))
            .collect();
        let wanted: Vec<f64> =
            points.iter().map(|at| whole.nearest_within(*at, f64::MAX).expect("a place").distance).collect();
        for max_faces in [60, 500, 100_000] {
            let found = Search::new(&mesh, &points, &|_| f64::INFINITY, max_faces).run(0.7);
            for ((hit, wanted), at) in found.iter().zip(&wanted).zip(&points) {
                let hit = hit.expect("a place");
                assert!((hit.distance - *wanted).abs() < 1e-12, "{at}");
                let own = Mesh { faces: vec![mesh.faces[hit.index as usize]], ..mesh.clone() };
                let own = Surface::new(&own, "face").expect("a face").nearest_within(*at, f64::MAX).expect("a place");
                assert!((own.distance - wanted).abs() < 1e-12);
            }
            let limit = |at: usize| 0.2 * (at % 9) as f64;
            let found = Search::new(&mesh, &points, &limit, max_faces).run(0.7);
            for (at, (hit, wanted)) in found.iter().zip(&wanted).enumerate() {
                assert_eq!(hit.is_some(), *wanted < limit(at), "{wanted}");
                assert!(hit.is_none_or(|hit| (hit.distance - wanted).abs() < 1e-12));
            }
        }
    }

    #[test]
    fn places_that_are_none_are_near_nothing() {
        let mut mesh = hills(4);
        mesh.vertices.extend([[f64::NAN; 3]; 3]);
        mesh.faces.push([16, 17, 18]);
        let found = nearest(&mesh, &[DVec3::NAN, DVec3::splat(1e6)], 1.0, |_| f64::INFINITY);
        assert!(found[0].is_none() && found[1].is_some());
        for reach in [0.0, f64::NAN, f64::INFINITY] {
            assert!(nearest(&mesh, &[DVec3::splat(9.0)], reach, |_| f64::INFINITY)[0].is_some(), "{reach}");
        }
        assert!(nearest(&Mesh::default(), &[DVec3::ZERO], 1.0, |_| f64::INFINITY)[0].is_none());
    }
}
