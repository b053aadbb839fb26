//! Which jobs would run, and why.

use std::fmt;
use std::path::PathBuf;

use anyhow::{Context as _, Result};

use super::Run;
use super::manifest::{Identity, Manifest, StageManifest};
use super::stage::{JobPlan, Per, Stage};

/// Why a job runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reason {
    /// Nothing is published.
    New,
    /// A setting is another than before (`None`: absent).
    Setting {
        /// Dotted key.
        key: String,
        /// As published.
        old: String,
        /// As asked now.
        new: String,
    },
    /// An upstream artifact is another than before.
    Input(String),
    /// A file outside the run is another than before.
    Source(String),
    /// The code or the format is another than before.
    Code,
    /// Device or SIMD level is another than before.
    Backend,
    /// The published folder is not whole.
    Damaged(String),
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::New => write!(f, "not done yet"),
            Self::Setting { key, old, new } => write!(f, "{key}: {old} -> {new}"),
            Self::Input(name) => write!(f, "{name} changed"),
            Self::Source(name) => write!(f, "{name} changed"),
            Self::Code => write!(f, "made by another version of this stage"),
            Self::Backend => write!(f, "made on another device or SIMD level"),
            Self::Damaged(what) => write!(f, "damaged: {what}"),
        }
    }
}

/// What is to be done about a job.
#[derive(Clone, Debug, PartialEq)]
pub enum Decision {
    /// Nothing.
    Done,
    /// An attempt is complete and only has to be published.
    Adopt(PathBuf),
    /// It runs; never without a reason.
    Run(Vec<Reason>),
}

/// A job with everything that is known before it runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Order {
    /// Name, inputs, estimate.
    pub plan: JobPlan,
    /// What decides its answer.
    pub identity: Identity,
    /// What is to be done.
    pub decision: Decision,
}

/// What is known of a stage before it runs.
#[derive(Clone, Debug, PartialEq)]
pub enum StagePlan {
    /// Its jobs.
    Jobs(Vec<Order>),
    /// It cannot be said before this stage is finished.
    After(&'static str),
}

impl Run {
    /// The orders of one stage; everything that it reads must be finished.
    ///
    /// # Errors
    /// Where an upstream artifact or a source cannot be read.
    pub fn orders(&self, stage: &'static Stage) -> Result<Vec<Order>> {
        let sources = (stage.sources)(self)?;
        let plans = (stage.jobs)(self).with_context(|| format!("jobs of {}", stage.name))?;
        plans.into_iter().map(|plan| self.order(stage, plan, &sources)).collect()
    }

    fn order(&self, stage: &'static Stage, plan: JobPlan, sources: &[(String, String)]) -> Result<Order> {
        let mut identity = Identity {
            stage: stage.name.into(),
            job: plan.name.clone(),
            format: stage.format.0.into(),
            version: stage.format.1,
            code: format!("{}+{}", env!("CARGO_PKG_VERSION"), stage.code),
            settings: self.settings.slice(stage.slice),
            sources: sources.iter().cloned().collect(),
            seed: if stage.slice.contains(&"seed") { self.seed } else { 0 },
            backend: if stage.on_backend { self.backend.clone() } else { "none".into() },
            ..Default::default()
        };
        for (upstream, part) in &plan.inputs {
            let name = part.as_ref().map_or_else(|| (*upstream).to_owned(), |part| format!("{upstream}/{part}"));
            identity.inputs.insert(name, self.fingerprint(upstream, part.as_deref())?);
        }
        let decision = self.decide(stage, &plan.name, &identity);
        Ok(Order { plan, identity, decision })
    }

    fn decide(&self, stage: &Stage, job: &str, identity: &Identity) -> Decision {
        let folder = self.job_folder(stage, job);
        let reasons = match Manifest::read(&folder) {
            Err(_) => vec![Reason::New],
            Ok(manifest) => {
                let mut reasons = changes(&manifest.identity, identity);
                reasons.extend(manifest.first_damage(&folder).map(Reason::Damaged));
                reasons
            }
        };
        if reasons.is_empty() {
            return Decision::Done;
        }
        let complete = self.attempts(stage.name, job).into_iter().find(|attempt| {
            Manifest::read(attempt)
                .is_ok_and(|manifest| manifest.identity == *identity && manifest.first_damage(attempt).is_none())
        });
        complete.map_or(Decision::Run(reasons), Decision::Adopt)
    }

    /// What would run, stage by stage, as far as it can be said without running anything.
    ///
    /// # Errors
    /// Where a finished artifact or a source cannot be read.
    pub fn plan(&self, until: Option<&str>) -> Result<Vec<(&'static Stage, StagePlan)>> {
        let mut open: Vec<&'static str> = Vec::new();
        let mut plans = Vec::new();
        for stage in self.table {
            let waits_for = stage.reads.iter().copied().find(|upstream| open.contains(upstream));
            let plan = match waits_for {
                Some(upstream) => StagePlan::After(upstream),
                None => StagePlan::Jobs(self.orders(stage)?),
            };
            let is_done = matches!(&plan, StagePlan::Jobs(orders)
                if orders.iter().all(|order| order.decision == Decision::Done) && self.is_recorded(stage, orders));
            if !is_done {
                open.push(stage.name);
            }
            plans.push((stage, plan));
            if until == Some(stage.name) {
                break;
            }
        }
        Ok(plans)
    }

    /// Whether the stage's own record names exactly these jobs and their outputs.
    #[must_use]
    pub fn is_recorded(&self, stage: &Stage, orders: &[Order]) -> bool {
        stage.per == Per::Whole
            || StageManifest::read(&self.stage_folder(stage.name)).is_ok_and(|record| {
                record.jobs.len() == orders.len()
                    && orders.iter().all(|order| {
                        let folder = self.job_folder(stage, &order.plan.name);
                        Manifest::read(&folder)
                            .is_ok_and(|manifest| record.jobs.get(&order.plan.name) == Some(&manifest.output))
                    })
            })
    }
}

/// What differs, in the order in which a person would ask.
fn changes(old: &Identity, new: &Identity) -> Vec<Reason> {
    let mut reasons = Vec::new();
    if (&old.format, old.version, &old.code) != (&new.format, new.version, &new.code) {
        reasons.push(Reason::Code);
    }
    let shown = |value: Option<&serde_json::Value>| value.map_or_else(|| "unset".into(), ToString::to_string);
    let mut keys: Vec<&str> = old.settings.iter().chain(new.settings.iter()).map(|(key, _)| key).collect();
    keys.sort_unstable();
    keys.dedup();
    for key in keys {
        let (before, now) = (old.settings.get(key), new.settings.get(key));
        if before != now {
            reasons.push(Reason::Setting { key: key.into(), old: shown(before), new: shown(now) });
        }
    }
    if old.seed != new.seed {
        reasons.push(Reason::Setting { key: "seed".into(), old: old.seed.to_string(), new: new.seed.to_string() });
    }
    if old.backend != new.backend {
        reasons.push(Reason::Backend);
    }
    reasons.extend(differing(&old.sources, &new.sources).map(Reason::Source));
    reasons.extend(differing(&old.inputs, &new.inputs).map(Reason::Input));
    reasons
}

type Prints = std::collections::BTreeMap<String, String>;

fn differing<'a>(old: &'a Prints, new: &'a Prints) -> impl Iterator<Item = String> + 'a {
    let changed = new.iter().filter(|(name, print)| old.get(*name) != Some(*print)).map(|(name, _)| name.clone());
    let gone = old.keys().filter(|name| !new.contains_key(*name)).cloned();
    changed.chain(gone)
}
