//! `cargo x bench`: the CPU backend's iteration, appended to `benchmarks/results.json` with commit and machine.
//!
//! The example prints one line per case, as an object of JSON or in words; either is kept as it stands.

use std::path::Path;

use crate::Result;
use crate::json::Json;
use crate::steps::output_of;

const RESULTS: &str = "benchmarks/results.json";

pub(crate) fn run(root: &Path) -> Result<()> {
    let words = ["run", "--release", "--locked", "-p", "pgsag-splat", "--example", "iteration"];
    println!("$ cargo {}", words.join(" "));
    let printed = output_of(root, "cargo", &words)?;
    print!("{printed}");
    let cases = cases(&printed);
    if cases.is_empty() {
        return Err("the example `iteration` printed nothing".into());
    }
    let commit = output_of(root, "git", &["describe", "--always", "--dirty"])?;
    let path = root.join(RESULTS);
    let before = if path.exists() {
        std::fs::read_to_string(&path).map_err(|cause| format!("{RESULTS}: {cause}"))?
    } else {
        "[]".to_owned()
    };
    let after = appended(&before, record(commit.trim(), &machine(), cases))?;
    std::fs::create_dir_all(root.join("benchmarks")).map_err(|cause| format!("benchmarks: {cause}"))?;
    std::fs::write(&path, after).map_err(|cause| format!("{RESULTS}: {cause}"))?;
    println!("appended to {RESULTS}");
    Ok(())
}

fn cases(printed: &str) -> Vec<Json> {
    let lines = printed.lines().map(str::trim).filter(|line| !line.is_empty());
    lines.map(|line| Json::parse(line).unwrap_or_else(|_| Json::Text(line.to_owned()))).collect()
}

/// Processor and cores, in words.
fn machine() -> String {
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpu.lines().find(|line| line.starts_with("model name")).and_then(|line| line.split_once(':'));
    let model = model.map_or("unknown processor", |(_, name)| name.trim());
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    format!("{model}, {cores} cores")
}

fn record(commit: &str, machine: &str, cases: Vec<Json>) -> Json {
    Json::Object(vec![
        ("commit".into(), Json::Text(commit.into())),
        ("machine".into(), Json::Text(machine.into())),
        ("cases".into(), Json::List(cases)),
    ])
}

/// The list with one record more; one record per line, so that a diff shows what was added.
fn appended(before: &str, record: Json) -> Result<String> {
    let Json::List(mut records) = Json::parse(before).map_err(|fault| format!("{RESULTS}: {fault}"))? else {
        return Err(format!("{RESULTS}: a list of records is expected"));
    };
    records.push(record);
    let lines: Vec<String> = records.iter().map(Json::to_string).collect();
    Ok(format!("[\n{}\n]\n", lines.join(",\n")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_case_is_json_or_words() {
        let found = cases("{\"ms\": 3.5}\n\n20000 Gaussians: 9 ms\n");
        assert_eq!(found[0].get("ms"), Some(&Json::Number("3.5".into())));
        assert_eq!(found[1].text(), Some("20000 Gaussians: 9 ms"));
    }

    #[test]
    fn records_are_appended_and_kept() {
        let one = appended("[]", record("abc", "m", vec![Json::Null])).unwrap();
        let two = appended(&one, record("def", "m", Vec::new())).unwrap();
        assert_eq!(two.lines().count(), 4);
        assert!(two.contains(r#"{"commit": "abc", "machine": "m", "cases": [null]}"#));
        assert!(appended("{}", Json::Null).is_err());
    }
}
