//! Depth before training: PatchMatch stereo on covisible neighbours.
//!
//! Gaussians that start on the surface need no luck: the 1 px gate of the multi-view terms gives no gradient where depth
//! is wrong, and plain roofs pull on nothing. Each pixel carries a plane (depth and normal); planes spread over a
//! checkerboard and are refined at random (Bleyer et al. 2011; Galliani et al. 2015), judged by bilaterally weighted NCC
//! over the best neighbours. Deterministic for any number of threads: every half-step reads only the other colour.

mod check;
mod cost;
mod points;

pub use check::{CheckOptions, confirmed};
pub use points::{SurfacePoint, lift, thin_points};

use pgsag_scene::numbers::SplitMix64;
use pgsag_scene::{Image, Map, Pinhole, RigidTransform};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::lanes::SimdLevel;
use cost::{Bilinear, Matcher, Patch};

/// A grey view for stereo.
#[derive(Clone, Debug)]
pub struct StereoView {
    /// Of `gray`.
    pub camera: Pinhole,
    /// COLMAP axes.
    pub camera_from_world: RigidTransform,
    /// Luma in `[0, 1]`.
    pub gray: Map<f32>,
}

impl StereoView {
    /// Luma of a photograph (Rec. 601, as PGSR's NCC).
    #[must_use]
    pub fn new(camera: Pinhole, camera_from_world: RigidTransform, image: &Image) -> Self {
        let luma = |p: &[u8; 3]| (0.299 * f32::from(p[0]) + 0.587 * f32::from(p[1]) + 0.114 * f32::from(p[2])) / 255.0;
        let gray = Map { width: image.width, height: image.height, values: image.pixels.iter().map(luma).collect() };
        Self { camera, camera_from_world, gray }
    }

    /// The view at half the size, every pixel the mean of those that it covers.
    fn halved(&self) -> Self {
        let (width, height) = ((self.gray.width / 2).max(1), (self.gray.height / 2).max(1));
        let at = |x: u32, y: u32| self.gray.at(x.min(self.gray.width - 1), y.min(self.gray.height - 1));
        let mean = |x: u32, y: u32| (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1)) * 0.25;
        let values =
            (0..height).flat_map(|y| (0..width).map(move |x| (2 * x, 2 * y))).map(|(x, y)| mean(x, y)).collect();
        // Twice a pixel is twice a pixel, also where a last odd row or column is left over.
        let camera = &self.camera;
        let (fx, fy, cx, cy) = (camera.fx * 0.5, camera.fy * 0.5, camera.cx * 0.5, camera.cy * 0.5);
        let camera = Pinhole { width, height, fx, fy, cx, cy };
        Self { camera, camera_from_world: self.camera_from_world, gray: Map { width, height, values } }
    }
}

/// How stereo works.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StereoOptions {
    /// Sizes of the images, each half of the one before; the search begins on the smallest.
    pub sizes: u32,
    /// Images are not halved to less than this, longest side.
    pub smallest_px: u32,
    /// Rounds over both colours of the checkerboard on the smallest images.
    pub iterations: u32,
    /// Rounds on each of the larger ones.
    pub refinements: u32,
    /// Half-width of the patch, in samples.
    pub patch_radius: u32,
    /// Distance between samples, pixels.
    pub patch_step_px: u32,
    /// The cost of a plane is the mean over so many best neighbours: occluded views do not vote.
    pub best_count: u32,
    /// Luma difference at which a sample of the patch counts 1/e.
    pub color_sigma: f32,
    /// Pixels whose final cost 1 − NCC is higher are left without depth.
    pub max_cost: f32,
}

impl Default for StereoOptions {
    fn default() -> Self {
        Self {
            sizes: 2,
            smallest_px: 150,
            iterations: 4,
            refinements: 2,
            patch_radius: 2,
            patch_step_px: 2,
            best_count: 2,
            color_sigma: 0.12,
            max_cost: 0.35,
        }
    }
}

/// What stereo found. Depth 0 where nothing was found.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoDepth {
    /// z-depth, scene units.
    pub depth: Map<f32>,
    /// Unit, camera frame, facing the camera.
    pub normal: Map<[f32; 3]>,
    /// 1 − NCC of the kept plane.
    pub cost: Map<f32>,
}

/// A plane at a pixel, and what it costs.
#[derive(Clone, Copy, Debug)]
struct Hypothesis {
    depth: f32,
    normal: [f32; 3],
    cost: f32,
    /// The two neighbours that match best: asked first, so that a bad plane is refused early.
    favorites: [u8; 2],
}

/// On larger images the steps at random are as small as after so many rounds: little is searched, much refined.
const SETTLED: u32 = 2;
/// Where the favourites alone are so much worse than the kept plane, the other neighbours are not asked.
const HOPELESS: f32 = 0.15;

/// What is known before the search.
#[derive(Clone, Copy, Debug)]
pub struct Prior<'a> {
    /// `(x, y, depth)` of sparse points in the reference image.
    pub seeds: &'a [[f32; 3]],
    /// Nearest and farthest depth that is looked for.
    pub depth_range: [f32; 2],
}

/// Estimates the depth of `reference` from its neighbours: on the smallest images first, then refined image by image.
#[must_use]
pub fn estimate(
    reference: &StereoView,
    neighbors: &[&StereoView],
    prior: &Prior<'_>,
    options: &StereoOptions,
    seed: u64,
) -> StereoDepth {
    let mut sizes = vec![(reference.clone(), neighbors.iter().map(|view| (*view).clone()).collect::<Vec<_>>())];
    while sizes.len() < options.sizes as usize {
        let (smallest, neighbors) = &sizes[sizes.len() - 1];
        if smallest.camera.width.max(smallest.camera.height) < 2 * options.smallest_px {
            break;
        }
        let half = (smallest.halved(), neighbors.iter().map(StereoView::halved).collect());
        sizes.push(half);
    }
    let full_width = reference.camera.width as f32;
    let mut found: Option<StereoDepth> = None;
    for (round, (reference, neighbors)) in (0u64..).zip(sizes.into_iter().rev()) {
        let images: Vec<Bilinear> = neighbors.iter().map(|neighbor| Bilinear::new(&neighbor.gray)).collect();
        let matchers = matchers(&reference, &neighbors, &images);
        let seed = seed ^ (round << 56);
        let search = Search { reference: &reference, matchers, prior, full_width, options, seed };
        found = Some(match found {
            None => search.rounds(search.start(), 0..options.iterations),
            Some(coarse) => search.rounds(search.finer(&coarse), SETTLED..SETTLED + options.refinements),
        });
    }
    found.expect("there is at least one size")
}

fn matchers<'a>(reference: &StereoView, neighbors: &[StereoView], images: &'a [Bilinear]) -> Vec<Matcher<'a>> {
    let level = SimdLevel::Auto.detected().expect("every machine has the scalar level");
    let matcher = |(neighbor, image): (&StereoView, &'a Bilinear)| Matcher::new(level, reference, neighbor, image);
    neighbors.iter().zip(images).map(matcher).collect()
}

struct Search<'a> {
    reference: &'a StereoView,
    matchers: Vec<Matcher<'a>>,
    prior: &'a Prior<'a>,
    /// Width of the image that the prior speaks of.
    full_width: f32,
    options: &'a StereoOptions,
    seed: u64,
}

/// How far planes jump along each direction: odd steps lead to the other colour.
const JUMPS: [i32; 6] = [1, 3, 5, 9, 15, 25];
/// Neighbours beyond this are not asked.
const MAX_NEIGHBORS: usize = 16;
const DIRECTIONS: [[i32; 2]; 4] = [[1, 0], [-1, 0], [0, 1], [0, -1]];

impl Search<'_> {
    fn rounds(&self, mut state: Vec<Hypothesis>, iterations: std::ops::Range<u32>) -> StereoDepth {
        for iteration in iterations {
            for color in 0..2 {
                state = self.half_step(&state, iteration, color);
            }
        }
        self.finish(&state)
    }

    /// Every pixel starts from the plane of the coarse pixel that it lies in.
    fn finer(&self, coarse: &StereoDepth) -> Vec<Hypothesis> {
        let (width, height) = (self.width(), self.reference.gray.height as usize);
        let (wide, high) = (coarse.depth.width as usize, coarse.depth.height as usize);
        let start = |index: usize| {
            let (x, y) = ((index % width / 2).min(wide - 1), (index / width / 2).min(high - 1));
            let (at, ray) = (y * wide + x, self.ray(index));
            let coarse_ray = self.reference.camera.ray((2 * x + 1) as f64, (2 * y + 1) as f64).as_vec3().to_array();
            let plane = Hypothesis {
                depth: coarse.depth.values[at],
                normal: facing(coarse.normal.values[at], coarse_ray),
                cost: f32::INFINITY,
                favorites: [0, 1],
            };
            let carried = (plane.depth > 0.0).then(|| carried_depth(&plane, coarse_ray, ray)).flatten();
            let depth = carried.unwrap_or_else(|| self.random_depth(&mut self.stream(index, u64::MAX >> 40)));
            let [near, far] = self.prior.depth_range;
            let start = Hypothesis { depth: depth.clamp(near, far), normal: facing(plane.normal, ray), ..plane };
            self.judged(&self.patch(index), index, start, f32::INFINITY).unwrap_or(start)
        };
        (0..width * height).into_par_iter().map(start).collect()
    }

    fn width(&self) -> usize {
        self.reference.gray.width as usize
    }

    /// Ray through a pixel's centre, z = 1.
    fn ray(&self, index: usize) -> [f32; 3] {
        let (x, y) = ((index % self.width()) as f64 + 0.5, (index / self.width()) as f64 + 0.5);
        self.reference.camera.ray(x, y).as_vec3().to_array()
    }

    fn stream(&self, index: usize, round: u64) -> SplitMix64 {
        SplitMix64::new(SplitMix64::new(self.seed ^ (round << 40) ^ index as u64).next_u64())
    }

    /// Every pixel starts from the depth of the nearest seed, a little off, on a plane that faces the camera roughly.
    fn start(&self) -> Vec<Hypothesis> {
        let (width, height) = (self.reference.gray.width, self.reference.gray.height);
        let shrink = width as f32 / self.full_width;
        let seeds: Vec<[f32; 3]> = self.prior.seeds.iter().map(|[x, y, z]| [x * shrink, y * shrink, *z]).collect();
        let nearest = nearest_seed(width, height, &seeds);
        let [near, far] = self.prior.depth_range;
        (0..self.reference.gray.values.len())
            .into_par_iter()
            .map(|index| {
                let mut stream = self.stream(index, u64::MAX >> 40);
                let depth = match nearest.as_ref() {
                    Some(nearest) => seeds[nearest[index] as usize][2] * (1.0 + 0.05 * (stream.uniform() as f32 - 0.5)),
                    None => self.random_depth(&mut stream),
                };
                let start = Hypothesis {
                    depth: depth.clamp(near, far),
                    normal: facing(tilted([0.0, 0.0, -1.0], 0.7, &mut stream), self.ray(index)),
                    cost: f32::INFINITY,
                    favorites: [0, 1],
                };
                self.judged(&self.patch(index), index, start, f32::INFINITY).unwrap_or(start)
            })
            .collect()
    }

    /// Uniform in inverse depth.
    fn random_depth(&self, stream: &mut SplitMix64) -> f32 {
        let [near, far] = self.prior.depth_range;
        1.0 / stream.range(1.0 / f64::from(far), 1.0 / f64::from(near)) as f32
    }

    fn patch(&self, index: usize) -> Patch {
        Patch::new(&self.reference.gray, index, self.options)
    }

    /// The plane with its cost, the mean of the best neighbours' 1 − NCC; `None` where it is no better than `bound`.
    fn judged(&self, patch: &Patch, index: usize, plane: Hypothesis, bound: f32) -> Option<Hypothesis> {
        let ray = self.ray(index);
        let center = [(index % self.width()) as f32 + 0.5, (index / self.width()) as f32 + 0.5];
        let count = self.matchers.len().min(MAX_NEIGHBORS);
        let best_count = (self.options.best_count as usize).clamp(1, count.max(1));
        let cost_of = |k: usize| self.matchers[k].cost(patch, center, ray, plane.depth, plane.normal);
        let mut ranked = [(2.0f32, 0u8); MAX_NEIGHBORS];
        let mut asked = 0;
        for favorite in plane.favorites.map(usize::from).into_iter().filter(|k| *k < count) {
            ranked[asked] = (cost_of(favorite), favorite as u8);
            asked += 1;
        }
        if asked == 2 && best_count <= 2 && (ranked[0].0 + ranked[1].0) * 0.5 > bound + HOPELESS {
            return None;
        }
        for k in (0..count).filter(|k| !plane.favorites.contains(&(*k as u8))) {
            ranked[asked] = (cost_of(k), k as u8);
            asked += 1;
        }
        ranked[..asked].sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let cost = ranked[..best_count].iter().map(|r| r.0).sum::<f32>() / best_count as f32;
        let favorites = if asked > 1 { [ranked[0].1, ranked[1].1] } else { [0, 1] };
        (cost < bound).then_some(Hypothesis { cost, favorites, ..plane })
    }

    fn half_step(&self, state: &[Hypothesis], iteration: u32, color: usize) -> Vec<Hypothesis> {
        let width = self.width();
        let mut next = state.to_vec();
        next.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, kept) in row.iter_mut().enumerate() {
                let index = y * width + x;
                if (x + y) % 2 == color {
                    *kept = self.improved(state, index, iteration);
                }
            }
        });
        next
    }

    /// The best of: the pixel's own plane, planes of the other colour, random refinements.
    fn improved(&self, state: &[Hypothesis], index: usize, iteration: u32) -> Hypothesis {
        let patch = self.patch(index);
        let ray = self.ray(index);
        let mut best = state[index];
        let [near, far] = self.prior.depth_range;
        let mut consider = |candidate: Hypothesis| {
            if candidate.depth >= near && candidate.depth <= far {
                // The pixel's own favourites: what a donor sees well may be hidden here.
                let candidate = Hypothesis { favorites: best.favorites, ..candidate };
                if let Some(better) = self.judged(&patch, index, candidate, best.cost) {
                    best = better;
                }
            }
            best
        };
        for direction in DIRECTIONS {
            let (near, far) = self.donors(state, index, direction);
            for donor in [near, far].into_iter().flatten() {
                if let Some(depth) = carried_depth(&state[donor], self.ray(donor), ray) {
                    consider(Hypothesis { depth, ..state[donor] });
                }
            }
        }
        let mut stream = self.stream(index, u64::from(iteration));
        let shrink = 0.5f32.powi(iteration as i32);
        let best = consider(Hypothesis { depth: self.random_depth(&mut stream), ..state[index] });
        let depth = best.depth * (1.0 + 0.04 * shrink * (stream.uniform() as f32 * 2.0 - 1.0));
        let best = consider(Hypothesis { depth, ..best });
        let normal = facing(tilted(best.normal, 0.8 * shrink, &mut stream), ray);
        let best = consider(Hypothesis { normal, ..best });
        let depth = best.depth * (1.0 + 0.01 * shrink * (stream.uniform() as f32 * 2.0 - 1.0));
        let normal = facing(tilted(best.normal, 0.3 * shrink, &mut stream), ray);
        consider(Hypothesis { depth, normal, ..best })
    }

    /// The neighbour next door, and the cheapest of the far ones in a direction.
    fn donors(&self, state: &[Hypothesis], index: usize, direction: [i32; 2]) -> (Option<usize>, Option<usize>) {
        let (width, height) = (self.width() as i32, self.reference.gray.height as i32);
        let (x, y) = ((index % self.width()) as i32, (index / self.width()) as i32);
        let at = |jump: i32| {
            let (u, v) = (x + jump * direction[0], y + jump * direction[1]);
            (u >= 0 && v >= 0 && u < width && v < height).then_some((v * width + u) as usize)
        };
        let far = JUMPS[1..].iter().filter_map(|jump| at(*jump));
        (at(JUMPS[0]), far.min_by(|a, b| state[*a].cost.total_cmp(&state[*b].cost)))
    }

    fn finish(&self, state: &[Hypothesis]) -> StereoDepth {
        let (width, height) = (self.reference.gray.width, self.reference.gray.height);
        let kept = |h: &Hypothesis| h.cost <= self.options.max_cost;
        StereoDepth {
            depth: Map { width, height, values: state.iter().map(|h| if kept(h) { h.depth } else { 0.0 }).collect() },
            normal: Map { width, height, values: state.iter().map(|h| h.normal).collect() },
            cost: Map { width, height, values: state.iter().map(|h| h.cost).collect() },
        }
    }
}

/// Depth at which the ray meets the plane of another pixel; `None` where it does not in front.
fn carried_depth(plane: &Hypothesis, plane_ray: [f32; 3], ray: [f32; 3]) -> Option<f32> {
    let depth = plane.depth * dot(plane.normal, plane_ray) / dot(plane.normal, ray);
    (depth.is_finite() && depth > 0.0).then_some(depth)
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn unit(a: [f32; 3]) -> [f32; 3] {
    let length = dot(a, a).sqrt().max(1e-20);
    a.map(|v| v / length)
}

/// A unit vector off by up to `amount` in each component.
fn tilted(normal: [f32; 3], amount: f32, stream: &mut SplitMix64) -> [f32; 3] {
    unit(normal.map(|v| v + amount * (stream.uniform() as f32 * 2.0 - 1.0)))
}

/// The normal that meets the ray at 84 degrees at most: steeper planes are pulled towards the camera.
fn facing(normal: [f32; 3], ray: [f32; 3]) -> [f32; 3] {
    const MIN_COSINE: f32 = 0.1;
    let view = unit(ray);
    let cosine = -dot(normal, view);
    if cosine >= MIN_COSINE {
        return normal;
    }
    let lift = MIN_COSINE - cosine;
    unit(std::array::from_fn(|i| normal[i] - lift * view[i]))
}

/// Index of the nearest seed for every pixel, by jump flooding over halving steps; `None` without seeds.
fn nearest_seed(width: u32, height: u32, seeds: &[[f32; 3]]) -> Option<Vec<u32>> {
    const NONE: u32 = u32::MAX;
    let mut owner = vec![NONE; width as usize * height as usize];
    for (number, [x, y, _]) in (0u32..).zip(seeds) {
        if *x >= 0.0 && *y >= 0.0 && *x < width as f32 && *y < height as f32 {
            owner[*y as usize * width as usize + *x as usize] = number;
        }
    }
    if owner.iter().all(|number| *number == NONE) {
        return None;
    }
    let mut step = width.max(height).next_power_of_two() as i32 / 2;
    while step > 0 {
        let previous = owner.clone();
        owner.par_iter_mut().enumerate().for_each(|(index, kept)| {
            let (x, y) = ((index % width as usize) as i32, (index / width as usize) as i32);
            let reach = |number: u32| {
                let [sx, sy, _] = seeds[number as usize];
                (sx - x as f32 - 0.5).powi(2) + (sy - y as f32 - 0.5).powi(2)
            };
            for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx * step, dy * step))) {
                let (u, v) = (x + dx, y + dy);
                if u < 0 || v < 0 || u >= width as i32 || v >= height as i32 {
                    continue;
                }
                let other = previous[v as usize * width as usize + u as usize];
                if other != NONE && (*kept == NONE || reach(other) < reach(*kept)) {
                    *kept = other;
                }
            }
        });
        step /= 2;
    }
    Some(owner)
}

#[cfg(test)]
mod tests;
