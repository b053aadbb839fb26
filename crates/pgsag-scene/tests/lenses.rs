//! Our lenses against COLMAP's: golden values of `tests/golden`, and real photographs where there are some.
#![expect(clippy::unwrap_used, reason = "a test stops where something is wrong")]

use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3};
use pgsag_scene::Image;
use pgsag_scene::camera::distortion::{LensCamera, LensModel};
use pgsag_scene::camera::undistort::{Window, pinhole_for, undistort, validity};
use pgsag_scene::files::{folder, raster};
use serde_json::Value;

fn golden(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

fn cameras() -> Vec<(LensCamera, Value)> {
    let golden: Value = serde_json::from_slice(&golden("lens_models.json")).unwrap();
    let cameras = golden["cameras"].as_array().unwrap().iter().map(|camera| {
        let model = LensModel::from_name(camera["model"].as_str().unwrap()).unwrap();
        assert_eq!(i64::from(model.number()), camera["number"].as_i64().unwrap());
        (LensCamera { model, width: 1400, height: 1000, params: numbers(&camera["params"]) }, camera.clone())
    });
    let cameras: Vec<_> = cameras.collect();
    assert_eq!(cameras.len(), 11);
    cameras
}

#[test]
fn points_project_as_in_colmap() {
    for (lens, golden) in cameras() {
        for row in golden["project"].as_array().unwrap() {
            let row = numbers(row);
            let xy = lens.project(DVec3::new(row[0], row[1], row[2])).unwrap();
            let miss = (xy - DVec2::new(row[3], row[4])).length();
            assert!(miss <= 1e-9, "{:?}: {row:?}, off by {miss} px", lens.model);
        }
    }
}

#[test]
fn pixels_unproject_as_in_colmap() {
    for (lens, golden) in cameras() {
        for row in golden["unproject"].as_array().unwrap() {
            let row = numbers(row);
            let ray = lens.unproject(DVec2::new(row[0], row[1])).unwrap();
            // COLMAP's iteration stops at steps of 1e-5, one quadratic step short of rounding.
            let miss = (ray - DVec3::new(row[2], row[3], 1.0)).length() / ray.length();
            assert!(miss <= 1e-9, "{:?}: {row:?}, off by {miss}", lens.model);
        }
    }
}

#[test]
fn the_pinhole_of_a_lens_is_colmaps() {
    for (lens, golden) in cameras() {
        let expected = numbers(&golden["undistorted"]);
        let target = pinhole_for(&lens);
        let ours = [f64::from(target.width), f64::from(target.height), target.fx, target.fy, target.cx, target.cy];
        assert!(ours.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-9), "{:?}: {ours:?}", lens.model);
    }
}

/// Mean and 99 % of the differences in grey levels, over pixels that both have.
fn differences(ours: &Image, theirs: &Image, valid: &[bool]) -> (f64, u8) {
    let pixels = ours.pixels.iter().zip(&theirs.pixels).zip(valid);
    // COLMAP leaves black what lies beyond the outermost pixel centres.
    let both = pixels.filter(|((_, theirs), valid)| **valid && theirs.iter().any(|&value| value > 0));
    let mut histogram = [0usize; 256];
    both.for_each(|((a, b), _)| (0..3).for_each(|c| histogram[usize::from(a[c].abs_diff(b[c]))] += 1));
    let count: usize = histogram.iter().sum();
    let sum: usize = histogram.iter().enumerate().map(|(level, count)| level * count).sum();
    let mut seen = 0;
    let most = histogram.iter().position(|&level| {
        seen += level;
        seen * 100 >= count * 99
    });
    (sum as f64 / count as f64, most.unwrap() as u8)
}

#[test]
fn a_photograph_is_undistorted_as_by_colmap() {
    let photo = raster::decode_image("photo.png", &golden("photo.png")).unwrap();
    let theirs = raster::decode_image("photo_undistorted.png", &golden("photo_undistorted.png")).unwrap();
    let params = vec![100.0, 102.0, 47.0, 37.0, -0.25, 0.1, 2e-3, -4e-3];
    let lens = LensCamera { model: LensModel::Opencv, width: 96, height: 72, params };
    let target = pinhole_for(&lens);
    assert_eq!((target.width, target.height), (theirs.width, theirs.height));
    let ours = undistort(&photo, &lens, &target);
    let valid = validity(&lens, &target, Window::full(&target));
    let (mean, most) = differences(&ours, &theirs, &valid.values);
    assert!(mean < 0.01 && most <= 1, "mean {mean}, 99 % {most}");
}

#[test]
#[ignore = "needs PGSAG_DATA (workspaces) and PGSAG_COLMAP (output of golden/undistort_by_colmap.py for sceaux-full)"]
fn real_photographs_are_undistorted_as_by_colmap() {
    let variable = |name: &str| PathBuf::from(std::env::var_os(name).expect(name));
    let scene = folder::open_scene(&variable("PGSAG_DATA").join("sceaux-full")).unwrap();
    for (i, view) in scene.scene.views.iter().enumerate() {
        let (file, bytes) = folder::read_file(&variable("PGSAG_COLMAP").join(format!("{}.png", view.name))).unwrap();
        let theirs = raster::decode_image(&file, &bytes).unwrap();
        assert_eq!((view.camera.width, view.camera.height), (theirs.width, theirs.height));
        let ours = scene.read_undistorted_image(i).unwrap();
        let valid = validity(&view.lens, &view.camera, Window::full(&view.camera));
        let (mean, most) = differences(&ours, &theirs, &valid.values);
        println!("{}: mean {mean:.4}, 99 % {most} grey levels", view.name);
        assert!(mean < 0.5 && most < 3, "{}: mean {mean}, 99 % {most}", view.name);
    }
}
