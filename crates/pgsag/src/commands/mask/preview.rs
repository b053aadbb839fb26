//! Masks to look at: each over its photograph, on one page that begins with the most unusual; and as COCO annotations.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context as _, Result};
use pgsag_models::rle;
use pgsag_scene::files::raster::{decode_image, decode_mask, encode_jpeg};
use serde_json::json;

use super::{Record, mask_path};
use crate::run::artifact::write_whole;

/// Longest side of an overlay, pixels.
const OVERLAY_PX: f64 = 800.0;
/// Colour of what is marked, and how much of it is mixed in, of 256.
const TINT: [u32; 3] = [255, 60, 0];
const TINT_SHARE: u32 = 110;

/// How unusual a coverage is: its distance from the median, in medians of such distances.
fn anomalies(records: &BTreeMap<String, Record>) -> Vec<(f64, &str)> {
    let middle = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(0.0)
    };
    let median = middle(records.values().map(|record| record.coverage).collect());
    let spread = middle(records.values().map(|record| (record.coverage - median).abs()).collect()).max(1e-3);
    let unusual = |record: &Record| (record.coverage - median).abs() / spread;
    let mut order: Vec<(f64, &str)> = records.iter().map(|(name, record)| (unusual(record), name.as_str())).collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(b.1)));
    order
}

/// Writes `preview/<name>.jpg` and `preview/index.html`.
pub(super) fn write(images: &Path, output: &Path, records: &BTreeMap<String, Record>) -> Result<()> {
    let folder = output.join("preview");
    let mut page = String::from(
        "<!doctype html><meta charset=utf-8><title>Masks</title><style>body{font:14px sans-serif}figure{display:inline-block;margin:6px}img{max-width:380px;display:block}</style>\n",
    );
    for (unusual, name) in anomalies(records) {
        overlay(images, output, &folder, name)?;
        let shown = name.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
        let coverage = 100.0 * records[name].coverage;
        writeln!(
            page,
            "<figure><img loading=lazy src=\"{shown}.jpg\"><figcaption>{shown}: {coverage:.1} %, {unusual:.1} from usual</figcaption></figure>"
        )?;
    }
    std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    write_whole(&folder.join("index.html"), page.as_bytes())
}

fn overlay(images: &Path, output: &Path, folder: &Path, name: &str) -> Result<()> {
    let read = |path: &Path| std::fs::read(path).with_context(|| path.display().to_string());
    let image = decode_image(name, &read(&images.join(name))?)?;
    let mask = decode_mask(name, &read(&mask_path(output, name))?)?;
    let scale = (OVERLAY_PX / f64::from(image.width.max(image.height))).min(1.0);
    let side = |side: u32| ((f64::from(side) * scale) as u32).max(1);
    let mut small = image.resized(side(image.width), side(image.height));
    let marked = mask.resized(small.width, small.height);
    for (pixel, _) in small.pixels.iter_mut().zip(&marked.values).filter(|(_, inside)| **inside) {
        *pixel =
            std::array::from_fn(|c| ((u32::from(pixel[c]) * (256 - TINT_SHARE) + TINT[c] * TINT_SHARE) / 256) as u8);
    }
    let path = folder.join(format!("{name}.jpg"));
    if let Some(parent) = path.parent() {
        std::fs::create_dir_all(parent).with_context(|| parent.display().to_string())?;
    }
    write_whole(&path, &encode_jpeg(&small, 85))
}

/// Writes `detections.coco.json`: one annotation per photograph, the whole mask in run lengths.
pub(super) fn write_coco(output: &Path, words: &str, records: &BTreeMap<String, Record>) -> Result<()> {
    let (mut images, mut annotations) = (Vec::new(), Vec::new());
    for (index, (name, record)) in records.iter().enumerate() {
        let [width, height] = record.size;
        let path = mask_path(output, name);
        let bytes = std::fs::read(&path).with_context(|| path.display().to_string())?;
        let mask = decode_mask(name, &bytes)?;
        let area = mask.values.iter().filter(|inside| **inside).count();
        images.push(json!({ "id": index + 1, "file_name": name, "width": width, "height": height }));
        annotations.push(json!({
            "id": index + 1, "image_id": index + 1, "category_id": 1, "iscrowd": 1, "area": area,
            "segmentation": { "size": [height, width], "counts": rle::encode(&mask) },
        }));
    }
    let categories = [json!({ "id": 1, "name": words })];
    let file = json!({ "images": images, "annotations": annotations, "categories": categories });
    write_whole(&output.join("detections.coco.json"), serde_json::to_string(&file)?.as_bytes())
}
