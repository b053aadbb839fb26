//! `cargo x ablate`: one row per switch, everything else as in the preset `fast`, on one or more scenes with truth.
//!
//! The base is run once per seed. Every other row begins with a copy of the base's run folder, made of hard links, so that
//! the run's own cache by identity does again only what the row's settings decide. A finished row is kept and not run
//! again. The spread of the base's seeds is what a row must exceed to count.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::Result;
use crate::json::Json;
use crate::steps::{output_of, shell};

mod figures;
mod rows;
mod table;

use figures::Figures;
use rows::{Row, SEEDS, rows};

/// Steps of training where `--iterations` says nothing: those of the demo.
const ITERATIONS: u32 = 800;
const USAGE: &str = "cargo x ablate [--scenes town,delft] [--rows a,b,…] [--iterations N] [--threads N] \
                     [--binary PGSAG --commit ID] [--fresh | --kept] [--tiny]";
/// The quarter of delft that its rows are run on: north, east of the model's frame, metres.
const DELFT_AREA: &str = r#"{"type":"Polygon","coordinates":[[[5,-45],[50,-45],[50,-5],[5,-5],[5,-45]]]}"#;

/// What was typed.
#[derive(Debug, Default, PartialEq)]
struct Wish {
    /// Empty: all there are.
    scenes: Vec<String>,
    rows: Vec<String>,
    iterations: u32,
    threads: u32,
    binary: Option<PathBuf>,
    /// What `binary` was built of; this checkout where nothing is said.
    commit: Option<String>,
    /// Rows finished before are run again.
    fresh: bool,
    /// Nothing is run: the page is written of the rows finished before.
    kept: bool,
    tiny: bool,
}

/// A scene with truth, and what its base is run with.
struct Scene {
    name: &'static str,
    folder: PathBuf,
    /// Of its photographs, pixels.
    width: u32,
    words: Vec<String>,
}

/// One row on one scene, finished.
struct Done {
    scene: &'static str,
    row: Row,
    /// What it was run with.
    commit: String,
    /// `None`: it failed.
    figures: Option<Figures>,
}

pub(crate) fn run(root: &Path, words: &[String]) -> Result<()> {
    let wish = wish(words)?;
    let binary = match &wish.binary {
        Some(path) => path.clone(),
        None if wish.kept => PathBuf::new(),
        None => built(root)?,
    };
    let commit = match &wish.commit {
        Some(commit) => commit.clone(),
        None => output_of(root, "git", &["describe", "--always", "--dirty"])?.trim().to_owned(),
    };
    let work = root.join("target/ablations").join(if wish.tiny { "tiny" } else { "full" });
    if wish.fresh {
        remove(&work)?;
    }
    make(&work)?;
    let scenes = scenes(&binary, &work, &wish)?;
    let chosen = chosen(&wish)?;
    let mut done = Vec::new();
    for scene in &scenes {
        for row in &chosen {
            if wish.kept && remembered(&work, scene, row, &wish).is_none() {
                continue;
            }
            let (commit, figures) = match one(&binary, &work, scene, row, &wish, &commit) {
                Ok((commit, figures)) => (commit, Some(figures)),
                Err(message) => {
                    println!("{} {}: {message}", scene.name, row.name);
                    (commit.clone(), None)
                }
            };
            done.push(Done { scene: scene.name, row: row.clone(), commit, figures });
        }
    }
    let (page, list) = if wish.tiny {
        (work.join("ablations.md"), work.join("ablations.json"))
    } else {
        (root.join("docs/ablations.md"), root.join("benchmarks/ablations.json"))
    };
    let names: Vec<&str> = scenes.iter().map(|scene| scene.name).collect();
    write(&page, &table::page(&names, &done, wish.iterations))?;
    write(&list, &table::list(&done, wish.iterations))?;
    println!("{} and {}", page.display(), list.display());
    Ok(())
}

fn wish(words: &[String]) -> Result<Wish> {
    let mut wish = Wish { iterations: ITERATIONS, ..Wish::default() };
    let mut words = words.iter();
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or(format!("{word} wants a value\n{USAGE}"));
        let number = |text: &String| text.parse::<u32>().map_err(|_| format!("{text} is no number\n{USAGE}"));
        match word.as_str() {
            "--scenes" => wish.scenes = value()?.split(',').map(str::to_owned).collect(),
            "--rows" => wish.rows = value()?.split(',').map(str::to_owned).collect(),
            "--iterations" => wish.iterations = number(value()?)?,
            "--threads" => wish.threads = number(value()?)?,
            "--binary" => wish.binary = Some(PathBuf::from(value()?)),
            "--commit" => wish.commit = Some(value()?.clone()),
            "--fresh" => wish.fresh = true,
            "--kept" => wish.kept = true,
            "--tiny" => wish.tiny = true,
            _ => return Err(format!("{word} is unknown\n{USAGE}")),
        }
    }
    Ok(wish)
}

/// The base with its seeds, then the rows that were asked for.
fn chosen(wish: &Wish) -> Result<Vec<Row>> {
    let all = rows();
    if let Some(name) = wish.rows.iter().find(|name| !all.iter().any(|row| row.name == **name)) {
        let names: Vec<&str> = all.iter().map(|row| row.name).collect();
        return Err(format!("there is no row {name}; there are {}", names.join(" ")));
    }
    let is_wanted = |row: &Row| row.is_base() || wish.rows.is_empty() || wish.rows.iter().any(|name| name == row.name);
    Ok(all.into_iter().filter(is_wanted).collect())
}

fn built(root: &Path) -> Result<PathBuf> {
    shell(root, "cargo", &["build", "--release", "--locked", "-p", "pgsag"])?;
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    Ok(target.join("release/pgsag"))
}

/// The town, and a quarter of `delft` where `PGSAG_DATA` has it.
fn scenes(binary: &Path, work: &Path, wish: &Wish) -> Result<Vec<Scene>> {
    let is_wanted = |name: &str| wish.scenes.is_empty() || wish.scenes.iter().any(|wanted| wanted == name);
    let mut scenes = Vec::new();
    if is_wanted("town") {
        scenes.push(town(binary, work, wish.tiny)?);
    }
    if let Some(data) = std::env::var_os("PGSAG_DATA").filter(|_| is_wanted("delft")) {
        let folder = PathBuf::from(data).join("delft");
        if !folder.join("truth/masks").exists() {
            return Err(format!("{}: there is no delft with its truth; see PGSAG_DATA", folder.display()));
        }
        let area = work.join("delft.geojson");
        write(&area, DELFT_AREA)?;
        let masks = folder.join("truth/masks").display().to_string();
        let words = vec!["--masks".into(), masks, "--aoi".into(), area.display().to_string()];
        scenes.push(Scene { name: "delft", folder, width: 800, words });
    }
    if scenes.is_empty() {
        Err(format!("no scene is left: there are town and, with PGSAG_DATA, delft\n{USAGE}"))
    } else {
        Ok(scenes)
    }
}

/// A town that is made here.
fn town(binary: &Path, work: &Path, tiny: bool) -> Result<Scene> {
    let folder = work.join("town");
    if !folder.join("truth").exists() {
        let mut words = vec!["town", "--exact-masks", "--no-depth"];
        if tiny {
            words.extend(["--houses", "2", "--row-houses", "0", "--views", "12", "--points", "700"]);
            words.extend(["--width", "96", "--height", "64", "--gsd", "0.4"]);
        }
        let mut command = Command::new(binary);
        finish(command.args(words).arg("-o").arg(&folder), &work.join("town.log"))?;
    }
    Ok(Scene { name: "town", folder, width: if tiny { 96 } else { 320 }, words: Vec::new() })
}

/// A setting for a scene: `image_width=1/N` is a share of its photographs' width.
fn assignment(set: &str, scene: &Scene) -> String {
    match set.split_once("=1/").and_then(|(key, share)| Some((key, share.parse::<u32>().ok()?))) {
        Some((key, share)) => format!("{key}={}", scene.width / share),
        None => set.to_owned(),
    }
}

/// What decides a row's figures, beside the program.
fn identity(row: &Row, wish: &Wish) -> String {
    format!("{} {} {:?}", wish.iterations, row.seed, row.set)
}

fn kept_in(work: &Path, scene: &Scene, row: &Row) -> PathBuf {
    work.join(format!("{}.{}.json", scene.name, row.name))
}

/// Commit and figures of a row that was finished before.
fn remembered(work: &Path, scene: &Scene, row: &Row, wish: &Wish) -> Option<(String, Figures)> {
    Figures::remembered(&std::fs::read_to_string(kept_in(work, scene, row)).ok()?, &identity(row, wish))
}

/// Runs a row, or remembers it with the commit that it was run with.
fn one(binary: &Path, work: &Path, scene: &Scene, row: &Row, wish: &Wish, commit: &str) -> Result<(String, Figures)> {
    if let Some((commit, figures)) = remembered(work, scene, row, wish) {
        println!("{} {}: finished before, at {commit}", scene.name, row.name);
        return Ok((commit, figures));
    }
    println!("{} {} …", scene.name, row.name);
    let base = work.join(format!("{}.run", scene.name));
    let folder = if row.name == "base" { base.clone() } else { work.join(format!("{}.{}.run", scene.name, row.name)) };
    if row.name != "base" {
        remove(&folder)?;
        linked(&base, &folder)?;
    }
    let mut command = Command::new(binary);
    command.arg("reconstruct").arg(&scene.folder).arg("-o").arg(&folder);
    command.args(["--preset", "fast", "--json", "--iterations"]).arg(wish.iterations.to_string());
    command.arg("--truth").arg(scene.folder.join("truth")).args(&scene.words);
    command.arg("--threads").arg(wish.threads.to_string()).arg("--seed").arg(row.seed.to_string());
    for set in row.set {
        command.arg("--set").arg(assignment(set, scene));
    }
    finish(&mut command, &work.join(format!("{}.{}.log", scene.name, row.name)))?;
    let figures = Figures::of_run(&folder)?;
    write(&kept_in(work, scene, row), &figures.to_text(commit, &identity(row, wish)))?;
    if row.name != "base" {
        remove(&folder)?;
    }
    Ok((commit.to_owned(), figures))
}

/// Runs a command to its end, with what it says in a file.
fn finish(command: &mut Command, log: &Path) -> Result<()> {
    let output = command.output().map_err(|cause| format!("{command:?} cannot start: {cause}"))?;
    std::fs::write(log, [output.stdout, output.stderr].concat())
        .map_err(|cause| format!("{}: {cause}", log.display()))?;
    if output.status.success() { Ok(()) } else { Err(format!("{}; see {}", output.status, log.display())) }
}

/// The same files under a second name. A run replaces files, it never writes into one, so the first keep what they hold.
fn linked(from: &Path, to: &Path) -> Result<()> {
    let fault = |cause: std::io::Error| format!("{}: {cause}", to.display());
    make(to)?;
    for entry in std::fs::read_dir(from).map_err(fault)? {
        let entry = entry.map_err(fault)?;
        let (name, path) = (entry.file_name(), entry.path());
        if path.is_dir() {
            linked(&path, &to.join(&name))?;
        } else if name != "lock" && std::fs::hard_link(&path, to.join(&name)).is_err() {
            std::fs::copy(&path, to.join(&name)).map_err(fault)?;
        }
    }
    Ok(())
}

fn make(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|cause| format!("{}: {cause}", folder.display()))
}

fn remove(folder: &Path) -> Result<()> {
    if folder.exists() {
        std::fs::remove_dir_all(folder).map_err(|cause| format!("{}: {cause}", folder.display()))?;
    }
    Ok(())
}

fn write(path: &Path, text: &str) -> Result<()> {
    std::fs::write(path, text).map_err(|cause| format!("{}: {cause}", path.display()))
}

/// A JSON file of a run.
fn read(path: &Path) -> Result<Json> {
    let text = std::fs::read_to_string(path).map_err(|cause| format!("{}: {cause}", path.display()))?;
    Json::parse(&text).map_err(|fault| format!("{}: {fault}", path.display()))
}

#[cfg(test)]
mod tests;
