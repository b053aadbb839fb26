//! Albedo of every material as a pure function of place: value noise over several octaves plus structure (bricks, tiles,
//! windows, kerbs). `footprint` is how much of the surface a pixel sees, metres; what is finer than half of it fades to
//! its mean, so that far views are not grainy.

use glam::{DVec2, DVec3};

use super::layout::{Layout, PAVEMENT};
use super::solids::{Material, Surface};

/// Linear RGB, 0 to 1.
pub(super) type Albedo = DVec3;

/// An avalanche of two lattice coordinates and a seed (the finaliser of MurmurHash3).
pub(super) fn hash(x: i32, y: i32, seed: u32) -> u32 {
    let mut h =
        (x as u32).wrapping_mul(0x9E37_79B1) ^ (y as u32).wrapping_mul(0x85EB_CA77) ^ seed.wrapping_mul(0xC2B2_AE3D);
    h = (h ^ (h >> 16)).wrapping_mul(0x85EB_CA6B);
    h = (h ^ (h >> 13)).wrapping_mul(0xC2B2_AE35);
    h ^ (h >> 16)
}

/// `hash` in [-1, 1].
fn signed(x: i32, y: i32, seed: u32) -> f64 {
    f64::from(hash(x, y, seed) as i32) * (1.0 / 2_147_483_648.0)
}

/// Floor and fraction.
fn parted(x: f64) -> (i32, f64) {
    let truncated = x as i32;
    let floor = truncated - i32::from(x < f64::from(truncated));
    (floor, x - f64::from(floor))
}

/// Smooth noise in [-1, 1] with a lattice of unit cells.
fn noise(x: f64, y: f64, seed: u32) -> f64 {
    let ((ix, fx), (iy, fy)) = (parted(x), parted(y));
    let (sx, sy) = (fx * fx * (3.0 - 2.0 * fx), fy * fy * (3.0 - 2.0 * fy));
    let low = signed(ix, iy, seed) * (1.0 - sx) + signed(ix + 1, iy, seed) * sx;
    let high = signed(ix, iy + 1, seed) * (1.0 - sx) + signed(ix + 1, iy + 1, seed) * sx;
    low * (1.0 - sy) + high * sy
}

/// How much of a structure of this size a pixel still resolves, 0 to 1.
fn resolved(size: f64, footprint: f64) -> f64 {
    (2.0 * size / footprint - 1.0).clamp(0.0, 1.0)
}

/// Noise summed over octaves from cells of `coarse` metres down to the footprint, each `falloff` as strong as the last.
fn octaves(at: DVec2, coarse: f64, falloff: f64, footprint: f64, seed: u32) -> f64 {
    let (mut sum, mut cell, mut weight) = (0.0, coarse, 1.0);
    for octave in 0..7u32 {
        let seen = resolved(cell, footprint);
        if seen == 0.0 || cell < 0.06 {
            break;
        }
        sum += weight * seen * noise(at.x / cell, at.y / cell, seed.wrapping_add(octave * 101));
        cell *= 0.5;
        weight *= falloff;
    }
    sum
}

/// The albedo of a surface at a place (town coordinates).
pub(super) fn albedo(layout: &Layout, surface: &Surface, place: DVec3, footprint: f64) -> Albedo {
    let from = place - surface.origin;
    let at = DVec2::new(from.dot(surface.u), from.dot(surface.v));
    let color = match surface.material {
        Material::Ground => ground(layout, DVec2::new(place.x, place.y), footprint),
        Material::Wall => wall(surface, at, footprint),
        Material::Tiles => tiles(surface, at, footprint),
        Material::Gravel => gravel(surface, at, footprint),
        Material::Masonry => bricks(at, DVec3::new(0.34, 0.22, 0.17), footprint, surface.seed),
        Material::Crown => crown(surface, from, footprint),
        Material::Trunk => DVec3::new(0.13, 0.09, 0.06) * (1.0 + 0.4 * octaves(at, 0.5, 0.7, footprint, surface.seed)),
        Material::Car => car(surface, at, footprint),
    };
    color.clamp(DVec3::splat(0.01), DVec3::splat(0.95))
}

/// Courses of blocks 0.5 x 0.25 m, each of its own shade, with mortar and stains.
fn bricks(at: DVec2, tint: DVec3, footprint: f64, seed: u32) -> Albedo {
    let (row, fy) = parted(at.y / 0.25);
    let (column, fx) = parted(at.x / 0.5 + 0.5 * f64::from(row & 1));
    let shade = 1.0 + 0.34 * signed(column, row, seed) * resolved(0.25, footprint);
    let mortar = if fx < 0.08 || fy < 0.16 { 0.5 * resolved(0.16, footprint) } else { 0.0 };
    let stain = 1.0 + 0.30 * octaves(at, 1.6, 0.72, footprint, seed ^ 0x51);
    (tint * shade).lerp(DVec3::new(0.52, 0.5, 0.46), mortar) * stain
}

fn wall_tint(building: u32, seed: u32) -> DVec3 {
    const TINTS: [[f64; 3]; 7] = [
        [0.42, 0.20, 0.14],
        [0.62, 0.56, 0.44],
        [0.46, 0.29, 0.20],
        [0.55, 0.55, 0.55],
        [0.60, 0.45, 0.30],
        [0.36, 0.17, 0.14],
        [0.50, 0.53, 0.46],
    ];
    let shift = signed(building as i32, seed as i32, 9) * 0.05;
    DVec3::from_array(TINTS[building as usize % TINTS.len()]) * (1.0 + shift)
}

/// Storeys of windows; a door at the foot of one of them.
fn wall(surface: &Surface, at: DVec2, footprint: f64) -> Albedo {
    const STOREY: f64 = 2.75;
    let seed = surface.seed;
    let mut color = bricks(at, wall_tint(surface.building, 0), footprint, seed);
    if at.y < 0.45 {
        color *= 0.55;
    }
    let bays = (surface.size.x / 2.4).floor().max(1.0);
    let (bay, fx) = parted(at.x * bays / surface.size.x);
    let (storey, fy) = parted(at.y / STOREY);
    let storeys = (surface.size.y / STOREY + 0.12).floor() as i32;
    if storey < 0 || storey >= storeys || bay < 0 || bay >= bays as i32 {
        return color;
    }
    let x = ((fx - 0.5) * surface.size.x / bays).abs();
    let y = fy * STOREY;
    let pick = hash(bay, storey, seed ^ 0xD00);
    let door = storey == 0 && bay == (hash(3, 5, seed) % bays as u32) as i32;
    let (half, low, high) = if door { (0.55, 0.0, 2.15) } else { (0.45 + 0.15 * f64::from(pick & 1), 0.85, 2.25) };
    if !door && pick.is_multiple_of(9) {
        return color;
    }
    let outside = (x - half).max((low - y).max(y - high));
    let grain = 1.0 + 0.25 * octaves(at, 0.5, 0.7, footprint, seed ^ 0x77);
    if outside > 0.13 {
        // A sill throws a dark streak.
        if y < low && y > low - 0.35 && x < half { color * 0.8 } else { color }
    } else if outside > 0.0 || (!door && x < 0.05) {
        DVec3::splat(0.72) * grain
    } else if door {
        DVec3::new(0.10, 0.16 + 0.1 * f64::from((pick >> 3) & 1), 0.13) * grain
    } else {
        let blind = if y > high - 0.45 * f64::from((pick >> 5) & 3) / 3.0 { 0.28 } else { 0.0 };
        let sky = 0.05 + 0.09 * (y - low) + 0.05 * noise(at.x * 2.3, at.y * 1.7, seed);
        DVec3::new(sky * 0.85 + blind, sky + blind, sky * 1.2 + blind) * grain
    }
}

/// Rows of tiles 0.3 x 0.36 m, dark where one row overlaps the next, with moss, mended patches and skylights.
fn tiles(surface: &Surface, at: DVec2, footprint: f64) -> Albedo {
    const TINTS: [[f64; 3]; 4] = [[0.44, 0.17, 0.10], [0.20, 0.19, 0.20], [0.38, 0.22, 0.15], [0.30, 0.14, 0.11]];
    let seed = surface.seed;
    let tint = DVec3::from_array(TINTS[surface.building as usize % TINTS.len()]);
    let (row, fy) = parted(at.y / 0.36);
    let (column, _) = parted(at.x / 0.3 + 0.5 * f64::from(row & 1));
    let seen = resolved(0.3, footprint);
    let shade = 1.0 + seen * (0.30 * signed(column, row, seed) + 0.25 * (0.4 - fy));
    let patch = if noise(at.x / 1.7, at.y / 1.3, seed ^ 0x3A) > 0.35 { 1.22 } else { 1.0 };
    let stain = 1.0 + 0.26 * octaves(at, 2.2, 0.74, footprint, seed ^ 0x99);
    let moss = (noise(at.x / 0.9, at.y / 0.7, seed ^ 0x4D) - 0.35).clamp(0.0, 0.5);
    let color = (tint * shade * patch).lerp(DVec3::new(0.20, 0.24, 0.10), moss) * stain;
    let (cell, fx) = parted(at.x / 3.1);
    let (x, low) = (fx * 3.1, 0.35 * surface.size.y);
    let whole = cell >= 0 && f64::from(cell) * 3.1 + 2.2 < surface.size.x;
    let inside = x > 1.1 && x < 2.0 && at.y > low && at.y < low + 1.2;
    if inside && whole && hash(cell, 1, seed ^ 0x5C).is_multiple_of(3) {
        let frame = !(1.22..=1.88).contains(&x) || at.y < low + 0.12 || at.y > low + 1.08;
        return if frame { DVec3::splat(0.5) } else { DVec3::new(0.08, 0.10, 0.14) * stain };
    }
    color
}

/// Gravel between seams of felt, with puddles and a pale rim.
fn gravel(surface: &Surface, at: DVec2, footprint: f64) -> Albedo {
    let seed = surface.seed;
    let (panel_x, fx) = parted(at.x / 1.9);
    let (panel_y, fy) = parted(at.y / 2.6);
    let panel = 1.0 + 0.18 * signed(panel_x, panel_y, seed);
    let grain = 1.0 + 0.42 * octaves(at, 1.5, 0.80, footprint, seed ^ 0x31);
    let puddle = (noise(at.x / 1.4, at.y / 1.4, seed ^ 0x66) - 0.3).clamp(0.0, 0.4);
    let mut color = DVec3::new(0.33, 0.32, 0.30) * panel * grain * (1.0 - puddle);
    if fx < 0.05 || fy < 0.04 {
        color *= 0.6;
    }
    let rim = at.x.min(at.y).min((surface.size - at).min_element());
    if rim < 0.28 { DVec3::new(0.55, 0.54, 0.52) * (0.7 + 0.3 * grain) } else { color }
}

/// Leaves: noise over two projections of the crown.
fn crown(surface: &Surface, from: DVec3, footprint: f64) -> Albedo {
    let seed = surface.seed;
    let tint = 0.5 + 0.5 * signed(1, 2, seed);
    let a = octaves(DVec2::new(from.x + 0.6 * from.z, from.y - 0.4 * from.z), 0.7, 0.85, footprint, seed);
    let b = octaves(DVec2::new(from.z - 0.3 * from.x, from.x + from.y), 0.5, 0.85, footprint, seed ^ 0x21);
    let base = DVec3::new(0.09, 0.17, 0.05).lerp(DVec3::new(0.17, 0.21, 0.06), tint);
    base * (1.0 + 0.35 * a + 0.30 * b).max(0.15)
}

fn car(surface: &Surface, at: DVec2, footprint: f64) -> Albedo {
    const PAINTS: [[f64; 3]; 5] =
        [[0.60, 0.06, 0.05], [0.75, 0.75, 0.76], [0.06, 0.12, 0.35], [0.05, 0.05, 0.06], [0.45, 0.46, 0.48]];
    let paint = DVec3::from_array(PAINTS[surface.seed as usize % PAINTS.len()]);
    paint * (1.0 + 0.12 * octaves(at, 0.6, 0.6, footprint, surface.seed))
}

/// Streets and pavements, terraces about the houses, gardens with beds, fields outside.
fn ground(layout: &Layout, at: DVec2, footprint: f64) -> Albedo {
    let rough = 1.0 + 0.24 * octaves(at, 3.0, 0.76, footprint, 5);
    let street = layout.street_depth(at);
    let inside = at.x.abs() < layout.half.x + 6.0 && at.y.abs() < layout.half.y + 6.0;
    if street > PAVEMENT {
        return asphalt(layout, at, footprint) * rough;
    }
    if street > 0.0 {
        let ((x, fx), (y, fy)) = (parted(at.x / 0.6), parted(at.y / 0.6));
        let joint = if fx.min(fy) < 0.1 { 1.0 - 0.4 * resolved(0.12, footprint) } else { 1.0 };
        let shade = 1.0 + 0.2 * signed(x, y, 19) * resolved(0.6, footprint);
        let kerb = if street > PAVEMENT - 0.2 { 1.25 } else { 1.0 };
        return DVec3::new(0.38, 0.36, 0.33) * shade * joint * kerb * rough;
    }
    let wobble = 0.5 * noise(at.x / 1.3, at.y / 1.3, 41);
    if inside && layout.nearest_house(at) < 1.0 + wobble {
        let ((x, _), (y, _)) = (parted(at.x / 0.4), parted(at.y / 0.4));
        let shade = 1.0 + 0.28 * signed(x, y, 23) * resolved(0.4, footprint);
        return DVec3::new(0.36, 0.28, 0.22) * shade * rough;
    }
    meadow(at, footprint, inside) * rough
}

fn asphalt(layout: &Layout, at: DVec2, footprint: f64) -> Albedo {
    let grain = 1.0 + 0.3 * octaves(at, 0.5, 0.85, footprint, 61);
    let patch = if noise(at.x / 2.1, at.y / 1.6, 67) > 0.38 { 0.7 } else { 1.0 };
    let crack = noise(at.x / 1.1, at.y / 1.1, 71).abs();
    let color = DVec3::new(0.125, 0.125, 0.135) * grain * patch * if crack < 0.035 { 0.55 } else { 1.0 };
    let dash = |streets: &[[f64; 2]], across: f64, along: f64| {
        streets.iter().any(|street| (across - (street[0] + street[1]) / 2.0).abs() < 0.09)
            && parted(along / 3.0).1 < 0.5
    };
    if dash(&layout.streets_x, at.x, at.y) || dash(&layout.streets_y, at.y, at.x) {
        DVec3::splat(0.62) * grain
    } else {
        color
    }
}

fn meadow(at: DVec2, footprint: f64, inside: bool) -> Albedo {
    let blades = 1.0 + 0.42 * octaves(at, 0.8, 0.9, footprint, 83);
    let dry = (0.5 + 0.6 * noise(at.x / 3.7, at.y / 3.1, 89)).clamp(0.0, 1.0);
    let grass = DVec3::new(0.11, 0.19, 0.055).lerp(DVec3::new(0.25, 0.24, 0.10), 0.7 * dry) * blades;
    let bed = noise(at.x / 2.4, at.y / 2.0, 97);
    if bed > 0.42 {
        let ((x, _), (y, _)) = (parted(at.x / 0.45), parted(at.y / 0.45));
        let plant = signed(x, y, 103);
        if plant > 0.4 && inside {
            return DVec3::new(0.30 + 0.25 * plant, 0.22, 0.18 + 0.2 * signed(x, y, 107).abs()) * blades;
        }
        return DVec3::new(0.19, 0.13, 0.085) * blades;
    }
    grass
}
