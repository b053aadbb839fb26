//! A written town is an ordinary scene, whole or absent.

use clap::Parser;
use pgsag_scene::files::folder::open_scene;
use pgsag_scene::files::map::decode_map;
use pgsag_scene::files::ply::{read_cloud, read_mesh};
use pgsag_scene::files::raster::decode_instances;
use pgsag_scene::synthetic::{LensDistortion, TownOptions};

use super::*;

fn tiny() -> TownOptions {
    TownOptions { view_count: 5, width: 96, height: 64, gsd_m: 0.4, point_count: 60, ..TownOptions::default() }
}

/// A town written as `SCENE` into a temporary folder.
fn written(options: &TownOptions, folder: &FolderOptions) -> (tempfile::TempDir, Town, PathBuf) {
    let dir = tempfile::tempdir().expect("a folder");
    let town = Town::generate(options);
    let scene = dir.path().join("SCENE");
    let mut heard = Vec::new();
    write_town_with(&town, folder, &scene, &mut |done, all| heard.push((done, all))).expect("written");
    assert_eq!(heard, (0..=5).map(|done| (done, 5)).collect::<Vec<_>>());
    (dir, town, scene)
}

#[test]
fn what_is_written_reads_back() {
    let (dir, town, root) = written(&tiny(), &FolderOptions { masks: true, ..FolderOptions::default() });
    let opened = open_scene(&root).expect("a scene");
    assert_eq!(opened.scene.views.len(), 5);
    for (k, (read, made)) in opened.scene.views.iter().zip(&town.scene.views).enumerate() {
        assert_eq!((&read.name, &read.lens, &read.camera), (&made.name, &made.lens, &made.camera));
        assert!(read.center_world().distance(made.center_world()) < 1e-9);
        assert!(opened.mask_paths[k].is_some());
    }
    assert_eq!(opened.scene.points.len(), 60);
    for (read, made) in opened.scene.points.iter().zip(&town.scene.points) {
        assert_eq!((read.position_world, &read.track), (made.position_world, &made.track));
    }
    let read = |path: &str| fs::read(root.join("truth").join(path)).expect("a file");
    let photograph = town.photograph(3);
    assert_eq!(decode_instances("i", &read("instances/town_003.png")).expect("instances"), photograph.instances);
    assert_eq!(decode_map::<f32>("d", &read("depth/town_003.depth")).expect("depth"), photograph.depth);
    assert_eq!(read_mesh("s", &read("scene.ply")).expect("a mesh"), town.truth_mesh());
    let visible = read_cloud("v", &read("visible.ply")).expect("a cloud");
    assert_eq!(visible.attribute("building").expect("numbers"), town.visible_points(0.15).1);
    let options: TownOptions = serde_json::from_slice(&read("town.json")).expect("options");
    assert_eq!(options, town.options);
    assert_eq!(fs::read_dir(dir.path()).expect("a folder").count(), 1, "a partial folder is left");
}

#[test]
fn a_lens_survives_the_round_trip() {
    let lens = Some(LensDistortion { k1: -0.08, k2: 0.01, p1: 0.001, p2: -0.001 });
    let (_dir, town, root) = written(&TownOptions { lens, lossless: true, ..tiny() }, &FolderOptions::default());
    let opened = open_scene(&root).expect("a scene");
    assert_eq!(opened.scene.views[2].camera, town.scene.views[2].camera);
    assert_eq!(opened.read_image(2).expect("an image"), town.photograph(2).image);
    for (read, made) in opened.scene.points.iter().zip(&town.scene.points) {
        let apart = |k: usize| glam::Vec2::from(read.track[k].xy_px).distance(made.track[k].xy_px.into());
        assert!(read.track.len() == made.track.len() && (0..read.track.len()).all(|k| apart(k) < 1e-3));
    }
}

#[test]
fn a_folder_with_something_in_it_is_left_alone() {
    let dir = tempfile::tempdir().expect("a folder");
    fs::write(dir.path().join("mine.txt"), "mine").expect("written");
    let town = Town::generate(&TownOptions { view_count: 0, ..tiny() });
    let error = write_town(&town, dir.path(), &mut |_, _| ()).expect_err("refused");
    assert!(error.to_string().contains("not empty"), "{error}");
    assert_eq!(fs::read_dir(dir.path()).expect("a folder").count(), 1);
}

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    town: TownArgs,
}

#[test]
fn no_words_on_the_command_line_are_the_demo() {
    let line = Line::try_parse_from(["town"]).expect("parsed");
    assert_eq!(line.town.town_options(), TownOptions::default());
    assert_eq!(line.town.folder_options(), FolderOptions::default());
}

#[test]
fn words_on_the_command_line_arrive() {
    let words = "town --houses 8 --lens -0.1 0.02 0 0 --world-offset 691000 5334000 -12.5 --oblique-tilt-deg 45 --png";
    let options = Line::try_parse_from(words.split(' ')).expect("parsed").town.town_options();
    assert_eq!((options.house_count, options.view_count, options.lossless), (8, 44, true));
    assert_eq!(options.lens, Some(LensDistortion { k1: -0.1, k2: 0.02, p1: 0.0, p2: 0.0 }));
    assert_eq!(options.world_offset_m, [691_000.0, 5_334_000.0, -12.5]);
    assert!((options.oblique_tilt_rad - std::f64::consts::FRAC_PI_4).abs() < 1e-12);
    assert!(Line::try_parse_from(["town", "--nadir-share", "1.5"]).is_err());
    assert!(Line::try_parse_from(["town", "--gsd", "nan"]).is_err());
}
