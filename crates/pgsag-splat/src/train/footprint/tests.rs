use super::*;
use crate::train::trainer::fake::camera_above;

#[test]
fn the_finest_view_decides() {
    let cameras = [camera_above([0.0, 0.0], 10.0, 100), camera_above([0.0, 0.0], 5.0, 100)];
    let found = footprints(&[[0.0; 3], [1000.0, 0.0, 0.0]], &cameras);
    assert!((found[0].depth - 5.0).abs() < 1e-6);
    assert_eq!(found[1], Footprint::UNSEEN);
}

#[test]
fn reference_sizes_do_not_depend_on_resolution() {
    let size = |width| footprints(&[[0.0; 3]], &[camera_above([0.0, 0.0], 5.0, width)])[0].reference_px(0.01);
    assert!((size(100) - 2.0).abs() < 1e-5);
    assert!((size(100) - size(400)).abs() < 1e-5);
}
