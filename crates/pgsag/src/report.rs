//! The report: one offline page of numbers, pictures, curves, warnings and the switches in force.

use anyhow::{Context as _, Result};
use pgsag_group::{Group, GroupView, Vote};
use pgsag_mesh::score::Score;
use serde_json::{Value, json};

use crate::config::keys::{shown, unit};
use crate::config::{Config, Preset, size_text};
use crate::run::Run;
use crate::run::artifact::files_below;
use crate::run::manifest::Manifest;
use crate::run::stage::{Job, Per};
use crate::stages::group::Made;
use crate::stages::import::Imported;
use crate::stages::merge::Building;
use crate::stages::score::evidence::Evidence;
use crate::stages::train::Trained;

pub mod accuracy;
pub mod curves;
pub mod footprints;
pub mod glb;
pub mod pictures;
pub mod votes;

const TEMPLATE: &str = include_str!("report/template.html");

/// What the page shows beside what the run's folders say.
pub struct Content<'a> {
    /// The scene.
    pub imported: &'a Imported,
    /// Its buildings.
    pub buildings: &'a [Building],
    /// Whether masks told buildings apart.
    pub masked: bool,
    /// Faces of the whole surface.
    pub face_count: usize,
    /// Views with their pictures.
    pub shown: Vec<pictures::Shown>,
    /// Where there was a truth.
    pub score: Option<Score>,
    /// What was found without one.
    pub evidence: Evidence,
    /// What the views said of the points; empty without masks.
    pub votes: Vec<Vote>,
    /// The groups themselves.
    pub grouped: &'a [Group],
    /// How they came about.
    pub made: Made,
}

/// The page as text.
///
/// # Errors
/// Where an artifact cannot be read.
pub fn page(job: &Job<'_>, config: &Config, content: &Content<'_>) -> Result<String> {
    let mut environment = minijinja::Environment::new();
    environment.add_template("report.html", TEMPLATE).context("the report's template")?;
    let template = environment.get_template("report.html").context("the report's template")?;
    let groups = content.grouped.iter().map(|one| group(job, one)).collect::<Result<Vec<_>>>()?;
    let (jobs, warnings) = jobs(job.run)?;
    let frame = &content.imported.scene.frame;
    let settings = config.settings();
    let defaults = Config::preset(Preset::Standard).settings();
    let rows: Vec<Value> = settings
        .iter()
        .map(|(key, value)| {
            json!({"key": key, "value": shown(value), "unit": unit(key), "changed": defaults.get(key) != Some(value)})
        })
        .collect();
    let context = json!({
        "version": env!("CARGO_PKG_VERSION"), "backend": job.run.backend, "seed": config.seed,
        "scene": config.scene, "view_count": content.imported.scene.views.len(),
        "point_count": content.imported.scene.points.len(), "frame": frame.source,
        "scale_known": frame.metres_per_unit.is_some(), "masked": content.masked,
        "face_count": content.face_count, "groups": groups, "buildings": content.buildings,
        "made": content.masked.then_some(content.made),
        "votes": votes::distribution(&content.votes, &config.vote),
        "shown": content.shown, "score": content.score, "evidence": accuracy::shown(&content.evidence), "jobs": jobs, "warnings": warnings, "settings": rows,
    });
    template.render(minijinja::value::Serde(&context)).context("the report")
}

/// A group with its curves and what images that were kept out say of it.
fn group(job: &Job<'_>, of: &Group) -> Result<Value> {
    let name = &of.id.to_string();
    let summary = Trained::summary_of(&job.input("train").join(name))?;
    let log = std::fs::read_to_string(job.run.log_path("train", name)).unwrap_or_default();
    let curves: Vec<Value> = curves::curves(&log)
        .into_iter()
        .map(|curve| json!({"name": curve.name, "svg": curve.svg, "last": format!("{:.5}", curve.last)}))
        .collect();
    let held_out = &summary.held_out;
    let mean = |of: fn(&crate::stages::train::HeldOut) -> f64| {
        (!held_out.is_empty()).then(|| held_out.iter().map(of).sum::<f64>() / held_out.len() as f64)
    };
    let (psnr, ssim) = (mean(|image| image.psnr), mean(|image| image.ssim));
    Ok(json!({
        "name": name, "views": of.views.len(), "points": of.core_count, "halo": of.points.len() - of.core_count,
        "seen": format!("{:.0}", 100.0 * median_of(of, |view| view.seen_share)),
        "incidence": format!("{:.0}", median_of(of, |view| view.incidence_deg)),
        "gaussians": summary.gaussians, "iterations": summary.iterations, "curves": curves,
        "held_out": held_out.len(), "psnr": psnr.map(|value| format!("{value:.2}")),
        "ssim": ssim.map(|value| format!("{value:.4}")),
    }))
}

/// The middle of what a group's views say.
fn median_of(group: &Group, of: fn(&GroupView) -> f32) -> f64 {
    let mut values: Vec<f64> = group.views.iter().map(|view| f64::from(of(view))).collect();
    pgsag_scene::numbers::median(&mut values).unwrap_or(0.0)
}

/// Cost of every finished job, and every warning with where it came from.
fn jobs(run: &Run) -> Result<(Vec<Value>, Vec<Value>)> {
    let (mut rows, mut warnings) = (Vec::new(), Vec::new());
    for stage in run.table {
        let names = match stage.per {
            Per::Whole => vec![crate::run::stage::WHOLE.to_owned()],
            _ => run.finished_jobs(stage.name).unwrap_or_default(),
        };
        if stage.per == Per::Group {
            // Groups that failed twice left only their last words.
            let prefix = format!("{}.", stage.name);
            for file in files_below(&run.folder.join("log")).unwrap_or_default() {
                let job = file.strip_prefix(&prefix).and_then(|rest| rest.strip_suffix(".failed"));
                if let Some(job) = job.filter(|job| !names.contains(&(*job).to_owned())) {
                    let words = std::fs::read_to_string(run.failure_path(stage.name, job)).unwrap_or_default();
                    let text = format!("failed twice and is missing: {words}");
                    warnings.push(json!({"stage": stage.name, "job": job, "text": text}));
                }
            }
        }
        for name in names {
            // The report itself is not finished yet.
            let Ok(manifest) = Manifest::read(&run.job_folder(stage, &name)) else { continue };
            let measured = &manifest.measured;
            rows.push(json!({
                "stage": stage.name, "job": name, "wall": format!("{:.1}", measured.wall_secs),
                "cpu": format!("{:.1}", measured.cpu_secs), "memory": size_text(measured.peak_memory_bytes),
                "host": measured.host,
            }));
            warnings
                .extend(manifest.warnings.iter().map(|text| json!({"stage": stage.name, "job": name, "text": text})));
        }
    }
    Ok((rows, warnings))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_template_escapes_and_needs_nothing_from_outside() {
        let mut environment = minijinja::Environment::new();
        environment.add_template("report.html", TEMPLATE).expect("a good template");
        let template = environment.get_template("report.html").expect("added");
        let page = template
            .render(minijinja::value::Serde(json!({"scene": "<b>&", "groups": [], "buildings": [], "shown": [],
                "jobs": [], "warnings": [], "settings": [], "face_count": 3})))
            .expect("renders");
        assert!(page.contains("&lt;b&gt;&amp;"));
        assert!(!page.contains("http://") && !page.contains("https://") && !page.contains("<script"), "offline");
    }
}
