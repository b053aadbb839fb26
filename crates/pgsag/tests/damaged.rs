//! A hundred damaged scenes through the real binary: each gives one clear line and exit 2, and leaves no result.
//!
//! A sound scene of a few kilobytes is made once, copied for each case, damaged in one place, and imported. Damage that
//! only pixels show is looked for by the stages that decode pixels. The scene itself must stay as it was.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use pgsag_scene::files::colmap::{Encoding, Model};
use pgsag_scene::files::raster;
use pgsag_scene::numbers::SplitMix64;
use pgsag_scene::synthetic::{Town, TownOptions};
use rayon::prelude::*;
use tempfile::TempDir;

/// One damage: what it is called, and what it does to a scene's folder.
type Case = (String, Box<dyn Fn(&Path) + Sync + Send>);

fn case(name: impl Into<String>, damage: impl Fn(&Path) + Sync + Send + 'static) -> Case {
    (name.into(), Box::new(damage))
}

struct Sound {
    folder: TempDir,
    model: Model,
    names: Vec<String>,
}

/// The scene that all cases are copies of. It is made on rayon's threads, so it must not be asked for there first.
fn sound() -> &'static Sound {
    static SCENE: OnceLock<Sound> = OnceLock::new();
    SCENE.get_or_init(|| {
        let options = TownOptions {
            house_count: 2,
            row_house_count: 0,
            tree_count: 1,
            car_count: 0,
            view_count: 5,
            width: 48,
            height: 36,
            gsd_m: 0.9,
            point_count: 120,
            lossless: true,
            ..TownOptions::default()
        };
        let town = Town::generate(&options);
        let model = Model::from_scene(&town.scene);
        let folder = tempfile::tempdir().expect("temporary folder");
        let names: Vec<String> = town.scene.views.iter().map(|view| view.name.clone()).collect();
        for (index, name) in names.iter().enumerate() {
            let photograph = town.photograph(index);
            let building = photograph.instances.values.iter().map(|instance| *instance > 0).collect();
            let mask = pgsag_scene::Map { width: options.width, height: options.height, values: building };
            put(folder.path(), &format!("images/{name}"), &raster::encode_png(&photograph.image));
            put(folder.path(), &format!("masks/{name}"), &raster::encode_mask_png(&mask));
        }
        put_model(folder.path(), &model, Encoding::Binary);
        Sound { folder, model, names }
    })
}

fn put(folder: &Path, name: &str, bytes: &[u8]) {
    let path = folder.join(name);
    fs::create_dir_all(path.parent().expect("below a folder")).expect("folder");
    fs::write(path, bytes).expect("written");
}

fn put_model(folder: &Path, model: &Model, encoding: Encoding) {
    for (name, bytes) in model.encode(encoding) {
        put(folder, &format!("sparse/0/{name}"), &bytes);
    }
}

/// Every file below a folder with its bytes, sorted.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("listed") {
        let path = entry.expect("listed").path();
        if path.is_dir() {
            found.extend(contents(&path));
        } else {
            found.push((path.clone(), fs::read(&path).expect("read")));
        }
    }
    found.sort();
    found
}

fn copy_of_sound() -> TempDir {
    let (from, to) = (sound().folder.path(), tempfile::tempdir().expect("temporary folder"));
    for (path, bytes) in contents(from) {
        put(to.path(), &path.strip_prefix(from).expect("below").to_string_lossy(), &bytes);
    }
    to
}

fn pgsag(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pgsag")).args(arguments).env("RUST_BACKTRACE", "0").output().expect("started")
}

fn reconstruct(scene: &Path, run: &Path, until: &str) -> Output {
    let (scene, run) = (scene.to_string_lossy(), run.to_string_lossy());
    pgsag(&["reconstruct", &scene, "-o", &run, "--until", until, "--threads", "1", "--memory-limit", "1GiB"])
}

fn error_lines(output: &Output) -> Vec<String> {
    let text = String::from_utf8_lossy(&output.stderr);
    text.lines().filter(|line| line.starts_with("error:")).map(str::to_owned).collect()
}

/// What is wrong with how the program took a damage; `None` where it did well.
fn misbehaviour(output: &Output) -> Option<String> {
    let text = String::from_utf8_lossy(&output.stderr);
    let lines = error_lines(output);
    let clear = lines.len() == 1 && lines[0].len() > 20 && lines[0].contains("; ");
    if output.status.code() == Some(2) && clear && !text.contains("panicked") {
        return None;
    }
    Some(format!("exit {:?}, stderr: {text}", output.status.code()))
}

/// Names of stage folders and of `result` in a run: what would pass for a finished thing.
fn published(run: &Path, stage: &str) -> Vec<String> {
    let Ok(entries) = fs::read_dir(run) else { return Vec::new() };
    let names = entries.map(|entry| entry.expect("listed").file_name().to_string_lossy().into_owned());
    names.filter(|name| name == "result" || name.ends_with(&format!("-{stage}"))).collect()
}

/// Each case must fail at `until` with one line and exit 2.
fn all_refused(cases: &[Case], until: &str) {
    sound();
    let failed = |(name, damage): &Case| {
        let (scene, run) = (copy_of_sound(), tempfile::tempdir().expect("temporary folder"));
        damage(scene.path());
        let before = contents(scene.path());
        let output = reconstruct(scene.path(), run.path(), until);
        let whole = published(run.path(), until);
        let fault = misbehaviour(&output)
            .or_else(|| (!whole.is_empty()).then(|| format!("published {whole:?}")))
            .or_else(|| (contents(scene.path()) != before).then(|| "the scene was changed".to_owned()));
        fault.map(|fault| format!("{name}: {fault}"))
    };
    let faults: Vec<String> = cases.par_iter().filter_map(failed).collect();
    assert!(faults.is_empty(), "{} of {} cases:\n{}", faults.len(), cases.len(), faults.join("\n"));
}

#[test]
fn the_sound_scene_is_imported() {
    let run = tempfile::tempdir().expect("temporary folder");
    let output = reconstruct(sound().folder.path(), run.path(), "import");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(published(run.path(), "import"), ["01-import"]);
}

fn with_bytes(name: &str, file: &str, change: impl Fn(&mut Vec<u8>) + Sync + Send + 'static) -> Case {
    let file = file.to_owned();
    case(format!("{file}: {name}"), move |scene| {
        let mut bytes = fs::read(scene.join(&file)).expect("of the sound scene");
        change(&mut bytes);
        put(scene, &file, &bytes);
    })
}

fn without(file: &str) -> Case {
    let file = file.to_owned();
    case(format!("{file}: missing"), move |scene| fs::remove_file(scene.join(&file)).expect("removed"))
}

fn set_count(bytes: &mut [u8], change: fn(u64) -> u64) {
    let count = u64::from_le_bytes(bytes[..8].try_into().expect("eight"));
    bytes[..8].copy_from_slice(&change(count).to_le_bytes());
}

/// Files of the model cut, emptied, lengthened, with counts that lie.
fn torn_models() -> Vec<Case> {
    let mut cases = vec![
        case("no sparse folder", |scene| fs::remove_dir_all(scene.join("sparse")).expect("removed")),
        case("no images folder", |scene| fs::remove_dir_all(scene.join("images")).expect("removed")),
        case("nothing at all", |scene| {
            for name in ["sparse", "images", "masks"] {
                fs::remove_dir_all(scene.join(name)).expect("removed");
            }
        }),
    ];
    for name in ["cameras", "images", "points3D"] {
        let file = format!("sparse/0/{name}.bin");
        cases.extend([
            without(&file),
            with_bytes("empty", &file, Vec::clear),
            with_bytes("one byte", &file, |bytes| bytes.truncate(1)),
            with_bytes("count only", &file, |bytes| bytes.truncate(8)),
            with_bytes("last byte lost", &file, |bytes| bytes.truncate(bytes.len() - 1)),
            with_bytes("second half lost", &file, |bytes| bytes.truncate(bytes.len() / 2)),
            with_bytes("a byte too many", &file, |bytes| bytes.push(7)),
            with_bytes("first byte last", &file, |bytes| bytes.rotate_left(1)),
            with_bytes("count of 2^64 - 1", &file, |bytes| set_count(bytes, |_| u64::MAX)),
            with_bytes("count of 2^40", &file, |bytes| set_count(bytes, |_| 1 << 40)),
            with_bytes("count + 1", &file, |bytes| set_count(bytes, |count| count + 1)),
            with_bytes("count - 1", &file, |bytes| set_count(bytes, |count| count - 1)),
            with_bytes("all 0xFF", &file, |bytes| bytes.fill(0xFF)),
            with_bytes("a web page", &file, |bytes| *bytes = b"<!DOCTYPE html><html>404 Not Found</html>".to_vec()),
        ]);
    }
    cases
}

#[test]
fn torn_models_are_refused() {
    all_refused(&torn_models(), "import");
}

fn with_model(name: &str, change: impl Fn(&mut Model) + Sync + Send + 'static) -> Case {
    case(name, move |scene| {
        let mut model = sound().model.clone();
        change(&mut model);
        put_model(scene, &model, Encoding::Binary);
    })
}

/// A parameter of every camera: 0 focal length, 2 and 3 principal point.
fn with_parameter(name: &str, index: usize, value: f64) -> Case {
    with_model(name, move |model| model.cameras.values_mut().for_each(|camera| camera.params[index] = value))
}

/// Whole files that say impossible things.
fn impossible_models() -> Vec<Case> {
    let nan = f64::NAN;
    vec![
        with_parameter("focal length NaN", 0, nan),
        with_parameter("focal length 0", 0, 0.0),
        with_parameter("focal length negative", 0, -40.0),
        with_parameter("focal length infinite", 0, f64::INFINITY),
        with_parameter("principal point NaN", 2, nan),
        with_parameter("principal point infinite", 1, f64::NEG_INFINITY),
        with_model("width 0", |model| model.cameras.values_mut().for_each(|camera| camera.width = 0)),
        with_model("height 2^32 - 1", |model| model.cameras.values_mut().for_each(|camera| camera.height = u32::MAX)),
        with_model("camera of another shape", |model| model.cameras.values_mut().for_each(|camera| camera.width *= 3)),
        with_model("no cameras", |model| model.cameras.clear()),
        with_model("no images", |model| {
            model.images.clear();
            model.points.clear();
        }),
        with_model("one image", |model| {
            model.images.truncate(1);
            model.points.clear();
        }),
        with_model("image without its camera", |model| model.images[1].camera_id = 77),
        with_model("image number twice", |model| model.images[1].id = model.images[0].id),
        with_model("image name twice", |model| model.images[1].name = model.images[0].name.clone()),
        with_model("image name empty", |model| model.images[1].name.clear()),
        with_model("image name leads up", |model| model.images[1].name = "../../etc/passwd".into()),
        with_model("image name absolute", |model| model.images[1].name = "/etc/passwd".into()),
        with_model("image name unknown", |model| model.images[1].name = "nowhere.png".into()),
        with_model("image name with a line break", |model| model.images[1].name = "a\nerror: b.png".into()),
        with_model("rotation 0", |model| {
            model.images[0].camera_from_world.rotation = glam::DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0)
        }),
        with_model("rotation NaN", move |model| model.images[0].camera_from_world.rotation.x = nan),
        with_model("position NaN", move |model| model.images[0].camera_from_world.translation.y = nan),
        with_model("position infinite", |model| model.images[0].camera_from_world.translation.z = f64::INFINITY),
        with_model("point NaN", move |model| model.points[3].position_world.x = nan),
        with_model("point infinite", |model| model.points[3].position_world.z = f64::INFINITY),
        with_model("track to no image", |model| model.points[0].track[0].0 = 9999),
        with_model("track to no feature", |model| model.points[0].track[0].1 = u32::MAX),
        with_bytes("camera model 99", "sparse/0/cameras.bin", |bytes| bytes[12] = 99),
        with_bytes("camera model -1", "sparse/0/cameras.bin", |bytes| bytes[12..16].fill(0xFF)),
        with_bytes("name without an end", "sparse/0/images.bin", |bytes| {
            let start = 8 + 4 + 56 + 4;
            bytes.iter_mut().skip(start).for_each(|byte| *byte = (*byte).max(1));
        }),
        with_bytes("name not UTF-8", "sparse/0/images.bin", |bytes| bytes[8 + 4 + 56 + 4] = 0xC3),
    ]
}

#[test]
fn impossible_models_are_refused() {
    all_refused(&impossible_models(), "import");
}

/// The model as text, one file of it changed.
fn with_text(name: &str, file: &str, change: impl Fn(String) -> String + Sync + Send + 'static) -> Case {
    let file = format!("sparse/0/{file}.txt");
    case(format!("{file}: {name}"), move |scene| {
        fs::remove_dir_all(scene.join("sparse")).expect("removed");
        put_model(scene, &sound().model, Encoding::Text);
        let text = fs::read_to_string(scene.join(&file)).expect("of the sound scene");
        put(scene, &file, change(text).as_bytes());
    })
}

fn last_word_as(text: &str, word: &str) -> String {
    let kept = text.trim_end().rsplit_once(' ').map_or("", |(kept, _)| kept);
    format!("{kept} {word}\n")
}

fn damaged_texts() -> Vec<Case> {
    vec![
        with_text("a letter for a number", "cameras", |text| last_word_as(&text, "x")),
        with_text("NaN", "cameras", |text| last_word_as(&text, "nan")),
        with_text("a parameter missing", "cameras", |text| last_word_as(&text, "")),
        with_text("a parameter too many", "cameras", |text| format!("{} 1\n", text.trim_end())),
        with_text("unknown model", "cameras", |text| text.replace("PINHOLE", "PANHOLE")),
        with_text("twice", "cameras", |text| format!("{text}{text}")),
        with_text("empty", "cameras", |_| String::new()),
        with_text("empty", "images", |_| String::new()),
        with_text("a zero byte", "images", |text| format!("{text}\0\n")),
        with_text("half a line of features", "images", |text| format!("{} 1.5\n", text.trim_end())),
        with_text("a negative number", "images", |text| format!("{text}-4 1 0 0 0 0 0 0 1 b.png\n\n")),
        with_text("half a track", "points3D", |text| format!("{} 1\n", text.trim_end())),
        with_text("a short line", "points3D", |text| format!("{text}9 0.5 0.5\n")),
        with_text("a colour of 300", "points3D", |text| format!("{text}99999 0 0 1 300 0 0 0.5\n")),
        with_text("infinity", "points3D", |text| format!("{text}99999 0 inf 1 3 0 0 0.5\n")),
        case("cameras.txt: not UTF-8", |scene| {
            fs::remove_dir_all(scene.join("sparse")).expect("removed");
            put_model(scene, &sound().model, Encoding::Text);
            put(scene, "sparse/0/cameras.txt", b"\xFF\xFE1 PINHOLE");
        }),
    ]
}

#[test]
fn damaged_texts_are_refused() {
    all_refused(&damaged_texts(), "import");
}

/// A PNG of this size and one grey value.
fn grey_png(width: u32, height: u32) -> Vec<u8> {
    let count = width as usize * height as usize;
    raster::encode_mask_png(&pgsag_scene::Map { width, height, values: vec![true; count] })
}

/// Damage that headers of photographs and masks show.
fn damaged_headers() -> Vec<Case> {
    let (first, last) = (&sound().names[0], &sound().names[sound().names.len() - 1]);
    let mut cases = vec![without(&format!("images/{first}")), without(&format!("images/{last}"))];
    cases.push(case("a folder in place of a photograph", move |scene| {
        fs::remove_file(scene.join("images").join(first)).expect("removed");
        fs::create_dir(scene.join("images").join(first)).expect("made");
    }));
    for folder in ["images", "masks"] {
        let file = format!("{folder}/{first}");
        cases.extend([
            with_bytes("empty", &file, Vec::clear),
            with_bytes("three bytes", &file, |bytes| bytes.truncate(3)),
            with_bytes("header only by half", &file, |bytes| bytes.truncate(20)),
            with_bytes("prose", &file, |bytes| *bytes = b"this is not a photograph".to_vec()),
            with_bytes("zeros", &file, |bytes| bytes.fill(0)),
            with_bytes("width 0", &file, |bytes| bytes[16..20].fill(0)),
            with_bytes("another shape", &file, |bytes| *bytes = grey_png(36, 48)),
            with_bytes("a strip", &file, |bytes| *bytes = grey_png(2, 60)),
        ]);
    }
    cases
}

#[test]
fn damaged_headers_are_refused() {
    all_refused(&damaged_headers(), "import");
}

/// Headers are sound, pixels are not: found by the stages that decode them, with the file's name.
#[test]
fn damaged_pixels_are_refused() {
    let body = |folder: &str, name: &str, change: fn(&mut Vec<u8>)| {
        let folder = folder.to_owned();
        case(format!("{folder}: {name}"), move |scene| {
            for name in &sound().names {
                let path = scene.join(&folder).join(name);
                let mut bytes = fs::read(&path).expect("of the sound scene");
                change(&mut bytes);
                fs::write(&path, bytes).expect("written");
            }
        })
    };
    let half: fn(&mut Vec<u8>) = |bytes| bytes.truncate(bytes.len() / 2);
    let zeros: fn(&mut Vec<u8>) = |bytes| bytes.iter_mut().skip(45).take(20).for_each(|byte| *byte = 0);
    all_refused(&[body("masks", "second half lost", half), body("masks", "zeros inside", zeros)], "masks");
    all_refused(&[body("images", "second half lost", half), body("images", "zeros inside", zeros)], "train");
}

/// Arguments that cannot be meant: nothing is begun.
#[test]
fn impossible_arguments_are_refused() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let at = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    put(folder.path(), "full/thesis.txt", b"mine");
    put(folder.path(), "file", b"mine");
    put(folder.path(), "bad.toml", b"iterations = = 3");
    put(folder.path(), "unknown.toml", b"colour = 3");
    put(folder.path(), "bad.geojson", b"{\"type\": \"Polygon\", \"coordinates\": [[0, ");
    let scene = sound().folder.path().to_string_lossy().into_owned();
    let new = at("new");
    let mut lines: Vec<Vec<String>> = Vec::new();
    let mut line = |words: &[&str]| lines.push(words.iter().map(|word| (*word).to_owned()).collect());
    line(&["reconstruct", &at("nowhere"), "-o", &new]);
    line(&["reconstruct", &at("file"), "-o", &new]);
    line(&["reconstruct", &scene, "-o", &at("full")]);
    line(&["reconstruct", &scene, "-o", &at("file")]);
    line(&["plan", &at("nowhere")]);
    line(&["status", &at("full")]);
    line(&["status", &at("nowhere")]);
    line(&["job", "train", "g000", "--run", &at("full")]);
    line(&["score", &at("nowhere"), "--truth", &at("file")]);
    line(&["score", &at("file"), "--truth", &at("file")]);
    for options in [
        ["--masks", &at("nowhere")],
        ["--truth", &at("nowhere")],
        ["--aoi", &at("nowhere")],
        ["--aoi", &at("bad.geojson")],
        ["--config", &at("nowhere")],
        ["--config", &at("bad.toml")],
        ["--config", &at("unknown.toml")],
        ["--set", "colour=3"],
        ["--set", "train.iterations=many"],
        ["--set", "nonsense"],
        ["--until", "lunch"],
        ["--device", "abacus"],
        ["--simd", "mmx"],
        ["--engine", "steam"],
        ["--memory-limit", "lots"],
        ["--memory-limit", "1MiB"],
        ["--image-width", "wide"],
        ["--holdout", "1"],
    ] {
        line(&["reconstruct", &scene, "-o", &new, options[0], options[1]]);
    }
    let before = contents(folder.path());
    let failed = |line: &Vec<String>| {
        let words: Vec<&str> = line.iter().map(String::as_str).collect();
        let output = pgsag(&words);
        misbehaviour(&output).map(|fault| format!("pgsag {}: {fault}", line.join(" ")))
    };
    let faults: Vec<String> = lines.iter().filter_map(failed).collect();
    assert!(faults.is_empty(), "{} of {} lines:\n{}", faults.len(), lines.len(), faults.join("\n"));
    let kept = contents(folder.path()).into_iter().filter(|(path, _)| !path.starts_with(&new)).collect::<Vec<_>>();
    assert_eq!(kept, before, "a file of the user was changed");
    assert_eq!(published(Path::new(&new), "import"), Vec::<String>::new());
}

/// Any single bit of the model flipped: read or refused, never a panic, never two lines.
#[test]
fn flipped_bits_never_panic() {
    let mut random = SplitMix64::new(20);
    let mut cases = Vec::new();
    for index in 0..36 {
        let file = format!("sparse/0/{}.bin", ["cameras", "images", "points3D"][index % 3]);
        let length = fs::read(sound().folder.path().join(&file)).expect("read").len();
        // Half of the flips in the first hundred bytes, where the counts and numbers are.
        let (byte, bit) = (random.below(if index % 2 == 0 { length.min(100) } else { length }), random.below(8));
        cases.push(with_bytes(&format!("bit {bit} of byte {byte}"), &file, move |bytes| bytes[byte] ^= 1 << bit));
    }
    let failed = |(name, damage): &Case| {
        let (scene, run) = (copy_of_sound(), tempfile::tempdir().expect("temporary folder"));
        damage(scene.path());
        let output = reconstruct(scene.path(), run.path(), "import");
        let fault = if output.status.success() { None } else { misbehaviour(&output) };
        fault.map(|fault| format!("{name}: {fault}"))
    };
    let faults: Vec<String> = cases.par_iter().filter_map(failed).collect();
    assert!(faults.is_empty(), "{} of {} flips:\n{}", faults.len(), cases.len(), faults.join("\n"));
}
