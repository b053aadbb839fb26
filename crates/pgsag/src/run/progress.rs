//! Whom a job tells how far it is: nobody, lines, bars on a terminal, or one JSON object per line.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use serde_json::{Value, json};

/// Listens to jobs.
pub trait Progress: Send + Sync {
    /// A job begins; `detail` says why.
    fn started(&self, stage: &str, job: &str, detail: &str);
    /// A job did `done` of `total`.
    fn advance(&self, stage: &str, job: &str, done: u64, total: u64, unit: &str);
    /// A job ended; `outcome` is `done`, `stopped` or an error.
    fn finished(&self, stage: &str, job: &str, outcome: &str, seconds: f64);
    /// Something worth reading.
    fn note(&self, stage: &str, job: &str, text: &str);
    /// Something that a reader of the result should know.
    fn warning(&self, stage: &str, job: &str, text: &str);
}

/// Tells nobody.
pub struct Silent;

impl Progress for Silent {
    fn started(&self, _: &str, _: &str, _: &str) {}
    fn advance(&self, _: &str, _: &str, _: u64, _: u64, _: &str) {}
    fn finished(&self, _: &str, _: &str, _: &str, _: f64) {}
    fn note(&self, _: &str, _: &str, _: &str) {}
    fn warning(&self, _: &str, _: &str, _: &str) {}
}

/// Between two progress messages of one job.
const QUIET: Duration = Duration::from_millis(500);
/// Between two progress lines of one job where there is no terminal.
const QUIET_LINES: Duration = Duration::from_secs(20);

type Key = (String, String);

fn key(stage: &str, job: &str) -> Key {
    (stage.to_owned(), job.to_owned())
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn label(stage: &str, job: &str) -> String {
    if job == super::stage::WHOLE { stage.to_owned() } else { format!("{stage} {job}") }
}

/// Lets through one message of a job per `interval`, and the last.
#[derive(Default)]
struct Pace(Mutex<BTreeMap<Key, (Instant, Instant)>>);

impl Pace {
    /// Seconds since the job's first message where it is time for another.
    fn due(&self, stage: &str, job: &str, interval: Duration, last: bool) -> Option<f64> {
        let now = Instant::now();
        let mut jobs = locked(&self.0);
        let (first, previous) = jobs.entry(key(stage, job)).or_insert((now, now));
        let due = last || now.duration_since(*previous) >= interval;
        due.then(|| {
            *previous = now;
            now.duration_since(*first).as_secs_f64()
        })
    }
}

/// One JSON object per line on standard output.
#[derive(Default)]
pub struct JsonLines(Pace);

impl JsonLines {
    fn put(value: &Value) {
        // A reader that went away must not end the work.
        let _ = writeln!(std::io::stdout().lock(), "{value}");
    }
}

impl Progress for JsonLines {
    fn started(&self, stage: &str, job: &str, detail: &str) {
        Self::put(&json!({"event": "started", "stage": stage, "job": job, "detail": detail}));
    }

    fn advance(&self, stage: &str, job: &str, done: u64, total: u64, unit: &str) {
        if let Some(seconds) = self.0.due(stage, job, QUIET, done >= total) {
            Self::put(&json!({"event": "progress", "stage": stage, "job": job, "unit": unit,
                "measured": {"done": done, "total": total, "seconds": seconds}}));
        }
    }

    fn finished(&self, stage: &str, job: &str, outcome: &str, seconds: f64) {
        Self::put(&json!({"event": "finished", "stage": stage, "job": job, "outcome": outcome,
            "measured": {"seconds": seconds}}));
    }

    fn note(&self, stage: &str, job: &str, text: &str) {
        Self::put(&json!({"event": "note", "stage": stage, "job": job, "text": text}));
    }

    fn warning(&self, stage: &str, job: &str, text: &str) {
        Self::put(&json!({"event": "warning", "stage": stage, "job": job, "text": text}));
    }
}

/// Tells `to` what a child said in [`JsonLines`]; anything else is a note.
pub fn relay(line: &str, to: &dyn Progress) {
    let Ok(value) = serde_json::from_str::<Value>(line) else { return };
    let word = |name: &str| value.get(name).and_then(Value::as_str).unwrap_or_default();
    let (stage, job) = (word("stage"), word("job"));
    let number = |name: &str| value.pointer(&format!("/measured/{name}")).and_then(Value::as_u64).unwrap_or(0);
    match word("event") {
        "progress" => to.advance(stage, job, number("done"), number("total"), word("unit")),
        "note" => to.note(stage, job, word("text")),
        "warning" => to.warning(stage, job, word("text")),
        _ => {}
    }
}

/// Plain lines on standard error.
#[derive(Default)]
pub struct Lines(Pace);

impl Lines {
    fn put(text: &str) {
        // As above.
        let _ = writeln!(std::io::stderr().lock(), "{text}");
    }
}

impl Progress for Lines {
    fn started(&self, stage: &str, job: &str, detail: &str) {
        Self::put(&format!("{}: {detail}", label(stage, job)));
    }

    fn advance(&self, stage: &str, job: &str, done: u64, total: u64, unit: &str) {
        if let Some(seconds) = self.0.due(stage, job, QUIET_LINES, false) {
            let left = seconds * (total.saturating_sub(done)) as f64 / (done.max(1)) as f64;
            Self::put(&format!("{}: {done} of {total} {unit}, about {left:.0} s left", label(stage, job)));
        }
    }

    fn finished(&self, stage: &str, job: &str, outcome: &str, seconds: f64) {
        Self::put(&format!("{}: {outcome} in {seconds:.1} s", label(stage, job)));
    }

    fn note(&self, stage: &str, job: &str, text: &str) {
        Self::put(&format!("{}: {text}", label(stage, job)));
    }

    fn warning(&self, stage: &str, job: &str, text: &str) {
        Self::put(&format!("{}: warning: {text}", label(stage, job)));
    }
}

/// Bars with the time left, on a terminal.
#[derive(Default)]
pub struct Bars {
    all: MultiProgress,
    bars: Mutex<BTreeMap<Key, ProgressBar>>,
}

impl Bars {
    fn put(&self, text: &str) {
        // A terminal that went away must not end the work.
        let _ = self.all.println(text);
    }
}

impl Progress for Bars {
    fn started(&self, stage: &str, job: &str, detail: &str) {
        let bar = self.all.add(ProgressBar::new(0));
        if let Ok(style) = ProgressStyle::with_template("{prefix:>14} {wide_bar} {pos}/{len} {msg} {elapsed} eta {eta}")
        {
            bar.set_style(style);
        }
        bar.set_prefix(label(stage, job));
        bar.set_message(detail.to_owned());
        locked(&self.bars).insert(key(stage, job), bar);
    }

    fn advance(&self, stage: &str, job: &str, done: u64, total: u64, unit: &str) {
        if let Some(bar) = locked(&self.bars).get(&key(stage, job)) {
            bar.set_length(total);
            bar.set_position(done);
            bar.set_message(unit.to_owned());
        }
    }

    fn finished(&self, stage: &str, job: &str, outcome: &str, seconds: f64) {
        if let Some(bar) = locked(&self.bars).remove(&key(stage, job)) {
            bar.finish_and_clear();
        }
        self.put(&format!("{:>14} {outcome} in {seconds:.1} s", label(stage, job)));
    }

    fn note(&self, stage: &str, job: &str, text: &str) {
        self.put(&format!("{:>14} {text}", label(stage, job)));
    }

    fn warning(&self, stage: &str, job: &str, text: &str) {
        self.put(&format!("{:>14} warning: {text}", label(stage, job)));
    }
}
