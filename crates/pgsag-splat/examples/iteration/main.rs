//! CPU milliseconds of one training iteration, phase by phase, and how they grow with Gaussians, pixels, channels, masks,
//! patches and threads. Prints one line of JSON per case; `cargo x bench` keeps them. See benchmarks/README.md.
//!
//!     cargo run --release -p pgsag-splat --example iteration -- --help

#![expect(clippy::print_stdout, reason = "an example speaks to its terminal")]

mod clock;
mod files;
mod measure;
mod report;
mod scene;

use std::collections::{BTreeMap, btree_map::Entry};
use std::path::PathBuf;

use pgsag_splat::cpu::SimdLevel;
use serde_json::{Value, json};

use measure::{Bench, Case};
use scene::{SMALL, Scene, synthetic_cloud};

/// What went wrong, in words.
pub(crate) type Failure = Box<dyn std::error::Error>;

const USAGE: &str = "\
iteration [OPTIONS]
  --level LEVEL      avx512, avx2, neon, scalar; default: the best of this machine
  --rounds N         iterations kept per case (default 12), the cases of a group taking turns
  --only GROUPS      some of channels,size,mask,views,threads,growth,memory,trained; comma-separated
  --ply FILE --scene FOLDER --image NAME [--shrink N]
                     measures this cloud, seen by that image of a COLMAP scene, too (group `trained`)
  --export-ply FILE  writes the synthetic cloud of --gaussians N (default 20000) and ends
  --export-scene FOLDER
                     writes splats.ply, images/ and sparse/0/ of the synthetic scene, for another program, and ends
  --size WxH         of --export-scene (default 708x522)";

const LARGE: (u32, u32) = (1416, 1044);
const GROUPS: [&str; 8] = ["channels", "size", "mask", "views", "threads", "growth", "memory", "trained"];

struct Arguments {
    simd: SimdLevel,
    rounds: u32,
    only: Vec<String>,
    ply: Option<PathBuf>,
    scene: Option<PathBuf>,
    image: String,
    shrink: u32,
    export_ply: Option<PathBuf>,
    export_scene: Option<PathBuf>,
    gaussians: usize,
    size: (u32, u32),
    peak_of: Option<usize>,
}

impl Default for Arguments {
    fn default() -> Self {
        Self {
            simd: SimdLevel::Auto,
            rounds: 12,
            only: GROUPS.map(String::from).to_vec(),
            ply: None,
            scene: None,
            image: String::new(),
            shrink: 1,
            export_ply: None,
            export_scene: None,
            gaussians: 20_000,
            size: SMALL,
            peak_of: None,
        }
    }
}

fn level(word: &str) -> Result<SimdLevel, Failure> {
    Ok(match word {
        "avx512" => SimdLevel::Avx512,
        "avx2" => SimdLevel::Avx2,
        "neon" => SimdLevel::Neon,
        "scalar" => SimdLevel::Scalar,
        _ => return Err(format!("there is no level {word}").into()),
    })
}

/// `None` where only help was asked for.
fn arguments() -> Result<Option<Arguments>, Failure> {
    let mut read = Arguments::default();
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        if word == "--help" {
            println!("{USAGE}");
            return Ok(None);
        }
        let value = words.next().ok_or_else(|| format!("{word} wants a value\n{USAGE}"))?;
        match word.as_str() {
            "--level" => read.simd = level(&value)?,
            "--rounds" => read.rounds = value.parse()?,
            "--only" => read.only = value.split(',').map(String::from).collect(),
            "--ply" => read.ply = Some(value.into()),
            "--scene" => read.scene = Some(value.into()),
            "--image" => read.image = value,
            "--shrink" => read.shrink = value.parse::<u32>()?.max(1),
            "--export-ply" => read.export_ply = Some(value.into()),
            "--export-scene" => read.export_scene = Some(value.into()),
            "--gaussians" => read.gaussians = value.parse()?,
            "--size" => {
                let (width, height) = value.split_once('x').ok_or("a size is WIDTHxHEIGHT")?;
                read.size = (width.parse()?, height.parse()?);
            }
            "--peak-of" => read.peak_of = Some(value.parse()?),
            _ => return Err(format!("there is no {word}\n{USAGE}").into()),
        }
    }
    match read.only.iter().find(|group| !GROUPS.contains(&group.as_str())) {
        Some(group) => Err(format!("there is no group {group}; groups: {}", GROUPS.join(", ")).into()),
        None => Ok(Some(read)),
    }
}

/// Cases of one group take turns, so that what else the machine does hits all of them.
fn measured(arguments: &Arguments, cases: &[Case]) -> Result<Vec<Bench>, Failure> {
    let mut clouds = BTreeMap::new();
    for case in cases {
        if let Entry::Vacant(free) = clouds.entry(case.gaussians) {
            free.insert(synthetic_cloud(case.gaussians)?);
        }
    }
    let scene = |case: &Case| Scene::synthetic(clouds[&case.gaussians].clone(), case.size);
    let mut benches =
        cases.iter().map(|case| Bench::new(arguments.simd, *case, &scene(case))).collect::<Result<Vec<_>, _>>()?;
    take_turns(&mut benches, arguments.rounds)?;
    Ok(benches)
}

fn take_turns(benches: &mut [Bench], rounds: u32) -> Result<(), Failure> {
    // Two by two: an iteration that follows one of its own kind finds caches as training does.
    for _ in 0..=rounds.div_ceil(2) {
        for bench in &mut *benches {
            bench.run()?;
            bench.run()?;
        }
    }
    Ok(())
}

fn cases(group: &str) -> Vec<Case> {
    let plain = Case::PLAIN;
    match group {
        "channels" => [20_000, 100_000, 300_000]
            .into_iter()
            .flat_map(|gaussians| [false, true].map(|planes| Case { gaussians, planes, ..plain }))
            .collect(),
        "size" => vec![plain, Case { planes: false, size: LARGE, ..plain }, Case { size: LARGE, ..plain }],
        "mask" => {
            let shares = [(1.0, false), (0.15, false), (0.15, true)];
            let cases = |size| shares.map(|(share, sparse)| Case { size, share, sparse, ..plain });
            [SMALL, LARGE].into_iter().flat_map(cases).collect()
        }
        "views" => vec![
            Case { gaussians: 20_000, patches: 25_600, ..plain },
            plain,
            Case { patches: 25_600, ..plain },
            Case { patches: 102_400, ..plain },
            Case { patches: 25_600, share: 0.15, ..plain },
        ],
        "threads" => [Case { gaussians: 20_000, ..plain }, plain, Case { patches: 25_600, ..plain }]
            .into_iter()
            .flat_map(|case| [1, 2].map(|threads| Case { threads, ..case }))
            .collect(),
        "growth" => [100_000, 200_000, 400_000].map(|gaussians| Case { gaussians, ..plain }).to_vec(),
        _ => Vec::new(),
    }
}

fn lines(group: &str, benches: &[Bench], gflops: f64) -> Vec<Value> {
    let mut lines: Vec<Value> = benches.iter().map(|bench| report::case_line(group, bench, gflops)).collect();
    match group {
        "growth" => lines.push(report::growth_line("gaussians", &benches.iter().collect::<Vec<_>>())),
        "size" => lines.push(report::growth_line("pixels", &[&benches[0], &benches[2]])),
        "threads" | "trained" => {
            let pairs = benches.windows(2).filter(|two| two[1].case.threads == 2);
            lines.extend(pairs.map(|two| report::efficiency_line(&two[0], &two[1])));
        }
        _ => {}
    }
    lines
}

/// Peak memory of a process that does nothing but this case.
fn peak_of(gaussians: usize) -> Result<(), Failure> {
    let case = Case { gaussians, ..Case::PLAIN };
    let mut bench = Bench::new(SimdLevel::Auto, case, &Scene::synthetic(synthetic_cloud(gaussians)?, case.size))?;
    take_turns(std::slice::from_mut(&mut bench), 2)?;
    println!("{}", clock::peak_mib().map_or("nan".into(), |mib| mib.to_string()));
    Ok(())
}

/// MiB with 100, 200 and 400 thousand Gaussians, and what each further 100 thousand take.
fn memory_line() -> Result<Value, Failure> {
    let mut peaks = Vec::new();
    for gaussians in ["100000", "200000", "400000"] {
        let output = std::process::Command::new(std::env::current_exe()?).args(["--peak-of", gaussians]).output()?;
        peaks.push(String::from_utf8(output.stdout)?.trim().parse::<f64>()?);
    }
    Ok(json!({
        "program": "pgsag", "group": "memory", "width": SMALL.0, "height": SMALL.1, "channels": 8,
        "peak_mib": peaks.iter().map(|&mib| report::round(mib, 0)).collect::<Vec<_>>(),
        "mib_per_100k": report::round((peaks[2] - peaks[0]) / 3.0, 1),
    }))
}

fn trained_lines(arguments: &Arguments, gflops: f64) -> Result<Vec<Value>, Failure> {
    let (Some(ply), Some(folder)) = (&arguments.ply, &arguments.scene) else { return Ok(Vec::new()) };
    let scene = Scene::trained(files::read_ply(ply)?, folder, &arguments.image, arguments.shrink)?;
    let pinhole = scene.cameras[0].pinhole;
    let case = Case { gaussians: scene.cloud.len(), size: (pinhole.width, pinhole.height), ..Case::PLAIN };
    let two_views = Case { patches: 25_600, ..case };
    let on_two = |case: Case| [case, Case { threads: 2, ..case }];
    let one_thread = [Case { planes: false, ..case }, Case { sparse: true, ..two_views }];
    let cases = [one_thread, on_two(case), on_two(two_views)].concat();
    let mut benches =
        cases.iter().map(|case| Bench::new(arguments.simd, *case, &scene)).collect::<Result<Vec<_>, _>>()?;
    take_turns(&mut benches, arguments.rounds)?;
    Ok(lines("trained", &benches, gflops))
}

fn machine_line(simd: SimdLevel, gflops: f64) -> Value {
    let used = if simd == SimdLevel::Auto { SimdLevel::available()[0] } else { simd };
    json!({"simd": used, "fma_gflops_per_core": report::round(gflops, 1)})
}

fn main() -> Result<(), Failure> {
    let Some(arguments) = arguments()? else { return Ok(()) };
    if let Some(gaussians) = arguments.peak_of {
        return peak_of(gaussians);
    }
    if let Some(path) = &arguments.export_ply {
        return files::write_ply(path, &synthetic_cloud(arguments.gaussians)?);
    }
    if let Some(folder) = &arguments.export_scene {
        let scene = Scene::synthetic(synthetic_cloud(arguments.gaussians)?, arguments.size);
        return files::write_scene(folder, &scene);
    }
    let mut gflops = (0..20).map(|_| clock::fma_gflops()).fold(0.0, f64::max);
    for group in &arguments.only {
        let printed = match group.as_str() {
            "memory" => vec![memory_line()?],
            "trained" => trained_lines(&arguments, gflops)?,
            group => lines(group, &measured(&arguments, &cases(group))?, gflops),
        };
        printed.iter().for_each(|line| println!("{line}"));
        gflops = (0..5).map(|_| clock::fma_gflops()).fold(gflops, f64::max);
    }
    println!("{}", machine_line(arguments.simd, gflops));
    Ok(())
}
