//! Masks made worse on purpose, and how good masks and identities of a run are against the truth.
//!
//! `masks corrupt MASKS OUT [PX]`: of the masks in a folder 30 % are dilated by PX (15), 10 % say that there is no
//! building, and each gets three false blobs beside its buildings; seeded, so always the same. `masks judge RUN TRUTH`:
//! pixel IoU before and after refinement.
#![expect(clippy::print_stdout, reason = "an example speaks on standard output")]

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use pgsag::run::artifact::Artifact as _;
use pgsag::stages::import::Imported;
use pgsag_group::distance::signed_distance;
use pgsag_scene::Map;
use pgsag_scene::files::raster::{decode_mask, encode_mask_png};
use pgsag_scene::numbers::SplitMix64;

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let path = |at: usize| words.get(at).map(PathBuf::from).context("see the head of this example for its arguments");
    match words.first().map(String::as_str) {
        Some("corrupt") => {
            let reach = words.get(3).map_or(Ok(15.0), |px| px.parse()).context("PX is a number")?;
            corrupt(&path(1)?, &path(2)?, reach)
        }
        Some("judge") => judge(&path(1)?, &path(2)?),
        _ => bail!("use corrupt or judge"),
    }
}

fn read(path: &Path) -> Result<(String, Vec<u8>)> {
    let name = path.display().to_string();
    let bytes = fs::read(path).with_context(|| name.clone())?;
    Ok((name, bytes))
}

fn mask(path: &Path) -> Result<Map<bool>> {
    let (name, bytes) = read(path)?;
    Ok(decode_mask(&name, &bytes)?)
}

fn corrupt(from: &Path, to: &Path, reach_px: f32) -> Result<()> {
    fs::create_dir_all(to)?;
    let mut names: Vec<String> = fs::read_dir(from)?
        .map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()))
        .collect::<Result<_>>()?;
    names.sort();
    let mut stream = SplitMix64::new(1);
    for at in (1..names.len()).rev() {
        names.swap(at, stream.below(at + 1));
    }
    let (dilated, removed) = (names.len() * 3 / 10, names.len() * 4 / 10);
    for (at, name) in names.iter().enumerate() {
        let given = mask(&from.join(name))?;
        let mut worse = given.clone();
        if at < dilated {
            worse.values = signed_distance(&given).values.iter().map(|d| *d <= reach_px).collect();
        } else if at < removed {
            worse.values.fill(false);
        }
        for _ in 0..3 {
            add_blob(&mut worse, &given, &mut stream);
        }
        fs::write(to.join(name), encode_mask_png(&worse))?;
    }
    println!(
        "{} masks: {dilated} dilated by {reach_px} px, {} emptied, three blobs each",
        names.len(),
        removed - dilated
    );
    Ok(())
}

/// A disc about a pixel that shows no building.
fn add_blob(worse: &mut Map<bool>, given: &Map<bool>, stream: &mut SplitMix64) {
    let (width, height) = (given.width, given.height);
    let radius = stream.range(0.03, 0.07) * f64::from(width);
    for _ in 0..100 {
        let (x, y) = (stream.below(width as usize) as u32, stream.below(height as usize) as u32);
        if given.at(x, y) {
            continue;
        }
        for v in 0..height {
            for u in 0..width {
                let (dx, dy) = (f64::from(u) - f64::from(x), f64::from(v) - f64::from(y));
                if dx * dx + dy * dy <= radius * radius {
                    worse.set(u, v, true);
                }
            }
        }
        return;
    }
}

fn judge(run: &Path, truth: &Path) -> Result<()> {
    let imported = Imported::read(&run.join("01-import"))?;
    let mut sums = [[0u64; 2]; 2];
    for (at, view) in imported.scene.views.iter().enumerate() {
        let stem = Path::new(&view.name).with_extension("png");
        let truth = mask(&truth.join("masks").join(stem))?;
        let batch = format!("i{:03}", at / pgsag::stages::BATCH);
        let before = run.join("03-masks").join(&batch).join(format!("{at:05}.mask.png"));
        let after = run.join("05-refine").join(&batch).join("masks").join(format!("{}.png", view.name));
        for (sum, path) in sums.iter_mut().zip([before, after]) {
            if !path.exists() {
                continue;
            }
            let found = mask(&path)?;
            let truth = truth.resized(found.width, found.height);
            let both = |rule: fn(bool, bool) -> bool| {
                found.values.iter().zip(&truth.values).filter(|(a, b)| rule(**a, **b)).count() as u64
            };
            sum[0] += both(|a, b| a && b);
            sum[1] += both(|a, b| a || b);
        }
    }
    let iou = |sum: [u64; 2]| sum[0] as f64 / sum[1].max(1) as f64;
    println!("IoU of the masks {:.4}, refined {:.4}", iou(sums[0]), iou(sums[1]));
    Ok(())
}
