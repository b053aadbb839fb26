use super::*;
use crate::numbers::SplitMix64;

/// A lens of every model, as strong as those of real cameras.
pub(crate) fn lenses() -> Vec<LensCamera> {
    let params: [&[f64]; 11] = [
        &[900.0, 700.0, 500.0],
        &[900.0, 910.0, 690.0, 510.0],
        &[900.0, 700.0, 500.0, -0.12],
        &[900.0, 700.0, 500.0, -0.2, 0.08],
        &[900.0, 910.0, 690.0, 510.0, -0.25, 0.12, 1e-3, -2e-3],
        &[700.0, 705.0, 690.0, 510.0, -0.03, 0.01, -4e-3, 5e-4],
        &[900.0, 910.0, 690.0, 510.0, 0.3, -0.1, 1e-3, -2e-3, 0.02, 0.35, 0.02, 0.005],
        &[900.0, 910.0, 690.0, 510.0, 0.9],
        &[700.0, 690.0, 510.0, 0.02],
        &[700.0, 690.0, 510.0, -0.02, 3e-3],
        &[700.0, 705.0, 690.0, 510.0, -0.03, 0.01, 1e-3, -1e-3, -2e-3, 2e-4, 5e-4, -5e-4],
    ];
    LensModel::ALL
        .into_iter()
        .zip(params)
        .map(|(model, params)| LensCamera { model, width: 1400, height: 1000, params: params.to_vec() })
        .collect()
}

#[test]
fn names_and_numbers_find_their_model() {
    for (number, model) in (0..).zip(LensModel::ALL) {
        assert_eq!(LensModel::from_number(number), Some(model));
        assert_eq!(model.number(), number);
        assert_eq!(LensModel::from_name(model.name()), Some(model));
    }
    assert_eq!(LensModel::from_number(11), None);
    assert_eq!(LensModel::from_number(-1), None);
    assert_eq!(LensModel::from_name("EUCM"), None);
}

#[test]
fn the_inverse_converges_over_the_whole_image() {
    for lens in lenses() {
        lens.check().unwrap();
        for y in 0..=20 {
            for x in 0..=28 {
                let at = DVec2::new(f64::from(x) * 50.0, f64::from(y) * 50.0);
                let ray = lens.unproject(at).unwrap_or_else(|| panic!("{:?} {at}", lens.model));
                assert_eq!(ray.z, 1.0);
                let back = lens.project(ray * 3.5).unwrap();
                assert!((back - at).length() < 1e-9, "{:?} {at} {back}", lens.model);
            }
        }
    }
}

#[test]
fn nothing_behind_the_camera_is_seen() {
    for lens in lenses() {
        assert_eq!(lens.project(DVec3::new(0.1, 0.1, -1.0)), None);
        assert_eq!(lens.project(DVec3::new(0.1, 0.1, 0.0)), None);
        assert_eq!(lens.project(DVec3::NAN), None);
        assert_eq!(lens.unproject(DVec2::NAN), None);
    }
}

#[test]
fn a_fisheye_has_no_ray_at_90_degrees() {
    let params = vec![100.0, 500.0, 500.0, 0.0];
    let lens = LensCamera { model: LensModel::SimpleRadialFisheye, width: 1000, height: 1000, params };
    assert!(lens.unproject(DVec2::new(500.0 + 156.0, 500.0)).is_some());
    assert_eq!(lens.unproject(DVec2::new(500.0 + 158.0, 500.0)), None);
}

#[test]
fn resizing_a_lens_resizes_its_image() {
    let mut stream = SplitMix64::new(9);
    for lens in lenses() {
        let half = lens.resized(700, 500);
        let ray = DVec3::new(stream.range(-0.5, 0.5), stream.range(-0.4, 0.4), 1.0);
        let (a, b) = (lens.project(ray).unwrap(), half.project(ray).unwrap());
        assert!((a * 0.5 - b).length() < 1e-9);
    }
}

#[test]
fn implausible_cameras_are_named() {
    let lens =
        |width, params: &[f64]| LensCamera { model: LensModel::Pinhole, width, height: 10, params: params.into() };
    assert!(lens(10, &[1.0, 1.0, 5.0, 5.0]).check().is_ok());
    assert!(lens(0, &[1.0, 1.0, 5.0, 5.0]).check().unwrap_err().contains("0 x 10"));
    assert!(lens(10, &[1.0, 1.0, 5.0]).check().unwrap_err().contains("PINHOLE has 4 parameters, not 3"));
    assert!(lens(10, &[1.0, -1.0, 5.0, 5.0]).check().unwrap_err().contains("-1"));
    assert!(lens(10, &[1.0, 1.0, f64::NAN, 5.0]).check().unwrap_err().contains("NaN"));
}
