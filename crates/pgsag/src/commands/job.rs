//! `pgsag job`: one job of a run, in this process.

use std::io::Read as _;
use std::sync::Arc;

use anyhow::{Context as _, Result};

use super::{cancel_on_signals, limits, open_run, progress, stored_settings};
use crate::cli::JobArgs;
use crate::config::Config;
use crate::error::UserError;
use crate::run::execute::refusal;
use crate::run::plan::Decision;

/// Runs the job, if it is not finished already.
pub(super) fn run(args: &JobArgs, json: bool) -> Result<()> {
    let folder = super::existing(&args.run, "the run")?;
    let settings = stored_settings(&folder)?;
    let mut config = Config::from_settings(&settings)?;
    config.threads = args.threads;
    if let Some(limit) = &args.memory_limit {
        config.memory_limit.clone_from(limit);
    }
    let mut limits = limits(&config)?;
    let mut run = open_run(&folder, settings, args.device.as_deref())?;
    run.devices = args.device.iter().cloned().collect();
    limits.device = args.device.as_ref().map(|_| 0);
    let Some(stage) = run.stage(&args.stage) else {
        let names: Vec<&str> = run.table.iter().map(|stage| stage.name).collect();
        return Err(
            UserError::new(&args.stage, "there is no such stage", format!("use one of {}", names.join(" "))).into()
        );
    };
    for upstream in stage.reads {
        if run.fingerprint(upstream, None).is_err() {
            return Err(UserError::new(
                &args.stage,
                format!("{upstream} is not finished"),
                format!("run {upstream} first"),
            )
            .into());
        }
    }
    let orders = run.orders(stage)?;
    let order = orders.iter().find(|order| order.plan.name == args.job);
    let order = order.with_context(|| {
        let names: Vec<&str> = orders.iter().map(|order| order.plan.name.as_str()).collect();
        UserError::new(
            format!("{} {}", args.stage, args.job),
            "there is no such job",
            format!("use one of {}", names.join(" ")),
        )
    })?;
    if order.decision == Decision::Done {
        return Ok(());
    }
    if order.plan.cost.memory_bytes > limits.memory_bytes {
        return Err(refusal(stage.name, &args.job, order.plan.cost, limits).into());
    }
    let cancel = cancel_on_signals()?;
    if args.supervised {
        let asked = cancel.clone();
        std::thread::spawn(move || {
            // Nothing is ever written to it; it ends when the parent closes it or dies.
            let _ = std::io::stdin().read_to_end(&mut Vec::new());
            asked.request(75);
        });
    }
    let progress = progress(json);
    run.run_job(stage, order, limits, &cancel, &Arc::clone(&progress))
}
