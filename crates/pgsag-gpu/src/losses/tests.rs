//! Every term alone against the f64 losses of `pgsag-splat`, on maps that are uploaded, so that no rasterizer is in the way.

use pgsag_scene::numbers::SplitMix64;
use pgsag_scene::{Image, Map, Mask, Pinhole, PixelClass};
use pgsag_splat::backend::{Exposure, LossValues, LossWeights, Reading, TrainingView, ViewCamera};
use pgsag_splat::equations::projection::Lens;
use pgsag_splat::equations::{Scalar, plane};
use pgsag_splat::losses::{Evaluation, Inputs, LossView, RenderedMaps, evaluate};

use super::{Request, Side, compare};
use crate::device::Device;
use crate::memory::Buffer;
use crate::view::GpuView;

const WIDTH: u32 = 53;
const HEIGHT: u32 = 37;
const PIXELS: usize = (WIDTH * HEIGHT) as usize;
/// Planes of maps and of their gradients.
const PLANES: usize = 10;
/// Most relative error of a vector, or three times what f32 on the processor leaves: depth maps are differenced.
const TOLERANCE: f64 = 1e-4;
const SCENE_SCALE: f32 = 5.0;
const EXPOSURE: Exposure = Exposure { gain: [1.05, 0.95, 1.0], bias: [0.01, -0.02, 0.0] };

/// A view with its maps, on the host.
struct Seen {
    training: TrainingView,
    /// Ten planes.
    maps: Vec<f32>,
}

fn camera(yaw_rad: f64, translation: [f64; 3]) -> ViewCamera {
    let (sin, cos) = (libm::sin(yaw_rad), libm::cos(yaw_rad));
    ViewCamera {
        pinhole: Pinhole { width: WIDTH, height: HEIGHT, fx: 48.0, fy: 50.0, cx: 26.1, cy: 18.7 },
        rotation: [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]],
        translation,
        near: 0.1,
    }
}

/// What a tilted, slightly waved and textured plane looks like from a camera.
fn seen(camera: ViewCamera, masked: bool) -> Seen {
    let lens = Lens::<f64>::new(&camera);
    // The plane n · x = −5 of the common frame, in this camera's.
    let tilted = [0.12, -0.07, -1.0].map(|value| value / 1.009_603_883);
    let normal = [0, 1, 2].map(|row| (0..3).map(|k| lens.rotation[row][k] * tilted[k]).sum::<f64>());
    let distance = 5.0 - (0..3).map(|k| normal[k] * lens.translation[k]).sum::<f64>();
    let mut random = SplitMix64::new(3);
    let mut image = Image::filled(WIDTH, HEIGHT, [0; 3]);
    let mut maps = vec![0.0f32; PLANES * PIXELS];
    let mut mask = Mask::filled(WIDTH, HEIGHT, PixelClass::Free);
    let mut edges = Map::filled(WIDTH, HEIGHT, false);
    for index in 0..PIXELS {
        let (x, y) = (index as u32 % WIDTH, index as u32 / WIDTH);
        let ray = lens.ray(f64::from(x), f64::from(y));
        let wave = 0.004 * libm::sin(0.7 * f64::from(x)) * libm::cos(0.5 * f64::from(y));
        let alpha = 0.9 + 0.08 * libm::sin(0.3 * f64::from(x + 2 * y));
        let n = [normal[0] + wave, normal[1] - 0.5 * wave, normal[2]].map(|value| (value * alpha) as f32);
        let d = (distance * (1.0 + wave) * alpha) as f32;
        let z = plane::depth(f64::from(d), n.map(f64::from), ray);
        let here = [0, 1, 2]
            .map(|k| (0..3).map(|row| lens.rotation[row][k] * (ray[row] * z - lens.translation[row])).sum::<f64>());
        let shade = |channel: f64| {
            let wave = libm::sin(4.1 * here[0] + channel) * libm::cos(3.3 * here[1]);
            0.5 + 0.28 * wave + 0.16 * libm::sin(6.7 * here[1] - 2.9 * here[0] + 0.5 * channel)
        };
        image.pixels[index] = [0.0, 1.0, 2.0].map(|channel| (255.0 * shade(channel)) as u8);
        let color = [0.0, 1.0, 2.0].map(|channel| (shade(channel) + random.range(-0.1, 0.1)) as f32);
        let load = (9.0 + random.range(0.0, 6.0)) as f32;
        let all = [color[0], color[1], color[2], alpha as f32, n[0], n[1], n[2], d, z as f32, load.floor()];
        let radius = libm::hypot(f64::from(x) - 27.0, 1.2 * (f64::from(y) - 18.0));
        let class = match radius {
            r if r < 15.0 => PixelClass::Inside,
            r if r < 17.5 => PixelClass::Boundary,
            _ if x < 16 && y < 16 => PixelClass::Occluded,
            _ => PixelClass::Free,
        };
        mask.classes[index] = class;
        edges.set(x, y, (x + y) % 13 == 0);
        let drawn = !masked || class != PixelClass::Occluded;
        for (plane, value) in all.into_iter().enumerate().filter(|_| drawn) {
            maps[plane * PIXELS + index] = value;
        }
    }
    let (mask, inner_edges) = if masked { (Some(mask), Some(edges)) } else { (None, None) };
    Seen { training: TrainingView { camera, image, mask, inner_edges }, maps }
}

/// The same on the card.
struct OnCard {
    view: GpuView,
    maps: Buffer,
    grads: Buffer,
    sizes: Buffer,
}

impl OnCard {
    fn new(device: &Device, seen: &Seen) -> Self {
        let sizes = [0, 0, 0, 0, 3.5f32.to_bits(), 70, 0, 0];
        Self {
            view: GpuView::new(device, &seen.training).unwrap(),
            maps: device.buffer_with("maps", &seen.maps).unwrap(),
            grads: device.buffer("gradients", 4 * (PLANES * PIXELS) as u64).unwrap(),
            sizes: device.buffer_with("sizes", &sizes).unwrap(),
        }
    }

    fn side(&self) -> Side<'_> {
        Side { view: &self.view, maps: &self.maps, grads: &self.grads, sizes: &self.sizes }
    }
}

const NOTHING: LossWeights = LossWeights {
    l1: 0.0,
    dssim: 0.0,
    flatness: 0.0,
    normal: 0.0,
    normal_boundary: 0.1,
    normal_image_gradient: false,
    geometric: 0.0,
    geometric_gate_px: 1000.0,
    ncc: 0.0,
    ncc_patches: 100_000,
    load: 0.0,
    free_opacity: 0.0,
    reading: Reading::Code,
    mean_over_mask: true,
};

fn weightings() -> Vec<(&'static str, LossWeights)> {
    let all = LossWeights {
        l1: 0.8,
        dssim: 0.2,
        flatness: 1.0,
        normal: 0.015,
        normal_image_gradient: true,
        geometric: 0.03,
        ncc: 0.15,
        ncc_patches: 300,
        load: 0.41,
        free_opacity: 0.1,
        ..NOTHING
    };
    vec![
        ("L1", LossWeights { l1: 1.0, ..NOTHING }),
        ("SSIM", LossWeights { dssim: 1.0, ..NOTHING }),
        ("SSIM over the frame", LossWeights { dssim: 1.0, mean_over_mask: false, ..NOTHING }),
        ("normal", LossWeights { normal: 1.0, normal_image_gradient: true, ..NOTHING }),
        ("normal as printed", LossWeights { normal: 1.0, reading: Reading::Paper, ..NOTHING }),
        ("geometric", LossWeights { geometric: 1.0, ..NOTHING }),
        ("NCC", LossWeights { ncc: 1.0, ..NOTHING }),
        ("NCC of some", LossWeights { ncc: 1.0, ncc_patches: 100, ..NOTHING }),
        ("load", LossWeights { l1: 1.0, load: 0.41, ..NOTHING }),
        ("load as printed", LossWeights { l1: 1.0, load: 0.41, reading: Reading::Paper, ..NOTHING }),
        ("load over the frame", LossWeights { l1: 1.0, load: 0.41, mean_over_mask: false, ..NOTHING }),
        ("free opacity", LossWeights { free_opacity: 1.0, ..NOTHING }),
        ("all terms", all),
        ("all terms over the frame, as printed", LossWeights { reading: Reading::Paper, mean_over_mask: false, ..all }),
    ]
}

/// What the losses of `pgsag-splat` say of two views.
fn expected<T: Scalar>(seen: &[Seen; 2], weights: &LossWeights) -> Evaluation<T> {
    let views = seen.each_ref().map(|seen| LossView::new(&seen.training));
    let wide = seen.each_ref().map(|seen| seen.maps.iter().map(|&value| T::from_f32(value)).collect::<Vec<T>>());
    let [own, far] = wide.each_ref().map(|maps| {
        let plane = |k: usize| &maps[k * PIXELS..(k + 1) * PIXELS];
        RenderedMaps {
            color: [plane(0), plane(1), plane(2)],
            normal: [plane(4), plane(5), plane(6)],
            distance: plane(7),
            opacity: plane(3),
            load: plane(9),
        }
    });
    let flatness = if weights.flatness == 0.0 { 0.0 } else { 3.5 / 70.0 / f64::from(SCENE_SCALE) };
    evaluate(&Inputs {
        view: &views[0],
        maps: own,
        neighbor: Some((&views[1], far)),
        exposure: EXPOSURE,
        weights,
        flatness,
        seed: 17,
    })
}

/// Every value and every plane of gradients, by name.
type Quantities = Vec<(String, Vec<f64>)>;

fn list(values: &LossValues, planes: impl Fn(usize, usize) -> Vec<f64>) -> Quantities {
    let terms = [
        ("total", values.total),
        ("L1", values.l1),
        ("SSIM", values.dssim),
        ("flatness", values.flatness),
        ("normal", values.normal),
        ("geometric", values.geometric),
        ("valid", values.geometric_valid),
        ("NCC", values.ncc),
        ("patches", values.ncc_patches as f32),
        ("load", values.load),
        ("free", values.free_opacity),
    ];
    let mut all: Quantities = terms.map(|(name, value)| (name.into(), vec![value.into()])).into();
    all.push(("gain".into(), values.d_gain.map(f64::from).into()));
    all.push(("bias".into(), values.d_bias.map(f64::from).into()));
    for (side, name) in ["own", "neighbour's"].into_iter().enumerate() {
        all.extend((0..PLANES).map(|k| (format!("gradient of {name} plane {k}"), planes(side, k))));
    }
    all
}

fn by_reference<T: Scalar>(seen: &[Seen; 2], weights: &LossWeights) -> Quantities {
    let found = expected::<T>(seen, weights);
    list(&found.values, |side, k| {
        let all = if side == 0 { &found.reference } else { &found.neighbor };
        let plane: &[T] = match k {
            0..3 => &all.color[k],
            3 => &all.opacity,
            4..7 => &all.normal[k - 4],
            7 => &all.distance,
            9 => &all.load,
            _ => &[],
        };
        if plane.is_empty() { vec![0.0; PIXELS] } else { plane.iter().map(|value| value.to_f64()).collect() }
    })
}

fn by_card(device: &Device, seen: &[Seen; 2], weights: &LossWeights) -> Quantities {
    let cards = seen.each_ref().map(|seen| OnCard::new(device, seen));
    let request = Request {
        reference: cards[0].side(),
        neighbor: Some(cards[1].side()),
        exposure: EXPOSURE,
        weights,
        scene_scale: SCENE_SCALE,
        seed: 17,
        has_load: true,
    };
    let (values, _) = compare(device, &request, &[]).unwrap();
    let grads = cards.each_ref().map(|card| device.read::<f32>(&card.grads, 0, PLANES * PIXELS).unwrap());
    list(&values, |side, k| grads[side][k * PIXELS..(k + 1) * PIXELS].iter().map(|&value| value.into()).collect())
}

/// ‖a − b‖ / ‖b‖, or ‖a‖ where b is nothing.
fn error(found: &[f64], truth: &[f64]) -> f64 {
    let length = truth.iter().map(|value| value * value).sum::<f64>().sqrt();
    let off = found.iter().zip(truth).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
    if length < 1e-12 { off } else { off / length }
}

#[test]
fn every_term_alone_is_that_of_the_reference() {
    let Some(device) = crate::tests::device() else { return };
    let mut faults = Vec::new();
    for masked in [false, true] {
        let both = [seen(camera(0.0, [0.0; 3]), masked), seen(camera(0.12, [-0.6, 0.08, 0.05]), masked)];
        for (term, weights) in weightings() {
            let truth = by_reference::<f64>(&both, &weights);
            let single = by_reference::<f32>(&both, &weights);
            for (((name, truth), (_, single)), (_, found)) in
                truth.iter().zip(&single).zip(by_card(device, &both, &weights))
            {
                let (error, bound) = (error(&found, truth), TOLERANCE.max(3.0 * error(single, truth)));
                if error.is_nan() || error > bound {
                    faults.push(format!("masked {masked}, {term}: {name}: {error:.2e}, at most {bound:.2e}"));
                }
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}
