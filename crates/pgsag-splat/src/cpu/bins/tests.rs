//! Lists against brute force over pixels.

use pgsag_scene::numbers::SplitMix64;

use super::*;
use crate::lanes::{SimdLevel, at_level};

/// A random elongated ellipse near a raster of 100 x 70.
fn random_record(stream: &mut SplitMix64) -> Line {
    let mut record = Line::ZERO;
    let angle = stream.range(0.0, std::f64::consts::PI);
    let (long, short) = (stream.range(0.3, 30.0), stream.range(0.3, 3.0));
    let (c, s) = (libm::cos(angle), libm::sin(angle));
    let (a, b) = (1.0 / (long * long), 1.0 / (short * short));
    let scale = std::f64::consts::LOG2_E;
    record.0[X] = stream.range(-20.0, 120.0) as f32;
    record.0[Y] = stream.range(-20.0, 90.0) as f32;
    record.0[XX] = (-0.5 * scale * (a * c * c + b * s * s)) as f32;
    record.0[XY] = (-scale * (a - b) * c * s) as f32;
    record.0[YY] = (-0.5 * scale * (a * s * s + b * c * c)) as f32;
    record.0[PEAK] = libm::log2(stream.range(0.004, 1.0)) as f32;
    record
}

fn exponent(record: &Line, x: u32, y: u32) -> f32 {
    let (dx, dy) = (x as f32 + 0.5 - record.0[X], y as f32 + 0.5 - record.0[Y]);
    record.0[XX] * dx * dx + record.0[XY] * dx * dy + record.0[YY] * dy * dy + record.0[PEAK]
}

#[inline(always)]
fn find<S: Carried>(simd: S, layout: &Layout, fields: &[Line; 16], cut: f32, tiles: &mut Vec<u32>) {
    simd.carry();
    let mut boxes = Boxes::NONE;
    let one = Wide::<S>::from_f64(1.0);
    boxes.set::<S>(layout, fields, 0, cut, Wide::<S>::zero().less(one));
    boxes.touched(layout, fields, 0, cut, tiles);
}

#[test]
fn no_pixel_is_lost_and_few_tiles_are_too_many() {
    let layout = Layout::new(100, 70, |x, y| x + y > 30);
    let cut = libm::log2f(1.0 / 255.0);
    let mut stream = SplitMix64::new(5);
    let (mut kept, mut needed) = (0, 0);
    for _ in 0..500 {
        let record = random_record(&mut stream);
        let mut tiles = Vec::new();
        let fields: [Line; 16] = std::array::from_fn(|k| Line([record.0[k]; 16]));
        let level = SimdLevel::Auto.detected().expect("some level is there");
        at_level!(level, simd => find(simd, &layout, &fields, cut, &mut tiles));
        for slot in 0..layout.tiles.len() as u32 {
            let (x0, y0) = layout.corner(layout.tiles[slot as usize]);
            let touched = (0..256).any(|i| {
                let (x, y) = (x0 + i % 16, y0 + i / 16);
                x < 100 && y < 70 && exponent(&record, x, y) >= cut
            });
            assert!(!touched || tiles.contains(&slot));
            needed += u32::from(touched);
        }
        kept += tiles.len() as u32;
    }
    assert!(needed > 1000 && f64::from(kept) < 1.15 * f64::from(needed), "{kept} for {needed}");
}

#[test]
fn lists_are_by_depth_then_index_and_places_lead_back() {
    let mut stream = SplitMix64::new(9);
    let mut entries = Vec::new();
    let mut tiles = Vec::new();
    for gaussian in 0..6000u32 {
        let count = stream.below(4) as u32 + 1;
        let first = tiles.len() as u32;
        entries.push(Entry { gaussian, depth: stream.below(50) as u32, first, count, thickness: 0.0 });
        let start = stream.below(36) as u32;
        tiles.extend(start..start + count);
    }
    let mut bins = Bins::default();
    bins.gather(&[(&entries[..], &tiles[..])]);
    bins.fill(40);
    let mut pairs = 0;
    for slot in 0..40 {
        let listed = bins.listed(bins.list(slot)).iter().map(|listed| listed.load(Relaxed));
        let list: Vec<(u32, u32)> = listed.map(|gaussian| (entries[gaussian as usize].depth, gaussian)).collect();
        assert!(list.is_sorted());
        pairs += list.len();
    }
    assert_eq!(pairs, tiles.len());
    for entry in &entries {
        for pair in entry.first..entry.first + entry.count {
            let place = bins.places[pair as usize].load(Relaxed) as usize;
            let listed = bins.listed(place..place + 1)[0].load(Relaxed);
            assert_eq!(listed, entry.gaussian);
            assert!(bins.list(tiles[pair as usize] as usize).contains(&place));
        }
    }
}
