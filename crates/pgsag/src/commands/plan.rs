//! `pgsag plan`: what would run and why, and whether it fits.

use std::path::PathBuf;

use anyhow::Result;
use pgsag_scene::files::folder::open_scene;
use serde_json::json;

use super::{checked, existing, limits, open_run, print, stored_settings};
use crate::cli::PlanArgs;
use crate::config::{Config, size_text};
use crate::error::UserError;
use crate::run::artifact::Artifact as _;
use crate::run::execute::Limits;
use crate::run::plan::{Decision, StagePlan};
use crate::run::stage::Cost;
use crate::stages::forecast::Forecast;
use crate::stages::import::Imported;

/// Prints a line per job with its reason and estimate, then go or no-go.
pub(super) fn run(args: &PlanArgs, json: bool) -> Result<()> {
    let (folder, config) = what_and_how(args)?;
    let limits = limits(&config)?;
    let until = (!config.until.is_empty()).then(|| config.until.clone());
    let run = open_run(&folder, config.settings(), None)?;
    let scene = match Imported::read(&run.stage_folder("import")) {
        Ok(imported) => imported.scene,
        Err(_) => open_scene(config.scene.as_ref())?.scene,
    };
    let forecast = Forecast::new(&scene, &config);
    let mut total = Total { json, limits, sum: Cost::default(), refusal: None };
    for (stage, plan) in run.plan(until.as_deref())? {
        let orders = match plan {
            StagePlan::Jobs(orders) => orders,
            StagePlan::After(upstream) => {
                total.add(stage.name, "", &format!("after {upstream}"), forecast.cost(stage.name))?;
                continue;
            }
        };
        for order in &orders {
            let reason = match &order.decision {
                Decision::Done => "done".to_owned(),
                Decision::Adopt(_) => "complete, to be published".to_owned(),
                Decision::Run(reasons) => reasons.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "),
            };
            let cost = matches!(order.decision, Decision::Run(_)).then_some(order.plan.cost);
            total.add(stage.name, &order.plan.name, &reason, cost)?;
        }
    }
    total.verdict()
}

/// The run's folder (for a scene: one that holds nothing) and the configuration.
fn what_and_how(args: &PlanArgs) -> Result<(PathBuf, Config)> {
    let target = existing(&args.target, "the scene or run")?;
    let typed = args.settings.resolve()?;
    if !target.join(super::RUN_FILE).is_file() {
        let mut config = checked(typed.config)?;
        config.scene = target.to_string_lossy().into_owned();
        return Ok((target.join(".pgsag-plan-of-nothing"), config));
    }
    let mut settings = stored_settings(&target)?;
    let typed_settings = typed.config.settings();
    for key in typed.sources.keys() {
        if let Some(value) = typed_settings.get(key) {
            settings.set(key, value.clone());
        }
    }
    Ok((target, checked(Config::from_settings(&settings)?)?))
}

struct Total {
    json: bool,
    limits: Limits,
    sum: Cost,
    refusal: Option<UserError>,
}

impl Total {
    fn add(&mut self, stage: &str, job: &str, reason: &str, cost: Option<Cost>) -> Result<()> {
        if let Some(cost) = cost {
            self.sum.cpu_secs += cost.cpu_secs;
            self.sum.disk_bytes += cost.disk_bytes;
            self.sum.memory_bytes = self.sum.memory_bytes.max(cost.memory_bytes);
            if cost.memory_bytes > self.limits.memory_bytes {
                self.refusal = Some(crate::run::execute::refusal(stage, job, cost, self.limits));
            }
        }
        if self.json {
            let cost = cost.map(|cost| {
                json!({"memory_bytes": cost.memory_bytes, "disk_bytes": cost.disk_bytes, "cpu_secs": cost.cpu_secs})
            });
            return print(&json!({"stage": stage, "job": job, "reason": reason, "cost": cost}).to_string());
        }
        let cost = cost.map_or_else(String::new, |cost| {
            let (memory, disk) = (size_text(cost.memory_bytes), size_text(cost.disk_bytes));
            format!("  (memory {memory}, disk {disk}, {:.0} CPU-s)", cost.cpu_secs)
        });
        print(&format!("{stage:8} {job:8} {reason}{cost}"))
    }

    fn verdict(self) -> Result<()> {
        let Self { json, limits, sum, refusal } = self;
        if json {
            let go = refusal.is_none();
            print(
                &json!({"go": go, "memory_bytes": sum.memory_bytes, "disk_bytes": sum.disk_bytes,
                "cpu_secs": sum.cpu_secs, "memory_limit_bytes": limits.memory_bytes})
                .to_string(),
            )?;
        }
        if let Some(refusal) = refusal {
            return Err(refusal.into());
        }
        if json {
            return Ok(());
        }
        print(&format!(
            "go: at most {} of {} memory, {} of disk, about {:.0} CPU-s on {} threads",
            size_text(sum.memory_bytes),
            size_text(limits.memory_bytes),
            size_text(sum.disk_bytes),
            sum.cpu_secs,
            limits.threads
        ))
    }
}
