use super::*;
use crate::camera::distortion::LensModel;
use crate::numbers::SplitMix64;

fn lens() -> LensCamera {
    let params = vec![150.0, 152.0, 71.0, 48.0, -0.2, 0.1, 1e-3, -2e-3];
    LensCamera { model: LensModel::Opencv, width: 140, height: 100, params }
}

fn noise(width: u32, height: u32) -> Image {
    let mut stream = SplitMix64::new(3);
    let pixels = (0..width * height).map(|_| [0; 3].map(|_: u8| stream.below(256) as u8)).collect();
    Image { width, height, pixels }
}

#[test]
fn a_pinhole_stays_what_it_is() {
    let camera = Pinhole { width: 140, height: 100, fx: 150.0, fy: 152.0, cx: 71.0, cy: 48.0 };
    let lens = LensCamera::from(camera);
    assert_eq!(pinhole_for(&lens), camera);
    let image = noise(140, 100);
    assert_eq!(undistort(&image, &lens, &camera), image);
}

#[test]
fn resampling_a_pinhole_into_itself_is_exact() {
    let camera = Pinhole { width: 140, height: 100, fx: 150.0, fy: 152.0, cx: 71.0, cy: 48.0 };
    let params = vec![150.0, 152.0, 71.0, 48.0, 0.0, 0.0, 0.0, 0.0];
    let lens = LensCamera { model: LensModel::Opencv, width: 140, height: 100, params };
    let image = noise(140, 100);
    assert_eq!(undistort(&image, &lens, &camera), image);
}

#[test]
fn a_window_has_the_bytes_of_the_whole() {
    let (lens, image) = (lens(), noise(140, 100));
    let target = pinhole_for(&lens);
    let window = Window { x0: 13, y0: 7, width: 50, height: 31 };
    assert_eq!(
        undistort_window(&image, &lens, &target, window),
        undistort(&image, &lens, &target).cropped(13, 7, 50, 31)
    );
}

#[test]
fn no_pixel_is_blank() {
    let lens = lens();
    let target = pinhole_for(&lens);
    assert_ne!((target.width, target.height), (lens.width, lens.height));
    let valid = validity(&lens, &target, Window::full(&target));
    assert!(valid.values.iter().all(|&valid| valid));
}

#[test]
fn points_go_there_and_back() {
    let lens = lens();
    let target = pinhole_for(&lens);
    let mut stream = SplitMix64::new(5);
    for _ in 0..100 {
        let at = DVec2::new(stream.range(0.0, 140.0), stream.range(0.0, 100.0));
        let there = undistort_point(at, &lens, &target).unwrap();
        assert!((distort_point(there, &lens, &target).unwrap() - at).length() < 1e-9);
    }
}

#[test]
fn masks_follow_the_image() {
    let lens = lens();
    let target = pinhole_for(&lens);
    let mut mask = Map::filled(140, 100, false);
    (0..100).for_each(|y| (60..140).for_each(|x| mask.set(x, y, true)));
    let seen = undistort_mask(&mask, &lens, &target);
    for (x, y) in [(10, 10), (30, 90), (100, 10), (120, 95), (55, 48), (70, 48)] {
        let at = distort_point(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5), &lens, &target).unwrap();
        assert_eq!(seen.at(x, y), at.x > 60.0, "{x} {y}");
    }
}
