//! How time and memory grow with a town: `town_growth PGSAG FOLDER [HOUSES ...]` makes towns of 10, 40 and 160 houses (or
//! as asked) in FOLDER, 400 x 300 pixels, reconstructs each with the program PGSAG, 500 steps per group, and prints
//! processor time per house and the largest memory of a job. Work that is linear keeps the time per house.
#![expect(clippy::print_stdout, reason = "an example speaks on standard output")]

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, ensure};
use pgsag::pipeline::PIPELINE;
use pgsag::run::artifact::files_below;
use pgsag::run::manifest::Manifest;
use pgsag::town_folder::{FolderOptions, write_town_with};
use pgsag_scene::synthetic::{Town, TownOptions};

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [program, folder, sizes @ ..] = words.as_slice() else {
        anyhow::bail!("use town_growth PGSAG FOLDER [HOUSES ...]");
    };
    let sizes: Vec<u32> = if sizes.is_empty() {
        vec![10, 40, 160]
    } else {
        sizes.iter().map(|size| size.parse().context("HOUSES is a number")).collect::<Result<_>>()?
    };
    println!(
        "{:>7} {:>7} {:>7} {:>9} {:>12} {:>12}  heaviest",
        "houses", "images", "jobs", "CPU-s", "CPU-s/house", "peak MiB"
    );
    for houses in sizes {
        let scene = PathBuf::from(folder).join(format!("town{houses}"));
        let run = PathBuf::from(folder).join(format!("run{houses}"));
        let views = town(houses, &scene)?;
        let status = Command::new(program)
            .arg("reconstruct")
            .args([&scene, &PathBuf::from("-o"), &run])
            .args(["--preset", "fast", "--iterations", "500", "--json"])
            .stdout(std::process::Stdio::null())
            .status()
            .with_context(|| program.clone())?;
        ensure!(status.success(), "{houses} houses: {status}");
        let Sum { jobs, cpu_secs, peak, heaviest } = measured(&run)?;
        let each = cpu_secs / f64::from(houses);
        println!("{houses:>7} {views:>7} {jobs:>7} {cpu_secs:>9.1} {each:>12.2} {:>12}  {heaviest}", peak >> 20);
    }
    Ok(())
}

/// Writes a town with masks, once; its number of images.
fn town(houses: u32, scene: &Path) -> Result<usize> {
    let options = TownOptions { width: 400, height: 300, ..TownOptions::for_houses(houses, 3) };
    if !scene.exists() {
        let folder = FolderOptions { masks: true, depth: false, ..FolderOptions::default() };
        write_town_with(&Town::generate(&options), &folder, scene, &mut |_, _| ())?;
    }
    Ok(options.view_count as usize)
}

/// What all jobs of a run came to.
#[derive(Default)]
struct Sum {
    jobs: usize,
    cpu_secs: f64,
    peak: u64,
    heaviest: String,
}

fn measured(run: &Path) -> Result<Sum> {
    let mut sum = Sum::default();
    for (at, stage) in PIPELINE.iter().enumerate() {
        let folder = run.join(format!("{:02}-{}", at + 1, stage.name));
        for file in files_below(&folder)?.iter().filter(|file| file.ends_with("manifest.json")) {
            let Some(parent) = folder.join(file).parent().map(Path::to_path_buf) else { continue };
            // A divided stage has a record of another kind beside those of its jobs.
            let Ok(manifest) = Manifest::read(&parent) else { continue };
            sum.jobs += 1;
            sum.cpu_secs += manifest.measured.cpu_secs;
            if manifest.measured.peak_memory_bytes > sum.peak {
                sum.peak = manifest.measured.peak_memory_bytes;
                sum.heaviest = format!("{} {}", stage.name, manifest.identity.job);
            }
        }
    }
    Ok(sum)
}
