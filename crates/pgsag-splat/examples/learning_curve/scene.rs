//! The town as a source of training views, and its points to start from.

use std::sync::Arc;

use pgsag_scene::synthetic::{Photograph, Town, TownOptions};
use pgsag_splat::backend::{TrainingView, ViewCamera};
use pgsag_splat::stereo::{
    CheckOptions, Prior, StereoDepth, StereoOptions, StereoView, SurfacePoint, confirmed, estimate, lift, thin_points,
};
use pgsag_splat::train::ViewSource;
use pgsag_splat::train::{InitialPoint, NeighborOptions, TrainOptions, neighbors_of};

/// What the command line asks for.
pub(crate) struct Arguments {
    pub(crate) town: TownOptions,
    pub(crate) options: TrainOptions,
    pub(crate) stereo: bool,
    pub(crate) every: u32,
}

const HELP: &str =
    "learning_curve [--iterations N] [--every N] [--views N] [--width PX] [--stereo] [--set key=value]...
  --set takes keys of TrainOptions, as rates.position_gsd=0.3";

impl Arguments {
    /// `None` where help was asked for.
    pub(crate) fn read() -> Result<Option<Self>, Box<dyn std::error::Error>> {
        let mut town = TownOptions::default();
        let mut options = serde_json::to_value(TrainOptions::fast())?;
        let (mut stereo, mut every) = (false, 500);
        let mut words = std::env::args().skip(1);
        while let Some(word) = words.next() {
            let mut value = || words.next().ok_or_else(|| format!("{word} needs a value"));
            match word.as_str() {
                "--iterations" => options["iterations"] = value()?.parse::<u32>()?.into(),
                "--every" => every = value()?.parse()?,
                "--views" => town.view_count = value()?.parse()?,
                "--width" => {
                    let width: u32 = value()?.parse()?;
                    town.gsd_m *= f64::from(town.width) / f64::from(width);
                    (town.height, town.width) = (width * 3 / 4, width);
                }
                "--stereo" => stereo = true,
                "--set" => {
                    let text = value()?;
                    let (key, value) = text.split_once('=').ok_or("--set key=value")?;
                    let place = key.split('.').fold(&mut options, |place, part| &mut place[part]);
                    *place = serde_json::from_str(value)?;
                }
                _ => {
                    println!("{HELP}");
                    return Ok(None);
                }
            }
        }
        Ok(Some(Self { town, options: serde_json::from_value(options)?, stereo, every }))
    }
}

/// Some views of a town.
#[derive(Clone)]
pub(crate) struct TownViews {
    pub(crate) town: Arc<Town>,
    /// Into the scene's views.
    pub(crate) indices: Vec<u32>,
    photographs: Arc<Vec<Photograph>>,
}

impl TownViews {
    pub(crate) fn new(arguments: &Arguments) -> Self {
        let town = Town::generate(&arguments.town);
        let count = town.scene.views.len();
        let photographs = (0..count).map(|view| town.photograph(view)).collect();
        Self { town: Arc::new(town), indices: (0..count as u32).collect(), photographs: Arc::new(photographs) }
    }

    /// All but every `nth` view, and every `nth` view.
    pub(crate) fn split(&self, nth: u32) -> (Self, Self) {
        let part = |held_out: bool| Self {
            indices: self.indices.iter().copied().filter(|i| (i % nth == nth / 2) == held_out).collect(),
            ..self.clone()
        };
        (part(false), part(true))
    }

    pub(crate) fn photograph(&self, position: usize) -> &Photograph {
        &self.photographs[self.indices[position] as usize]
    }

    pub(crate) fn origin(&self) -> [f64; 3] {
        self.town.options.world_offset_m
    }

    pub(crate) fn training_view(&self, position: usize) -> TrainingView {
        let image = self.photograph(position).image.clone();
        TrainingView { camera: self.camera(position), image, mask: None, inner_edges: None }
    }

    pub(crate) fn sparse_points(&self) -> Vec<InitialPoint> {
        let to_initial = |p: &pgsag_scene::SparsePoint| InitialPoint {
            position_world: p.position_world.to_array(),
            color: p.color,
            normal: None,
        };
        self.town.scene.points.iter().map(to_initial).collect()
    }

    /// Points of PatchMatch stereo on which at least two views agree.
    pub(crate) fn stereo_points(&self, indices: &[u32]) -> Vec<InitialPoint> {
        let scene = &self.town.scene;
        let views: Vec<StereoView> = indices
            .iter()
            .map(|i| {
                let view = &scene.views[*i as usize];
                StereoView::new(view.camera, view.camera_from_world, &self.photographs[*i as usize].image)
            })
            .collect();
        let neighbors = neighbors_of(scene, indices, &NeighborOptions::default());
        let depths: Vec<_> = (0..views.len())
            .map(|position| {
                let seeds = self.seeds(indices[position]);
                let z = |pick: fn(f32, f32) -> f32, start: f32| seeds.iter().map(|s| s[2]).fold(start, pick);
                let range = [0.9 * z(f32::min, f32::INFINITY), 1.1 * z(f32::max, 0.0)];
                let beside: Vec<&StereoView> =
                    neighbors[position].iter().take(4).map(|n| &views[n.view as usize]).collect();
                let prior = Prior { seeds: &seeds, depth_range: range };
                estimate(&views[position], &beside, &prior, &StereoOptions::default(), 1)
            })
            .collect();
        let mut points: Vec<SurfacePoint> = Vec::new();
        for (position, found) in depths.iter().enumerate() {
            let beside = neighbors[position].iter().take(4).map(|n| n.view as usize);
            let others: Vec<(&StereoView, &StereoDepth)> =
                beside.map(|other| (&views[other], &depths[other])).collect();
            let view = &views[position];
            let depth = confirmed((view, found), &others, &CheckOptions::default());
            let image = &self.photographs[indices[position] as usize].image;
            points.extend(lift(position as u32, &view.camera, &view.camera_from_world, &depth, found, image));
        }
        let cell = 3.0 * self.town.options.gsd_m;
        let to_initial = |p: SurfacePoint| InitialPoint {
            position_world: p.position_world,
            color: p.color,
            normal: Some(p.normal_world.map(f64::from)),
        };
        thin_points(points, cell).into_iter().map(to_initial).collect()
    }

    fn seeds(&self, view: u32) -> Vec<[f32; 3]> {
        let scene = &self.town.scene;
        let mut seeds = Vec::new();
        for point in &scene.points {
            for seen in point.track.iter().filter(|t| t.view_index == view) {
                let z = scene.views[view as usize].camera_from_world.transform_point(point.position_world).z;
                seeds.push([seen.xy_px[0], seen.xy_px[1], z as f32]);
            }
        }
        seeds
    }
}

impl ViewSource for TownViews {
    fn len(&self) -> usize {
        self.indices.len()
    }

    fn camera(&self, index: usize) -> ViewCamera {
        let view = &self.town.scene.views[self.indices[index] as usize];
        let pose = view.camera_from_world.with_origin(self.origin().into());
        let columns = pose.rotation_matrix();
        ViewCamera {
            pinhole: view.camera,
            rotation: columns.transpose().to_cols_array_2d(),
            translation: pose.translation.to_array(),
            near: 0.0,
        }
    }

    fn view(&self, index: usize) -> pgsag_splat::train::Result<Arc<TrainingView>> {
        Ok(Arc::new(self.training_view(index)))
    }
}
