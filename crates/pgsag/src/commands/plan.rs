//! `pgsag plan`: what would run and why, and whether it fits.

use anyhow::Result;
use serde_json::json;

use super::{checked, existing, limits, open_run, print, stored_settings};
use crate::cli::PlanArgs;
use crate::config::{Config, size_text};
use crate::run::execute::Limits;
use crate::run::plan::{Decision, StagePlan};
use crate::run::stage::Cost;

/// Prints a line per job with its reason and estimate, then go or no-go.
pub(super) fn run(args: &PlanArgs, json: bool) -> Result<()> {
    let target = existing(&args.target, "the scene or run")?;
    let is_run = target.join(super::RUN_FILE).is_file();
    let scratch;
    let (folder, config) = if is_run {
        let mut settings = stored_settings(&target)?;
        let typed = args.settings.resolve()?;
        let typed_settings = typed.config.settings();
        for key in typed.sources.keys() {
            if let Some(value) = typed_settings.get(key) {
                settings.set(key, value.clone());
            }
        }
        (target, checked(Config::from_settings(&settings)?)?)
    } else {
        let mut config = checked(args.settings.resolve()?.config)?;
        config.scene = target.to_string_lossy().into_owned();
        // A folder that holds nothing: everything is to be done.
        scratch = target.join(".pgsag-plan-of-nothing");
        (scratch, config)
    };
    let limits = limits(&config)?;
    let until = (!config.until.is_empty()).then(|| config.until.clone());
    let run = open_run(&folder, config.settings())?;
    let mut total = Cost::default();
    let mut too_large = None;
    for (stage, plan) in run.plan(until.as_deref())? {
        let orders = match plan {
            StagePlan::After(upstream) => {
                show(json, stage.name, "", &format!("after {upstream}"), None)?;
                continue;
            }
            StagePlan::Jobs(orders) => orders,
        };
        for order in &orders {
            let reason = match &order.decision {
                Decision::Done => "done".to_owned(),
                Decision::Adopt(_) => "complete, to be published".to_owned(),
                Decision::Run(reasons) => reasons.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "),
            };
            let cost = matches!(order.decision, Decision::Run(_)).then_some(order.plan.cost);
            show(json, stage.name, &order.plan.name, &reason, cost)?;
            if let Some(cost) = cost {
                total.cpu_secs += cost.cpu_secs;
                total.disk_bytes += cost.disk_bytes;
                total.memory_bytes = total.memory_bytes.max(cost.memory_bytes);
                if cost.memory_bytes > limits.memory_bytes {
                    too_large = Some(run.refusal(stage, order, limits));
                }
            }
        }
    }
    if let Some(refusal) = too_large {
        return Err(refusal.into());
    }
    go(json, total, limits)
}

fn show(json: bool, stage: &str, job: &str, reason: &str, cost: Option<Cost>) -> Result<()> {
    if json {
        let cost = cost.map(
            |cost| json!({"memory_bytes": cost.memory_bytes, "disk_bytes": cost.disk_bytes, "cpu_secs": cost.cpu_secs}),
        );
        return print(&json!({"stage": stage, "job": job, "reason": reason, "cost": cost}).to_string());
    }
    let cost = cost.map_or_else(String::new, |cost| {
        format!(
            "  memory {}, disk {}, {:.0} CPU-s",
            size_text(cost.memory_bytes),
            size_text(cost.disk_bytes),
            cost.cpu_secs
        )
    });
    print(&format!("{stage:8} {job:8} {reason}{cost}"))
}

fn go(json: bool, total: Cost, limits: Limits) -> Result<()> {
    if json {
        return print(
            &json!({"go": true, "memory_bytes": total.memory_bytes, "disk_bytes": total.disk_bytes,
            "cpu_secs": total.cpu_secs, "memory_limit_bytes": limits.memory_bytes})
            .to_string(),
        );
    }
    print(&format!(
        "go: at most {} of {} memory, {} of disk, about {:.0} CPU-s on {} threads",
        size_text(total.memory_bytes),
        size_text(limits.memory_bytes),
        size_text(total.disk_bytes),
        total.cpu_secs,
        limits.threads
    ))
}
