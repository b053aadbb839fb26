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
