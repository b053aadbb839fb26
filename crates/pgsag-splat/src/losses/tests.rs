//! Views and maps that the proofs of several losses share.

use pgsag_scene::numbers::SplitMix64;
use pgsag_scene::{Image, Mask, Pinhole, PixelClass};

use super::view::LossView;
use crate::backend::{LossWeights, Reading, TrainingView, ViewCamera};

/// A camera at the origin of its group that looks along z.
pub(crate) fn camera(width: u32, height: u32) -> ViewCamera {
    let focal = 0.9 * f64::from(width);
    let (cx, cy) = (0.48 * f64::from(width), 0.53 * f64::from(height));
    ViewCamera {
        pinhole: Pinhole { width, height, fx: focal, fy: 1.05 * focal, cx, cy },
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
        near: 0.1,
    }
}

/// A noisy photograph whose mask is a disc with a boundary, in front of free pixels and an occluded corner.
pub(crate) fn training_view(width: u32, height: u32, seed: u64, masked: bool) -> TrainingView {
    let mut random = SplitMix64::new(seed);
    let mut image = Image::filled(width, height, [0; 3]);
    for (index, pixel) in image.pixels.iter_mut().enumerate() {
        let wave = 90.0 + 60.0 * libm::sin(0.4 * index as f64) * libm::cos(0.05 * index as f64);
        *pixel = std::array::from_fn(|_| (wave + random.range(-25.0, 25.0)) as u8);
    }
    let mut mask = Mask::filled(width, height, PixelClass::Free);
    for (index, class) in mask.classes.iter_mut().enumerate() {
        let (x, y) = ((index as u32 % width) as f64 + 0.5, (index as u32 / width) as f64 + 0.5);
        let radius = libm::hypot(x / f64::from(width) - 0.5, y / f64::from(height) - 0.5);
        *class = match radius {
            r if r < 0.36 => PixelClass::Inside,
            r if r < 0.43 => PixelClass::Boundary,
            _ if x < f64::from(width) * 0.3 && y < f64::from(height) * 0.3 => PixelClass::Occluded,
            _ => PixelClass::Free,
        };
    }
    TrainingView { camera: camera(width, height), image, mask: masked.then_some(mask), inner_edges: None }
}

/// The same, prepared.
pub(crate) fn loss_view(width: u32, height: u32, seed: u64, masked: bool) -> LossView {
    LossView::new(&training_view(width, height, seed, masked))
}

/// A neighbour of [`camera`]: turned and moved to the side, looking at what lies about z = 4.
pub(crate) fn turned_camera(width: u32, height: u32) -> ViewCamera {
    let (sin, cos) = (libm::sin(0.15), libm::cos(0.15));
    let rotation = [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]];
    ViewCamera { rotation, translation: [-0.55, 0.07, 0.04], ..camera(width, height) }
}

/// What it sees, prepared.
pub(crate) fn turned(width: u32, height: u32, seed: u64, masked: bool) -> LossView {
    LossView::new(&TrainingView { camera: turned_camera(width, height), ..training_view(width, height, seed, masked) })
}

/// No term at all.
pub(crate) fn no_weights() -> LossWeights {
    LossWeights {
        l1: 0.0,
        dssim: 0.0,
        flatness: 0.0,
        normal: 0.0,
        normal_boundary: 0.1,
        normal_image_gradient: false,
        geometric: 0.0,
        geometric_gate_px: 1.0,
        ncc: 0.0,
        ncc_patches: 1000,
        load: 0.0,
        free_opacity: 0.0,
        reading: Reading::Code,
        mean_over_mask: true,
    }
}

/// Three maps, one after another in one list.
pub(crate) fn planes<T>(flat: &[T]) -> [&[T]; 3] {
    let (first, rest) = flat.split_at(flat.len() / 3);
    let (second, third) = rest.split_at(first.len());
    [first, second, third]
}

/// The same, to be written.
pub(crate) fn planes_mut<T>(flat: &mut [T]) -> [&mut [T]; 3] {
    let count = flat.len() / 3;
    let (first, rest) = flat.split_at_mut(count);
    let (second, third) = rest.split_at_mut(count);
    [first, second, third]
}

/// Prints the least processor time of a few runs on one thread; a busy machine does not disturb it.
pub(crate) fn print_processor_time(name: &str, work: impl Fn() + Sync) {
    let spent_ms = || {
        let statistics = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
        statistics.split(' ').next().unwrap().parse::<f64>().unwrap() / 1e6
    };
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let least = one.install(|| {
        let run = |_| {
            let start = spent_ms();
            work();
            spent_ms() - start
        };
        (0..9).map(run).fold(f64::INFINITY, f64::min)
    });
    println!("{name}: {least:.1} ms of processor");
}
