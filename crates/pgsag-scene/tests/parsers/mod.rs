//! Every parser of foreign bytes behind one signature, with a sound file for each. Shared with the fuzz targets.

use std::io::Cursor;

use glam::{DQuat, DVec3};
use pgsag_scene::camera::distortion::{LensCamera, LensModel};
use pgsag_scene::camera::undistort::pinhole_for;
use pgsag_scene::files::colmap::{Encoding, Model};
use pgsag_scene::files::{georef, map, nerfstudio, opensfm, photo, ply, raster};
use pgsag_scene::{FileError, Image, Map, Mesh, RigidTransform, Scene, SparsePoint, TrackElement, View};

/// A parser and a sound file for it.
pub(crate) struct Parser {
    /// Name of the file, as handed to the parser.
    pub(crate) file: &'static str,
    /// Reads a file of that name and throws the result away.
    pub(crate) parse: fn(&str, &[u8]) -> Result<(), FileError>,
    /// A sound file.
    pub(crate) sound: fn() -> Vec<u8>,
}

/// Parses one file of a COLMAP model beside two sound ones, and makes a scene of the three.
fn colmap(encoding: Encoding, index: usize, file: &str, bytes: &[u8]) -> Result<(), FileError> {
    let sound = Model::from_scene(&scene()).encode(encoding);
    let mut files = [0, 1, 2].map(|i| (sound[i].0, sound[i].1.as_slice()));
    files[index] = (file, bytes);
    Model::decode(encoding, files)?.into_scene([files[1].0, files[2].0]).map(drop)
}

fn colmap_file(encoding: Encoding, index: usize) -> Vec<u8> {
    let [cameras, images, points] = Model::from_scene(&scene()).encode(encoding);
    [cameras.1, images.1, points.1][index].clone()
}

/// Two lenses, three views, four points.
pub(crate) fn scene() -> Scene {
    let lens = |model, params: &[f64]| LensCamera { model, width: 64, height: 48, params: params.into() };
    let lenses = [
        lens(LensModel::Pinhole, &[50.0, 51.0, 32.0, 24.0]),
        lens(LensModel::Opencv, &[50.0, 50.0, 32.0, 24.0, -0.1, 0.02, 1e-3, -1e-3]),
        lens(LensModel::OpencvFisheye, &[50.0, 50.0, 32.0, 24.0, -0.02, 1e-3, 1e-4, 1e-4]),
    ];
    let views = ["a.jpg", "b/ü.jpg", "c d.png"].iter().zip(lenses).enumerate().map(|(i, (name, lens))| View {
        name: (*name).into(),
        camera: pinhole_for(&lens),
        lens,
        camera_from_world: RigidTransform {
            rotation: DQuat::from_xyzw(0.1, 0.2 * i as f64, 0.3, 0.9).normalize(),
            translation: DVec3::new(1.0, -2.0, 3.5e5),
        },
    });
    let track = |k: f32| (0..3).map(|view_index| TrackElement { view_index, xy_px: [8.0 + k, 20.0 - k] }).collect();
    let points = (0..4).map(|k| SparsePoint {
        position_world: DVec3::new(f64::from(k), 1.0 / 3.0, 5.1e6),
        color: [k as u8, 2, 3],
        error_px: 0.5,
        track: track(k as f32),
    });
    Scene { views: views.collect(), points: points.collect(), ..Scene::default() }
}

fn mesh() -> Vec<u8> {
    let mesh = Mesh {
        vertices: (0..12).map(|i| [f64::from(i), f64::from(i % 3), 1e6]).collect(),
        colors: vec![[1, 2, 3]; 12],
        faces: (0..10).map(|i| [i, i + 1, i + 2]).collect(),
        buildings: (0..10).collect(),
        groups: vec![1; 10],
        closed: vec![0; 10],
    };
    let mut out = Vec::new();
    ply::write_mesh(&mut out, &mesh, &["origin_world 1 2 3".into()]).expect("memory");
    out
}

const ASCII_PLY: &[u8] = b"ply\nformat ascii 1.0\ncomment x\nelement vertex 3\nproperty float x\nproperty float y\n\
    property double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\n\
    property list uchar int vertex_indices\nend_header\n0 0 0 1 2 3\n1 0 0 1 2 3\n0 1 0.5 1 2 3\n3 0 1 2\n";

fn floats() -> Vec<u8> {
    let names = ["x", "y", "z", "opacity"].map(String::from).to_vec();
    let table = ply::FloatTable { names, values: (0..40u8).map(f32::from).collect(), comments: Vec::new() };
    let mut out = Vec::new();
    ply::write_floats(&mut out, &table).expect("memory");
    out
}

fn every_shape(file: &str, bytes: &[u8]) -> Result<(), FileError> {
    let _ = ply::read_cloud(file, bytes).map(|cloud| cloud.attribute("building").map(<[u32]>::len));
    let _ = ply::read_floats(file, bytes).map(|table| (table.row_count(), ply::origin_world(&table.comments)));
    ply::read_mesh(file, bytes).map(drop)
}

const RECONSTRUCTION: &[u8] = br#"[{"cameras": {"v2 a": {"projection_type": "brown", "width": 64, "height": 48,
 "focal_x": 0.85, "focal_y": 0.86, "c_x": 0.01, "c_y": 0.0, "k1": -0.1, "k2": 0.02, "p1": 0.001, "p2": 0, "k3": 0}},
 "shots": {"a.jpg": {"rotation": [0.1, 0.2, 0.3], "translation": [1, 2, 3.5], "camera": "v2 a"}},
 "points": {"7": {"color": [1, 2, 3], "coordinates": [0.5, -0.25, 4.0]}},
 "reference_lla": {"latitude": 46.8, "longitude": -92.0, "altitude": 3.0}}]"#;

const TRANSFORMS: &[u8] = br#"{"camera_model": "OPENCV", "w": 64, "h": 48, "fl_x": 50, "fl_y": 51, "cx": 32, "cy": 24,
 "k1": -0.1, "k2": 0.01, "p1": 0.001, "p2": 0, "applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 5]],
 "ply_file_path": "sparse_pc.ply", "frames": [{"file_path": "./images/2.png", "mask_path": "masks/2.png",
 "transform_matrix": [[1, 0, 0, 4], [0, 1, 0, 5], [0, 0, 1, 6], [0, 0, 0, 1]]}]}"#;

fn tracks(file: &str, bytes: &[u8]) -> Result<(), FileError> {
    opensfm::parse("reconstruction.json", RECONSTRUCTION)?.add_tracks(file, bytes)
}

fn every_raster(file: &str, bytes: &[u8]) -> Result<(), FileError> {
    let _ = raster::image_size(file, bytes);
    let _ = raster::decode_instances(file, bytes);
    let _ = photo::read_header(file, &mut Cursor::new(bytes));
    raster::decode_mask(file, bytes)?;
    raster::decode_image(file, bytes).map(drop)
}

fn image() -> Image {
    Image { width: 13, height: 9, pixels: (0..117u8).map(|i| [i, 2 * i, 255 - i]).collect() }
}

fn jpeg_with_xmp() -> Vec<u8> {
    let body = b"http://ns.adobe.com/xap/1.0/\0<d a:GpsLatitude=\"1.5\" a:GpsLongitude='2'/>";
    let jpeg = raster::encode_jpeg(&image(), 90);
    let mut out = jpeg[..2].to_vec();
    out.extend([0xFF, 0xE1, 0, body.len() as u8 + 2]);
    out.extend(body);
    out.extend(&jpeg[2..]);
    out
}

/// All parsers.
pub(crate) const PARSERS: [Parser; 18] = [
    Parser {
        file: "cameras.bin",
        parse: |file, bytes| colmap(Encoding::Binary, 0, file, bytes),
        sound: || colmap_file(Encoding::Binary, 0),
    },
    Parser {
        file: "images.bin",
        parse: |file, bytes| colmap(Encoding::Binary, 1, file, bytes),
        sound: || colmap_file(Encoding::Binary, 1),
    },
    Parser {
        file: "points3D.bin",
        parse: |file, bytes| colmap(Encoding::Binary, 2, file, bytes),
        sound: || colmap_file(Encoding::Binary, 2),
    },
    Parser {
        file: "cameras.txt",
        parse: |file, bytes| colmap(Encoding::Text, 0, file, bytes),
        sound: || colmap_file(Encoding::Text, 0),
    },
    Parser {
        file: "images.txt",
        parse: |file, bytes| colmap(Encoding::Text, 1, file, bytes),
        sound: || colmap_file(Encoding::Text, 1),
    },
    Parser {
        file: "points3D.txt",
        parse: |file, bytes| colmap(Encoding::Text, 2, file, bytes),
        sound: || colmap_file(Encoding::Text, 2),
    },
    Parser { file: "mesh.ply", parse: every_shape, sound: mesh },
    Parser { file: "ascii.ply", parse: every_shape, sound: || ASCII_PLY.to_vec() },
    Parser { file: "splats.ply", parse: |file, bytes| ply::read_floats(file, bytes).map(drop), sound: floats },
    Parser {
        file: "reconstruction.json",
        parse: |file, bytes| opensfm::parse(file, bytes).map(drop),
        sound: || RECONSTRUCTION.to_vec(),
    },
    Parser { file: "tracks.csv", parse: tracks, sound: || b"a.jpg\t7\t1\t0.1\t-0.2\t0.004\t1\t2\t3\n".to_vec() },
    Parser {
        file: "transforms.json",
        parse: |file, bytes| nerfstudio::parse(file, bytes, &mut |_| None).map(drop),
        sound: || TRANSFORMS.to_vec(),
    },
    Parser {
        file: "georef.json",
        parse: |file, bytes| georef::parse_georef(file, bytes).map(drop),
        sound: || br#"{"epsg": 28992, "offset": [1, 2, 3], "metres_per_unit": 2.5, "up": [0, 0, -1]}"#.to_vec(),
    },
    Parser {
        file: "gps.txt",
        parse: |file, bytes| georef::parse_gps_list(file, bytes).map(drop),
        sound: || b"# name\na.jpg 46.8 -92 198.3\nb.jpg 46.9 -92.5 190\n".to_vec(),
    },
    Parser {
        file: "a.depth",
        parse: |file, bytes| map::decode_map::<f32>(file, bytes).map(drop),
        sound: || map::encode_map(&Map::filled(5, 4, 1.5f32)),
    },
    Parser { file: "a.png", parse: every_raster, sound: || raster::encode_png(&image()) },
    Parser { file: "m.png", parse: every_raster, sound: || raster::encode_instances_png(&Map::filled(7, 5, 300)) },
    Parser { file: "a.jpg", parse: every_raster, sound: jpeg_with_xmp },
];
