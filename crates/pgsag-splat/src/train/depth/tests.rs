use super::*;
use crate::train::trainer::fake::camera_above;
use pgsag_scene::PixelClass;

/// Maps of a plane with this camera-frame normal, at `depth` on the optical axis.
fn plane(camera: &ViewCamera, normal: [f32; 3], depth: f32) -> PlaneMaps {
    let (w, h) = (camera.pinhole.width, camera.pinhole.height);
    let distance = -normal[2] * depth;
    let mut maps = PlaneMaps {
        color: Map::filled(w, h, [0.0; 3]),
        normal: Map::filled(w, h, normal.map(|v| 0.95 * v)),
        distance: Map::filled(w, h, 0.95 * distance),
        opacity: Map::filled(w, h, 0.95),
        depth: Map::filled(w, h, 0.0),
        load: Map::filled(0, 0, 0.0),
    };
    for y in 0..h {
        for x in 0..w {
            maps.depth.set(x, y, -distance / dot(normal, ray(camera, x, y)));
        }
    }
    maps
}

#[test]
fn a_slanted_plane_is_valid_and_weighed_by_its_cosine() {
    let camera = camera_above([0.0, 0.0], 5.0, 32);
    let (s, c) = (libm::sinf(1.0), libm::cosf(1.0));
    let found = valid_depth(&plane(&camera, [s, 0.0, -c], 5.0), &camera, None, &DepthOptions::default());
    assert!(found.depth.values.iter().filter(|d| **d > 0.0).count() > 900);
    assert!((found.weight.at(16, 16) - c * 0.95 / 25.0).abs() < 2e-3);
    assert!((dot(found.normal.at(3, 3), found.normal.at(3, 3)) - 1.0).abs() < 1e-5);
}

#[test]
fn grazing_faint_masked_and_distant_pixels_go() {
    let camera = camera_above([0.0, 0.0], 5.0, 32);
    let frontal = plane(&camera, [0.0, 0.0, -1.0], 5.0);
    let kept = |maps: &PlaneMaps, mask: Option<&Mask>, options: &DepthOptions| {
        valid_depth(maps, &camera, mask, options).depth.values.iter().filter(|d| **d > 0.0).count()
    };
    let defaults = DepthOptions::default();
    assert_eq!(kept(&frontal, None, &defaults), 32 * 32);
    assert_eq!(kept(&frontal, None, &DepthOptions { min_opacity: 0.96, ..defaults }), 0);
    assert_eq!(kept(&frontal, None, &DepthOptions { far: 4.9, ..defaults }), 0);
    let (s, c) = (libm::sinf(1.5), libm::cosf(1.5));
    let centre = valid_depth(&plane(&camera, [0.0, s, -c], 5.0), &camera, None, &defaults).depth.at(16, 16);
    assert_eq!(centre, 0.0, "86 degrees");
    let mut mask = Mask::filled(32, 32, PixelClass::Occluded);
    mask.classes[5] = PixelClass::Boundary;
    assert_eq!(kept(&frontal, Some(&mask), &defaults), 1);
}

#[test]
fn blends_between_two_surfaces_go() {
    let camera = camera_above([0.0, 0.0], 5.0, 32);
    let mut maps = plane(&camera, [0.0, 0.0, -1.0], 5.0);
    for y in 0..32 {
        for x in 16..32 {
            maps.depth.set(x, y, if x == 16 { 5.7 } else { 8.0 });
        }
    }
    let found = valid_depth(&maps, &camera, None, &DepthOptions::default());
    assert_eq!([15, 16, 17].map(|x| found.depth.at(x, 9)), [5.0, 0.0, 8.0]);
}
