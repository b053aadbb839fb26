//! The rows as a page for people and as a list for programs.

use super::figures::Figures;
use super::{Done, SEEDS};
use crate::json::Json;

/// The base's mean over its seeds, and the spread of its two F1.
struct Base {
    mean: Figures,
    spread: [f64; 2],
}

fn base(done: &[Done], scene: &str) -> Option<Base> {
    let of = |done: &&Done| done.scene == scene && done.row.is_base();
    let seeds: Vec<Figures> = done.iter().filter(of).filter_map(|done| done.figures).collect();
    let count = seeds.len() as f64;
    let mean = |value: fn(&Figures) -> f64| seeds.iter().map(value).sum::<f64>() / count;
    let spread = |value: fn(&Figures) -> f64| {
        let values = || seeds.iter().map(value);
        values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
    };
    (seeds.len() == SEEDS.len()).then(|| Base {
        mean: Figures {
            f1: [mean(|one| one.f1[0]), mean(|one| one.f1[1])],
            accuracy_m: mean(|one| one.accuracy_m),
            completeness_m: mean(|one| one.completeness_m),
            edge_m: mean(|one| one.edge_m),
            gaussians: mean(|one| one.gaussians),
            cpu_secs: mean(|one| one.cpu_secs),
        },
        spread: [spread(|one| one.f1[0]), spread(|one| one.f1[1])],
    })
}

/// Whether a row differs by more than the base differs from itself.
fn counts(figures: &Figures, base: &Base) -> bool {
    (0..2).any(|k| (figures.f1[k] - base.mean.f1[k]).abs() > base.spread[k])
}

/// `docs/ablations.md`.
pub(super) fn page(scenes: &[&str], done: &[Done], iterations: u32) -> String {
    let mut text = format!(
        "# What each part is worth\n\nMade by `cargo x ablate`; not written by hand. Preset `fast`, {iterations} steps, true masks. \
         Differences are to the mean of\nthe base over {} seeds; **bold** rows differ in F1 by more than those seeds do among \
         themselves. Accuracy: mean distance from\nmesh to truth; completeness: from truth to mesh; edges: accuracy within 0.5 m of \
         the truth's edges. CPU: the whole run, what the\nbase had done included; not so the base's stereo where a row only chooses other neighbours.\n",
        SEEDS.len()
    );
    for scene in scenes {
        let of: Vec<&Done> = done.iter().filter(|done| done.scene == *scene).collect();
        let base = base(done, scene);
        let mut commits: Vec<&str> = of.iter().map(|done| done.commit.as_str()).collect();
        commits.sort_unstable();
        commits.dedup();
        text += &format!("\n## {scene}\n\nCommits: {}. ", commits.join(", "));
        if let Some(base) = &base {
            text += &format!(
                "Seeds of the base differ by {:.4} in F1 at 0.1 m and {:.4} at 0.2 m.\n\n",
                base.spread[0], base.spread[1]
            );
        } else {
            text += "\n\n";
        }
        text += "| row | settings | F1 0.1 m | F1 0.2 m | accuracy, cm | completeness, cm | edges, cm | Gaussians | CPU-s |\n";
        text += "|---|---|---|---|---|---|---|---|---|\n";
        for done in of {
            text += &line(done, base.as_ref());
        }
    }
    text
}

fn line(done: &Done, base: Option<&Base>) -> String {
    let settings: Vec<String> = done.row.set.iter().map(|set| format!("`{set}`")).collect();
    let settings = if settings.is_empty() { format!("seed {}", done.row.seed) } else { settings.join(" ") };
    let Some(figures) = &done.figures else {
        return format!("| {} | {settings} | failed | | | | | | |\n", done.row.what);
    };
    let difference = |value: f64, of: fn(&Figures) -> f64, digits: usize| match base {
        Some(base) if !done.row.is_base() => format!("{value:.digits$} ({:+.digits$})", value - of(&base.mean)),
        _ => format!("{value:.digits$}"),
    };
    let is_bold = !done.row.is_base() && base.is_some_and(|base| counts(figures, base));
    let what = if is_bold { format!("**{}**", done.row.what) } else { done.row.what.to_owned() };
    format!(
        "| {what} | {settings} | {} | {} | {} | {} | {} | {:.0} | {:.0} |\n",
        difference(figures.f1[0], |one| one.f1[0], 3),
        difference(figures.f1[1], |one| one.f1[1], 3),
        difference(100.0 * figures.accuracy_m, |one| 100.0 * one.accuracy_m, 2),
        difference(100.0 * figures.completeness_m, |one| 100.0 * one.completeness_m, 2),
        difference(100.0 * figures.edge_m, |one| 100.0 * one.edge_m, 2),
        figures.gaussians,
        figures.cpu_secs,
    )
}

/// `benchmarks/ablations.json`: one line per scene and row.
pub(super) fn list(done: &[Done], iterations: u32) -> String {
    let text = |text: &str| Json::Text(text.into());
    let record = |one: &Done| {
        let is_counted = one.figures.as_ref().zip(base(done, one.scene)).map(|(figures, base)| counts(figures, &base));
        Json::Object(vec![
            ("commit".into(), text(&one.commit)),
            ("iterations".into(), Json::Number(iterations.to_string())),
            ("scene".into(), text(one.scene)),
            ("row".into(), text(one.row.name)),
            ("seed".into(), Json::Number(one.row.seed.to_string())),
            ("set".into(), Json::List(one.row.set.iter().map(|set| text(set)).collect())),
            ("figures".into(), one.figures.map_or(Json::Null, Figures::to_json)),
            ("counts".into(), is_counted.filter(|_| !one.row.is_base()).map_or(Json::Null, Json::Bool)),
        ])
    };
    let lines: Vec<String> = done.iter().map(|one| record(one).to_string()).collect();
    format!("[\n{}\n]\n", lines.join(",\n"))
}
