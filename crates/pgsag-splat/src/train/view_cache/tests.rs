use super::*;
use crate::train::trainer::fake::{Fake, FakeViews};
use pgsag_scene::{Mask, PixelClass};

#[test]
fn the_least_recently_used_goes_first() {
    let (backend, views) = (Fake::default(), FakeViews::ring(3, 16));
    let mut cache = ViewCache::<Fake>::new(&views, 2 * 16 * 16 * BYTES_PER_PIXEL);
    for index in [0, 1, 0, 2, 0, 1] {
        cache.get(&backend, index, || views.view(index)).expect("fakes do not fail");
    }
    // 0, 1, 2 (puts 1 out), 1 again (puts 2 out).
    assert_eq!(backend.calls("prepare"), 4);
}

#[test]
fn a_view_larger_than_the_bound_is_still_served() {
    let (backend, views) = (Fake::default(), FakeViews::ring(2, 16));
    let mut cache = ViewCache::<Fake>::new(&views, 1);
    for index in [0, 1] {
        assert!(cache.get(&backend, index, || views.view(index)).is_ok());
    }
}

#[test]
fn coarse_masks_say_where_a_view_takes_part() {
    let mut view = FakeViews::ring(1, 20).training_view(0);
    assert!(CoarseMask::of(&view).is_active([3.0, 3.0]));
    let mut mask = Mask::filled(20, 20, PixelClass::Free);
    mask.classes[17 * 20 + 18] = PixelClass::Inside;
    view.mask = Some(mask);
    let coarse = CoarseMask::of(&view);
    assert!(coarse.is_active([16.5, 16.5]) && !coarse.is_active([15.5, 16.5]));
}
