//! Runs what has to run: stage by stage, the jobs of a stage in slots inside the memory limit, heaviest first.

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail};

use super::artifact::{self, Checkpoint};
use super::manifest::{Identity, MANIFEST, Manifest, StageManifest};
use super::plan::{Decision, Order};
use super::progress::{Progress, relay};
use super::slots::Slots;
use super::stage::{Cancel, Cost, Job, Per, Stage, WHOLE};
use super::{Run, machine};
use crate::error::{Interrupted, UserError, exit_code};

/// What the machine may be asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Jobs of a stage at once.
    pub jobs: usize,
    /// Memory of all of them, bytes.
    pub memory_bytes: u64,
    /// Threads of all of them.
    pub threads: usize,
    /// Jobs at once of a stage whose jobs are handed devices; 0: one per device.
    pub device_jobs: usize,
    /// Of one job: which of the run's devices it was handed.
    pub device: Option<usize>,
}

/// How one job is run to its end.
pub trait Launcher: Sync {
    /// Runs it and publishes its artifact.
    ///
    /// # Errors
    /// What the job failed with.
    fn launch(&self, run: &Run, stage: &'static Stage, order: &Order, share: Limits) -> Result<()>;
}

/// Runs jobs on threads of this process.
pub struct InProcess {
    /// Stops them.
    pub cancel: Cancel,
    /// Whom they tell.
    pub progress: Arc<dyn Progress>,
}

impl Launcher for InProcess {
    fn launch(&self, run: &Run, stage: &'static Stage, order: &Order, share: Limits) -> Result<()> {
        run.run_job(stage, order, share, &self.cancel, &self.progress)
    }
}

/// Runs divided stages as child processes `pgsag job STAGE JOB --run RUN`, whole ones here.
pub struct Children {
    /// The program, usually this one.
    pub program: PathBuf,
    /// For whole stages.
    pub here: InProcess,
}

impl Launcher for Children {
    fn launch(&self, run: &Run, stage: &'static Stage, order: &Order, share: Limits) -> Result<()> {
        if stage.per == Per::Whole {
            return self.here.launch(run, stage, order, share);
        }
        let job = &order.plan.name;
        let mut child = Command::new(&self.program)
            .args(["job", stage.name, job, "--supervised", "--json", "--run"])
            .arg(&run.folder)
            .args(["--threads", &share.threads.to_string(), "--memory-limit", &share.memory_bytes.to_string()])
            .args(share.device.iter().flat_map(|&device| ["--device", &run.devices[device]]))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .with_context(|| format!("{}: cannot be started", self.program.display()))?;
        let mut leash = child.stdin.take();
        let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
        let words = Mutex::new(String::new());
        let status = std::thread::scope(|scope| {
            scope.spawn(|| {
                for line in stdout.into_iter().flat_map(|pipe| BufReader::new(pipe).lines()).map_while(Result::ok) {
                    relay(&line, self.here.progress.as_ref());
                }
            });
            scope.spawn(|| {
                let mut text = Vec::new();
                if stderr.is_some_and(|mut pipe| pipe.read_to_end(&mut text).is_ok()) {
                    *words.lock().unwrap_or_else(PoisonError::into_inner) = String::from_utf8_lossy(&text).into_owned();
                }
            });
            loop {
                if self.here.cancel.is_requested() {
                    // A closed standard input tells the child to save and stop.
                    leash = None;
                }
                match child.try_wait() {
                    Ok(Some(status)) => break Ok(status),
                    Ok(None) => std::thread::sleep(Duration::from_millis(if leash.is_some() { 20 } else { 50 })),
                    Err(error) => break Err(error),
                }
            }
        })?;
        let words = words.into_inner().unwrap_or_else(PoisonError::into_inner);
        if matches!(status.code(), Some(75 | 130)) {
            // Who was asked to stop says with which code; the child only saved.
            self.here.cancel.check()?;
        }
        end_of_child(status.code(), &words, stage.name, job)
    }
}

fn end_of_child(code: Option<i32>, words: &str, stage: &str, job: &str) -> Result<()> {
    let last = words.lines().last().unwrap_or("it said nothing").trim();
    match code {
        Some(0) => Ok(()),
        Some(75) => Err(Interrupted { exit_code: 75 }.into()),
        Some(130) => Err(Interrupted { exit_code: 130 }.into()),
        Some(2) => {
            let line = last.strip_prefix("error: ").unwrap_or(last);
            let mut parts = line.rsplitn(2, "; ");
            let cure = parts.next().unwrap_or_default();
            let (place, cause) = parts.next().unwrap_or(line).split_once(": ").unwrap_or((stage, line));
            Err(UserError::new(place, cause, cure).into())
        }
        Some(_) => bail!("{stage} {job}: {}", last.strip_prefix("error: ").unwrap_or(last)),
        None => bail!(
            "{stage} {job}: was killed by the system; run the same command to go on, with a lower --jobs if memory ran out"
        ),
    }
}

/// What a run did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Jobs that ran.
    pub ran: usize,
    /// Jobs that were finished already.
    pub kept: usize,
    /// Groups that failed twice and are missing from the result: stage, job and why.
    pub lost: Vec<String>,
}

impl Run {
    /// Finishes the run up to a stage.
    ///
    /// # Errors
    /// The first failure, after the other jobs of that stage have ended.
    pub fn execute(
        &self,
        until: Option<&str>,
        limits: Limits,
        launcher: &dyn Launcher,
        cancel: &Cancel,
        progress: &Arc<dyn Progress>,
    ) -> Result<Summary> {
        self.sweep()?;
        let mut summary = Summary::default();
        for stage in self.table {
            cancel.check()?;
            let orders = self.orders(stage)?;
            for order in &orders {
                if let Decision::Adopt(attempt) = &order.decision {
                    self.publish(stage, order, attempt)?;
                }
            }
            let pending: Vec<&Order> =
                orders.iter().filter(|order| matches!(order.decision, Decision::Run(_))).collect();
            summary.kept += orders.len() - pending.len();
            summary.ran += pending.len();
            let lost = self.run_jobs(stage, pending, limits, launcher, cancel, progress)?;
            let is_lost = |order: &Order| lost.iter().any(|(name, _)| *name == order.plan.name);
            let left: Vec<Order> = orders.into_iter().filter(|order| !is_lost(order)).collect();
            for (job, error) in lost {
                if left.is_empty() {
                    return Err(error);
                }
                progress.warning(stage.name, &job, "failed twice and is missing from the result");
                summary.lost.push(format!("{} {job}: {error:#}", stage.name));
            }
            self.record(stage, &left)?;
            if let Some(mirror) = stage.publishes {
                self.mirror(stage, mirror)?;
            }
            if until == Some(stage.name) {
                break;
            }
        }
        Ok(summary)
    }

    /// Runs jobs in slots. Of a stage of groups one that fails is tried once more; if it fails again, it is handed back
    /// with the reason and the rest goes on. Bad input fails the whole.
    fn run_jobs(
        &self,
        stage: &'static Stage,
        mut pending: Vec<&Order>,
        limits: Limits,
        launcher: &dyn Launcher,
        cancel: &Cancel,
        progress: &Arc<dyn Progress>,
    ) -> Result<Vec<(String, anyhow::Error)>> {
        pending.sort_by(|a, b| {
            b.plan.cost.cpu_secs.total_cmp(&a.plan.cost.cpu_secs).then_with(|| a.plan.name.cmp(&b.plan.name))
        });
        if let Some(order) = pending.iter().find(|order| order.plan.cost.memory_bytes > limits.memory_bytes) {
            return Err(refusal(stage.name, &order.plan.name, order.plan.cost, limits).into());
        }
        let mut slots = Slots::new(limits, if stage.on_backend { self.devices.len() } else { 0 }, pending.len());
        let (sender, receiver) = mpsc::channel::<(&Order, Limits, Result<()>)>();
        let mut failure: Option<anyhow::Error> = None;
        let mut lost: Vec<(String, anyhow::Error)> = Vec::new();
        std::thread::scope(|scope| {
            loop {
                while !cancel.is_requested()
                    && let Some((order, share)) = slots.start(&mut pending)
                {
                    let sender = sender.clone();
                    scope.spawn(move || {
                        let outcome = self.watched(stage, order, share, launcher, progress);
                        // The receiver lives as long as this scope.
                        let _ = sender.send((order, share, outcome));
                    });
                }
                if slots.is_idle() {
                    break;
                }
                let Ok((order, share, outcome)) = receiver.recv() else { break };
                slots.end(order, share);
                let Err(error) = outcome else { continue };
                let may_go_on = stage.per == Per::Group && exit_code(&error) == 1;
                if may_go_on && slots.is_first_failure(order, share) {
                    progress.note(stage.name, &order.plan.name, &format!("is tried once more: {error:#}"));
                    pending.push(order);
                } else if may_go_on {
                    lost.push((order.plan.name.clone(), error));
                } else {
                    failure.get_or_insert(error);
                }
            }
        });
        if let Some(error) = failure {
            return Err(error);
        }
        cancel.check()?;
        Ok(lost)
    }

    fn watched(
        &self,
        stage: &'static Stage,
        order: &Order,
        share: Limits,
        launcher: &dyn Launcher,
        progress: &Arc<dyn Progress>,
    ) -> Result<()> {
        let job = &order.plan.name;
        let started = Instant::now();
        progress.started(stage.name, job, &reasons(order));
        let outcome = launcher.launch(self, stage, order, share);
        let words = match &outcome {
            Ok(()) => "done",
            Err(error) if error.is::<Interrupted>() => "stopped, state saved",
            Err(_) => "failed",
        };
        progress.finished(stage.name, job, words, started.elapsed().as_secs_f64());
        outcome
    }

    /// Runs one job here and publishes its artifact.
    ///
    /// # Errors
    /// What the stage failed with.
    pub fn run_job(
        &self,
        stage: &'static Stage,
        order: &Order,
        share: Limits,
        cancel: &Cancel,
        progress: &Arc<dyn Progress>,
    ) -> Result<()> {
        let name = order.plan.name.clone();
        fs::create_dir_all(self.folder.join("log"))?;
        let failure = self.failure_path(stage.name, &name);
        // Usually there is none.
        let _ = fs::remove_file(&failure);
        self.drop_useless_attempts(stage, &name);
        let attempts = self.attempts(stage.name, &name);
        let attempt = self.new_attempt(stage.name, &name)?;
        machine::reset_peak();
        let (started, cpu_before) = (Instant::now(), machine::cpu_secs());
        let job = Job {
            run: self,
            stage,
            name,
            memory_bytes: share.memory_bytes,
            device: share.device.map(|device| self.devices[device].clone()).unwrap_or_default(),
            key: order.identity.key(),
            kindred: self.kindred_keys(stage, order),
            attempt: attempt.clone(),
            attempts,
            cancel: cancel.clone(),
            progress: Arc::clone(progress),
            warnings: Mutex::default(),
            measured: Mutex::default(),
        };
        let outcome = (stage.run)(&job).and_then(|()| {
            Checkpoint::remove_all(&attempt)?;
            let mut measured = job.measured.into_inner().unwrap_or_else(PoisonError::into_inner);
            measured.host = machine::host();
            measured.wall_secs = started.elapsed().as_secs_f64();
            measured.cpu_secs = machine::cpu_secs() - cpu_before;
            measured.peak_memory_bytes = machine::peak_memory_bytes();
            let warnings = job.warnings.into_inner().unwrap_or_else(PoisonError::into_inner);
            Manifest::of(order.identity.clone(), &attempt, warnings, measured)?.write(&attempt)?;
            self.publish(stage, order, &attempt)
        });
        if let Err(error) = &outcome {
            if exit_code(error) < 75 {
                // Only for `status`; the error itself is returned.
                let _ = fs::write(&failure, crate::error::one_line(error));
            }
            self.drop_useless_attempts(stage, &order.plan.name);
            if Checkpoint::newest(std::slice::from_ref(&attempt), &order.identity.key()).is_none() {
                let _ = fs::remove_dir_all(&attempt);
            }
        }
        outcome
    }

    /// Keys of the same work on kindred backends.
    pub(super) fn kindred_keys(&self, stage: &Stage, order: &Order) -> Vec<String> {
        let backends = self.kindred.iter().filter(|_| stage.on_backend);
        backends.map(|backend| Identity { backend: backend.clone(), ..order.identity.clone() }.key()).collect()
    }

    /// Renames a complete attempt to its place and removes what is left of other attempts.
    fn publish(&self, stage: &Stage, order: &Order, attempt: &Path) -> Result<()> {
        let job = &order.plan.name;
        let target = self.job_folder(stage, job);
        if let Some(parent) = target.parent() {
            fs::create_dir_all(parent).with_context(|| format!("{}", parent.display()))?;
        }
        let theirs = Manifest::read(&target)
            .ok()
            .filter(|found| found.identity == order.identity && found.first_damage(&target).is_none());
        if let Some(theirs) = theirs {
            let ours = Manifest::read(attempt)?;
            if ours.output != theirs.output {
                bail!("{} {job}: two attempts at the same work differ; please report this", stage.name);
            }
        } else {
            self.swap(attempt, &target)?;
        }
        for leftover in self.attempts(stage.name, job) {
            if !is_foreign_and_alive(&leftover) {
                // It is only space; the next start sweeps again.
                let _ = fs::remove_dir_all(leftover);
            }
        }
        Ok(())
    }

    /// Puts `fresh` at `target`; what was there goes.
    fn swap(&self, fresh: &Path, target: &Path) -> Result<()> {
        let old = fresh.with_file_name(format!(
            "{}.old",
            fresh.file_name().unwrap_or_default().to_string_lossy().replace(".partial.", ".gone.")
        ));
        if target.exists() {
            fs::rename(target, &old).with_context(|| format!("{}: cannot be moved away", target.display()))?;
        }
        fs::rename(fresh, target).with_context(|| format!("{}: cannot be published", target.display()))?;
        if let Ok(folder) = fs::File::open(target.parent().unwrap_or(&self.folder)) {
            // Not every file system can flush a folder.
            let _ = folder.sync_all();
        }
        if old.exists() {
            fs::remove_dir_all(&old).with_context(|| format!("{}", old.display()))?;
        }
        Ok(())
    }

    /// Attempts of dead processes without a checkpoint hold nothing that could be used.
    fn drop_useless_attempts(&self, stage: &Stage, job: &str) {
        for attempt in self.attempts(stage.name, job) {
            let Ok(mut entries) = fs::read_dir(&attempt) else { continue };
            let is_useful = entries.any(|entry| {
                entry.is_ok_and(|entry| {
                    let name = entry.file_name().to_string_lossy().into_owned();
                    name.starts_with("checkpoint.") || name == MANIFEST
                })
            });
            if !is_useful
                && owner(&attempt).is_some_and(|(host, pid)| host == machine::host() && !machine::is_alive(pid))
            {
                let _ = fs::remove_dir_all(attempt);
            }
        }
    }

    /// Removes what killed processes left half moved.
    fn sweep(&self) -> Result<()> {
        for path in self.folders_beginning(".") {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if name.ends_with(".old") || name.starts_with(".mirror.") {
                fs::remove_dir_all(&path).with_context(|| format!("{}", path.display()))?;
            }
        }
        Ok(())
    }

    /// Writes the record of a divided stage and removes folders of jobs that no longer exist.
    fn record(&self, stage: &Stage, orders: &[Order]) -> Result<()> {
        if stage.per == Per::Whole || self.is_recorded(stage, orders) {
            return Ok(());
        }
        let folder = self.stage_folder(stage.name);
        fs::create_dir_all(&folder)?;
        let mut jobs = std::collections::BTreeMap::new();
        for order in orders {
            let manifest = Manifest::read(&self.job_folder(stage, &order.plan.name))?;
            jobs.insert(order.plan.name.clone(), manifest.output);
        }
        for entry in fs::read_dir(&folder)? {
            let path = entry?.path();
            let is_known = path.file_name().is_some_and(|name| jobs.contains_key(name.to_string_lossy().as_ref()));
            if path.is_dir() && !is_known {
                fs::remove_dir_all(&path).with_context(|| format!("{}", path.display()))?;
            }
        }
        StageManifest { stage: stage.name.into(), jobs }.write(&folder)
    }

    /// Makes `RUN/<name>` hold exactly the files of a finished stage, as hard links where the disk has them.
    fn mirror(&self, stage: &Stage, name: &str) -> Result<()> {
        let (source, target) = (self.stage_folder(stage.name), self.folder.join(name));
        let wanted: Vec<String> = artifact::files_below(&source)?.into_iter().filter(|file| file != MANIFEST).collect();
        let there = if target.is_dir() { artifact::files_below(&target)? } else { Vec::new() };
        let same = |file: &String| {
            let (a, b) = (source.join(file), target.join(file));
            fs::metadata(&a).ok().map(|found| found.len()) == fs::metadata(&b).ok().map(|found| found.len())
                && artifact::fingerprint_file(&a).ok() == artifact::fingerprint_file(&b).ok()
        };
        if wanted == there && wanted.iter().all(same) {
            return Ok(());
        }
        let fresh = self.folder.join(format!(".mirror.{name}.{}-{}", machine::host(), std::process::id()));
        for file in &wanted {
            let to = fresh.join(file);
            fs::create_dir_all(to.parent().unwrap_or(&fresh))?;
            if fs::hard_link(source.join(file), &to).is_err() {
                fs::copy(source.join(file), &to).with_context(|| format!("{}", to.display()))?;
            }
        }
        self.swap(&fresh, &target)
    }
}

fn reasons(order: &Order) -> String {
    let Decision::Run(reasons) = &order.decision else { return String::new() };
    let words: Vec<String> = reasons.iter().take(3).map(ToString::to_string).collect();
    let more = reasons.len().saturating_sub(words.len());
    if more == 0 { words.join(", ") } else { format!("{} and {more} more", words.join(", ")) }
}

/// Why a job that does not fit is not started, with the number that it needs.
#[must_use]
pub fn refusal(stage: &str, job: &str, cost: Cost, limits: Limits) -> UserError {
    let job = if job == WHOLE || job.is_empty() { String::new() } else { format!(" {job}") };
    UserError::new(
        format!("{stage}{job}"),
        format!(
            "needs about {} of memory, more than the limit of {}",
            crate::config::size_text(cost.memory_bytes),
            crate::config::size_text(limits.memory_bytes)
        ),
        "raise --memory-limit or lower --image-width",
    )
}

/// Host and process of an attempt's folder.
pub(super) fn owner(attempt: &Path) -> Option<(String, u32)> {
    let name = attempt.file_name()?.to_string_lossy().into_owned();
    let (_, owner) = name.rsplit_once(".partial.")?;
    let mut parts = owner.rsplitn(3, '-');
    let (_number, pid, host) = (parts.next()?, parts.next()?, parts.next()?);
    Some((host.to_owned(), pid.parse().ok()?))
}

/// An attempt of another live process of this machine: it will see for itself that it came second.
fn is_foreign_and_alive(attempt: &Path) -> bool {
    owner(attempt)
        .is_some_and(|(host, pid)| host == machine::host() && pid != std::process::id() && machine::is_alive(pid))
}
