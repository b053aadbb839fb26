//! `pgsag mask check`: what is wrong with masks, before anything depends on them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use pgsag_scene::files::raster::{decode_image, image_size};
use serde_json::json;

use super::{photographs, print};
use crate::commands::existing;
use crate::error::UserError;

/// Names of a mask, in the order in which they are looked for.
fn candidates(name: &str) -> [String; 5] {
    let path = Path::new(name);
    let stem = path.with_extension("").to_string_lossy().into_owned();
    [
        format!("{name}.png"),
        format!("{stem}.png"),
        name.to_owned(),
        format!("{stem}.mask.png"),
        format!("{stem}_mask.png"),
    ]
}

/// Values of 1 to 254 above this share of the pixels are more than the rings of a JPEG edge.
const GREY_SHARE: f64 = 0.02;
/// Bars of the histogram of coverage.
const BARS: usize = 10;

pub(super) fn run(images: &Path, masks: &Path, json: bool) -> Result<()> {
    let images = existing(images, "the folder of photographs")?;
    let masks = existing(masks, "the folder of masks")?;
    let mut users: BTreeMap<PathBuf, String> = BTreeMap::new();
    let (mut problems, mut missing, mut histogram) = (Vec::new(), Vec::new(), [0usize; BARS]);
    let names = photographs(&images)?;
    for name in &names {
        let found = candidates(name).into_iter().map(|candidate| masks.join(candidate)).find(|path| path.is_file());
        let Some(path) = found else {
            missing.push(name.clone());
            continue;
        };
        if let Some(other) = users.insert(path.clone(), name.clone()) {
            problems.push((name.clone(), "collision", format!("{} is the mask of {other} as well", path.display())));
        }
        match look(&images.join(name), &path) {
            Ok((coverage, found)) => {
                histogram[((coverage * BARS as f64) as usize).min(BARS - 1)] += 1;
                problems.extend(found.into_iter().map(|(code, text)| (name.clone(), code, text)));
            }
            Err(error) => problems.push((name.clone(), "unreadable", format!("{error:#}"))),
        }
    }
    problems.extend(missing.iter().map(|name| (name.clone(), "missing", "no mask: nothing is known of it".to_owned())));
    tell(&names, &problems, &histogram, json)?;
    let is_bad = |code: &str| matches!(code, "missing" | "size" | "collision" | "unreadable");
    match problems.iter().find(|(_, code, _)| is_bad(code)) {
        None => Ok(()),
        Some((name, _, text)) => {
            let count = problems.iter().filter(|(_, code, _)| is_bad(code)).count();
            let cause = format!("{text} ({count} such problems)");
            Err(UserError::new(name.clone(), cause, "make these masks again, or name them a.jpg.png").into())
        }
    }
}

fn tell(names: &[String], problems: &[(String, &str, String)], histogram: &[usize], json: bool) -> Result<()> {
    for (name, code, text) in problems {
        if json {
            print(&json!({ "image": name, "code": code, "text": text }).to_string())?;
        } else {
            print(&format!("{code:10} {name}: {text}"))?;
        }
    }
    if json {
        return print(&json!({ "images": names.len(), "problems": problems.len(), "coverage": histogram }).to_string());
    }
    print("coverage of the images:")?;
    for (bar, count) in histogram.iter().enumerate() {
        print(&format!("{:3} - {:3} %  {count}", bar * 10, bar * 10 + 10))?;
    }
    print(&format!("{} photographs, {} findings", names.len(), problems.len()))
}

/// Coverage of a mask, and what is wrong with it.
fn look(photograph: &Path, mask: &Path) -> Result<(f64, Vec<(&'static str, String)>)> {
    let read = |path: &Path| -> Result<(String, Vec<u8>)> {
        Ok((path.display().to_string(), std::fs::read(path).with_context(|| path.display().to_string())?))
    };
    let (file, bytes) = read(photograph)?;
    let size = image_size(&file, &bytes)?;
    let (file, bytes) = read(mask)?;
    let image = decode_image(&file, &bytes)?;
    let mut found = Vec::new();
    let is_like = u64::from(size.0) * u64::from(image.height) == u64::from(size.1) * u64::from(image.width);
    if size != (image.width, image.height) {
        let text = format!("{} x {}, the photograph {} x {}", image.width, image.height, size.0, size.1);
        found.push((if is_like { "scale" } else { "size" }, text));
    }
    let count = image.pixels.len().max(1) as f64;
    let share = |is: &dyn Fn(u8) -> bool| image.pixels.iter().filter(|pixel| is(pixel[0])).count() as f64 / count;
    let (coverage, grey) = (share(&|value| value >= 128), share(&|value| value != 0 && value != 255));
    if coverage == 0.0 {
        found.push(("empty", "says that there is no building".into()));
    }
    if coverage == 1.0 {
        found.push(("full", "says that there is nothing but building".into()));
    }
    if grey > GREY_SHARE {
        found.push(("grey", format!("{:.1} % of its values are neither 0 nor 255; 128 and above count", 100.0 * grey)));
    }
    Ok((coverage, found))
}
