//! `pgsag score`: any mesh against any truth.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Result;
use pgsag_mesh::evidence::halves::{HalfSpread, HalvesOptions, halves};
use pgsag_mesh::score::{Distances, Panoptic, Score, ScoreOptions};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{existing, print};
use crate::cli::ScoreArgs;
use crate::error::UserError;
use crate::run::artifact::fingerprint_file;
use crate::stages::aoi::Area;
use crate::stages::mesh::read_surface;
use crate::stages::score::score_file;
use crate::stages::write_json;

/// Scores and prints.
pub(super) fn run(args: &ScoreArgs, json: bool) -> Result<()> {
    let mesh = existing(&args.mesh, "the mesh")?;
    if let Some(other) = &args.against {
        return against(args, &mesh, &existing(other, "the other mesh")?, json);
    }
    let truth = existing(args.truth.as_deref().unwrap_or(Path::new("")), "the truth")?;
    let defaults = ScoreOptions::default();
    let options = ScoreOptions {
        protocol: word("--protocol", &args.protocol, "pgsag, pg-sag, citygs-v2 or tanks-and-temples")?,
        align: word("--align", &args.align, "none, icp or icp-scale")?,
        thresholds_m: if args.threshold.is_empty() { defaults.thresholds_m.clone() } else { args.threshold.clone() },
        spacing_m: args.spacing,
        crop: args.crop.as_deref().map(Area::read).transpose()?.map(|area| area.outline()),
        metres_per_unit: args.metres_per_unit,
        seed: args.seed,
        ..defaults
    };
    let score = score_file(&mesh, &truth, &options)?;
    if let Some(path) = &args.output {
        write_json(path, &score)?;
    }
    if json {
        return print(&serde_json::to_string(&score)?);
    }
    for line in table(&score) {
        print(&line)?;
    }
    Ok(())
}

/// `halves.json`: two meshes of different images, each against the other. Lengths but `bias_m` are those of one mesh: the
/// differences over the square root of 2.
#[derive(Serialize)]
struct Halves {
    protocol: &'static str,
    spacing_m: f64,
    reach_m: f64,
    from_first_m: HalfSpread,
    from_second_m: HalfSpread,
    inputs: BTreeMap<&'static str, String>,
}

/// Compares two meshes, neither of which is the truth.
fn against(args: &ScoreArgs, mesh: &Path, other: &Path, json: bool) -> Result<()> {
    let thresholds =
        if args.threshold.is_empty() { ScoreOptions::default().thresholds_m } else { args.threshold.clone() };
    let reach_m = thresholds.iter().copied().fold(0.0, f64::max);
    let spacing_m = args.spacing.unwrap_or_else(|| thresholds.iter().copied().fold(f64::INFINITY, f64::min) / 3.0);
    let scale = args.metres_per_unit;
    let options = HalvesOptions { spacing: spacing_m / scale, reach: reach_m / scale, seed: args.seed };
    let found = halves(&read_surface(mesh)?, &read_surface(other)?, &options)
        .map_err(|error| UserError::at(mesh, error.to_string(), "see `pgsag score --help`"))?;
    let [from_first_m, from_second_m] = found.map(|found| found.scaled(scale));
    let inputs = [("mesh", fingerprint_file(mesh)?), ("against", fingerprint_file(other)?)].into();
    let found = Halves { protocol: "halves", spacing_m, reach_m, from_first_m, from_second_m, inputs };
    if let Some(path) = &args.output {
        write_json(path, &found)?;
    }
    if json {
        return print(&serde_json::to_string(&found)?);
    }
    for (name, way) in [("first to second", &found.from_first_m), ("second to first", &found.from_second_m)] {
        let number = |value: Option<f64>| value.map_or_else(|| "-".into(), |value| format!("{value:.3}"));
        print(&format!(
            "{name}: bias {} m; one mesh: spread {} m, 68 % within {} m, 95 % within {} m; {:.1} % has no counterpart within {reach_m} m",
            number(way.bias),
            number(way.sigma),
            number(way.p68),
            number(way.p95),
            100.0 * way.alone
        ))?;
    }
    Ok(())
}

/// A word of a library's own list.
fn word<T: DeserializeOwned>(option: &str, typed: &str, known: &str) -> Result<T> {
    serde_json::from_value(typed.into())
        .map_err(|_| UserError::new(format!("{option} {typed}"), "is unknown", format!("use {known}")).into())
}

/// A score as a person reads it.
pub(super) fn table(score: &Score) -> Vec<String> {
    let mut lines = vec![format!("{:>10} {:>10} {:>8} {:>8}", "threshold", "precision", "recall", "F1")];
    for row in &score.scores {
        lines.push(format!("{:>8.2} m {:>10.3} {:>8.3} {:>8.3}", row.threshold_m, row.precision, row.recall, row.f1));
    }
    let spread = |name: &str, found: &Distances| {
        let number = |value: Option<f64>| value.map_or_else(|| "-".into(), |value| format!("{value:.3}"));
        let all = &found.all;
        format!(
            "{name}: mean {} m, 68 % within {} m, 90 % within {} m, 95 % within {} m",
            number(all.mean),
            number(all.p68),
            number(all.p90),
            number(all.p95)
        )
    };
    lines.push(spread("accuracy", &score.accuracy_m));
    lines.push(spread("completeness", &score.completeness_m));
    lines.extend(score.panoptic.as_ref().map(told_apart));
    if let Some(share) = score.points_off_buildings {
        lines.push(format!("{:.2} % of the points of building groups lie on no building", 100.0 * share));
    }
    lines.extend(score.notes.iter().map(|note| format!("note: {note}")));
    lines
}

/// How well buildings are told apart.
fn told_apart(of: &Panoptic) -> String {
    format!(
        "buildings: {} found, {} true, {} matched; panoptic quality {:.3} (recognition {:.3} x segmentation {:.3})",
        of.found, of.truth, of.matched, of.quality, of.recognition, of.segmentation
    )
}
