use super::*;
use crate::camera::distortion::LensModel;
use crate::camera::undistort::pinhole_for;
use crate::files::colmap::{Encoding, Model};
use crate::pose::RigidTransform;

/// A folder with one pinhole camera, two photographs of 40 x 30 and no points.
fn write_scene(dir: &Path, image_size: (u32, u32)) -> Scene {
    let params = vec![50.0, 51.0, 20.0, 15.0];
    let lens = LensCamera { model: LensModel::Pinhole, width: 40, height: 30, params };
    let camera = pinhole_for(&lens);
    let names = ["a.jpg", "sub/b.JPG"];
    let view = |name: &str| View {
        name: name.into(),
        lens: lens.clone(),
        camera,
        camera_from_world: RigidTransform::IDENTITY,
    };
    let scene = Scene { views: names.iter().map(|name| view(name)).collect(), ..Scene::default() };
    fs::create_dir_all(dir.join("sparse/0")).unwrap();
    fs::create_dir_all(dir.join("images/sub")).unwrap();
    for (name, bytes) in Model::from_scene(&scene).encode(Encoding::Text) {
        fs::write(dir.join("sparse/0").join(name), bytes).unwrap();
    }
    let image = Image::filled(image_size.0, image_size.1, [90, 80, 70]);
    for name in names {
        fs::write(dir.join("images").join(name), raster::encode_jpeg(&image, 95)).unwrap();
    }
    scene
}

fn write_mask(dir: &Path, name: &str, size: (u32, u32)) {
    let path = dir.join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, raster::encode_mask_png(&Map::filled(size.0, size.1, true))).unwrap();
}

fn codes(folder: &SceneFolder) -> Vec<&'static str> {
    folder.notes.iter().map(|note| note.code).collect()
}

#[test]
fn opens_a_text_model_with_its_photographs() {
    let dir = tempfile::tempdir().unwrap();
    let scene = write_scene(dir.path(), (40, 30));
    fs::write(dir.path().join("images/other.txt"), "x").unwrap();
    let folder = open_scene(dir.path()).unwrap();
    assert_eq!(folder.scene.views, scene.views);
    assert_eq!(folder.image_paths[1], dir.path().join("images/sub/b.JPG"));
    assert!(codes(&folder).contains(&"image-unregistered"));
    let image = folder.read_undistorted_image(0).unwrap();
    assert!(image.at(3, 4).iter().zip([90, 80, 70]).all(|(a, b)| a.abs_diff(b) < 4));
    assert_eq!(folder.read_mask(0).unwrap(), None);
}

#[test]
fn every_naming_of_masks_is_found() {
    for (name, convention) in [
        ("masks/sub/b.JPG.png", "a.jpg.png"),
        ("masks/sub/b.png", "a.png"),
        ("mask/sub/b.jpg.PNG", "a.jpg.png"),
        ("masks/sub/b.JPG", "a.jpg"),
        ("mask/sub/b.mask.png", "a.mask.png"),
        ("masks/sub/b_mask.png", "a_mask.png"),
    ] {
        let dir = tempfile::tempdir().unwrap();
        write_scene(dir.path(), (40, 30));
        write_mask(dir.path(), name, (40, 30));
        let folder = open_scene(dir.path()).unwrap();
        assert_eq!(folder.mask_convention, Some(convention), "{name}");
        assert_eq!(folder.mask_paths, [None, Some(dir.path().join(name))]);
        assert_eq!(folder.read_undistorted_mask(1).unwrap(), Some(Map::filled(40, 30, true)));
    }
}

#[test]
fn masks_of_other_sizes() {
    let dir = tempfile::tempdir().unwrap();
    write_scene(dir.path(), (40, 30));
    write_mask(dir.path(), "masks/a.png", (20, 15));
    let folder = open_scene(dir.path()).unwrap();
    assert!(codes(&folder).contains(&"mask-resized"));
    assert_eq!(folder.read_mask(0).unwrap(), Some(Map::filled(40, 30, true)));
    write_mask(dir.path(), "masks/a.png", (20, 20));
    let error = open_scene(dir.path()).unwrap_err().to_string();
    assert!(error.contains("a.png: the mask is 20 x 20, its photograph 40 x 30; make"), "{error}");
    fs::remove_file(dir.path().join("masks/a.png")).unwrap();
    assert!(codes(&open_scene(dir.path()).unwrap()).contains(&"mask-none-matched"));
}

#[test]
fn photographs_of_other_sizes() {
    let dir = tempfile::tempdir().unwrap();
    write_scene(dir.path(), (80, 60));
    let folder = open_scene(dir.path()).unwrap();
    assert!(codes(&folder).contains(&"camera-rescaled"));
    let camera = folder.scene.views[0].camera;
    assert_eq!((camera.width, camera.fx, camera.cx), (80, 100.0, 40.0));
    write_scene(dir.path(), (80, 50));
    let error = open_scene(dir.path()).unwrap_err().to_string();
    assert!(error.contains("a.jpg: 80 x 50 pixels, but its camera is 40 x 30"), "{error}");
}

#[test]
fn what_is_missing_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let error = open_scene(dir.path()).unwrap_err().to_string();
    assert!(error.contains("no camera model was found") && error.contains("sparse/0/cameras.bin"), "{error}");
    write_scene(dir.path(), (40, 30));
    fs::remove_file(dir.path().join("images/a.jpg")).unwrap();
    let error = open_scene(dir.path()).unwrap_err().to_string();
    assert!(error.contains("images/a.jpg: 1 of the model's 2 photographs are missing"), "{error}");
    fs::remove_file(dir.path().join("sparse/0/points3D.txt")).unwrap();
    let error = open_scene(dir.path()).unwrap_err().to_string();
    assert!(error.contains("points3D.txt: cannot be read"), "{error}");
}

#[test]
fn a_georef_speaks_first() {
    let dir = tempfile::tempdir().unwrap();
    write_scene(dir.path(), (40, 30));
    let folder = open_scene(dir.path()).unwrap();
    assert_eq!(folder.scene.frame.metres_per_unit, None);
    assert!(codes(&folder).contains(&"scale-unknown"));
    let text = r#"{"epsg": 28992, "offset": [85000.5, 446700, 0], "metres_per_unit": 1, "rms": 2}"#;
    fs::write(dir.path().join("georef.json"), text).unwrap();
    let folder = open_scene(dir.path()).unwrap();
    let frame = &folder.scene.frame;
    assert_eq!((frame.metres_per_unit, frame.epsg, frame.up_world), (Some(1.0), Some(28992), glam::DVec3::Z));
    assert_eq!(frame.offset.x, 85000.5);
    assert_eq!(frame.source, "georef.json");
    assert!(codes(&folder).contains(&"georef-unknown-keys") && !codes(&folder).contains(&"scale-unknown"));
    fs::write(dir.path().join("georef.json"), "{").unwrap();
    assert!(open_scene(dir.path()).unwrap_err().to_string().contains("georef.json, line 1:"));
}

/// Photographs on a square of 40 m whose list of GPS places says that a unit is 8 metres.
#[test]
fn gps_places_give_scale_and_origin() {
    let dir = tempfile::tempdir().unwrap();
    let mut scene = write_scene(dir.path(), (40, 30));
    let local = crate::frame::geodesy::LocalFrame::at([46.8, -92.0, 100.0]);
    let mut list = String::from("# name latitude longitude altitude\n");
    let view = scene.views[0].clone();
    scene.views.clear();
    for (i, enu) in [(0.0, 0.0), (40.0, 0.0), (40.0, 40.0), (0.0, 40.0), (20.0, 16.0)].iter().enumerate() {
        let center = glam::DVec3::new(enu.0, enu.1, 50.0);
        let name = format!("{i}.png");
        let [lat, lon, height] = local.lla(center);
        list += &format!("{name} {lat} {lon} {height}\n");
        let camera_from_world = RigidTransform { translation: -center / 8.0, ..RigidTransform::IDENTITY };
        let image = Image::filled(40, 30, [1; 3]);
        fs::write(dir.path().join("images").join(&name), raster::encode_png(&image)).unwrap();
        scene.views.push(View { name, camera_from_world, ..view.clone() });
    }
    for (name, bytes) in Model::from_scene(&scene).encode(Encoding::Text) {
        fs::write(dir.path().join("sparse/0").join(name), bytes).unwrap();
    }
    fs::write(dir.path().join("gps.txt"), list).unwrap();
    let folder = open_scene(dir.path()).unwrap();
    let frame = &folder.scene.frame;
    assert!((frame.metres_per_unit.unwrap() - 8.0).abs() < 1e-6, "{frame:?}");
    assert!(frame.up_world.dot(glam::DVec3::Z) > 1.0 - 1e-9);
    assert!(local.enu(frame.origin_lla.unwrap()).length() < 1e-3);
    assert!(codes(&folder).contains(&"gps-fit"));
}

fn write_png(path: &Path, size: (u32, u32)) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, raster::encode_png(&Image::filled(size.0, size.1, [9; 3]))).unwrap();
}

#[test]
fn opensfm_folders_are_in_metres() {
    let dir = tempfile::tempdir().unwrap();
    let text = r#"[{"cameras": {"c": {"projection_type": "perspective", "width": 40, "height": 30, "focal": 1.0}},
        "shots": {"a.png": {"rotation": [3.1, 0, 0], "translation": [0, 0, 50], "camera": "c"}},
        "points": {"t1": {"color": [1, 2, 3], "coordinates": [0, 0, 0]}},
        "reference_lla": {"latitude": 46.8, "longitude": -92.0, "altitude": 0}}]"#;
    fs::create_dir_all(dir.path().join("opensfm")).unwrap();
    fs::write(dir.path().join("opensfm/reconstruction.json"), text).unwrap();
    fs::write(dir.path().join("opensfm/tracks.csv"), "a.png\tt1\t0\t0\t0.1\t1\t1\t1\t1\n").unwrap();
    write_png(&dir.path().join("images/a.png"), (40, 30));
    let folder = open_scene(dir.path()).unwrap();
    assert_eq!(folder.scene.frame.metres_per_unit, Some(1.0));
    assert_eq!(folder.scene.frame.origin_lla, Some([46.8, -92.0, 0.0]));
    assert_eq!(folder.scene.points[0].track[0].xy_px, [20.0, 19.0]);
    assert_eq!(folder.scene.views[0].lens.model, LensModel::Pinhole);
}

#[test]
fn nerfstudio_folders_name_their_masks_and_points() {
    let dir = tempfile::tempdir().unwrap();
    let text = r#"{"fl_x": 40, "applied_transform": [[1,0,0,0],[0,0,1,0],[0,-1,0,0]], "ply_file_path": "p.ply",
        "frames": [{"file_path": "train/r_0", "mask_path": "m/0.png",
        "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#;
    fs::write(dir.path().join("transforms.json"), text).unwrap();
    write_png(&dir.path().join("train/r_0.png"), (40, 30));
    write_mask(dir.path(), "m/0.png", (40, 30));
    let cloud = crate::files::ply::Cloud { positions: vec![[1.0, 2.0, 3.0]], ..Default::default() };
    let mut bytes = Vec::new();
    crate::files::ply::write_cloud(&mut bytes, &cloud, &[]).unwrap();
    fs::write(dir.path().join("p.ply"), bytes).unwrap();
    let folder = open_scene(dir.path()).unwrap();
    assert_eq!(folder.image_paths, [dir.path().join("train/r_0.png")]);
    assert_eq!(folder.read_mask(0).unwrap(), Some(Map::filled(40, 30, true)));
    assert_eq!(folder.scene.points[0].position_world, glam::DVec3::new(1.0, -3.0, 2.0));
    assert_eq!(folder.scene.views[0].camera.width, 40);
}
