//! Accuracy without truth: the photographs, the points that were kept back, and the mesh itself are asked.

use std::collections::BTreeMap;

use anyhow::Result;
use pgsag_mesh::evidence::flow::{FlowOptions, FlowView, Patch, Verdict, patch_step, residual_flow};
use pgsag_mesh::evidence::points::point_witness;
use pgsag_mesh::evidence::structure::{Plane, StructureOptions, edge_widths, planes};
use pgsag_mesh::evidence::{Spread, spread};
use pgsag_scene::numbers::{median, quantile};
use pgsag_scene::{Mesh, Scene};
use pgsag_splat::train::{Neighbor, neighbors_of};
use serde::{Deserialize, Serialize};

use crate::config::Config;
use crate::lengths::Lengths;
use crate::photographs::Photographs;
use crate::run::stage::Job;
use crate::stages::coarse::{Coarse, ground_sampling};
use crate::stages::import::Imported;

/// How accuracy is looked for where there is no truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvidenceOptions {
    /// Pairs of photographs that are compared through the mesh, both ways; 0: none.
    pub pairs: u32,
    /// One pair more for so many images beyond those.
    pub images_per_pair: u32,
    /// Points of the model farther from the mesh than this see no mesh, ground sampling distances.
    pub reach_gsd: f64,
    /// Comparison of photographs.
    pub flow: FlowOptions,
    /// Planes and edges.
    pub structure: StructureOptions,
}

impl Default for EvidenceOptions {
    fn default() -> Self {
        Self {
            pairs: 10,
            images_per_pair: 20,
            reach_gsd: 10.0,
            flow: FlowOptions::default(),
            structure: StructureOptions::default(),
        }
    }
}

/// `evidence.json`. Of scenes of unknown scale, `_m` counts as [`Lengths`] says.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// Ground sampling distance at the median depth, metres.
    pub gsd_m: f64,
    /// What photographs say.
    pub flow: Option<FlowEvidence>,
    /// What points that were kept back say.
    pub points: Option<PointsEvidence>,
    /// What the mesh says of itself.
    pub structure: StructureEvidence,
}

/// Residual flow.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FlowEvidence {
    /// Whether the photographs were kept out of training; those that were learnt from have been fitted.
    pub held_out: bool,
    /// Compared, both ways each.
    pub pairs: u32,
    /// Everything.
    pub all: FlowPart,
    /// Building surface.
    pub buildings: FlowPart,
    /// The rest.
    pub background: FlowPart,
    /// By number.
    pub per_building: BTreeMap<u32, FlowPart>,
}

/// Patches of one part of the mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FlowPart {
    /// Patches that both photographs of a pair see.
    pub patches: u64,
    /// Share of them with a residual.
    pub judged: f64,
    /// Share of them with texture that matches nothing within reach: gross errors, and what photographs disagree on.
    pub lost: f64,
    /// Along the epipolar line, pixels; positive where the true surface is nearer.
    pub residual_px: Spread,
    /// The mesh against what the photographs show, along its normal, metres; positive: outside.
    pub surface_m: Spread,
}

/// Points that were kept back.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PointsEvidence {
    /// Kept back.
    pub withheld: u64,
    /// Too few rays to know their own accuracy, or false matches.
    pub unfit: u64,
    /// Fit, but without mesh beside them.
    pub without_mesh: u64,
    /// Noise of the rays, pixels per coordinate.
    pub noise_px: Option<f64>,
    /// Everything.
    pub all: PointsPart,
    /// Building surface.
    pub buildings: PointsPart,
    /// The rest.
    pub background: PointsPart,
    /// By number.
    pub per_building: BTreeMap<u32, PointsPart>,
}

/// Points beside one part of the mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PointsPart {
    /// The mesh against them, metres; positive: outside.
    pub surface_m: Spread,
    /// Distances over their own standard deviations: their median.
    pub normalised_median: Option<f64>,
    /// Their robust standard deviation; 1: the mesh is as good as the points can tell.
    pub normalised_sigma: Option<f64>,
    /// Share within two of their standard deviations; 0.95: the same.
    pub within_two_sigma: Option<f64>,
}

/// Planes and edges, in ground sampling distances.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StructureEvidence {
    /// Planes less steep than 70 degrees.
    pub roofs: PlanesPart,
    /// Steeper ones.
    pub facades: PlanesPart,
    /// Roof edges from above.
    pub edges: EdgesPart,
}

/// Planes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlanesPart {
    /// How many.
    pub count: u64,
    /// Half of the planes' surface is flatter: root mean square off the plane.
    pub rms_gsd: Option<f64>,
    /// 90 % of it is flatter.
    pub p90_gsd: Option<f64>,
}

/// Edges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EdgesPart {
    /// Places at which the height was read across an edge.
    pub count: u64,
    /// Buildings with any.
    pub buildings: u64,
    /// Way from 90 % to 10 % of the fall: median over the buildings of their medians.
    pub width_gsd: Option<f64>,
    /// Median over the buildings of what 90 % of their edges keep below.
    pub p90_gsd: Option<f64>,
}

/// A photograph with its patches, for a picture.
pub struct PatchView {
    /// The photograph.
    pub view: usize,
    /// Distance between patches, pixels of training.
    pub step_px: u32,
    /// Its patches.
    pub patches: Vec<Patch>,
}

/// Planes steeper than this are facades: cosine of 70 degrees.
const FACADE_MAX_LEVEL: f64 = 0.342;
/// Pairs whose patches are kept for pictures.
const SHOWN: usize = 3;
/// Fewer points or patches than this tell nothing of one building.
const MIN_COUNT: u64 = 10;

/// Asks all witnesses.
pub(super) fn gather(
    job: &Job<'_>,
    config: &Config,
    imported: &Imported,
    city: &Mesh,
) -> Result<(Evidence, Vec<PatchView>)> {
    let scene = &imported.scene;
    let lengths = Lengths::of(scene);
    let gsd = ground_sampling(scene, config).unwrap_or(0.0);
    let (flow, shown) = flow(job, config, imported, city, &lengths)?;
    let Coarse { withheld, .. } = job.read("coarse")?;
    let points = points(config, scene, city, &withheld, gsd, &lengths)?;
    let structure = structure(config, scene, city, gsd);
    Ok((Evidence { gsd_m: lengths.metres(gsd), flow, points, structure }, shown))
}

/// The pairs that are compared: held-out images among themselves, or any with their best neighbours.
fn pairs(config: &Config, scene: &Scene) -> (bool, Vec<[usize; 2]>) {
    let count = scene.views.len();
    let wanted = config.evidence.pairs as usize + count / config.evidence.images_per_pair.max(1) as usize;
    let of = |views: Vec<u32>| -> Vec<[usize; 2]> {
        let mut pairs: Vec<[usize; 2]> = neighbors_of(scene, &views, &config.neighbors)
            .iter()
            .enumerate()
            .filter_map(|(at, list)| list.first().map(|Neighbor { view, .. }| [at, *view as usize]))
            .map(|[a, b]| [views[a.min(b)] as usize, views[a.max(b)] as usize])
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        pairs
    };
    let held_out: Vec<u32> = (0..count).filter(|view| config.is_held_out(*view)).map(|view| view as u32).collect();
    let mut found = of(held_out);
    let is_held_out = found.len() >= 2;
    if !is_held_out {
        found = of((0..count).filter(|view| !config.is_held_out(*view)).map(|view| view as u32).collect());
    }
    let kept = wanted.min(found.len()) * usize::from(config.evidence.pairs > 0);
    let spread = (0..kept).map(|k| found[(2 * k + 1) * found.len() / (2 * kept)]).collect();
    (is_held_out, spread)
}

fn flow(
    job: &Job<'_>,
    config: &Config,
    imported: &Imported,
    city: &Mesh,
    lengths: &Lengths,
) -> Result<(Option<FlowEvidence>, Vec<PatchView>)> {
    let (held_out, pairs) = pairs(config, &imported.scene);
    if pairs.is_empty() {
        return Ok((None, Vec::new()));
    }
    let photographs = Photographs::new(imported, config, job, 0);
    let view = |index: usize| -> Result<FlowView> {
        let pose = imported.scene.views[index].camera_from_world;
        Ok(FlowView::new(city, photographs.camera(index), pose, photographs.whole(index)?.as_ref()))
    };
    let (mut all, mut shown) = (Vec::new(), Vec::new());
    let every = pairs.len().div_ceil(SHOWN);
    for (number, [one, other]) in pairs.iter().enumerate() {
        job.check()?;
        let (a, b) = (view(*one)?, view(*other)?);
        let there = residual_flow(&a, &b, &config.evidence.flow);
        all.extend(residual_flow(&b, &a, &config.evidence.flow));
        all.extend_from_slice(&there);
        if number % every == every / 2 {
            let step_px = patch_step(&photographs.camera(*one), &config.evidence.flow);
            shown.push(PatchView { view: *one, step_px, patches: there });
        }
        job.advance(number as u64 + 1, pairs.len() as u64, "pairs");
    }
    let building = |patch: &Patch| city.buildings.get(patch.face as usize).copied().unwrap_or(0);
    let part = |keep: &dyn Fn(u32) -> bool| flow_part(all.iter().filter(|patch| keep(building(patch))), lengths);
    let numbers: std::collections::BTreeSet<u32> = all.iter().map(building).filter(|number| *number != 0).collect();
    let found = FlowEvidence {
        held_out,
        pairs: pairs.len() as u32,
        all: part(&|_| true),
        buildings: part(&|number| number != 0),
        background: part(&|number| number == 0),
        per_building: numbers
            .into_iter()
            .map(|number| (number, part(&|other| other == number)))
            .filter(|(_, part)| part.surface_m.count >= MIN_COUNT)
            .collect(),
    };
    Ok((Some(found), shown))
}

fn flow_part<'a>(patches: impl Iterator<Item = &'a Patch>, lengths: &Lengths) -> FlowPart {
    let (mut pixels, mut surface) = (Vec::new(), Vec::new());
    let (mut count, mut lost) = (0_u64, 0_u64);
    for patch in patches {
        count += 1;
        match patch.verdict {
            Verdict::Plain => {}
            Verdict::Lost => lost += 1,
            Verdict::Measured { residual_px, noise_px, outside, noise } => {
                pixels.push([residual_px, noise_px]);
                surface.push([outside, noise]);
            }
        }
    }
    let share = |part: u64| part as f64 / count.max(1) as f64;
    FlowPart {
        patches: count,
        judged: share(pixels.len() as u64),
        lost: share(lost),
        residual_px: spread(&pixels),
        surface_m: spread(&surface).scaled(lengths.metres(1.0)),
    }
}

fn points(
    config: &Config,
    scene: &Scene,
    city: &Mesh,
    withheld: &[u32],
    gsd: f64,
    lengths: &Lengths,
) -> Result<Option<PointsEvidence>> {
    let asked: Vec<u32> = withheld.iter().copied().filter(|at| (*at as usize) < scene.points.len()).collect();
    if asked.is_empty() {
        return Ok(None);
    }
    let found = point_witness(city, scene, &asked, config.evidence.reach_gsd * gsd)?;
    let mut by_building: BTreeMap<u32, Vec<[f64; 2]>> = BTreeMap::new();
    for one in &found.near {
        let number = city.buildings.get(one.face as usize).copied().unwrap_or(0);
        by_building.entry(number).or_default().push([one.outside, one.sigma]);
    }
    let part = |keep: &dyn Fn(u32) -> bool| {
        let measured: Vec<[f64; 2]> =
            by_building.iter().filter(|(number, _)| keep(**number)).flat_map(|(_, list)| list.clone()).collect();
        points_part(&measured, lengths)
    };
    Ok(Some(PointsEvidence {
        withheld: withheld.len() as u64,
        unfit: found.unfit,
        without_mesh: found.without_mesh,
        noise_px: found.noise_px,
        all: part(&|_| true),
        buildings: part(&|number| number != 0),
        background: part(&|number| number == 0),
        per_building: by_building
            .iter()
            .filter(|(number, list)| **number != 0 && list.len() as u64 >= MIN_COUNT)
            .map(|(number, list)| (*number, points_part(list, lengths)))
            .collect(),
    }))
}

fn points_part(measured: &[[f64; 2]], lengths: &Lengths) -> PointsPart {
    let normalised: Vec<[f64; 2]> = measured.iter().map(|m| [m[0] / m[1].max(f64::MIN_POSITIVE), 0.0]).collect();
    let found = spread(&normalised);
    let within = normalised.iter().filter(|m| m[0].abs() <= 2.0).count();
    PointsPart {
        surface_m: spread(measured).scaled(lengths.metres(1.0)),
        normalised_median: found.bias,
        normalised_sigma: found.sigma,
        within_two_sigma: (!measured.is_empty()).then(|| within as f64 / measured.len() as f64),
    }
}

fn structure(config: &Config, scene: &Scene, city: &Mesh, gsd: f64) -> StructureEvidence {
    if gsd <= 0.0 {
        return StructureEvidence::default();
    }
    let (options, up) = (&config.evidence.structure, scene.frame.up_world);
    let found = planes(city, up, gsd, options);
    let part = |keep: &dyn Fn(&Plane) -> bool| {
        let mut kept: Vec<&Plane> = found.iter().filter(|plane| keep(plane)).collect();
        kept.sort_by(|a, b| a.rms.total_cmp(&b.rms));
        let total: f64 = kept.iter().map(|plane| plane.area).sum();
        let at = |share: f64| {
            let mut below = 0.0;
            let is_there = |plane: &&&Plane| {
                below += plane.area;
                below >= share * total
            };
            kept.iter().find(is_there).map(|plane| plane.rms / gsd)
        };
        PlanesPart { count: kept.len() as u64, rms_gsd: at(0.5), p90_gsd: at(0.9) }
    };
    let edges = edge_widths(city, up, gsd, options);
    let mut widths: Vec<f64> = edges.iter().map(|one| one.median / gsd).collect();
    let mut wide: Vec<f64> = edges.iter().map(|one| one.p90 / gsd).collect();
    StructureEvidence {
        roofs: part(&|plane| plane.level >= FACADE_MAX_LEVEL),
        facades: part(&|plane| plane.level < FACADE_MAX_LEVEL),
        edges: EdgesPart {
            count: edges.iter().map(|one| one.count).sum(),
            buildings: edges.len() as u64,
            width_gsd: median(&mut widths),
            p90_gsd: quantile(&mut wide, 0.5),
        },
    }
}

/// The figures in one line.
pub(super) fn in_words(evidence: &Evidence) -> Option<String> {
    let mut parts = Vec::new();
    if let Some(flow) = &evidence.flow
        && let (Some(bias), Some(net)) = (flow.all.surface_m.bias, flow.all.surface_m.net)
    {
        let who = if flow.held_out { "photographs that were kept out" } else { "the photographs themselves" };
        parts.push(format!("{who} find it {bias:+.3} m off, give or take {net:.3} m"));
    }
    if let Some(points) = &evidence.points
        && let (Some(bias), Some(net)) = (points.all.surface_m.bias, points.all.surface_m.net)
    {
        parts.push(format!("points that were kept back {bias:+.3} m, give or take {net:.3} m"));
    }
    (!parts.is_empty()).then(|| format!("the surface without truth: {}", parts.join("; ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn town() -> Scene {
        use pgsag_scene::synthetic::{Town, TownOptions};
        Town::generate(&TownOptions { view_count: 24, point_count: 900, ..TownOptions::default() }).scene
    }

    #[test]
    fn images_that_were_kept_out_are_asked_first() {
        let scene = town();
        let config = Config { holdout: 3, ..Config::default() };
        let (held_out, found) = pairs(&config, &scene);
        assert!(held_out && !found.is_empty());
        assert!(found.iter().flatten().all(|view| config.is_held_out(*view)), "{found:?}");
        let config = Config { holdout: 12, ..Config::default() };
        let (held_out, found) = pairs(&config, &scene);
        assert!(!held_out, "two images make one pair at most");
        assert!(found.iter().flatten().all(|view| !config.is_held_out(*view)), "{found:?}");
        assert!(found.len() <= 11 && found.iter().all(|[a, b]| a < b));
        let none = EvidenceOptions { pairs: 0, ..EvidenceOptions::default() };
        assert_eq!(pairs(&Config { evidence: none, ..config }, &scene).1, Vec::<[usize; 2]>::new());
    }

    #[test]
    fn shares_are_of_what_both_photographs_see() {
        let patch = |verdict| Patch { at_px: [0.0; 2], place_world: [0.0; 3], face: 0, verdict };
        let found = Verdict::Measured { residual_px: 0.5, noise_px: 0.1, outside: -0.2, noise: 0.05 };
        let list = [patch(Verdict::Plain), patch(Verdict::Lost), patch(found), patch(found)];
        let part = flow_part(list.iter(), &Lengths::known(2.0));
        assert_eq!((part.patches, part.judged, part.lost), (4, 0.5, 0.25));
        assert_eq!((part.residual_px.bias, part.surface_m.bias), (Some(0.5), Some(-0.4)));
    }

    #[test]
    fn points_as_good_as_they_say_are_normal() {
        let mut random = pgsag_scene::numbers::SplitMix64::new(4);
        let measured: Vec<[f64; 2]> = (0..4000).map(|k| [0.01, 0.1][k % 2]).map(|s| [s * random.normal(), s]).collect();
        let part = points_part(&measured, &Lengths::known(1.0));
        assert!((part.normalised_sigma.expect("some") - 1.0).abs() < 0.05, "{part:?}");
        assert!((part.within_two_sigma.expect("some") - 0.954).abs() < 0.015, "{part:?}");
    }
}
