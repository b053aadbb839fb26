//! Real scenes, where PGSAG_DATA says they are: counts, sizes, frames.
#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test stops where something is wrong, and says what it saw"
)]

use std::path::PathBuf;

use glam::DVec3;
use pgsag_scene::files::colmap::{Encoding, Model};
use pgsag_scene::files::folder::{SceneFolder, open_scene, read_file};
use pgsag_scene::files::ply;

fn data(name: &str) -> PathBuf {
    PathBuf::from(std::env::var_os("PGSAG_DATA").expect("PGSAG_DATA")).join(name)
}

fn open(name: &str, views: usize, points: usize, observations: usize) -> SceneFolder {
    let started = std::time::Instant::now();
    let folder = open_scene(&data(name)).unwrap();
    println!(
        "{name}: {:.0} ms; up {}; {}",
        started.elapsed().as_secs_f64() * 1e3,
        folder.scene.frame.up_world,
        folder.scene.frame.source
    );
    folder.notes.iter().for_each(|note| println!("  [{}] {}", note.code, note.text));
    assert_eq!(folder.scene.views.len(), views);
    assert_eq!(folder.scene.points.len(), points);
    assert_eq!(folder.scene.points.iter().map(|point| point.track.len()).sum::<usize>(), observations);
    folder
}

/// Root mean square and largest reprojection error over all observations, pixels.
fn reprojection(folder: &SceneFolder) -> (f64, f64) {
    let (mut sum, mut count, mut most) = (0.0, 0.0, 0.0f64);
    for point in &folder.scene.points {
        for seen in &point.track {
            let view = &folder.scene.views[seen.view_index as usize];
            let in_camera = view.camera_from_world.transform_point(point.position_world);
            let miss = view.camera.project(in_camera).unwrap() - glam::Vec2::from(seen.xy_px).as_dvec2();
            sum += miss.length_squared();
            count += 1.0;
            most = most.max(miss.length());
        }
    }
    ((sum / count).sqrt(), most)
}

fn degrees(a: DVec3, b: DVec3) -> f64 {
    libm::acos(a.normalize().dot(b.normalize()).min(1.0)).to_degrees()
}

#[test]
#[ignore = "needs PGSAG_DATA"]
fn delft() {
    let folder = open("delft", 73, 21_284, 110_202);
    assert!(degrees(folder.scene.frame.up_world, DVec3::Z) < 0.1);
    assert_eq!(folder.scene.frame.metres_per_unit, None);
    assert!(reprojection(&folder).0 < 1.0);
    let (file, bytes) = read_file(&data("delft/truth/scene.ply")).unwrap();
    let mesh = ply::read_mesh(&file, &bytes).unwrap();
    assert_eq!((mesh.vertices.len(), mesh.faces.len()), (19_273, 35_607));
    assert_eq!(mesh.buildings.iter().max(), Some(&100));
    let (file, bytes) = read_file(&data("delft/truth/visible.ply")).unwrap();
    let cloud = ply::read_cloud(&file, &bytes).unwrap();
    assert_eq!(cloud.positions.len(), 300_000);
    assert!(cloud.attribute("building").unwrap().iter().all(|&number| (1..=100).contains(&number)));
}

#[test]
#[ignore = "needs PGSAG_DATA"]
fn sceaux() {
    let full = open("sceaux-full", 11, 5867, 29_283);
    let small = open("sceaux-small", 11, 5867, 29_283);
    for folder in [&full, &small] {
        assert_eq!(folder.mask_convention, Some("a.jpg.png"));
        assert_eq!(folder.mask_paths.iter().flatten().count(), 7);
        assert!(folder.read_undistorted_mask(3).unwrap().unwrap().values.iter().any(|&inside| inside));
    }
    // 0.589 px is the mean error in the photographs; undistortion stretches the borders a little.
    let (rms, most) = reprojection(&full);
    println!("sceaux-full: RMS {rms:.3} px, largest {most:.1} px");
    assert!(rms < 1.0);
    assert_eq!(small.scene.views[0].camera.width, 1416);
}

#[test]
#[ignore = "needs PGSAG_DATA"]
fn castle_has_z_down() {
    let folder = open("castle-p30-small", 30, 10_162, 46_434);
    let angle = degrees(folder.scene.frame.up_world, DVec3::new(0.005, 0.025, -1.0));
    println!("castle: {angle:.2} degrees off");
    assert!(angle < 2.0);
    assert!(reprojection(&folder).0 < 0.6);
}

#[test]
#[ignore = "needs PGSAG_DATA"]
fn brighton_is_in_metres() {
    let folder = open("brighton-small", 18, 2882, 11_788);
    let frame = &folder.scene.frame;
    assert_eq!((frame.metres_per_unit, frame.up_world), (Some(1.0), DVec3::Z));
    assert_eq!(frame.origin_lla, Some([46.842_656_666_666_66, -91.994_008_024_691_37, 0.0]));
    assert!(folder.notes.iter().any(|note| note.code == "gps-fit"));
}

#[test]
#[ignore = "needs PGSAG_DATA"]
fn models_survive_being_written() {
    for name in ["delft", "sceaux-full", "castle-p30-small", "brighton-small"] {
        let files =
            Encoding::Binary.file_names().map(|file| read_file(&data(name).join("sparse/0").join(file)).unwrap());
        let files = [0, 1, 2].map(|i| (files[i].0.as_str(), files[i].1.as_slice()));
        let model = Model::decode(Encoding::Binary, files).unwrap();
        let back = model.encode(Encoding::Binary);
        assert_eq!(back[0].1, files[0].1, "{name}");
        assert_eq!(back[2].1, files[2].1, "{name}");
        let text = model.encode(Encoding::Text);
        let again = Model::decode(Encoding::Text, [0, 1, 2].map(|i| (text[i].0, text[i].1.as_slice()))).unwrap();
        assert_eq!((again.cameras, again.points), (model.cameras, model.points), "{name}");
    }
}

#[test]
#[ignore = "needs PGSAG_DATA"]
fn text_and_binary_agree() {
    let read = |folder: &str, encoding: Encoding| {
        let files = encoding.file_names().map(|file| read_file(&data("sceaux-small").join(folder).join(file)).unwrap());
        Model::decode(encoding, [0, 1, 2].map(|i| (files[i].0.as_str(), files[i].1.as_slice()))).unwrap()
    };
    let (text, binary) = (read("sparse_txt/0", Encoding::Text), read("sparse/0", Encoding::Binary));
    assert_eq!(text.cameras, binary.cameras);
    let sorted = |model: Model| {
        let mut points = model.points;
        points.sort_by_key(|point| point.id);
        points
    };
    let (a, b) = (sorted(text), sorted(binary));
    assert!(a.iter().zip(&b).all(|(a, b)| a == b) && a.len() == b.len());
}
