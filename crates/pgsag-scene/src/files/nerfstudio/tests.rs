use glam::DVec2;

use super::*;

const TEXT: &str = r#"{"camera_model": "OPENCV", "w": 640, "h": 480.0, "fl_x": 500, "fl_y": 501, "cx": 321, "cy": 239,
 "k1": -0.1, "k2": 0.01, "p1": 0.001, "p2": 0, "aabb_scale": 16,
 "applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 5]],
 "ply_file_path": "sparse_pc.ply",
 "frames": [
  {"file_path": "./images/z/2.png", "transform_matrix": [[1,0,0,4],[0,1,0,5],[0,0,1,6],[0,0,0,1]]},
  {"file_path": "images/1.png", "mask_path": "masks/1.png", "fl_x": 400, "k1": 0, "k2": 0, "p1": 0,
   "transform_matrix": [[0,-1,0,0],[1,0,0,0],[0,0,1,0],[0,0,0,1]]}]}"#;

fn read(text: &str) -> Result<Transforms, FileError> {
    parse("transforms.json", text.as_bytes(), &mut |_| Some((100, 50)))
}

#[test]
fn frames_become_views() {
    let read = read(TEXT).unwrap();
    let names: Vec<&str> = read.scene.views.iter().map(|view| view.name.as_str()).collect();
    assert_eq!(names, ["1.png", "z/2.png"]);
    assert_eq!(read.image_files, ["images/1.png", "images/z/2.png"]);
    assert_eq!(read.mask_files, [Some("masks/1.png".into()), None]);
    assert_eq!(read.points_file.as_deref(), Some("sparse_pc.ply"));
    assert_eq!(read.scene.views[0].camera.fx, 400.0);
    assert_eq!(read.scene.views[0].lens.model, LensModel::Pinhole);
    assert_eq!(
        read.scene.views[1].lens.params,
        [500.0, 501.0, 321.0, 239.0, -0.1, 0.01, 0.001, 0.0, 0.0, 0.0, 0.0, 0.0]
    );
}

#[test]
fn a_point_is_seen_where_opengl_sees_it() {
    let read = read(TEXT).unwrap();
    // In the file's world, the camera of 2.png stands at (4, 5, 6) and looks along -z with y up.
    let in_file = DVec3::new(4.5, 5.25, 6.0 - 10.0);
    let world = read.applied.undo(in_file);
    assert_eq!(world, DVec3::new(4.5, 9.0, 5.25));
    let in_camera = read.scene.views[1].camera_from_world.transform_point(world);
    assert!((in_camera - DVec3::new(0.5, -0.25, 10.0)).length() < 1e-12, "{in_camera}");
    let seen = read.scene.views[0].camera_from_world.transform_point(read.applied.undo(DVec3::new(0.0, 1.0, -2.0)));
    let xy = read.scene.views[0].camera.project(seen).unwrap();
    // The camera is turned by 90 degrees: the world's y is its right.
    assert!((xy - DVec2::new(321.0 + 200.0, 239.0)).length() < 1e-9, "{xy}");
}

#[test]
fn blender_scenes_have_an_angle_and_no_size() {
    let text = r#"{"camera_angle_x": 1.5707963267948966, "frames": [
        {"file_path": "./train/r_0", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#;
    let read = read(text).unwrap();
    let camera = read.scene.views[0].camera;
    assert_eq!((camera.width, camera.height, camera.cx), (100, 50, 50.0));
    assert!((camera.fx - 50.0).abs() < 1e-12 && camera.fx == camera.fy);
    assert_eq!(read.scene.views[0].name, "train/r_0");
}

#[test]
fn what_is_wrong_is_named() {
    for (from, to, words) in [
        (
            "\"OPENCV\"",
            "\"EQUIRECTANGULAR\"",
            "frame images/z/2.png: the camera model EQUIRECTANGULAR is not supported",
        ),
        ("\"fl_x\": 500, \"fl_y\": 501", "\"x\": 1", "frame images/z/2.png: fl_x is missing"),
        ("[[1,0,0,4]", "[[1,0.1,0,4]", "frame ./images/z/2.png: transform_matrix is not a rotation"),
        ("[[1, 0, 0, 0]", "[[2, 0, 0, 0]", "applied_transform: not a similarity"),
        ("./images/z/2.png", "../2.png", "leads out of the image folder"),
        ("./images/z/2.png", "1.png", "two frames are named 1.png"),
        ("\"k1\": -0.1", "\"k1\": -0.1, \"k4\": 1", "a fourth radial coefficient"),
        ("\"frames\"", "\"frame\"", "missing field `frames`"),
    ] {
        let error = read(&TEXT.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(error.starts_with("transforms.json") && error.contains(words), "{error}");
    }
}
