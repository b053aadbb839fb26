//! `cargo x bench`: the CPU backend's iteration, appended to `benchmarks/results.json` with commit and machine.
//!
//! The example prints one object of JSON per case. Words after `bench` go to it; `--peer COMMAND` runs another program in
//! the same session, before and after ours, and keeps what it prints: a ratio is only as good as its two machines are one.

use std::path::Path;

use crate::Result;
use crate::json::Json;
use crate::steps::output_of;

const RESULTS: &str = "benchmarks/results.json";

pub(crate) fn run(root: &Path, words: &[String]) -> Result<()> {
    let (peer, passed) = peer_of(words)?;
    let theirs_before = printed_by_peer(root, peer)?;
    let mut arguments = vec!["run", "--release", "--locked", "-p", "pgsag-splat", "--example", "iteration", "--"];
    arguments.extend(passed);
    println!("$ cargo {}", arguments.join(" "));
    let printed = output_of(root, "cargo", &arguments)?;
    print!("{printed}");
    let theirs_after = printed_by_peer(root, peer)?;
    let ours = cases(&printed);
    if ours.is_empty() {
        return Err("the example `iteration` printed nothing".into());
    }
    let all = [cases(&theirs_before), ours, cases(&theirs_after)].concat();
    let commit = output_of(root, "git", &["describe", "--always", "--dirty"])?;
    let path = root.join(RESULTS);
    let before = if path.exists() {
        std::fs::read_to_string(&path).map_err(|cause| format!("{RESULTS}: {cause}"))?
    } else {
        "[]".to_owned()
    };
    let after = appended(&before, record(commit.trim(), &machine(), all))?;
    std::fs::create_dir_all(root.join("benchmarks")).map_err(|cause| format!("benchmarks: {cause}"))?;
    std::fs::write(&path, after).map_err(|cause| format!("{RESULTS}: {cause}"))?;
    println!("appended to {RESULTS}");
    Ok(())
}

/// The peer's command, if there is one, and the words for our example.
fn peer_of(words: &[String]) -> Result<(Option<&str>, Vec<&str>)> {
    let (mut peer, mut passed) = (None, Vec::new());
    let mut words = words.iter().map(String::as_str);
    while let Some(word) = words.next() {
        if word == "--peer" {
            peer = Some(words.next().ok_or("--peer wants a command")?);
        } else {
            passed.push(word);
        }
    }
    Ok((peer, passed))
}

/// Lines of JSON that the peer prints; what else it says is dropped.
fn printed_by_peer(root: &Path, command: Option<&str>) -> Result<String> {
    let Some(command) = command else { return Ok(String::new()) };
    println!("$ {command}");
    let printed = output_of(root, "sh", &["-c", command])?;
    let lines: String = printed.lines().filter(|line| line.starts_with('{')).map(|line| format!("{line}\n")).collect();
    print!("{lines}");
    Ok(lines)
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
    fn the_peer_is_told_from_our_own_words() {
        let words = ["--rounds", "4", "--peer", "./other x"].map(String::from);
        assert_eq!(peer_of(&words), Ok((Some("./other x"), vec!["--rounds", "4"])));
        assert!(peer_of(&words[..3]).is_err());
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
