use glam::DVec2;

use super::*;

const TEXT: &str = r#"[{"cameras": {}, "shots": {}, "points": {}}, {
 "cameras": {
  "v2 a": {"projection_type": "perspective", "width": 4000, "height": 3000, "focal": 0.85, "k1": -0.1, "k2": 0.02},
  "v2 b": {"projection_type": "brown", "width": 400, "height": 300, "focal_x": 0.9, "focal_y": 0.91, "c_x": 0.01,
           "c_y": -0.02, "k1": -0.1, "k2": 0.02, "p1": 0.001, "p2": -0.002, "k3": 0.003},
  "v2 c": {"projection_type": "fisheye", "width": 400, "height": 300, "focal": 0.6, "k1": 0.01, "k2": 0.0}},
 "shots": {
  "b.jpg": {"rotation": [0.1, -2.0, 0.3], "translation": [1, 2, 3], "camera": "v2 b", "gps_dop": 5},
  "a.jpg": {"rotation": [0, 0, 0], "translation": [0, 0, 1e6], "camera": "v2 a"},
  "c.jpg": {"rotation": [0, 0, 0], "translation": [0, 0, 0], "camera": "v2 c"}},
 "points": {"7": {"color": [1.0, 2.0, 300.0], "coordinates": [0.5, -0.25, 4.0]}},
 "reference_lla": {"latitude": 46.8, "longitude": -92.0, "altitude": 3.0}}]"#;

#[test]
fn cameras_are_those_of_opensfm() {
    let read = parse("reconstruction.json", TEXT.as_bytes()).unwrap();
    assert_eq!(read.reference_lla, Some([46.8, -92.0, 3.0]));
    assert_eq!(read.notes[0].code, "model-several");
    let views = &read.scene.views;
    assert_eq!(views.iter().map(|view| view.name.as_str()).collect::<Vec<_>>(), ["a.jpg", "b.jpg", "c.jpg"]);
    let point = DVec3::new(0.3, -0.2, 1.5);
    let (x, y) = (point.x / point.z, point.y / point.z);
    let r2 = x * x + y * y;

    let d = 1.0 + r2 * (-0.1 + 0.02 * r2);
    let expected = DVec2::new(0.85 * d * x, 0.85 * d * y) * 4000.0 + DVec2::new(2000.0, 1500.0);
    assert!((views[0].lens.project(point).unwrap() - expected).length() < 1e-9);

    let radial = 1.0 + r2 * (-0.1 + r2 * (0.02 + r2 * 0.003));
    let tangential =
        DVec2::new(2.0 * 0.001 * x * y - 0.002 * (r2 + 2.0 * x * x), 0.001 * (r2 + 2.0 * y * y) - 2.0 * 0.002 * x * y);
    let normalised = (DVec2::new(x, y) * radial + tangential) * DVec2::new(0.9, 0.91) + DVec2::new(0.01, -0.02);
    let expected = normalised * 400.0 + DVec2::new(200.0, 150.0);
    assert!((views[1].lens.project(point).unwrap() - expected).length() < 1e-9);

    let theta = libm::atan(r2.sqrt());
    let expected = DVec2::new(x, y) / r2.sqrt() * (0.6 * 400.0 * theta * (1.0 + 0.01 * theta * theta));
    assert!((views[2].lens.project(point).unwrap() - expected - DVec2::new(200.0, 150.0)).length() < 1e-9);
}

#[test]
fn poses_carry_the_world_to_the_camera() {
    let read = parse("reconstruction.json", TEXT.as_bytes()).unwrap();
    let axis = DVec3::new(0.1, -2.0, 0.3);
    let at = DVec3::new(4.0, 5.0, 6.0);
    // Rodrigues' formula.
    let (angle, k) = (axis.length(), axis.normalize());
    let turned = at * libm::cos(angle) + k.cross(at) * libm::sin(angle) + k * k.dot(at) * (1.0 - libm::cos(angle));
    let moved = read.scene.views[1].camera_from_world.transform_point(at);
    assert!((moved - turned - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12);
    assert_eq!(read.scene.points[0].color, [1, 2, 255]);
}

#[test]
fn tracks_land_on_the_undistorted_image() {
    let mut read = parse("reconstruction.json", TEXT.as_bytes()).unwrap();
    let tracks = "OPENSFM_TRACKS_VERSION_v2\na.jpg\t7\t11\t0.1\t-0.2\t0.004\t1\t2\t3\t-1\t-1\nz.jpg\t7\t1\tx\ty\n\
                  a.jpg\t8\t1\tx\ty\n";
    read.add_tracks("tracks.csv", tracks.as_bytes()).unwrap();
    let view = &read.scene.views[0];
    let expected = undistort_point(DVec2::new(2400.0, 700.0), &view.lens, &view.camera).unwrap();
    assert_eq!(read.scene.points[0].track.len(), 1);
    assert_eq!(read.scene.points[0].track[0].xy_px, <[f32; 2]>::from(expected.as_vec2()));
    let error = read.add_tracks("tracks.csv", b"a.jpg\t7\t11\t0.1\n").unwrap_err().to_string();
    assert!(error.starts_with("tracks.csv, line 1: x or y"), "{error}");
}

#[test]
fn what_is_wrong_is_named() {
    for (from, to, words) in [
        ("brown", "spherical", "reconstruction.json, cameras/v2 b: the projection type 'spherical' is not supported"),
        ("\"camera\": \"v2 b\"", "\"camera\": \"v\"", "reconstruction.json, shots/b.jpg: its camera 'v' is missing"),
        ("\"focal\": 0.85", "\"focal\": -1", "reconstruction.json, cameras/v2 a: a focal length of -4000"),
        ("b.jpg", "../b.jpg", "reconstruction.json, shots/../b.jpg: the image name"),
    ] {
        let error = parse("reconstruction.json", TEXT.replace(from, to).as_bytes()).unwrap_err().to_string();
        assert!(error.starts_with(words), "{error}");
    }
    assert!(parse("reconstruction.json", b"[]").unwrap_err().to_string().contains("empty"));
}
