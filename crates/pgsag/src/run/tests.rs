//! The runner with three toy stages: numbers -> their squares, one job each -> the sum, which is published.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use serde_json::json;

use super::execute::{InProcess, Launcher, Limits, Summary};
use super::plan::{Decision, Order, Reason, StagePlan};
use super::progress::{Progress, Silent};
use super::stage::{Cancel, Cost, Job, JobPlan};
use super::*;
use crate::error::exit_code;

const fn toy(
    name: &'static str,
    reads: &'static [&'static str],
    per: Per,
    jobs: fn(&Run) -> Result<Vec<JobPlan>>,
    run: fn(&Job<'_>) -> Result<()>,
) -> Stage {
    let sources = no_sources;
    Stage {
        name,
        reads,
        per,
        slice: &[],
        on_backend: false,
        format: ("toy", 1),
        code: 1,
        publishes: None,
        sources,
        jobs,
        run,
    }
}

fn no_sources(_: &Run) -> Result<Vec<(String, String)>> {
    Ok(Vec::new())
}

static TABLE: &[Stage] = &[
    Stage { slice: &["numbers"], ..toy("list", &[], Per::Whole, |_| Ok(JobPlan::whole(&[], Cost::default())), list) },
    Stage { slice: &["power", "fail"], ..toy("power", &["list"], Per::Group, power_jobs, power) },
    Stage {
        publishes: Some("out"),
        ..toy("sum", &["power"], Per::Whole, |_| Ok(JobPlan::whole(&["power"], Cost::default())), sum)
    },
];

fn numbers(run: &Run) -> Vec<u64> {
    let text = fs::read_to_string(run.stage_folder("list").join("all.txt")).expect("finished");
    text.split_whitespace().map(|word| word.parse().expect("number")).collect()
}

fn list(job: &Job<'_>) -> Result<()> {
    let list = job.run.settings.get("numbers").expect("set").as_str().expect("text").to_owned();
    fs::write(job.output().join("all.txt"), &list)?;
    for number in list.split_whitespace() {
        fs::create_dir(job.output().join(number))?;
        fs::write(job.output().join(number).join("n.txt"), number)?;
    }
    Ok(())
}

fn power_jobs(run: &Run) -> Result<Vec<JobPlan>> {
    Ok(numbers(run)
        .into_iter()
        .map(|number| JobPlan {
            name: number.to_string(),
            inputs: vec![("list", Some(number.to_string()))],
            cost: Cost { cpu_secs: number as f64, memory_bytes: number, disk_bytes: 0 },
        })
        .collect())
}

/// Counts up to 50 with a checkpoint at every step, so that it can be stopped anywhere.
fn power(job: &Job<'_>) -> Result<()> {
    let number: u32 = job.name.parse()?;
    if job.run.settings.get("fail").and_then(|fail| fail.as_u64()) == Some(u64::from(number)) {
        return Err(UserError::new("toy", "cannot be done", "take another number").into());
    }
    let from = job.checkpoint();
    let mut state = from.as_ref().map_or(0_u64, |found| u64::from_le_bytes(found.state[..].try_into().expect("8")));
    for step in from.map_or(0, |found| found.step)..50 {
        if job.is_cancelled() {
            job.save(step, &state.to_le_bytes())?;
            job.check()?;
        }
        state += u64::from(number).pow(job.run.settings.get("power").expect("set").as_u64().expect("u64") as u32);
        job.advance(step + 1, 50, "steps");
        if job.run.settings.get("stop").and_then(|stop| stop.as_u64()) == Some(step) {
            job.cancel.request(130);
        }
    }
    job.measure("steps", 50);
    fs::write(job.output().join("power.txt"), state.to_string())?;
    Ok(())
}

fn sum(job: &Job<'_>) -> Result<()> {
    let mut sum = 0;
    for name in job.run.finished_jobs("power")? {
        sum += fs::read_to_string(job.input("power").join(name).join("power.txt"))?.parse::<u64>()?;
    }
    job.warn("toy");
    fs::write(job.output().join("sum.txt"), sum.to_string())?;
    Ok(())
}

fn run(folder: &Path, settings: serde_json::Value) -> Run {
    Run {
        folder: folder.to_owned(),
        table: TABLE,
        settings: Settings::flatten(&settings),
        seed: 1,
        backend: "toy".into(),
        kindred: Vec::new(),
        devices: Vec::new(),
    }
}

const LIMITS: Limits = Limits { jobs: 2, memory_bytes: 1000, threads: 2, device_jobs: 2, device: None };

fn execute(run: &Run) -> Result<Summary> {
    let cancel = Cancel::default();
    let progress: Arc<dyn Progress> = Arc::new(Silent);
    let launcher = InProcess { cancel: cancel.clone(), progress: Arc::clone(&progress) };
    run.execute(None, LIMITS, &launcher, &cancel, &progress)
}

fn published(folder: &Path) -> String {
    fs::read_to_string(folder.join("out/sum.txt")).expect("published")
}

#[test]
fn a_finished_run_does_nothing_again() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = run(folder.path(), json!({"numbers": "2 3", "power": 2}));
    assert_eq!(execute(&run).expect("runs"), Summary { ran: 4, ..Summary::default() });
    assert_eq!(published(folder.path()), "650");
    assert_eq!(execute(&run).expect("runs"), Summary { kept: 4, ..Summary::default() });
    let manifest = Manifest::read(&run.job_folder(&TABLE[2], "all")).expect("there");
    assert_eq!(manifest.warnings, ["toy"]);
    assert!(run.folders_beginning(".").is_empty(), "no leftovers");
}

#[test]
fn only_what_reads_a_changed_setting_runs_and_the_plan_says_why() {
    let folder = tempfile::tempdir().expect("temporary folder");
    execute(&run(folder.path(), json!({"numbers": "2 3", "power": 2}))).expect("runs");
    let changed = run(folder.path(), json!({"numbers": "2 3", "power": 1, "unread": 7}));
    let plan = changed.plan(None).expect("plan");
    let StagePlan::Jobs(orders) = &plan[1].1 else { panic!("{plan:?}", plan = plan[1].1) };
    let why = Reason::Setting { key: "power".into(), old: "2".into(), new: "1".into() };
    assert_eq!(orders[0].decision, Decision::Run(vec![why]));
    assert_eq!(plan[2].1, StagePlan::After("power"));
    assert_eq!(execute(&changed).expect("runs"), Summary { ran: 3, kept: 1, ..Summary::default() });
    assert_eq!(published(folder.path()), "250");
}

#[test]
fn a_job_reads_only_its_part_and_a_vanished_job_leaves_no_folder() {
    let folder = tempfile::tempdir().expect("temporary folder");
    execute(&run(folder.path(), json!({"numbers": "2 3 4", "power": 2}))).expect("runs");
    let fewer = run(folder.path(), json!({"numbers": "2 4", "power": 2}));
    assert_eq!(execute(&fewer).expect("runs"), Summary { ran: 2, kept: 2, ..Summary::default() }, "list and sum");
    assert!(!folder.path().join("02-power/3").exists());
    assert_eq!(published(folder.path()), "1000");
}

#[test]
fn a_stopped_job_goes_on_from_its_checkpoint_with_the_same_answer() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let stopped = run(folder.path(), json!({"numbers": "3", "power": 2, "stop": 20}));
    let error = execute(&stopped).expect_err("stopped");
    assert_eq!(exit_code(&error), 130);
    assert!(!folder.path().join("02-power/3").exists());
    let resumed = run(folder.path(), json!({"numbers": "3", "power": 2}));
    let attempts = resumed.attempts("power", "3");
    let orders = resumed.orders(&TABLE[1]).expect("orders");
    let found = artifact::Checkpoint::newest(&attempts, &orders[0].identity.key()).expect("saved");
    assert_eq!(found.step, 21);
    assert_eq!(execute(&resumed).expect("runs"), Summary { ran: 2, kept: 1, ..Summary::default() });
    assert_eq!(published(folder.path()), "450");
    assert!(resumed.attempts("power", "3").is_empty());
}

#[test]
fn a_complete_attempt_of_a_killed_process_is_adopted() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = run(folder.path(), json!({"numbers": "2 3", "power": 2}));
    execute(&run).expect("runs");
    let partial = folder.path().join(format!(".02-power.3.partial.{}-1-0", machine::host()));
    fs::rename(folder.path().join("02-power/3"), &partial).expect("moved");
    assert_eq!(execute(&run).expect("runs"), Summary { kept: 4, ..Summary::default() });
    assert!(folder.path().join("02-power/3/power.txt").exists() && !partial.exists());
}

#[test]
fn damage_is_noticed_and_mended() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = run(folder.path(), json!({"numbers": "2 3", "power": 2}));
    execute(&run).expect("runs");
    fs::write(folder.path().join("02-power/2/power.txt"), "1").expect("written");
    fs::remove_file(folder.path().join("out/sum.txt")).expect("removed");
    let orders = run.orders(&TABLE[1]).expect("orders");
    assert!(matches!(&orders[0].decision, Decision::Run(reasons) if matches!(reasons[..], [Reason::Damaged(_)])));
    assert_eq!(execute(&run).expect("runs"), Summary { ran: 1, kept: 3, ..Summary::default() });
    assert_eq!(published(folder.path()), "650");
}

#[test]
fn one_failing_job_lets_the_others_finish() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let failing = run(folder.path(), json!({"numbers": "2 3 4", "power": 2, "fail": 4}));
    let error = execute(&failing).expect_err("fails");
    assert_eq!(exit_code(&error), 2);
    assert!(folder.path().join("02-power/2").exists() && folder.path().join("02-power/3").exists());
    let lines = failing.status().expect("status");
    let failed = lines.iter().find(|line| line.job == "4").expect("listed");
    assert_eq!(failed.state, status::State::Failed { error: "toy: cannot be done; take another number".into() });
}

#[test]
fn a_group_that_fails_twice_is_reported_and_the_rest_goes_on() {
    struct Breaking(AtomicUsize);
    impl Launcher for Breaking {
        fn launch(&self, run: &Run, stage: &'static Stage, order: &Order, share: Limits) -> Result<()> {
            if order.plan.name == "3" {
                self.0.fetch_add(1, Ordering::SeqCst);
                anyhow::bail!("no luck");
            }
            let here = InProcess { cancel: Cancel::default(), progress: Arc::new(Silent) };
            here.launch(run, stage, order, share)
        }
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = run(folder.path(), json!({"numbers": "2 3", "power": 2}));
    let (launcher, cancel) = (Breaking(AtomicUsize::new(0)), Cancel::default());
    let progress: Arc<dyn Progress> = Arc::new(Silent);
    let summary = run.execute(None, LIMITS, &launcher, &cancel, &progress).expect("goes on");
    assert_eq!(launcher.0.load(Ordering::SeqCst), 2, "once more and no further");
    assert!(summary.lost.len() == 1 && summary.lost[0].contains("power 3"), "{:?}", summary.lost);
    assert_eq!(published(folder.path()), "200", "fifty times two squared");
    let again = execute(&run).expect("runs");
    assert!(again.lost.is_empty());
    assert_eq!(published(folder.path()), "650");
}

#[test]
fn a_job_that_cannot_fit_is_refused_before_it_starts() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let error = execute(&run(folder.path(), json!({"numbers": "2 2000", "power": 1}))).expect_err("refused");
    assert_eq!(exit_code(&error), 2);
    assert!(!folder.path().join("02-power/2").exists(), "nothing of the stage was started");
}

#[test]
fn jobs_share_the_memory_limit_and_start_heaviest_first() {
    struct Watch {
        started: std::sync::Mutex<Vec<String>>,
        running: AtomicUsize,
        changed: std::sync::Condvar,
    }
    impl Watch {
        /// Notes the start of a job; one of the first two waits here until both have started.
        fn note(&self, job: &str) {
            let mut started = self.started.lock().expect("unpoisoned");
            started.push(job.to_string());
            self.changed.notify_all();
            if matches!(job, "700" | "200") {
                let patience = std::time::Duration::from_secs(20);
                let alone = |started: &mut Vec<String>| started.len() < 2;
                let (started, waited) = self.changed.wait_timeout_while(started, patience, alone).expect("unpoisoned");
                assert!(!waited.timed_out(), "nothing was started beside {started:?}, though 1000 bytes hold two jobs");
            }
        }
    }
    impl Launcher for Watch {
        fn launch(&self, run: &Run, stage: &'static Stage, order: &Order, share: Limits) -> Result<()> {
            let held = order.plan.cost.memory_bytes as usize;
            assert!(self.running.fetch_add(held, Ordering::SeqCst) + held <= 1000);
            if stage.name == "power" {
                self.note(&order.plan.name);
            }
            let here = InProcess { cancel: Cancel::default(), progress: Arc::new(Silent) };
            let outcome = here.launch(run, stage, order, share);
            self.running.fetch_sub(held, Ordering::SeqCst);
            outcome
        }
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = run(folder.path(), json!({"numbers": "100 700 600 200", "power": 1}));
    let watch = Watch {
        started: std::sync::Mutex::default(),
        running: AtomicUsize::new(0),
        changed: std::sync::Condvar::new(),
    };
    let progress: Arc<dyn Progress> = Arc::new(Silent);
    run.execute(None, LIMITS, &watch, &Cancel::default(), &progress).expect("runs");
    let started = watch.started.into_inner().expect("unpoisoned");
    // Which of the two threads speaks first is theirs to settle.
    let mut first = [started[0].as_str(), started[1].as_str()];
    first.sort_unstable();
    assert_eq!(first, ["200", "700"], "the heaviest, and what fits beside it: {started:?}");
}

#[test]
fn two_processes_do_not_share_a_run() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let guard = lock(folder.path()).expect("free");
    let error = lock(folder.path()).expect_err("taken");
    assert_eq!(exit_code(&error), 2);
    drop(guard);
    assert!(lock(folder.path()).is_ok());
}

static ON_DEVICES: &[Stage] = &[
    Stage { slice: &["numbers"], ..toy("list", &[], Per::Whole, |_| Ok(JobPlan::whole(&[], Cost::default())), list) },
    Stage { on_backend: true, ..toy("power", &["list"], Per::Group, power_jobs, on_a_device) },
];

/// Meets the other job, then writes on which device it is; the one called `broken` fails whatever it is given.
fn on_a_device(job: &Job<'_>) -> Result<()> {
    let device = job.device("typed").to_owned();
    let here = job.run.folder.join(format!("met.{}", job.name));
    let others = || numbers(job.run).into_iter().all(|other| job.run.folder.join(format!("met.{other}")).exists());
    fs::write(here, "")?;
    for _ in 0..500 {
        if others() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    anyhow::ensure!(others(), "the other job does not run");
    anyhow::ensure!(device != "broken", "{device} is lost");
    fs::write(job.output().join("device.txt"), device)?;
    Ok(())
}

fn with_devices(folder: &Path, devices: [&str; 2]) -> Run {
    let devices = devices.map(str::to_owned).into();
    Run { table: ON_DEVICES, devices, ..run(folder, json!({"numbers": "2 3"})) }
}

fn device_of(folder: &Path, job: &str) -> String {
    fs::read_to_string(folder.join("02-power").join(job).join("device.txt")).expect("finished")
}

#[test]
fn jobs_at_once_are_handed_a_device_each() {
    let folder = tempfile::tempdir().expect("temporary folder");
    execute(&with_devices(folder.path(), ["first", "second"])).expect("runs");
    assert_eq!((device_of(folder.path(), "3"), device_of(folder.path(), "2")), ("first".into(), "second".into()));
}

#[test]
fn a_job_whose_device_is_lost_is_tried_once_on_another() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let summary = execute(&with_devices(folder.path(), ["broken", "sound"])).expect("runs");
    assert!(summary.lost.is_empty(), "{summary:?}");
    assert_eq!((device_of(folder.path(), "3"), device_of(folder.path(), "2")), ("sound".into(), "sound".into()));
}

#[test]
fn a_checkpoint_of_a_kindred_backend_is_gone_on_with() {
    let folder = tempfile::tempdir().expect("temporary folder");
    static TABLE: &[Stage] = &[
        Stage {
            slice: &["numbers"],
            ..toy("list", &[], Per::Whole, |_| Ok(JobPlan::whole(&[], Cost::default())), list)
        },
        Stage { on_backend: true, slice: &["power"], ..toy("power", &["list"], Per::Group, power_jobs, power) },
    ];
    let on = |backend: &str, kindred: &[&str], settings| Run {
        table: TABLE,
        backend: backend.into(),
        kindred: kindred.iter().map(|word| (*word).to_owned()).collect(),
        ..run(folder.path(), settings)
    };
    let stopped = on("cpu", &[], json!({"numbers": "3", "power": 2, "stop": 20}));
    assert_eq!(exit_code(&execute(&stopped).expect_err("stopped")), 130);
    let found = |run: &Run| {
        let order = run.orders(&TABLE[1]).expect("orders").remove(0);
        let keys = std::iter::once(order.identity.key()).chain(run.kindred_keys(&TABLE[1], &order));
        keys.filter_map(|key| artifact::Checkpoint::newest(&run.attempts("power", "3"), &key)).count()
    };
    let settings = json!({"numbers": "3", "power": 2});
    assert_eq!(found(&on("gpu", &[], settings.clone())), 0);
    let kindred = on("gpu", &["cpu"], settings);
    assert_eq!(found(&kindred), 1);
    execute(&kindred).expect("goes on");
    assert!(kindred.attempts("power", "3").is_empty());
}
