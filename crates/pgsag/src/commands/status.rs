//! `pgsag status`.

use anyhow::Result;
use serde_json::Value;

use super::{open_run, print, stored_settings};
use crate::cli::StatusArgs;
use crate::config::size_text;
use crate::run::status::State;

/// Prints a line per job and what is left.
pub(super) fn run(args: &StatusArgs, json: bool) -> Result<()> {
    let folder = super::existing(&args.run, "the run")?;
    let settings = stored_settings(&folder)?;
    let run = open_run(&folder, settings, None)?;
    let lines = run.status()?;
    let mut counts = [0_usize; 4];
    for line in &lines {
        if json {
            print(&serde_json::to_string(line)?)?;
        }
        let (place, text) = match &line.state {
            State::Done { wall_secs, peak_memory_bytes } => {
                (0, format!("done in {wall_secs:.1} s, peak {}", size_text(*peak_memory_bytes)))
            }
            State::Running { iteration, iterations, seconds, loss } => {
                (1, running(iteration.zip(*iterations), *seconds, *loss))
            }
            State::Waiting { reason } => (2, format!("waiting: {reason}")),
            State::Failed { error } => (3, format!("failed: {error}")),
        };
        counts[place] += 1;
        if !json {
            print(&format!("{:8} {:8} {text}", line.stage, line.job))?;
        }
    }
    let [done, running, waiting, failed] = counts;
    let summary = format!("{done} done, {running} running, {waiting} waiting, {failed} failed");
    if json {
        let counts = serde_json::json!({"done": done, "running": running, "waiting": waiting, "failed": failed});
        return print(&Value::to_string(&counts));
    }
    print(&summary)
}

fn running(steps: Option<(u64, u64)>, seconds: Option<f64>, loss: Option<f64>) -> String {
    let (Some((iteration, iterations)), Some(seconds)) = (steps, seconds) else { return "running".into() };
    let left = seconds * iterations.saturating_sub(iteration) as f64 / iteration.max(1) as f64;
    let loss = loss.map_or_else(String::new, |loss| format!(", loss {loss:.4}"));
    format!("running: step {iteration} of {iterations}{loss}, about {left:.0} s left")
}
