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
const USAGE: &str = "cargo x ablate [--rows a,b,…] [--iterations N] [--threads N] [--binary PGSAG] [--tiny]";

/// What was typed.
#[derive(Debug, PartialEq)]
struct Wish {
    rows: Vec<String>,
    iterations: u32,
    threads: u32,
    binary: Option<PathBuf>,
    tiny: bool,
}

/// A scene with truth, and what its base is run with.
struct Scene {
    name: &'static str,
    folder: PathBuf,
    words: Vec<String>,
}

/// One row on one scene, finished.
struct Done {
    scene: &'static str,
    row: Row,
    /// `None`: it failed.
    figures: Option<Figures>,
}

pub(crate) fn run(root: &Path, words: &[String]) -> Result<()> {
    let wish = wish(words)?;
    let binary = match &wish.binary {
        Some(path) => path.clone(),
        None => built(root)?,
    };
    let work = root.join("target/ablations").join(if wish.tiny { "tiny" } else { "full" });
    make(&work)?;
    let scenes = scenes(&binary, &work, wish.tiny)?;
    let commit = output_of(root, "git", &["describe", "--always", "--dirty"])?.trim().to_owned();
    let chosen = chosen(&wish)?;
    let mut done = Vec::new();
    for scene in &scenes {
        for row in &chosen {
            let figures = one(&binary, &work, scene, row, &wish, &commit);
            if let Err(message) = &figures {
                println!("{} {}: {message}", scene.name, row.name);
            }
            done.push(Done { scene: scene.name, row: row.clone(), figures: figures.ok() });
        }
    }
    let (page, list) = if wish.tiny {
        (work.join("ablations.md"), work.join("ablations.json"))
    } else {
        (root.join("docs/ablations.md"), root.join("benchmarks/ablations.json"))
    };
    let names: Vec<&str> = scenes.iter().map(|scene| scene.name).collect();
    write(&page, &table::page(&names, &done, wish.iterations, &commit))?;
    write(&list, &table::list(&done, wish.iterations, &commit))?;
    println!("{} and {}", page.display(), list.display());
    Ok(())
}

fn wish(words: &[String]) -> Result<Wish> {
    let mut wish = Wish { rows: Vec::new(), iterations: ITERATIONS, threads: 0, binary: None, tiny: false };
    let mut words = words.iter();
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or(format!("{word} wants a value\n{USAGE}"));
        let number = |text: &String| text.parse::<u32>().map_err(|_| format!("{text} is no number\n{USAGE}"));
        match word.as_str() {
            "--rows" => wish.rows = value()?.split(',').map(str::to_owned).collect(),
            "--iterations" => wish.iterations = number(value()?)?,
            "--threads" => wish.threads = number(value()?)?,
            "--binary" => wish.binary = Some(PathBuf::from(value()?)),
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

/// The town, and `delft` of `PGSAG_DATA` where there is one.
fn scenes(binary: &Path, work: &Path, tiny: bool) -> Result<Vec<Scene>> {
    let town = work.join("town");
    if !town.join("truth").exists() {
        let mut words = vec!["town", "--exact-masks", "--no-depth"];
        if tiny {
            words.extend(["--houses", "2", "--row-houses", "0", "--views", "12", "--points", "700"]);
            words.extend(["--width", "96", "--height", "64", "--gsd", "0.4"]);
        }
        let mut command = Command::new(binary);
        finish(command.args(words).arg("-o").arg(&town), &work.join("town.log"))?;
    }
    let mut scenes = vec![Scene { name: "town", folder: town, words: Vec::new() }];
    if let Some(data) = std::env::var_os("PGSAG_DATA") {
        let folder = PathBuf::from(data).join("delft");
        if !folder.join("truth").exists() {
            return Err(format!("{}: there is no delft with its truth; see PGSAG_DATA", folder.display()));
        }
        let masks = folder.join("truth/masks");
        let masks = if masks.exists() { masks.display().to_string() } else { "none".into() };
        scenes.push(Scene { name: "delft", folder, words: vec!["--masks".into(), masks] });
    }
    Ok(scenes)
}

/// Runs a row, or remembers it.
fn one(binary: &Path, work: &Path, scene: &Scene, row: &Row, wish: &Wish, commit: &str) -> Result<Figures> {
    let identity = format!("{commit} {} {} {:?}", wish.iterations, row.seed, row.set);
    let kept = work.join(format!("{}.{}.json", scene.name, row.name));
    if let Some(figures) = std::fs::read_to_string(&kept).ok().and_then(|text| Figures::remembered(&text, &identity)) {
        println!("{} {}: finished before", scene.name, row.name);
        return Ok(figures);
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
    for assignment in row.set {
        command.arg("--set").arg(assignment);
    }
    finish(&mut command, &work.join(format!("{}.{}.log", scene.name, row.name)))?;
    let figures = Figures::of_run(&folder)?;
    write(&kept, &figures.to_text(&identity))?;
    if row.name != "base" {
        remove(&folder)?;
    }
    Ok(figures)
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
