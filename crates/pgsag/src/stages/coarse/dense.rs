//! Stereo over all views: match each with its neighbours, keep what others confirm, thin to one point per cell.
//!
//! Depth maps wait on disk in `RUN/cache/`, so that memory does not grow with the number of views and a stopped run
//! goes on where it was.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use glam::DVec3;
use pgsag_scene::numbers::{median, quantile};
use pgsag_scene::{Map, Pinhole, Scene, SparsePoint, TrackElement};
use pgsag_splat::stereo::{Prior, StereoDepth, StereoView, SurfacePoint, confirmed, estimate, lift, thin_points};
use pgsag_splat::train::{Neighbor, neighbors_of};

use super::Coarse;
use crate::config::Config;
use crate::photographs::{Photographs, training_camera};
use crate::run::artifact;
use crate::run::stage::Job;
use crate::stages::import::Imported;

/// Grey images and depth maps held at once, bytes.
pub(super) const HELD_BYTES: u64 = 256 << 20;

/// The camera of a view's image in stereo.
pub(crate) fn stereo_camera(camera: &Pinhole, config: &Config) -> Pinhole {
    let training = training_camera(camera, config.image_width);
    let longest = f64::from(training.width.max(training.height));
    let options = &config.coarse;
    let wanted = (longest * options.scale).max(f64::from(options.smallest_px)).min(f64::from(options.largest_px));
    training_camera(&training, (wanted.min(longest).round() as u32).max(1))
}

/// Dense oriented points with the views that see them.
pub(super) fn surface(job: &Job<'_>, imported: &Imported, config: &Config) -> Result<Coarse> {
    let scene = &imported.scene;
    let view_indices: Vec<u32> =
        (0..scene.views.len()).filter(|view| !config.is_held_out(*view)).map(|view| view as u32).collect();
    let neighbors = neighbors_of(scene, &view_indices, &config.neighbors);
    let photographs = Photographs::new(imported, config, job, 0);
    let mut survey =
        Survey { job, imported, config, photographs, view_indices, neighbors, gallery: Gallery::default() };
    let total = 2 * survey.view_indices.len() as u64;
    let seeds = seeds(scene);
    for at in 0..survey.view_indices.len() {
        job.check()?;
        survey.depth(at, &seeds)?;
        job.advance(at as u64 + 1, total, "views");
    }
    let Some(cell) = cell(scene, config) else { return Ok(Coarse::default()) };
    let mut kept: Vec<SurfacePoint> = Vec::new();
    for at in 0..survey.view_indices.len() {
        job.check()?;
        let lifted = survey.points(at, &seeds)?;
        kept.extend(thin_points(lifted, cell));
        job.advance((survey.view_indices.len() + at) as u64 + 1, total, "views");
    }
    let kept = thin_points(kept, cell);
    survey.with_tracks(kept, &seeds)
}

/// What a pixel of the training images covers at the median depth, scene units.
pub(crate) fn ground_sampling(scene: &Scene, config: &Config) -> Option<f64> {
    let focal = |camera: &Pinhole| training_camera(camera, config.image_width).focal_px();
    let mut focals: Vec<f64> = scene.views.iter().map(|view| focal(&view.camera)).collect();
    Some(scene.median_depth()? / median(&mut focals)?)
}

/// Cells are a few ground sampling distances of the training images wide.
pub(super) fn cell(scene: &Scene, config: &Config) -> Option<f64> {
    Some(config.coarse.cell_gsd * ground_sampling(scene, config)?)
}

/// Per view, the sparse points it sees: position in the full image and depth.
fn seeds(scene: &Scene) -> Vec<Vec<[f64; 3]>> {
    let mut seeds = vec![Vec::new(); scene.views.len()];
    for point in &scene.points {
        for seen in &point.track {
            let view = &scene.views[seen.view_index as usize];
            let depth = view.camera_from_world.transform_point(point.position_world).z;
            if depth > 0.0 {
                seeds[seen.view_index as usize].push([seen.xy_px[0].into(), seen.xy_px[1].into(), depth]);
            }
        }
    }
    seeds
}

/// Depths beyond the sparse points' own by this factor are not looked for.
const DEPTH_SLACK: f64 = 1.25;

fn depth_range(depths: impl Iterator<Item = f64>) -> Option<[f32; 2]> {
    let mut depths: Vec<f64> = depths.collect();
    if depths.len() < 8 {
        return None;
    }
    let (near, far) = (quantile(&mut depths, 0.01)?, quantile(&mut depths, 0.99)?);
    Some([(near / DEPTH_SLACK) as f32, (far * DEPTH_SLACK) as f32])
}

type Held = (Arc<StereoView>, Arc<StereoDepth>);

/// Grey images and depth maps by view, the oldest given up first.
#[derive(Default)]
struct Gallery {
    clock: u64,
    views: BTreeMap<usize, (u64, Arc<StereoView>)>,
    depths: BTreeMap<usize, (u64, Arc<StereoDepth>)>,
}

fn give_up_oldest<T>(kept: &mut BTreeMap<usize, (u64, T)>, most: usize) {
    while kept.len() > most {
        let oldest = kept.iter().map(|(view, (used, _))| (*used, *view)).min();
        oldest.map(|(_, view)| kept.remove(&view));
    }
}

struct Survey<'a, 'j> {
    job: &'a Job<'j>,
    imported: &'a Imported,
    config: &'a Config,
    photographs: Photographs,
    view_indices: Vec<u32>,
    neighbors: Vec<Vec<Neighbor>>,
    gallery: Gallery,
}

impl Survey<'_, '_> {
    fn view(&mut self, at: usize) -> Result<Arc<StereoView>> {
        self.gallery.clock += 1;
        let clock = self.gallery.clock;
        if let Some((used, view)) = self.gallery.views.get_mut(&at) {
            *used = clock;
            return Ok(Arc::clone(view));
        }
        let index = self.view_indices[at] as usize;
        let view = &self.imported.scene.views[index];
        let camera = stereo_camera(&view.camera, self.config);
        let image = self.photographs.whole(index)?.resized(camera.width, camera.height);
        let held = Arc::new(StereoView::new(camera, view.camera_from_world, &image));
        self.gallery.views.insert(at, (clock, Arc::clone(&held)));
        let most = (HELD_BYTES / 2 / (4 * camera.pixel_count() as u64)).max(12) as usize;
        give_up_oldest(&mut self.gallery.views, most);
        Ok(held)
    }

    /// Stereo of one view, from memory, from disk, or made now.
    fn depth(&mut self, at: usize, seeds: &[Vec<[f64; 3]>]) -> Result<Arc<StereoDepth>> {
        self.gallery.clock += 1;
        let clock = self.gallery.clock;
        if let Some((used, depth)) = self.gallery.depths.get_mut(&at) {
            *used = clock;
            return Ok(Arc::clone(depth));
        }
        let index = self.view_indices[at] as usize;
        let camera = stereo_camera(&self.imported.scene.views[index].camera, self.config);
        let path = self.cache_path(at, &seeds[index]);
        let found = match read_spilled(&path, &camera) {
            Some(found) => found,
            None => {
                let found = self.matched(at, &seeds[index])?;
                std::fs::create_dir_all(path.parent().context("a cache folder")?)?;
                artifact::write_whole(&path, &spilled(&found))?;
                rounded(&found)
            }
        };
        let found = Arc::new(found);
        self.gallery.depths.insert(at, (clock, Arc::clone(&found)));
        let most = (HELD_BYTES / 2 / (20 * camera.pixel_count() as u64)).max(10) as usize;
        give_up_oldest(&mut self.gallery.depths, most);
        Ok(found)
    }

    fn matched(&mut self, at: usize, seeds: &[[f64; 3]]) -> Result<StereoDepth> {
        let reference = self.view(at)?;
        let count = self.config.coarse.neighbor_count as usize;
        let near: Vec<usize> = self.neighbors[at].iter().take(count).map(|neighbor| neighbor.view as usize).collect();
        let others = near.into_iter().map(|other| self.view(other)).collect::<Result<Vec<_>>>()?;
        let others: Vec<&StereoView> = others.iter().map(Arc::as_ref).collect();
        let full = &self.imported.scene.views[self.view_indices[at] as usize].camera;
        let shrink = reference.camera.focal_px() / full.focal_px();
        let own = depth_range(seeds.iter().map(|seed| seed[2]));
        let Some(range) = own.or_else(|| self.scene_range()) else {
            return Ok(nothing(&reference.camera));
        };
        let seeds: Vec<[f32; 3]> =
            seeds.iter().map(|[x, y, z]| [(x * shrink) as f32, (y * shrink) as f32, *z as f32]).collect();
        let prior = Prior { seeds: &seeds, depth_range: range };
        Ok(estimate(&reference, &others, &prior, &self.config.coarse.matching, at as u64))
    }

    fn scene_range(&self) -> Option<[f32; 2]> {
        depth_range(seeds(&self.imported.scene).into_iter().flatten().map(|seed| seed[2]))
    }

    /// What is confirmed in one view, lifted into the world.
    fn points(&mut self, at: usize, seeds: &[Vec<[f64; 3]>]) -> Result<Vec<SurfacePoint>> {
        let own: Held = (self.view(at)?, self.depth(at, seeds)?);
        let near: Vec<usize> = self.neighbors[at].iter().map(|neighbor| neighbor.view as usize).collect();
        let mut others: Vec<Held> = Vec::new();
        for other in near {
            others.push((self.view(other)?, self.depth(other, seeds)?));
        }
        let others: Vec<_> = others.iter().map(|(view, depth)| (view.as_ref(), depth.as_ref())).collect();
        let kept = confirmed((&own.0, &own.1), &others, &self.config.coarse.check);
        let camera = &own.0.camera;
        let image = self.photographs.whole(self.view_indices[at] as usize)?.resized(camera.width, camera.height);
        Ok(lift(at as u32, camera, &own.0.camera_from_world, &kept, &own.1, &image))
    }

    /// Who sees a point: the view that found it, and those of its neighbours whose depth agrees.
    fn with_tracks(&mut self, points: Vec<SurfacePoint>, seeds: &[Vec<[f64; 3]>]) -> Result<Coarse> {
        let mut by_view: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for (index, point) in points.iter().enumerate() {
            by_view.entry(point.view).or_default().push(index);
        }
        let mut tracks: Vec<Vec<TrackElement>> = vec![Vec::new(); points.len()];
        for (at, indices) in by_view {
            let mut witnesses = vec![at as usize];
            witnesses.extend(self.neighbors[at as usize].iter().map(|neighbor| neighbor.view as usize));
            witnesses.sort_unstable();
            for witness in witnesses {
                self.job.check()?;
                let (view, depth): Held = (self.view(witness)?, self.depth(witness, seeds)?);
                for &index in &indices {
                    tracks[index].extend(self.sighting(witness, &view, &depth, points[index].position_world));
                }
            }
        }
        let normals = points.iter().map(|point| point.normal_world).collect();
        let sparse = |(point, track): (SurfacePoint, Vec<TrackElement>)| SparsePoint {
            position_world: DVec3::from_array(point.position_world),
            color: point.color,
            error_px: 0.0,
            track,
        };
        let points = points.into_iter().zip(tracks).map(sparse).collect();
        Ok(Coarse { points, normals, withheld: Vec::new() })
    }

    fn sighting(
        &self,
        at: usize,
        view: &StereoView,
        depth: &StereoDepth,
        point_world: [f64; 3],
    ) -> Option<TrackElement> {
        let point = view.camera_from_world.transform_point(DVec3::from_array(point_world));
        let hit = view.camera.project(point).filter(|hit| view.camera.contains(*hit))?;
        let seen = f64::from(depth.depth.at(hit.x as u32, hit.y as u32));
        let agrees = (seen / point.z - 1.0).abs() <= 2.0 * self.config.coarse.check.max_depth_ratio;
        let view_index = self.view_indices[at];
        let full = self.imported.scene.views[view_index as usize].camera.project(point)?;
        agrees.then_some(TrackElement { view_index, xy_px: [full.x as f32, full.y as f32] })
    }

    /// Everything that the depth of a view depends on is in the name of its file.
    fn cache_path(&self, at: usize, seeds: &[[f64; 3]]) -> PathBuf {
        let count = self.config.coarse.neighbor_count as usize;
        let mut involved = vec![at];
        involved.extend(self.neighbors[at].iter().take(count).map(|neighbor| neighbor.view as usize));
        let mut words = vec![format!("stereo 3 {:?} {seeds:?} {at}", self.config.coarse.matching)];
        for position in involved {
            let index = self.view_indices[position] as usize;
            let view = &self.imported.scene.views[index];
            let camera = stereo_camera(&view.camera, self.config);
            let photo = &self.imported.photos[index].fingerprint;
            words.push(format!("{photo} {:?} {camera:?} {:?}", view.lens, view.camera_from_world));
        }
        let print = artifact::fingerprint_words(words.iter().map(String::as_str));
        self.job.run.folder.join("cache").join(format!("{print}.stereo"))
    }
}

fn nothing(camera: &Pinhole) -> StereoDepth {
    let (width, height) = (camera.width, camera.height);
    StereoDepth {
        depth: Map::filled(width, height, 0.0),
        normal: Map::filled(width, height, [0.0, 0.0, -1.0]),
        cost: Map::filled(width, height, 2.0),
    }
}

/// Steps of cost, and of a direction's two coordinates on the octahedron, in the cache.
const COST_STEP: f32 = 2.0 / 255.0;
const NORMAL_STEPS: f32 = 2047.0;

/// Width and height, all depths, then per pixel a word of cost (8 bits) and normal (12 + 12): 8 bytes a pixel, and the
/// hash of it all.
fn spilled(found: &StereoDepth) -> Vec<u8> {
    let mut bytes: Vec<u8> = [found.depth.width, found.depth.height].iter().flat_map(|n| n.to_le_bytes()).collect();
    bytes.extend(found.depth.values.iter().flat_map(|z| z.to_le_bytes()));
    bytes.extend(found.cost.values.iter().zip(&found.normal.values).flat_map(|(c, n)| packed(*c, *n).to_le_bytes()));
    bytes.extend_from_slice(blake3::hash(&bytes).as_bytes());
    bytes
}

fn read_spilled(path: &std::path::Path, camera: &Pinhole) -> Option<StereoDepth> {
    let bytes = std::fs::read(path).ok()?;
    let (body, hash) = bytes.split_last_chunk::<32>()?;
    if blake3::hash(body).as_bytes() != hash {
        return None;
    }
    unspilled(body, camera)
}

fn unspilled(body: &[u8], camera: &Pinhole) -> Option<StereoDepth> {
    let (words, _) = body.as_chunks::<4>();
    let (size, values) = words.split_at_checked(2)?;
    let (width, height) = (u32::from_le_bytes(size[0]), u32::from_le_bytes(size[1]));
    if (width, height) != (camera.width, camera.height) || values.len() != 2 * camera.pixel_count() {
        return None;
    }
    let (depth, packed) = values.split_at(camera.pixel_count());
    let (cost, normal) = packed.iter().map(|word| unpacked(u32::from_le_bytes(*word))).unzip();
    Some(StereoDepth {
        depth: Map { width, height, values: depth.iter().map(|z| f32::from_le_bytes(*z)).collect() },
        normal: Map { width, height, values: normal },
        cost: Map { width, height, values: cost },
    })
}

/// What is found, as it comes back from the cache: a run that goes on computes with the same numbers as one that never
/// stopped.
fn rounded(found: &StereoDepth) -> StereoDepth {
    let (cost, normal) =
        found.cost.values.iter().zip(&found.normal.values).map(|(c, n)| unpacked(packed(*c, *n))).unzip();
    let (width, height) = (found.depth.width, found.depth.height);
    let normal = Map { width, height, values: normal };
    StereoDepth { depth: found.depth.clone(), normal, cost: Map { width, height, values: cost } }
}

fn packed(cost: f32, normal: [f32; 3]) -> u32 {
    let length = normal.iter().map(|n| n.abs()).sum::<f32>().max(1e-20);
    let [x, y, z] = normal.map(|n| n / length);
    let fold = |a: f32, b: f32| if z < 0.0 { (1.0 - b.abs()).copysign(a) } else { a };
    let step = |v: f32| ((v + 1.0) * NORMAL_STEPS + 0.5).clamp(0.0, 4095.0) as u32;
    let cost = (cost / COST_STEP + 0.5).clamp(0.0, 255.0) as u32;
    (cost << 24) | (step(fold(x, y)) << 12) | step(fold(y, x))
}

fn unpacked(word: u32) -> (f32, [f32; 3]) {
    let value = |bits: u32| (bits & 0xfff) as f32 / NORMAL_STEPS - 1.0;
    let (x, y) = (value(word >> 12), value(word));
    let z = 1.0 - x.abs() - y.abs();
    let fold = |a: f32, b: f32| if z < 0.0 { (1.0 - b.abs()).copysign(a) } else { a };
    let normal = [fold(x, y), fold(y, x), z];
    let length = normal.iter().map(|n| n * n).sum::<f32>().sqrt();
    ((word >> 24) as f32 * COST_STEP, normal.map(|n| n / length))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_survives_the_cache_and_damage_is_noticed() {
        let camera = Pinhole { width: 3, height: 2, fx: 1.0, fy: 1.0, cx: 1.5, cy: 1.0 };
        let mut found = nothing(&camera);
        found.depth.set(1, 1, 4.5);
        found.normal.set(2, 0, [0.36, 0.48, -0.8]);
        found.cost.set(2, 1, 0.25);
        let exact = found.normal.at(2, 0);
        found = rounded(&found);
        let off: f32 = exact.iter().zip(found.normal.at(2, 0)).map(|(a, b)| (a - b).abs()).sum();
        assert!(off < 2e-3 && (found.cost.at(2, 1) - 0.25).abs() < 4e-3, "{off}");
        assert_eq!(rounded(&found), found, "rounding twice changes nothing");
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("a.stereo");
        let mut bytes = spilled(&found);
        std::fs::write(&path, &bytes).expect("written");
        assert_eq!(read_spilled(&path, &camera), Some(found));
        bytes[30] ^= 1;
        std::fs::write(&path, &bytes).expect("written");
        assert_eq!(read_spilled(&path, &camera), None);
    }

    #[test]
    fn stereo_images_are_the_training_images_within_bounds() {
        let mut config = Config::default();
        let camera = Pinhole { width: 4000, height: 3000, fx: 3500.0, fy: 3500.0, cx: 2000.0, cy: 1500.0 };
        assert_eq!(stereo_camera(&camera, &config).width, 1600);
        config.image_width = 800;
        assert_eq!(stereo_camera(&camera, &config).width, 800);
        config.coarse.scale = 0.5;
        assert_eq!(stereo_camera(&camera, &config).width, 400);
        config.image_width = 96;
        assert_eq!(stereo_camera(&camera, &config).width, 96);
    }
}
