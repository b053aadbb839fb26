//! Lines of JSON: one per case, and what follows from several cases together.

use serde_json::{Map, Value, json};

use crate::measure::{Bench, Turn};

/// Operations per blended entry with 8 channels, forward and backward with absolute gradients, a fused multiply-add
/// being two: counted from the prototype's source once, so that shares of the peak can be compared between commits.
const OPERATIONS: [f64; 2] = [40.0, 87.0];

/// Least of some figures.
pub(crate) fn least(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(f64::INFINITY, f64::min)
}

/// The figure in the middle.
pub(crate) fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// With so many decimals that a reader can compare, and no more.
pub(crate) fn round(value: f64, decimals: i32) -> f64 {
    let scale = 10f64.powi(decimals);
    (value * scale).round() / scale
}

fn rates(bench: &Bench, gflops: f64) -> Map<String, Value> {
    let entries = bench.per_pixel * bench.pixels as f64;
    let mut rates = Map::new();
    for (phase, operations) in ["forward", "backward"].into_iter().zip(OPERATIONS) {
        let per_ms = entries / least(bench.turns.iter().map(|turn| turn.phase(phase)));
        rates.insert(format!("{phase}_entries_per_s"), json!((per_ms * 1e3).round()));
        if bench.case.planes {
            rates.insert(format!("{phase}_share_of_fma_peak"), json!(round(per_ms * operations * 1e-6 / gflops, 3)));
        }
    }
    rates
}

/// Of the iteration that idle cores would end first: what the busier thread of each phase spent.
fn busiest(bench: &Bench) -> Map<String, Value> {
    let fastest = bench.turns.iter().min_by(|a, b| a.critical().total_cmp(&b.critical()));
    let phases = fastest.map(|turn| &turn.phases[..]).unwrap_or_default();
    phases.iter().map(|phase| (phase.name.to_owned(), json!(round(phase.largest, 2)))).collect()
}

/// The line of one case.
pub(crate) fn case_line(group: &str, bench: &Bench, gflops: f64) -> Value {
    let case = &bench.case;
    let fastest = bench.turns.iter().min_by(|a, b| a.total().total_cmp(&b.total()));
    let phases = fastest.map(|turn| &turn.phases[..]).unwrap_or_default();
    let phases: Map<String, Value> =
        phases.iter().map(|phase| (phase.name.to_owned(), json!(round(phase.sum, 2)))).collect();
    let mut line = json!({
        "program": "pgsag",
        "group": group,
        "gaussians": case.gaussians,
        "width": case.size.0,
        "height": case.size.1,
        "channels": if case.planes { 8 } else { 3 },
        "mask": case.share,
        "patches": case.patches,
        "threads": case.threads,
        "sparse": case.sparse,
        "per_pixel": round(bench.per_pixel, 1),
        "min_ms": round(least(bench.turns.iter().map(Turn::total)), 2),
        "median_ms": round(median(bench.turns.iter().map(Turn::total)), 2),
        "phases_ms": phases,
    });
    if let (Value::Object(members), true) = (&mut line, case.threads > 1) {
        members.insert("busiest_ms".into(), json!(busiest(bench)));
    }
    if let (Value::Object(members), true) = (&mut line, case.threads == 1 && case.patches == 0) {
        members.extend(rates(bench, gflops));
    }
    line
}

/// How two threads do against one: 1 is perfect.
pub(crate) fn efficiency_line(one: &Bench, two: &Bench) -> Value {
    let alone = least(one.turns.iter().map(Turn::total));
    let share = |together: f64| round(alone / (2.0 * together), 3);
    json!({
        "program": "pgsag",
        "group": "efficiency",
        "gaussians": one.case.gaussians,
        "patches": one.case.patches,
        "threads": two.case.threads,
        "by_busiest_thread": share(least(two.turns.iter().map(Turn::critical))),
        "by_busiest_thread_median": share(median(two.turns.iter().map(Turn::critical))),
        "by_sum_of_cpu": round(alone / least(two.turns.iter().map(Turn::total)), 3),
        "by_wall": round(least(one.turns.iter().map(|t| t.wall)) / (2.0 * least(two.turns.iter().map(|t| t.wall))), 3),
    })
}

/// By how much the cost grows along some cases: each against the first.
pub(crate) fn growth_line(of: &str, benches: &[&Bench]) -> Value {
    let cost = |bench: &&Bench| least(bench.turns.iter().map(Turn::total));
    let first = benches.first().map_or(f64::NAN, cost);
    let factors: Vec<f64> = benches.iter().map(|bench| round(cost(bench) / first, 2)).collect();
    json!({"program": "pgsag", "group": "growth", "of": of, "factors": factors})
}
