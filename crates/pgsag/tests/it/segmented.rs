//! A model that finds buildings: by words in the stage of masks, by points in refinement. The model is a flood fill, the
//! photographs are painted: every building in a colour of its own on green.

use std::sync::Arc;

use pgsag::config::Config;
use pgsag::pipeline::PIPELINE;
use pgsag::run::Run;
use pgsag::run::execute::{InProcess, Limits};
use pgsag::run::progress::{Progress, Silent};
use pgsag::run::stage::{Cancel, Job, Stage};
use pgsag::stages::{masks, refine};
use pgsag::town_folder::{FolderOptions, write_town_with};
use pgsag_group::distance::signed_distance;
use pgsag_group::{Ask, SegmentError, Segmenter};
use pgsag_scene::files::raster::{decode_mask, encode_png};
use pgsag_scene::synthetic::{Town, TownOptions};
use pgsag_scene::{Image, Map};

use super::*;

const GARDEN: [u8; 3] = [40, 110, 40];
/// How much too large the masks by words are, pixels.
const SLOPPY_PX: f32 = 3.0;

struct Flood;

impl Segmenter for Flood {
    fn segment(&self, image: &Image, ask: &Ask<'_>) -> Result<Vec<Map<bool>>, SegmentError> {
        let (width, height) = (image.width, image.height);
        match *ask {
            Ask::Text(words) => {
                assert_eq!(words, "buildings.");
                let exact = Map { width, height, values: image.pixels.iter().map(|rgb| *rgb != GARDEN).collect() };
                let values = signed_distance(&exact).values.iter().map(|d| *d <= SLOPPY_PX).collect();
                Ok(vec![Map { width, height, values }])
            }
            Ask::Points { positive, .. } => {
                let colors: Vec<_> = positive.iter().map(|at| image.at(at[0] as u32, at[1] as u32)).collect();
                let is_one = |rgb: &[u8; 3]| *rgb != GARDEN && colors.contains(rgb);
                let one = Map { width, height, values: image.pixels.iter().map(is_one).collect() };
                Ok(vec![Map::filled(width, height, true), one])
            }
        }
    }

    fn everything(&self, image: &Image) -> Result<Option<Map<u32>>, SegmentError> {
        let number = |rgb: &[u8; 3]| u32::from(rgb[1]) + 1;
        let values = image.pixels.iter().map(number).collect();
        Ok(Some(Map { width: image.width, height: image.height, values }))
    }
}

/// A painted town and the true masks of its views.
fn painted(folder: &Path) -> Vec<Map<bool>> {
    let options = TownOptions {
        house_count: 3,
        row_house_count: 2,
        view_count: 8,
        width: 240,
        height: 180,
        gsd_m: 0.2,
        tree_count: 0,
        car_count: 0,
        point_count: 25_000,
        lossless: true,
        ..TownOptions::default()
    };
    let town = Town::generate(&options);
    let without_depth = FolderOptions { depth: false, ..FolderOptions::default() };
    write_town_with(&town, &without_depth, folder, &mut |_, _| ()).expect("written");
    let view = |at: usize| {
        let instances = town.photograph(at).instances;
        let color = |number: &u16| if *number == 0 { GARDEN } else { [200, 30 * (*number % 8) as u8, 50] };
        let pixels = instances.values.iter().map(color).collect();
        let image = Image { width: instances.width, height: instances.height, pixels };
        fs::write(folder.join("images").join(&town.scene.views[at].name), encode_png(&image)).expect("written");
        Map { width: image.width, height: image.height, values: instances.values.iter().map(|n| *n > 0).collect() }
    };
    (0..town.scene.views.len()).map(view).collect()
}

/// The rows up to refinement with a model behind masks, and behind refinement where `ask` holds.
fn table(ask: bool) -> &'static [Stage] {
    let mut rows: Vec<Stage> = PIPELINE[..5].to_vec();
    rows[2].run = |job: &Job<'_>| masks::make(job, Some(&Flood));
    rows[4].run = if ask { |job| refine::make(job, Some(&Flood)) } else { |job| refine::make(job, None) };
    Box::leak(rows.into_boxed_slice())
}

/// The mean IoU of the masks of a stage with the truth.
fn quality(run: &Run, stage: &str, truth: &[Map<bool>]) -> f64 {
    let mask = |view: usize| -> Map<bool> {
        let folder = run.stage_folder(stage);
        let found = match stage {
            "refine" => refine::building_of(&folder, view).expect("sound").expect("known"),
            _ => {
                let path = folder.join(format!("i000/{view:05}.mask.png"));
                decode_mask("mask", &fs::read(path).expect("a mask")).expect("sound")
            }
        };
        assert_eq!((found.width, found.height), (truth[view].width, truth[view].height));
        found
    };
    let iou = |view: usize| {
        let found = mask(view);
        let count = |rule: fn(bool, bool) -> bool| {
            found.values.iter().zip(&truth[view].values).filter(|(a, b)| rule(**a, **b)).count() as f64
        };
        count(|a, b| a && b) / count(|a, b| a || b).max(1.0)
    };
    (0..truth.len()).map(iou).sum::<f64>() / truth.len() as f64
}

fn execute(scene: &Path, folder: PathBuf, ask: bool, everything: bool) -> Run {
    let mut config = Config { scene: scene.display().to_string(), masks: "language".into(), ..Config::default() };
    config.coarse.stereo = false;
    config.refine.everything = everything;
    fs::create_dir_all(folder.join("log")).expect("a folder");
    let run = Run {
        folder,
        table: table(ask),
        settings: config.settings(),
        seed: 0,
        backend: "test".into(),
        kindred: Vec::new(),
        devices: Vec::new(),
    };
    let (cancel, progress): (Cancel, Arc<dyn Progress>) = (Cancel::default(), Arc::new(Silent));
    let launcher = InProcess { cancel: cancel.clone(), progress: Arc::clone(&progress) };
    let limits = Limits { jobs: 1, memory_bytes: 4 << 30, threads: 2, device_jobs: 1, device: None };
    run.execute(None, limits, &launcher, &cancel, &progress).expect("runs");
    run
}

#[test]
fn a_model_is_asked_by_words_and_then_by_points() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let scene = folder.path().join("scene");
    let truth = painted(&scene);
    let asked = execute(&scene, folder.path().join("asked"), true, false);
    let alone = execute(&scene, folder.path().join("alone"), false, false);
    let all = execute(&scene, folder.path().join("all"), true, true);
    let words = quality(&asked, "masks", &truth);
    let (with, without) = (quality(&asked, "refine", &truth), quality(&alone, "refine", &truth));
    assert!(words < 0.9, "words alone are sloppy: {words}");
    let all = quality(&all, "refine", &truth);
    assert!(all >= with && all > without, "{all} with everything queried, {with} without");
    assert!(with > 0.92 && with > without + 0.08, "words {words}, refined {without}, with points {with}");
}
