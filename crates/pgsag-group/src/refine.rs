//! Masks to the four pixel classes that training works with. Paper 4.1 (RBM and its boundary MB).
//!
//! The band where a mask's edge is uncertain is counted in pixels of mask error, not in shares of the image. Before that
//! a mask is set right where the voted points contradict it: they are drawn into the image, take hold of superpixels, and
//! overrule the mask where the contradiction is too wide to be an error of projection.

use std::collections::VecDeque;

use pgsag_scene::{Image, Map, Mask, PixelClass};
use serde::{Deserialize, Serialize};

use crate::distance::signed_distance;
use crate::fringe::trim;
use crate::label::Label;
use crate::superpixel::superpixels;
use crate::surface::{NO_POINT, Seen};

/// How masks become classes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefineOptions {
    /// Half-width of the boundary band inside the mask, pixels of the training image.
    pub band_px: f32,
    /// How far a background mask reaches into the building, pixels, so that both surfaces overlap in fusion.
    pub overlap_px: f32,
    /// Whether voted points correct the masks.
    pub correct: bool,
    /// Contradictions narrower than twice this are errors of projection and change nothing, pixels: stereo fattens edges
    /// by about five. At least one distance between points counts; half as much for masks that are mostly wrong.
    pub min_change_px: f32,
    /// Side of the superpixels, pixels.
    pub superpixel_px: u32,
    /// With masks by language: all that the segmenter sees in an image, queried by the points, fills in what they leave
    /// unknown. A thousand clicks per image.
    pub everything: bool,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self { band_px: 2.0, overlap_px: 4.0, correct: true, min_change_px: 6.0, superpixel_px: 8, everything: false }
    }
}

/// Classes for a building group: `Inside`, `Boundary` within `band_px` of the mask's edge, `Free` outside.
/// The image border is not an edge of the building.
#[must_use]
pub fn building_classes(building: &Map<bool>, options: &RefineOptions) -> Mask {
    classes(building, |distance_px| match distance_px {
        d if d > 0.0 => PixelClass::Free,
        d if d > -options.band_px => PixelClass::Boundary,
        _ => PixelClass::Inside,
    })
}

/// Classes for a background block: what is not building, plus `overlap_px` of it. Pixels deeper inside buildings are
/// `Occluded`: the background may go on behind them.
#[must_use]
pub fn background_classes(building: &Map<bool>, options: &RefineOptions) -> Mask {
    classes(building, |distance_px| match distance_px {
        d if d > options.band_px => PixelClass::Inside,
        d if d > -options.overlap_px => PixelClass::Boundary,
        _ => PixelClass::Occluded,
    })
}

/// Least share of the drawn pixels of one label, in a square of a few superpixels, that must come from points which this
/// very view has measured: what shows through a hole in a facade, the garden behind the house, was measured by others.
const MIN_WITNESSED: f32 = 0.02;
/// Side of that square, superpixels.
const WITNESS_SUPERPIXELS: u32 = 4;

/// How the points of one view are drawn.
#[derive(Clone, Copy)]
pub struct Drawing<'a> {
    /// The depth buffer.
    pub seen: &'a Seen,
    /// `[points]`.
    pub labels: &'a [Label],
    /// Whether this view has measured a point itself.
    pub is_witnessed: &'a dyn Fn(u32) -> bool,
    /// Share of a superpixel's points that must agree for the superpixel to take their label as a whole.
    pub agreement: f32,
    /// How far buildings are drawn past their edges, pixels of the image ([`fringe`](crate::fringe)).
    pub fringe_px: f32,
}

/// The labels of the nearest points, `[points]`, as they are drawn, at a size in pixels.
#[must_use]
pub fn raw_labels(seen: &Seen, labels: &[Label], width: u32, height: u32) -> Map<Label> {
    let label = |point: &u32| if *point == NO_POINT { Label::Unknown } else { labels[*point as usize] };
    seen.point.mapped(label).resized_nearest(width, height)
}

/// What the drawn points say of every pixel of the image: their labels, taken over whole superpixels where most of their
/// points agree.
#[must_use]
pub fn drawn_labels(drawing: &Drawing<'_>, image: &Image, options: &RefineOptions) -> Map<Label> {
    let Drawing { seen, labels, is_witnessed, agreement, fringe_px } = *drawing;
    let mut drawn = raw_labels(seen, labels, image.width, image.height);
    let focal_px = seen.camera.focal_px() * f64::from(image.width) / f64::from(seen.camera.width);
    // Stray points are no edges.
    change_specks(&mut drawn, options.superpixel_px.pow(2) as usize, |_| Label::Unknown);
    trim(&mut drawn, &seen.depth.resized_nearest(image.width, image.height), fringe_px, focal_px);
    let witness = |point: &u32| *point != NO_POINT && is_witnessed(*point);
    let witnessed = seen.point.mapped(witness).resized_nearest(image.width, image.height);
    silence(&mut drawn, &witnessed, WITNESS_SUPERPIXELS * options.superpixel_px.max(1));
    let patches = superpixels(image, options.superpixel_px);
    let mut counts = vec![[0f32; 3]; patches.count];
    for (patch, label) in patches.label.values.iter().zip(&drawn.values) {
        counts[*patch as usize][*label as usize] += 1.0;
    }
    for (patch, label) in patches.label.values.iter().zip(&mut drawn.values) {
        let [unknown, background, building] = counts[*patch as usize];
        let known = background + building;
        if known >= unknown && building.max(background) >= agreement * known {
            *label = if building > background { Label::Building } else { Label::Background };
        }
    }
    drawn
}

/// Least share of a segment's pixels of which the points must know something for it to be queried.
const MIN_QUERIED: f32 = 0.2;

/// Segments of a model, queried by the points: pixels of which nothing is known take the label on which at least
/// `agreement` of the known ones of their segment agree. `segment`: number of each pixel's, 0 for none.
pub fn fill_segments(drawn: &mut Map<Label>, segment: &Map<u32>, agreement: f32) {
    let count = segment.values.iter().max().map_or(0, |last| *last as usize + 1);
    let mut counts = vec![[0f32; 3]; count];
    for (segment, label) in segment.values.iter().zip(&drawn.values) {
        counts[*segment as usize][*label as usize] += 1.0;
    }
    for (segment, label) in segment.values.iter().zip(&mut drawn.values) {
        let [unknown, background, building] = counts[*segment as usize];
        let known = background + building;
        let is_sure = known >= MIN_QUERIED * (known + unknown) && building.max(background) >= agreement * known;
        if *segment > 0 && *label == Label::Unknown && is_sure {
            *label = if building > background { Label::Building } else { Label::Background };
        }
    }
}

/// Makes labels unknown in squares where hardly any of their points was measured by the view itself.
fn silence(drawn: &mut Map<Label>, witnessed: &Map<bool>, side: u32) {
    let columns = drawn.width.div_ceil(side);
    let width = drawn.width;
    let square = |at: usize| ((at as u32 / width / side) * columns + at as u32 % width / side) as usize;
    let rows = drawn.height.div_ceil(side);
    let mut counts = vec![[[0f32; 2]; 3]; (columns * rows) as usize];
    for (at, (label, is_witnessed)) in drawn.values.iter().zip(&witnessed.values).enumerate() {
        let count = &mut counts[square(at)][*label as usize];
        count[0] += 1.0;
        count[1] += f32::from(u8::from(*is_witnessed));
    }
    // Where the view has measured nothing far and wide, at the rim of the flight, its silence says nothing.
    let speaks: Vec<bool> = counts
        .iter()
        .map(|of| of.iter().map(|c| c[1]).sum::<f32>() >= MIN_WITNESSED * of.iter().map(|c| c[0]).sum::<f32>())
        .collect();
    let (columns, rows) = (columns as usize, rows as usize);
    let is_asked = |cell: usize| {
        let (x, y) = (cell % columns, cell / columns);
        let mut around = (y.saturating_sub(1)..(y + 2).min(rows))
            .flat_map(|v| (x.saturating_sub(1)..(x + 2).min(columns)).map(move |u| v * columns + u));
        around.any(|other| speaks[other])
    };
    let is_asked: Vec<bool> = (0..counts.len()).map(is_asked).collect();
    for (at, label) in drawn.values.iter_mut().enumerate() {
        let cell = square(at);
        let [known, witnessed] = counts[cell][*label as usize];
        if is_asked[cell] && witnessed < MIN_WITNESSED * known {
            *label = Label::Unknown;
        }
    }
}

/// A mask of which less than this share of the building is contradicted is right, and the points are wrong.
const NOISE_SHARE: f64 = 0.025;
/// One of which more is contradicted deserves little trust: half as wide contradictions count.
const DISTRUST_SHARE: f64 = 0.06;

/// A mask that lacks more than this share of the buildings that are drawn knows nothing of them.
const BLIND_SHARE: f64 = 0.5;

/// A given mask, overruled where what is drawn contradicts it over more than twice `reach_px`; what is drawn alone where it
/// lacks most of that.
#[must_use]
pub fn corrected(given: &Map<bool>, drawn: &Map<Label>, reach_px: f32) -> Map<bool> {
    let pixels = || given.values.iter().zip(&drawn.values).filter(|(_, label)| **label == Label::Building);
    if pixels().filter(|(given, _)| !**given).count() as f64 > BLIND_SHARE * pixels().count() as f64 {
        return mask_of_labels(drawn, (reach_px * reach_px) as usize, (4.0 * reach_px) as u32);
    }
    let building =
        given.values.iter().zip(&drawn.values).filter(|(given, label)| **given || **label == Label::Building);
    let building = building.count().max(1) as f64;
    let change = contradicted(given, drawn, reach_px);
    let share = change.iter().filter(|changes| **changes).count() as f64 / building;
    let change = match share {
        share if share < NOISE_SHARE => return given.clone(),
        share if share > DISTRUST_SHARE => contradicted(given, drawn, 0.5 * reach_px),
        _ => change,
    };
    let values = given.values.iter().zip(&change).map(|(given, changes)| given != changes).collect();
    Map { width: given.width, height: given.height, values }
}

/// `[pixels]` where a contradiction is wider than twice `reach_px`.
fn contradicted(given: &Map<bool>, drawn: &Map<Label>, reach_px: f32) -> Vec<bool> {
    let (width, height) = (given.width, given.height);
    let contradicts = |(given, label): (&bool, &Label)| match label {
        Label::Unknown => false,
        Label::Background => *given,
        Label::Building => !*given,
    };
    let differs =
        Map { width, height, values: given.values.iter().zip(&drawn.values).map(contradicts).collect::<Vec<bool>>() };
    let wide = signed_distance(&differs).values.into_iter().map(|d| d <= -reach_px).collect();
    let wide = Map { width, height, values: wide };
    let near = signed_distance(&wide);
    (0..given.values.len()).map(|at| differs.values[at] && near.values[at] <= reach_px + 1.0).collect()
}

/// A mask from what is drawn alone: gaps take the label of the nearest drawn pixel within `reach_px` steps, beyond which
/// nothing is known and nothing is invented; specks and holes of fewer than `min_area_px` pixels go.
#[must_use]
pub fn mask_of_labels(drawn: &Map<Label>, min_area_px: usize, reach_px: u32) -> Map<bool> {
    let mut filled = drawn.clone();
    let mut steps = vec![0u32; filled.values.len()];
    let mut open: VecDeque<usize> =
        (0..filled.values.len()).filter(|at| filled.values[*at] != Label::Unknown).collect();
    while let Some(at) = open.pop_front() {
        for other in beside(&filled, at) {
            if filled.values[other] == Label::Unknown && steps[at] < reach_px {
                filled.values[other] = filled.values[at];
                steps[other] = steps[at] + 1;
                open.push_back(other);
            }
        }
    }
    let is_building = filled.values.iter().map(|label| *label == Label::Building).collect();
    let mut mask = Map { width: drawn.width, height: drawn.height, values: is_building };
    change_specks(&mut mask, min_area_px, |is_building: bool| !is_building);
    mask
}

/// Gives connected patches of one value with fewer than `min_area_px` pixels another.
fn change_specks<T: Copy + PartialEq>(map: &mut Map<T>, min_area_px: usize, other_than: impl Fn(T) -> T) {
    let mut is_done = vec![false; map.values.len()];
    for start in 0..map.values.len() {
        if is_done[start] {
            continue;
        }
        let value = map.values[start];
        let mut patch = vec![start];
        is_done[start] = true;
        let mut next = 0;
        while next < patch.len() {
            for other in beside(map, patch[next]) {
                if map.values[other] == value && !is_done[other] {
                    is_done[other] = true;
                    patch.push(other);
                }
            }
            next += 1;
        }
        if patch.len() < min_area_px {
            patch.into_iter().for_each(|at| map.values[at] = other_than(value));
        }
    }
}

/// The pixels left, right, above and below.
fn beside<T>(map: &Map<T>, at: usize) -> impl Iterator<Item = usize> + use<T> {
    let (width, height) = (map.width as usize, map.height as usize);
    let (x, y) = (at % width, at / width);
    let found = [
        (x > 0).then(|| at - 1),
        (x + 1 < width).then(|| at + 1),
        (y > 0).then(|| at - width),
        (y + 1 < height).then(|| at + width),
    ];
    found.into_iter().flatten()
}

fn classes(building: &Map<bool>, class_at: impl Fn(f32) -> PixelClass) -> Mask {
    let distance = signed_distance(building);
    Mask {
        width: building.width,
        height: building.height,
        classes: distance.values.iter().map(|d| class_at(*d)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn half() -> Map<bool> {
        let mut mask = Map::filled(20, 4, false);
        for y in 0..4 {
            for x in 10..20 {
                mask.set(x, y, true);
            }
        }
        mask
    }

    #[test]
    fn building_has_a_band_inside_its_edge() {
        let classes = building_classes(&half(), &RefineOptions::default());
        let row: Vec<_> = (8..14).map(|x| classes.at(x, 1)).collect();
        use PixelClass::{Boundary, Free, Inside};
        assert_eq!(row, [Free, Free, Boundary, Boundary, Inside, Inside]);
    }

    #[test]
    fn background_reaches_into_the_building_and_no_further() {
        let classes = background_classes(&half(), &RefineOptions::default());
        let active: Vec<_> = (0..20).map(|x| classes.at(x, 2).is_active()).collect();
        assert!(active[..14].iter().all(|a| *a));
        assert!(active[14..].iter().all(|a| !a));
    }

    #[test]
    fn wide_contradictions_change_the_mask_and_narrow_ones_do_not() {
        let mut given = Map::filled(60, 40, false);
        let mut drawn = Map::filled(60, 40, Label::Background);
        for y in 10..30 {
            // Too large by twelve pixels on the right, a pixel short on the left.
            (10..42).for_each(|x| given.set(x, y, true));
            (9..30).for_each(|x| drawn.set(x, y, Label::Building));
        }
        (0..5).for_each(|x| drawn.set(x, 0, Label::Unknown));
        let mask = corrected(&given, &drawn, 3.0);
        let row: Vec<bool> = [9, 10, 29, 30, 41].iter().map(|x| mask.at(*x, 20)).collect();
        assert_eq!(row, [false, true, true, false, false]);
        // A speck that the points alone see is not enough to doubt a mask.
        let mut stray = Map::filled(60, 40, Label::Background);
        (10..30).for_each(|y| (10..42).for_each(|x| stray.set(x, y, Label::Building)));
        (0..4).for_each(|y| (0..4).for_each(|x| stray.set(x, y, Label::Building)));
        assert_eq!(corrected(&given, &stray, 1.0), given);
    }

    #[test]
    fn segments_take_the_label_of_the_points_in_them() {
        // Four columns: a roof and a garden that points know well, one on which they disagree, one that they hardly know.
        let segment = Map { width: 40, height: 10, values: (0..400).map(|at| at % 40 / 10 + 1).collect() };
        let mut drawn = Map::filled(40, 10, Label::Unknown);
        for at in (0..400).step_by(3) {
            let (column, y) = (at % 40 / 10, at / 40);
            drawn.values[at] = match (column, y) {
                (0, _) => Label::Building,
                (1, _) | (2, 5..) => Label::Background,
                (2, _) => Label::Building,
                (_, 0) => Label::Building,
                _ => Label::Unknown,
            };
        }
        let before = drawn.clone();
        fill_segments(&mut drawn, &segment, 0.8);
        for (at, label) in drawn.values.iter().enumerate() {
            let wanted = [Label::Building, Label::Background, before.values[at], before.values[at]][at % 40 / 10];
            assert_eq!(*label, wanted, "{at}");
        }
        let mut alone = before.clone();
        fill_segments(&mut alone, &Map::filled(40, 10, 0), 0.8);
        assert_eq!(alone, before);
    }

    /// Labels by place on a plain image of 192 x 96 pixels, one point to a pixel; witnessed left of `rim`.
    fn drawn_of(rim: u32, label: impl Fn(u32, u32) -> Label) -> Map<Label> {
        let (width, height) = (192, 96);
        let camera = pgsag_scene::Pinhole { width, height, fx: 100.0, fy: 100.0, cx: 96.0, cy: 48.0 };
        let point = Map { width, height, values: (0..width * height).collect() };
        let labels: Vec<Label> = point.values.iter().map(|at| label(at % width, at / width)).collect();
        // Ground lies five behind roofs.
        let depth = labels.iter().map(|label| if *label == Label::Building { 10.0 } else { 15.0 }).collect();
        let seen = Seen { camera, point, depth: Map { width, height, values: depth } };
        let is_witnessed = |at: u32| at % width < rim;
        let drawing =
            Drawing { seen: &seen, labels: &labels, is_witnessed: &is_witnessed, agreement: 0.6, fringe_px: 4.0 };
        drawn_labels(&drawing, &Image::filled(width, height, [90; 3]), &RefineOptions::default())
    }

    #[test]
    fn stray_points_on_a_roof_cut_no_hole_into_it_and_edges_are_cut() {
        let is_roof = |x: u32, y: u32| (40..160).contains(&x) && (10..90).contains(&y);
        let is_stray = |x: u32, y: u32| x % 24 < 3 && y % 20 < 3;
        let drawn = drawn_of(192, |x, y| match is_roof(x, y) && !is_stray(x, y) {
            true => Label::Building,
            false => Label::Background,
        });
        let holes =
            (50..150).flat_map(|x| (20..80).map(move |y| (x, y))).filter(|(x, y)| drawn.at(*x, *y) != Label::Building);
        assert_eq!(holes.count(), 0);
        let fringe = (20..80).filter(|y| drawn.at(40, *y) == Label::Building).count();
        assert!(fringe < 30, "{fringe}");
    }

    #[test]
    fn a_view_is_asked_only_where_it_has_measured_something() {
        // A roof over the whole height at either end; the view has measured the left three quarters of the left one.
        let label = |x: u32, _| if !(64..128).contains(&x) { Label::Building } else { Label::Background };
        let drawn = drawn_of(48, label);
        assert_eq!(drawn.at(10, 50), Label::Building);
        assert_eq!(drawn.at(70, 50), Label::Unknown, "nobody knows what hides it");
        assert_eq!(drawn.at(180, 50), Label::Building, "the rim of the flight");
    }

    #[test]
    fn labels_alone_make_a_mask_without_specks() {
        let mut drawn = Map::filled(30, 20, Label::Unknown);
        drawn.set(2, 10, Label::Background);
        (18..30).for_each(|x| drawn.set(x, 10, Label::Building));
        drawn.set(25, 15, Label::Background);
        drawn.set(26, 15, Label::Building);
        let mask = mask_of_labels(&drawn, 20, 100);
        assert!(!mask.at(5, 10) && mask.at(20, 3) && mask.at(29, 12));
        let near = mask_of_labels(&drawn, 20, 4);
        assert!(near.at(20, 8) && !near.at(20, 3));
    }

    #[test]
    fn all_zero_mask_says_no_building() {
        let none = Map::filled(5, 5, false);
        assert_eq!(building_classes(&none, &RefineOptions::default()).active_count(), 0);
        assert_eq!(background_classes(&none, &RefineOptions::default()).active_count(), 25);
    }
}
