//! What is done, running, waiting and failed, read from the folder alone.

use std::fs;

use anyhow::Result;
use serde::Serialize;
use serde_json::Value;

use super::manifest::Manifest;
use super::plan::{Decision, StagePlan};
use super::{Run, execute, machine};

/// How a job stands.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase", tag = "state")]
pub enum State {
    /// Published and up to date.
    Done {
        /// Of the attempt that finished.
        wall_secs: f64,
        /// Of the same.
        peak_memory_bytes: u64,
    },
    /// A live process of this machine works on it.
    Running {
        /// From the live log; `None` before the first line.
        iteration: Option<u64>,
        /// Steps in all.
        iterations: Option<u64>,
        /// Seconds since it began, from the live log.
        seconds: Option<f64>,
        /// Most recent weighted loss.
        loss: Option<f64>,
    },
    /// It could run.
    Waiting {
        /// Why it is not done.
        reason: String,
    },
    /// Its last attempt ended with this.
    Failed {
        /// One line.
        error: String,
    },
}

/// One line of `status`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// Which row.
    pub stage: String,
    /// Which job; empty where the jobs are not known yet.
    pub job: String,
    /// How it stands.
    #[serde(flatten)]
    pub state: State,
}

impl Run {
    /// Every job that is known, in order.
    ///
    /// # Errors
    /// Where a finished artifact cannot be read.
    pub fn status(&self) -> Result<Vec<Line>> {
        let mut lines = Vec::new();
        for (stage, plan) in self.plan(None)? {
            let orders = match plan {
                StagePlan::Jobs(orders) => orders,
                StagePlan::After(upstream) => {
                    let state = State::Waiting { reason: format!("for {upstream}") };
                    lines.push(Line { stage: stage.name.into(), job: String::new(), state });
                    continue;
                }
            };
            for order in orders {
                let job = order.plan.name.clone();
                let state = match &order.decision {
                    Decision::Done => self.done(stage, &job),
                    Decision::Adopt(_) => State::Waiting { reason: "complete, to be published".into() },
                    Decision::Run(reasons) => self.unfinished(stage.name, &job, reasons),
                };
                lines.push(Line { stage: stage.name.into(), job, state });
            }
        }
        Ok(lines)
    }

    fn done(&self, stage: &super::stage::Stage, job: &str) -> State {
        let measured = Manifest::read(&self.job_folder(stage, job)).map(|found| found.measured).unwrap_or_default();
        State::Done { wall_secs: measured.wall_secs, peak_memory_bytes: measured.peak_memory_bytes }
    }

    fn unfinished(&self, stage: &str, job: &str, reasons: &[super::plan::Reason]) -> State {
        let alive = self.attempts(stage, job).iter().any(|attempt| {
            execute::owner(attempt).is_some_and(|(host, pid)| host == machine::host() && machine::is_alive(pid))
        });
        if alive {
            let last = self.last_log_line(stage, job).unwrap_or_default();
            return State::Running {
                iteration: last.get("iteration").and_then(Value::as_u64),
                iterations: last.get("iterations").and_then(Value::as_u64),
                seconds: last.get("seconds").and_then(Value::as_f64),
                loss: last.get("loss").and_then(Value::as_f64),
            };
        }
        if let Ok(error) = fs::read_to_string(self.failure_path(stage, job)) {
            return State::Failed { error };
        }
        State::Waiting { reason: reasons.first().map(ToString::to_string).unwrap_or_default() }
    }

    /// The newest whole line of a job's live log.
    #[must_use]
    pub fn last_log_line(&self, stage: &str, job: &str) -> Option<Value> {
        let text = fs::read_to_string(self.log_path(stage, job)).ok()?;
        text.lines().rev().find_map(|line| serde_json::from_str(line).ok())
    }
}
