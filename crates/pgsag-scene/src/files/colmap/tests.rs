use super::*;
use crate::camera::distortion::LensModel;
use crate::numbers::SplitMix64;

pub(crate) fn small_model() -> Model {
    let mut stream = SplitMix64::new(1);
    let mut model = Model::default();
    let lens = |model, params: &[f64]| LensCamera { model, width: 640, height: 480, params: params.into() };
    model.cameras.insert(3, lens(LensModel::Pinhole, &[500.0, 501.0, 320.0, 240.5]));
    model.cameras.insert(7, lens(LensModel::Opencv, &[500.0, 501.0, 320.0, 240.5, -0.1, 0.02, 1e-3, -1e-3]));
    for (i, name) in ["b/straße.jpg", "a.jpg", "b/c d.jpg"].into_iter().enumerate() {
        let rotation = DQuat::from_euler(glam::EulerRot::XYZ, stream.normal(), stream.normal(), stream.normal());
        let translation = DVec3::new(stream.normal(), 4.5e5 + 1.0 / 3.0, 5.1e6);
        model.images.push(ModelImage {
            id: 10 - i as u32,
            camera_id: if i == 1 { 7 } else { 3 },
            name: name.into(),
            camera_from_world: RigidTransform { rotation, translation },
            keypoints: vec![Keypoint { xy_px: [1.5, 2.5], point_id: NO_POINT }],
        });
    }
    for id in [5, 9, 2] {
        let mut track = Vec::new();
        for image in &mut model.images {
            track.push((image.id, image.keypoints.len() as u32));
            let xy_px = [stream.range(0.0, 640.0), stream.range(0.0, 480.0)];
            image.keypoints.push(Keypoint { xy_px, point_id: id });
        }
        let position_world = DVec3::new(stream.normal(), stream.normal(), stream.normal());
        model.points.push(ModelPoint { id, position_world, color: [1, 2, id as u8], error_px: 0.25, track });
    }
    model
}

fn decode(encoding: Encoding, files: &[(&'static str, Vec<u8>); 3]) -> Result<Model, FileError> {
    Model::decode(encoding, [0, 1, 2].map(|i| (files[i].0, files[i].1.as_slice())))
}

#[test]
fn both_encodings_return_the_model() {
    let model = small_model();
    for encoding in [Encoding::Binary, Encoding::Text] {
        let back = decode(encoding, &model.encode(encoding)).unwrap();
        assert_eq!(back.cameras, model.cameras);
        assert_eq!(back.points, model.points);
        for (a, b) in back.images.iter().zip(&model.images) {
            assert!((a.camera_from_world.rotation - b.camera_from_world.rotation).length() < 1e-15);
            assert_eq!(a.camera_from_world.translation, b.camera_from_world.translation);
            assert_eq!((a.id, a.camera_id, &a.name, &a.keypoints), (b.id, b.camera_id, &b.name, &b.keypoints));
        }
    }
}

#[test]
fn a_scene_survives_its_model() {
    let scene = small_model().into_scene(["images.bin", "points3D.bin"]).unwrap();
    assert_eq!(
        scene.views.iter().map(|view| view.name.as_str()).collect::<Vec<_>>(),
        ["a.jpg", "b/c d.jpg", "b/straße.jpg"]
    );
    let model = Model::from_scene(&scene);
    assert_eq!(model.cameras.len(), 2);
    let back = model.into_scene(["images.bin", "points3D.bin"]).unwrap();
    assert_eq!(back.views, scene.views);
    for (a, b) in back.points.iter().zip(&scene.points) {
        assert_eq!(a.position_world, b.position_world);
        for (a, b) in a.track.iter().zip(&b.track) {
            assert_eq!(a.view_index, b.view_index);
            assert!((glam::Vec2::from(a.xy_px) - glam::Vec2::from(b.xy_px)).length() < 1e-3);
        }
    }
}

#[test]
fn observations_are_carried_into_the_undistorted_image() {
    let model = small_model();
    let image = model.images.iter().find(|image| image.name == "a.jpg").unwrap();
    let lens = &model.cameras[&image.camera_id];
    let xy = image.keypoints[1].xy_px;
    let expected = undistort_point(xy.into(), lens, &pinhole_for(lens)).unwrap();
    let scene = model.clone().into_scene(["images.bin", "points3D.bin"]).unwrap();
    let seen = scene.points[0].track.iter().find(|seen| seen.view_index == 0).unwrap();
    assert_eq!(seen.xy_px, <[f32; 2]>::from(expected.as_vec2()));
    assert!((expected - glam::DVec2::from(xy)).length() > 0.5, "the lens must move the point");
}

#[test]
fn newer_models_are_refused_by_name() {
    let file = b"# comment\n1 EUCM 10 10 1 1 1 1 1 1\n";
    let error = cameras::parse_text("cameras.txt", file).unwrap_err().to_string();
    assert_eq!(error.split(';').next(), Some("cameras.txt, line 2: the camera model EUCM is not supported"));
    let mut binary = 1u64.to_le_bytes().to_vec();
    binary.extend(1u32.to_le_bytes());
    binary.extend(17i32.to_le_bytes());
    binary.extend([0; 64]);
    let error = cameras::parse_binary("cameras.bin", &binary).unwrap_err().to_string();
    assert!(error.contains("EQUIRECTANGULAR is not supported") && error.contains("byte 8"), "{error}");
}

#[test]
fn fisheyes_without_distortion_are_read_with_zeros() {
    let cameras = cameras::parse_text("cameras.txt", b"1 FISHEYE 10 8 5 6 4 3\n").unwrap();
    assert_eq!(cameras[&1].model, LensModel::OpencvFisheye);
    assert_eq!(cameras[&1].params, [5.0, 6.0, 4.0, 3.0, 0.0, 0.0, 0.0, 0.0]);
}

#[test]
fn errors_name_file_place_and_cause() {
    let model = small_model();
    let mut files = model.encode(Encoding::Binary);
    files[2].1.truncate(100);
    let error = decode(Encoding::Binary, &files).unwrap_err().to_string();
    assert!(error.starts_with("points3D.bin, byte 0: 3 points are announced"), "{error}");
    let error = images::parse_text("images.txt", b"1 1 0 0 0 0 0 zero 1 a.jpg\n\n").unwrap_err().to_string();
    assert!(error.starts_with("images.txt, line 1: a number of the pose is 'zero'"), "{error}");
    let error = images::parse_text("images.txt", b"1 1 0 0 0 0 0 0 1 ../a.jpg\n\n").unwrap_err().to_string();
    assert!(error.contains("leads out of the image folder"), "{error}");
    let mut lost = model.clone();
    lost.points[1].track[0].1 = 77;
    let error = lost.into_scene(["images.bin", "points3D.bin"]).unwrap_err().to_string();
    assert!(error.starts_with("points3D.bin, point 9: its track leads to feature 77 of image 10"), "{error}");
}

#[test]
fn a_second_line_may_be_empty_or_absent() {
    let images = images::parse_text("images.txt", b"1 1 0 0 0 0 0 0 1 a b.jpg\n\n2 1 0 0 0 0 0 0 1 c.jpg").unwrap();
    assert_eq!(images.len(), 2);
    assert_eq!(images[0].name, "a b.jpg");
    assert!(images[1].keypoints.is_empty());
}
