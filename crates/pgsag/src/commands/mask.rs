//! `pgsag mask`: photographs in, building masks out, one at a time; the same line again goes on.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use anyhow::{Context as _, Result};
use pgsag_models::everything::{EverythingOptions, segments};
use pgsag_models::mend::{Mending, mend};
use pgsag_models::{Detection, LanguageSegmenter, MaskChoice, Prompt, RuntimeKind, Sam2};
use pgsag_scene::files::raster::{decode_image, encode_mask_png};
use pgsag_scene::{Image, Map};
use serde::{Deserialize, Serialize};

use super::{cancel_on_signals, existing, print};
use crate::cli::{MaskArgs, MaskCommand, MaskLook, MaskMode, NetworkArgs, YesNo};
use crate::error::UserError;
use crate::networks::{self, LanguageOptions};
use crate::run::artifact::write_whole;
use crate::run::machine;
use crate::run::stage::Cancel;

mod check;
mod edits;
mod preview;

use edits::Edits;

/// Photographs above this are cut where a tile size is given, pixels.
const TILED_ABOVE_PX: u64 = 8_000_000;
/// Endings of photographs.
const ENDINGS: [&str; 6] = ["jpg", "jpeg", "png", "tif", "tiff", "webp"];

pub(super) fn run(command: &MaskCommand, json: bool) -> Result<()> {
    if let Some(MaskLook::Check { images, masks }) = &command.look {
        return check::run(images, masks, json);
    }
    let args = &command.make;
    let (Some(images), Some(output)) = (&args.images, &args.output) else {
        return Err(UserError::new("pgsag mask", "no photographs", "pgsag mask IMAGES -o MASKS").into());
    };
    let images = existing(images, "the folder of photographs")?;
    let edits = args.points.as_deref().map(Edits::read).transpose()?;
    if (args.mode == MaskMode::Points) != edits.is_some() {
        return Err(UserError::new("--points", "--mode points and a file of points go together", "give both").into());
    }
    let names = chosen(&images, args, edits.as_ref())?;
    let asker = Asker::new(args, edits)?;
    std::fs::create_dir_all(output).with_context(|| output.display().to_string())?;
    let mut records = read_records(output);
    records.retain(|name, _| images.join(name).is_file() && mask_path(output, name).is_file());
    let cancel = cancel_on_signals()?;
    let made = make_all(&asker, args, &images, output, &names, &mut records, &cancel, json);
    write_records(output, &asker.story, &records)?;
    let made = made?;
    if args.preview {
        preview::write(&images, output, &records)?;
    }
    if args.coco {
        preview::write_coco(output, &args.prompt, &records)?;
    }
    if !json {
        let covered: Vec<f64> = records.values().map(|record| record.coverage).collect();
        let mean = covered.iter().sum::<f64>() / covered.len().max(1) as f64;
        print(&format!("{made} masks made, {} there before; mean coverage {:.1} %", names.len() - made, 100.0 * mean))?;
    }
    Ok(())
}

/// What is remembered of a mask.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Record {
    /// Fingerprint of the photograph and of the settings.
    pub(super) key: String,
    /// Width and height, pixels.
    pub(super) size: [u32; 2],
    /// Share of the image that is marked.
    pub(super) coverage: f64,
    /// What was found.
    pub(super) detections: Vec<Detection>,
    /// What it took.
    pub(super) secs: f64,
}

/// How the key of a mask that was corrected by points begins.
const CORRECTED: &str = "points-";

impl Record {
    fn is_corrected(&self) -> bool {
        self.key.starts_with(CORRECTED)
    }
}

/// `run.json`.
#[derive(Debug, Serialize, Deserialize)]
struct Story {
    version: String,
    models: BTreeMap<String, String>,
    settings: BTreeMap<String, String>,
    images: BTreeMap<String, Record>,
}

const RECORDS: &str = "run.json";

fn read_records(output: &Path) -> BTreeMap<String, Record> {
    let text = std::fs::read_to_string(output.join(RECORDS)).unwrap_or_default();
    serde_json::from_str::<Story>(&text).map(|story| story.images).unwrap_or_default()
}

fn write_records(
    output: &Path,
    story: &[BTreeMap<String, String>; 2],
    records: &BTreeMap<String, Record>,
) -> Result<()> {
    let [models, settings] = story.clone();
    let story = Story { version: env!("CARGO_PKG_VERSION").into(), models, settings, images: records.clone() };
    write_whole(&output.join(RECORDS), serde_json::to_string_pretty(&story)?.as_bytes())
}

/// Names of photographs below a folder, `/` between their parts, sorted.
pub(super) fn photographs(images: &Path) -> Result<Vec<String>> {
    let (mut open, mut names) = (vec![PathBuf::new()], Vec::new());
    while let Some(folder) = open.pop() {
        let path = images.join(&folder);
        for entry in std::fs::read_dir(&path).with_context(|| path.display().to_string())? {
            let entry = entry?;
            let name = folder.join(entry.file_name());
            if entry.file_name().to_string_lossy().starts_with('.') {
                continue;
            }
            if entry.path().is_dir() {
                open.push(name);
            } else if ENDINGS.iter().any(|ending| name.extension().is_some_and(|has| has.eq_ignore_ascii_case(ending)))
            {
                names.push(name.to_string_lossy().replace('\\', "/"));
            }
        }
    }
    names.sort();
    if names.is_empty() {
        let cause = format!("holds no photographs ({})", ENDINGS.join(", "));
        return Err(UserError::at(images, cause, "give the folder that does").into());
    }
    Ok(names)
}

/// The photographs to do.
fn chosen(images: &Path, args: &MaskArgs, edits: Option<&Edits>) -> Result<Vec<String>> {
    let mut names = photographs(images)?;
    if let Some(edits) = edits {
        edits.must_be_among(&names)?;
        names.retain(|name| edits.of(name).is_some());
    }
    if let Some(pattern) = &args.only {
        names.retain(|name| fits(pattern, name));
        if names.is_empty() {
            return Err(UserError::new("--only", format!("no photograph fits {pattern:?}"), "* is any text").into());
        }
    }
    Ok(names)
}

/// Whether a name fits a pattern in which `*` is any text.
fn fits(pattern: &str, name: &str) -> bool {
    let mut parts = pattern.split('*');
    let Some(mut rest) = name.strip_prefix(parts.next().unwrap_or_default()) else { return false };
    let parts: Vec<&str> = parts.collect();
    let Some((last, middle)) = parts.split_last() else { return rest.is_empty() };
    for part in middle {
        let Some(at) = rest.find(part) else { return false };
        rest = &rest[at + part.len()..];
    }
    rest.ends_with(last)
}

/// Who is asked.
enum Networks {
    Language(Box<LanguageSegmenter>),
    Segmenter(Box<Sam2>),
}

/// The networks, the question, and what is told about both.
struct Asker {
    networks: Networks,
    mode: MaskMode,
    prompt: Prompt,
    mending: Mending,
    edits: Option<Edits>,
    tile_px: u32,
    /// Models with their hashes, and settings.
    story: [BTreeMap<String, String>; 2],
}

impl Asker {
    fn new(args: &MaskArgs, edits: Option<Edits>) -> Result<Self> {
        let options = options(args)?;
        networks::must_be_share("--text-threshold", args.text_threshold.into(), 1.0)?;
        let threads = if args.networks.threads == 0 { machine::thread_count() } else { args.networks.threads };
        let prompt = Prompt {
            text: args.prompt.clone(),
            box_threshold: args.box_threshold,
            text_threshold: args.text_threshold,
        };
        let (networks, bundles) = if args.mode == MaskMode::Language {
            let bundles = networks::bundles(&options)?.to_vec();
            (Networks::Language(Box::new(networks::wing(&options, threads)?.networks)), bundles)
        } else {
            let models = networks::models_folder(&options.models)?;
            let bundle = networks::bundle_of(&models, pgsag_models::bundle::BundleKind::Segmenter, &options.segmenter)?;
            let engine = networks::engine(options.runtime, &options.device, threads)?;
            (Networks::Segmenter(Box::new(bundle.segmenter(&engine)?)), vec![bundle])
        };
        let mending = Mending { hole_px: args.fill_holes, speck_px: args.min_area, grow_px: args.dilate };
        let models = bundles
            .iter()
            .map(|bundle| {
                let manifest = bundle.folder.join(pgsag_models::bundle::MANIFEST);
                Ok((bundle.manifest.name.clone(), pgsag_models::bundle::sha256_of(&manifest)?))
            })
            .collect::<Result<BTreeMap<_, _>>>()?;
        let said = [
            ("mode", format!("{:?}", args.mode).to_lowercase()),
            ("prompt", args.prompt.clone()),
            ("thresholds", format!("{} {}", args.box_threshold, args.text_threshold)),
            ("choice", args.choice.clone()),
            ("tile", format!("{} {}", args.tile, args.overlap)),
            ("mending", format!("{mending:?}")),
            ("runtime", options.runtime.name().to_owned()),
        ];
        let settings = said.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        let (mode, tile_px) = (args.mode, args.tile);
        Ok(Self { networks, mode, prompt, mending, edits, tile_px, story: [models, settings] })
    }

    /// Fingerprint of a photograph, the settings and, where there are any, its points.
    fn key(&self, name: &str, bytes: &[u8]) -> Result<String> {
        let points = self.edits.as_ref().and_then(|edits| edits.of(name));
        let said = serde_json::to_string(&(&self.story, points))?;
        let mut hasher = blake3::Hasher::new();
        hasher.update(said.as_bytes()).update(bytes);
        let word = if self.mode == MaskMode::Points { CORRECTED } else { "" };
        Ok(format!("{word}{}", &hasher.finalize().to_hex()[..32]))
    }

    /// The mask of a photograph; `before` is the one that points change.
    fn mask(
        &self,
        name: &str,
        image: &Image,
        before: Option<Map<bool>>,
        cancel: &Cancel,
    ) -> Result<(Map<bool>, Vec<Detection>)> {
        let keep_going = || stop_if_asked(cancel);
        let (mut mask, detections) = match &self.networks {
            Networks::Language(networks) => {
                let is_large = u64::from(image.width) * u64::from(image.height) > TILED_ABOVE_PX;
                let found = if is_large || self.tile_px == 0 {
                    networks.find(image, &self.prompt, &keep_going)?
                } else {
                    networks.find_whole(image, &self.prompt, &keep_going)?
                };
                (found.mask, found.detections)
            }
            Networks::Segmenter(segmenter) if self.mode == MaskMode::Everything => {
                let mut mask = Map::filled(image.width, image.height, false);
                for segment in segments(segmenter, image, &EverythingOptions::default(), &keep_going)? {
                    segment.mark(&mut mask);
                }
                (mask, Vec::new())
            }
            Networks::Segmenter(segmenter) => {
                let edits = self.edits.as_ref().and_then(|edits| edits.of(name)).unwrap_or_default();
                (edits::apply(segmenter, (name, image), before, edits)?, Vec::new())
            }
        };
        mend(&mut mask, &self.mending);
        Ok((mask, detections))
    }
}

/// What was typed as the settings of the networks.
fn options(args: &MaskArgs) -> Result<LanguageOptions> {
    let NetworkArgs { models_dir, detector, segmenter, runtime, device, .. } = &args.networks;
    let mask = match args.choice.as_str() {
        "single" => MaskChoice::Single,
        "stable" => MaskChoice::Stable,
        "best" => MaskChoice::Best,
        other => {
            return Err(
                UserError::new(format!("--choice {other}"), "is no choice", "use single, stable or best").into()
            );
        }
    };
    Ok(LanguageOptions {
        models: models_dir.as_ref().map(|path| path.to_string_lossy().into_owned()).unwrap_or_default(),
        detector: detector.clone(),
        segmenter: segmenter.clone(),
        runtime: runtime_kind(runtime)?,
        device: device.clone(),
        words: args.prompt.clone(),
        box_threshold: args.box_threshold,
        mask,
        tile_px: args.tile,
        tile_overlap: args.overlap,
    })
}

/// A runtime as typed.
pub(super) fn runtime_kind(typed: &str) -> Result<RuntimeKind> {
    match typed {
        "rten" => Ok(RuntimeKind::Rten),
        "ort" => Ok(RuntimeKind::Ort),
        _ => Err(UserError::new(format!("--runtime {typed}"), "is no runtime", "use rten or ort").into()),
    }
}

/// Where the mask of a photograph goes.
pub(super) fn mask_path(output: &Path, name: &str) -> PathBuf {
    output.join(format!("{name}.png"))
}

/// Records are written again after so many masks, so that a kill costs no more than these.
const RECORDS_EVERY: usize = 20;

#[expect(clippy::too_many_arguments, reason = "one caller; a struct would only rename them")]
fn make_all(
    asker: &Asker,
    args: &MaskArgs,
    images: &Path,
    output: &Path,
    names: &[String],
    records: &mut BTreeMap<String, Record>,
    cancel: &Cancel,
    json: bool,
) -> Result<usize> {
    let (next, made) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let shared = Mutex::new((std::mem::take(records), None::<anyhow::Error>));
    let work = || {
        while let Some(name) = names.get(next.fetch_add(1, Ordering::Relaxed)) {
            let known = shared.lock().map(|guard| guard.0.get(name).cloned()).ok().flatten();
            let done = make_one(asker, args, images, output, name, known, cancel);
            let Ok(mut guard) = shared.lock() else { return };
            match done {
                Ok(Some(record)) => {
                    let count = made.fetch_add(1, Ordering::Relaxed) + 1;
                    let told = tell(name, &record, json);
                    guard.0.insert(name.clone(), record);
                    let kept = if count.is_multiple_of(RECORDS_EVERY) {
                        write_records(output, &asker.story, &guard.0)
                    } else {
                        Ok(())
                    };
                    if let Err(error) = told.and(kept) {
                        guard.1.get_or_insert(error);
                        return;
                    }
                }
                Ok(None) => {}
                Err(error) => {
                    guard.1.get_or_insert(error);
                    next.store(names.len(), Ordering::Relaxed);
                    return;
                }
            }
        }
    };
    std::thread::scope(|scope| (0..args.jobs.max(1)).for_each(|_| drop(scope.spawn(work))));
    let (found, failure) = shared.into_inner().map_err(|_| anyhow::anyhow!("a thread broke"))?;
    *records = found;
    failure.map_or(Ok(made.into_inner()), Err)
}

fn tell(name: &str, record: &Record, json: bool) -> Result<()> {
    if json {
        let mut line = serde_json::to_value(record)?;
        line["image"] = name.into();
        return print(&line.to_string());
    }
    let Record { coverage, detections, secs, .. } = record;
    print(&format!("{name}: {} boxes, {:.1} % of the image, {secs:.1} s", detections.len(), 100.0 * coverage))
}

/// Ends the command where Ctrl-C or a supervisor asked for it; what is done stays done.
fn stop_if_asked(cancel: &Cancel) -> Result<()> {
    Ok(cancel.check()?)
}

/// One mask; `None` where it is there already.
fn make_one(
    asker: &Asker,
    args: &MaskArgs,
    images: &Path,
    output: &Path,
    name: &str,
    known: Option<Record>,
    cancel: &Cancel,
) -> Result<Option<Record>> {
    stop_if_asked(cancel)?;
    let start = Instant::now();
    let path = images.join(name);
    let bytes = std::fs::read(&path).with_context(|| path.display().to_string())?;
    let (key, target) = (asker.key(name, &bytes)?, mask_path(output, name));
    // What was corrected by hand stays until it is made again on purpose.
    let is_kept = |record: &Record| record.key == key || asker.mode != MaskMode::Points && record.is_corrected();
    if args.resume == YesNo::Yes && target.is_file() && known.as_ref().is_some_and(is_kept) {
        return Ok(None);
    }
    let image = decode_image(&path.display().to_string(), &bytes)?;
    drop(bytes);
    let before = if asker.mode == MaskMode::Points { edits::mask_before(&target)? } else { None };
    let (mask, detections) = asker.mask(name, &image, before, cancel)?;
    if let Some(folder) = target.parent() {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    write_whole(&target, &encode_mask_png(&mask))?;
    let marked = mask.values.iter().filter(|inside| **inside).count();
    let coverage = marked as f64 / mask.values.len().max(1) as f64;
    let secs = start.elapsed().as_secs_f64();
    Ok(Some(Record { key, size: [image.width, image.height], coverage, detections, secs }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_fit_names() {
        for (pattern, name, wanted) in [
            ("*", "a/b.jpg", true),
            ("a/*.jpg", "a/b.jpg", true),
            ("a/*.png", "a/b.jpg", false),
            ("*b*", "a/b.jpg", true),
            ("b.jpg", "a/b.jpg", false),
            ("a*b*b", "ab", false),
            ("a/b.jpg", "a/b.jpg", true),
        ] {
            assert_eq!(fits(pattern, name), wanted, "{pattern} {name}");
        }
    }
}
