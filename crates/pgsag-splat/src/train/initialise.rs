//! The first cloud: one flat Gaussian per point, as wide as its surroundings are sparse (method.md 1.1).

use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::cloud::SplatCloud;
use crate::train::{Result, TrainError};

/// A point to start from: structure-from-motion, plane sweep, or a coarse model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InitialPoint {
    /// World frame, scene units.
    pub position_world: [f64; 3],
    /// RGB.
    pub color: [u8; 3],
    /// Surface normal, world frame, of any length and either sign; where given, the third axis of the Gaussian.
    pub normal: Option<[f64; 3]>,
}

/// How points become Gaussians.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InitialiseOptions {
    /// Degree of harmonics to store, 0 to 3. Aerial blocks need no more than 2 (method.md 8.5); paper: 3.
    pub sh_degree: u8,
    /// First opacity. 3DGS: 0.1.
    pub opacity: f32,
    /// Points without a normal get that of a plane through their neighbours.
    pub estimate_normals: bool,
    /// Third axis over the other two where a normal is known.
    pub flatness: f32,
    /// Points farther from their third neighbour than this many medians are dropped as isolated.
    pub isolation: f32,
}

impl Default for InitialiseOptions {
    fn default() -> Self {
        Self { sh_degree: 2, opacity: 0.1, estimate_normals: true, flatness: 0.1, isolation: 20.0 }
    }
}

impl InitialiseOptions {
    /// 3DGS's start: third-degree harmonics, round Gaussians.
    #[must_use]
    pub fn paper() -> Self {
        Self { sh_degree: 3, estimate_normals: false, ..Self::default() }
    }
}

/// Neighbours through which a plane is laid.
const PLANE_NEIGHBORS: usize = 10;
/// Degree-0 basis function, method.md 1.1.
const SH_C0: f64 = 0.282_094_791_773_878_14;

/// A cloud about `origin_world`, in the order of the points without exact duplicates and isolated ones.
///
/// # Errors
/// Where fewer than four distinct, finite points remain.
pub fn initialise(points: &[InitialPoint], origin_world: [f64; 3], options: &InitialiseOptions) -> Result<SplatCloud> {
    let distinct = distinct_points(points);
    if distinct.len() < 4 {
        return Err(TrainError::Empty("fewer than four distinct sparse points; give a scene with points"));
    }
    let positions: Vec<[f64; 3]> = distinct.iter().map(|i| local(points, *i, origin_world)).collect();
    let tree = ImmutableKdTree::<f64, 3>::new_from_slice(&positions)
        .map_err(|error| TrainError::Options(format!("neighbour search: {error}")))?;
    let surroundings: Vec<Surroundings> =
        positions.par_iter().with_min_len(64).map(|at| look_around(&tree, &positions, at)).collect();
    let mut spacings: Vec<f64> = surroundings.iter().map(|s| s.spacing).collect();
    let median = pgsag_scene::numbers::median(&mut spacings).unwrap_or(1.0);
    let mut cloud = SplatCloud { origin_world, sh_degree: options.sh_degree, ..SplatCloud::default() };
    for ((&i, at), around) in distinct.iter().zip(&positions).zip(&surroundings) {
        if around.spacing <= f64::from(options.isolation) * median {
            push(&mut cloud, &points[i], at, around, options);
        }
    }
    Ok(cloud)
}

/// What is near a point.
struct Surroundings {
    /// Root mean square distance to the three nearest others.
    spacing: f64,
    /// Normal of the plane through the nearest, where they lie in one.
    normal: Option<glam::DVec3>,
}

/// Indices of finite points, the first of each set of exact duplicates, ascending.
fn distinct_points(points: &[InitialPoint]) -> Vec<usize> {
    let mut order: Vec<usize> =
        (0..points.len()).filter(|i| points[*i].position_world.iter().all(|v| v.is_finite())).collect();
    let compare = |a: &usize, b: &usize| {
        let (p, q) = (&points[*a].position_world, &points[*b].position_world);
        p[0].total_cmp(&q[0]).then(p[1].total_cmp(&q[1])).then(p[2].total_cmp(&q[2])).then(a.cmp(b))
    };
    order.par_sort_unstable_by(compare);
    order.dedup_by(|b, a| points[*a].position_world == points[*b].position_world);
    order.sort_unstable();
    order
}

fn local(points: &[InitialPoint], i: usize, origin: [f64; 3]) -> [f64; 3] {
    let p = points[i].position_world;
    [p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]]
}

fn look_around(tree: &ImmutableKdTree<f64, 3>, positions: &[[f64; 3]], at: &[f64; 3]) -> Surroundings {
    let wanted = NonZero::new(PLANE_NEIGHBORS + 1).unwrap_or(NonZero::<usize>::MIN);
    let mut near = tree.query(at).nearest_n::<SquaredEuclidean<f64>>(wanted).execute();
    near.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.item.cmp(&b.item)));
    // The first is the point itself: duplicates are gone.
    let three = near.iter().skip(1).take(3);
    let mean_square = three.clone().map(|n| n.distance).sum::<f64>() / three.len().max(1) as f64;
    let neighbors: Vec<glam::DVec3> = near.iter().map(|n| positions[n.item as usize].into()).collect();
    Surroundings { spacing: mean_square.max(1e-14).sqrt(), normal: plane_normal(&neighbors) }
}

/// Normal of the least-squares plane; `None` where the points are not clearly flat.
fn plane_normal(points: &[glam::DVec3]) -> Option<glam::DVec3> {
    let mean = points.iter().sum::<glam::DVec3>() / points.len() as f64;
    let mut covariance = [[0.0; 3]; 3];
    for point in points {
        let d = (*point - mean).to_array();
        for (row, a) in d.iter().enumerate() {
            for (column, b) in d.iter().enumerate() {
                covariance[row][column] += a * b;
            }
        }
    }
    let (values, vectors) = symmetric_eigen(covariance);
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let [least, middle, _] = order;
    (values[middle] > 0.0 && values[least] < 0.04 * values[middle])
        .then(|| glam::DVec3::new(vectors[0][least], vectors[1][least], vectors[2][least]))
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix by cyclic Jacobi rotations.
fn symmetric_eigen(mut a: [[f64; 3]; 3]) -> ([f64; 3], [[f64; 3]; 3]) {
    let mut v = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for _ in 0..12 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q].abs() <= 1e-300 {
                continue;
            }
            let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let s = t * c;
            for k in 0..3 {
                let (x, y) = (a[k][p], a[k][q]);
                (a[k][p], a[k][q]) = (c * x - s * y, s * x + c * y);
            }
            for k in 0..3 {
                let (x, y) = (a[p][k], a[q][k]);
                (a[p][k], a[q][k]) = (c * x - s * y, s * x + c * y);
                let (x, y) = (v[k][p], v[k][q]);
                (v[k][p], v[k][q]) = (c * x - s * y, s * x + c * y);
            }
        }
    }
    ([a[0][0], a[1][1], a[2][2]], v)
}

fn push(
    cloud: &mut SplatCloud,
    point: &InitialPoint,
    at: &[f64; 3],
    around: &Surroundings,
    options: &InitialiseOptions,
) {
    let given = point.normal.map(glam::DVec3::from_array).and_then(glam::DVec3::try_normalize);
    let normal = given.or(if options.estimate_normals { around.normal } else { None });
    let wide = libm::log(around.spacing) as f32;
    let thin = if normal.is_some() { wide + libm::logf(options.flatness) } else { wide };
    let rotation = normal.map_or(glam::DQuat::IDENTITY, |n| glam::DQuat::from_rotation_arc(glam::DVec3::Z, n));
    cloud.means.push(at.map(|v| v as f32));
    cloud.log_scales.push([wide, wide, thin]);
    cloud.rotations.push([rotation.w, rotation.x, rotation.y, rotation.z].map(|v| v as f32));
    cloud.opacity_logits.push(libm::logf(options.opacity / (1.0 - options.opacity)));
    let start = cloud.harmonics.len();
    cloud.harmonics.resize(start + 3 * cloud.basis_count(), 0.0);
    for (channel, value) in point.color.iter().enumerate() {
        cloud.harmonics[start + channel] = ((f64::from(*value) / 255.0 - 0.5) / SH_C0) as f32;
    }
}

#[cfg(test)]
mod tests;
