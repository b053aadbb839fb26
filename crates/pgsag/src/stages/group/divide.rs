//! Points to clusters of buildings and blocks of background, with the reasons for every number.

use anyhow::Result;
use glam::{DVec2, DVec3};
use pgsag_group::Label;
use pgsag_group::blocks::{Airspace, Block, blocks};
use pgsag_group::cluster::{Cluster, ClusterRules, Density, clusters};
use pgsag_group::plan::PlanFrame;
use pgsag_group::surface::Surface;
use pgsag_scene::Scene;
use pgsag_scene::numbers::quantile;
use pgsag_splat::train::density::bytes_per_gaussian;

use super::{MIN_POINTS, Made};
use crate::config::{Config, parse_size};
use crate::lengths::Lengths;
use crate::photographs::training_camera;
use crate::run::stage::Job;
use crate::stages::train::{BYTES_PER_PIXEL, FIXED_BYTES, MAX_GROWTH, MAX_GROWTH_FLOOR};

/// Memory that two groups share where no limit is given, so that the answer does not depend on the machine.
const USUAL_MEMORY: u64 = 8 << 30;
/// A budget never cuts below this many points.
const SMALLEST_BUDGET: usize = 1000;
/// Roofs smaller than this are no group of their own, square metres.
const TINY_M2: f64 = 25.0;
/// A height step that halves the cost of a cut, metres.
const HEIGHT_STEP_M: f64 = 1.0;

/// A block of background and its airspace.
pub(super) struct Ground {
    pub(super) block: Block,
    pub(super) airspace: Airspace,
}

/// The scene, divided.
pub(super) struct Division {
    pub(super) frame: PlanFrame,
    /// All coarse points.
    pub(super) surface: Surface,
    /// Buildings, the largest first.
    pub(super) clusters: Vec<Cluster>,
    /// Background.
    pub(super) grounds: Vec<Ground>,
    /// Points of the background: all that no cluster owns.
    pub(super) background: Vec<u32>,
    /// What became of the clusters.
    pub(super) made: Made,
}

/// Divides the points of the area of interest.
pub(super) fn divide(
    job: &Job<'_>,
    scene: &Scene,
    points: &[u32],
    labels: &[Label],
    config: &Config,
) -> Result<Division> {
    let frame = PlanFrame::new(scene.frame.up_world);
    let positions: Vec<DVec3> = scene.points.iter().map(|point| point.position_world).collect();
    let is_building = |index: &u32| labels.get(*index as usize) == Some(&Label::Building);
    let buildings: Vec<u32> = points.iter().copied().filter(is_building).collect();
    let surface = Surface::new(positions.clone());
    let rules = rules(job, scene, &frame, &buildings, surface.spacing, config)?;
    let found = clusters(&buildings, &positions, &frame, &rules);
    job.say(&format!(
        "{} clusters of buildings; {} tiny ones merged, {} cuts, {} groups; {} of {} points lie apart from all",
        found.found,
        found.merged,
        found.cuts,
        found.clusters.len(),
        found.noise.len(),
        buildings.len()
    ));
    let mut owned = vec![false; positions.len()];
    found.clusters.iter().flat_map(|cluster| &cluster.core).for_each(|index| owned[*index as usize] = true);
    let background: Vec<u32> = points.iter().copied().filter(|index| !owned[*index as usize]).collect();
    let grounds = grounds(scene, &frame, &positions, &background, budget(scene, config)?, config);
    if grounds.len() > 1 {
        job.say(&format!("{} blocks of background", grounds.len()));
    }
    let made = Made { clusters: found.found, merged: found.merged, cuts: found.cuts, apart: found.noise.len() };
    Ok(Division { frame, surface, clusters: found.clusters, grounds, background, made })
}

/// What makes a cluster here, said aloud.
fn rules(
    job: &Job<'_>,
    scene: &Scene,
    frame: &PlanFrame,
    buildings: &[u32],
    spacing: f64,
    config: &Config,
) -> Result<ClusterRules> {
    let options = &config.groups;
    let lengths = Lengths::of(scene);
    let plan: Vec<DVec2> =
        buildings.iter().map(|index| frame.plan(scene.points[*index as usize].position_world)).collect();
    let bounds = [lengths.units(options.min_eps_m), lengths.units(options.max_eps_m)];
    let asked = (options.eps_m > 0.0).then(|| lengths.units(options.eps_m));
    let density = Density::measure(&plan, spacing, bounds, asked);
    let max_points = budget(scene, config)?;
    // Where points are few, few points are a house.
    let tiny = (density.points_per_area * lengths.square_units(TINY_M2)) as usize;
    let reason = match asked {
        Some(_) => "as asked".to_owned(),
        None => format!("eight distances between points, within {} to {} m", options.min_eps_m, options.max_eps_m),
    };
    job.say(&format!(
        "buildings have {:.1} points per m² of plan; neighbourhoods reach {:.2} m ({reason}) and need {:.0} points (30 % of \
         a full disc); at most {max_points} points per group ({})",
        density.points_per_area / lengths.square_metres(1.0),
        lengths.metres(density.eps),
        density.min_neighbors,
        if options.max_points > 0 { "as asked" } else { "what two at once can be trained with in memory" }
    ));
    Ok(ClusterRules {
        eps: density.eps,
        min_neighbors: density.min_neighbors,
        min_points: tiny.clamp(MIN_POINTS, options.min_points.max(MIN_POINTS)),
        max_points,
        halo: lengths.units(options.halo_m),
        height_step: lengths.units(HEIGHT_STEP_M),
    })
}

/// Points that training may begin with, such that two groups fit into memory at once.
pub(crate) fn budget(scene: &Scene, config: &Config) -> Result<usize> {
    if config.groups.max_points > 0 {
        return Ok(config.groups.max_points);
    }
    let limit = if config.memory_limit.is_empty() { USUAL_MEMORY } else { parse_size(&config.memory_limit)? };
    let camera = |view: &pgsag_scene::View| training_camera(&view.camera, config.image_width).pixel_count() as u64;
    let pixels = scene.views.iter().map(camera).max().unwrap_or(0);
    // Three fifths of a job's memory hold the Gaussians and what is drawn, the rest caches of images.
    let free = (limit / 2 * 3 / 5).saturating_sub(FIXED_BYTES + pixels * BYTES_PER_PIXEL);
    let gaussians = (free / bytes_per_gaussian(config.initialise.sh_degree)) as usize;
    Ok((gaussians.saturating_sub(MAX_GROWTH_FLOOR) / MAX_GROWTH).max(SMALLEST_BUDGET))
}

/// Blocks of background with finite airspaces around what they are trained on.
fn grounds(
    scene: &Scene,
    frame: &PlanFrame,
    positions: &[DVec3],
    background: &[u32],
    max_points: usize,
    config: &Config,
) -> Vec<Ground> {
    let cameras: Vec<DVec2> = scene.views.iter().map(|view| frame.plan(view.center_world())).collect();
    let at_least = background.len().div_ceil(max_points);
    let of = |block: Block| {
        let own = background.iter().map(|index| positions[*index as usize]).filter(|at| block.reaches(frame.plan(*at)));
        let own: Vec<DVec3> = own.collect();
        // A hundredth on each side are outliers.
        let bounds = |value: &dyn Fn(&DVec3) -> f64| {
            let mut values: Vec<f64> = own.iter().map(value).collect();
            [quantile(&mut values, 0.01).unwrap_or(0.0), quantile(&mut values, 0.99).unwrap_or(0.0)]
        };
        let [x, y] = [bounds(&|at| frame.plan(*at).x), bounds(&|at| frame.plan(*at).y)];
        let heights = bounds(&|at| frame.height(*at));
        let airspace = Airspace { low: DVec2::new(x[0], y[0]), high: DVec2::new(x[1], y[1]), heights };
        (!own.is_empty()).then_some(Ground { block, airspace })
    };
    blocks(&cameras, &config.blocks, at_least).into_iter().filter_map(of).collect()
}
