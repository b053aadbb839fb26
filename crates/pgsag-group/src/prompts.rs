//! Points to ask a segmenter with, one building at a time, and which of its answers to believe. Paper 4.1: reliable points,
//! drawn into the image, prompt the refined mask. Method 8.15: per building on native crops, 5 to 10 positives, negatives
//! from the ground and from neighbours, the mask chosen by agreement with the votes.

use std::collections::{BTreeMap, HashMap, VecDeque};

use glam::DVec3;
use pgsag_scene::Map;

use crate::distance::signed_distance;
use crate::label::Label;
use crate::plan::PlanFrame;
use crate::territory::cropped;

/// How a segmenter is asked for buildings, and when it is believed.
#[derive(Clone, Debug, PartialEq)]
pub struct PromptOptions {
    /// The words for coarse masks.
    pub words: String,
    /// Points on a building, at most.
    pub positives: usize,
    /// Points beside it, at most.
    pub negatives: usize,
    /// Points keep this far from the edge of what is drawn where there is room, pixels.
    pub inset_px: f32,
    /// Buildings of which fewer pixels are drawn are not asked for.
    pub min_drawn_px: usize,
    /// A building's window is larger than what is drawn of it by this share on each side, and by 16 pixels at least.
    pub margin: f32,
    /// Answers that share less than this part of their union with what is drawn are not believed.
    pub min_agreement: f32,
}

impl Default for PromptOptions {
    fn default() -> Self {
        Self {
            words: "buildings.".into(),
            positives: 8,
            negatives: 8,
            inset_px: 6.0,
            min_drawn_px: 64,
            margin: 0.2,
            min_agreement: 0.6,
        }
    }
}

/// What is drawn at a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Drawn {
    /// Nothing is known.
    #[default]
    Unknown,
    /// No building.
    Ground,
    /// A piece of building, from 1.
    Piece(u32),
}

/// A question about one building in one view, in pixels of the map that it was made from.
#[derive(Clone, Debug, PartialEq)]
pub struct Prompt {
    /// Which.
    pub piece: u32,
    /// Left, top, width, height.
    pub window_px: [u32; 4],
    /// On the building, pixel centres.
    pub positive: Vec<[f32; 2]>,
    /// On the ground and on neighbours, pixel centres.
    pub negative: Vec<[f32; 2]>,
}

/// Least margin of a window, pixels.
const LEAST_MARGIN_PX: f32 = 16.0;
/// Pixels among which points are chosen, at most.
const CHOICE: usize = 2000;

/// `[points]` what every point is drawn as: building points fall into pieces where plan view, in cells of side `cell`, has
/// a gap or a height step of more than `step` (scene units).
#[must_use]
pub fn pieces(positions: &[DVec3], labels: &[Label], frame: &PlanFrame, cell: f64, step: f64) -> Vec<Drawn> {
    let key = |at: DVec3| (frame.plan(at) / cell).floor().to_array().map(|v| v as i64);
    let mut tops: BTreeMap<[i64; 2], f64> = BTreeMap::new();
    let buildings = || positions.iter().zip(labels).filter(|(_, label)| **label == Label::Building);
    for (at, _) in buildings() {
        let top = tops.entry(key(*at)).or_insert(f64::NEG_INFINITY);
        *top = top.max(frame.height(*at));
    }
    let mut number: HashMap<[i64; 2], u32> = HashMap::new();
    let mut next = 0;
    for start in tops.keys() {
        if number.contains_key(start) {
            continue;
        }
        next += 1;
        number.insert(*start, next);
        let mut open = VecDeque::from([*start]);
        while let Some(here) = open.pop_front() {
            for k in (0..9).filter(|k| *k != 4) {
                let there = [here[0] + k % 3 - 1, here[1] + k / 3 - 1];
                let is_level = tops.get(&there).is_some_and(|top| (top - tops[&here]).abs() <= step);
                if is_level && !number.contains_key(&there) {
                    number.insert(there, next);
                    open.push_back(there);
                }
            }
        }
    }
    let drawn = |(at, label): (&DVec3, &Label)| match label {
        Label::Unknown => Drawn::Unknown,
        Label::Background => Drawn::Ground,
        Label::Building => Drawn::Piece(number[&key(*at)]),
    };
    positions.iter().zip(labels).map(drawn).collect()
}

/// One question per piece of which enough is drawn, in the order of the pieces.
#[must_use]
pub fn prompts(drawn: &Map<Drawn>, options: &PromptOptions) -> Vec<Prompt> {
    let mut boxes: BTreeMap<u32, (usize, [u32; 4])> = BTreeMap::new();
    for (at, what) in drawn.values.iter().enumerate() {
        let Drawn::Piece(piece) = what else { continue };
        let (x, y) = (at as u32 % drawn.width, at as u32 / drawn.width);
        let (count, [x0, y0, x1, y1]) = boxes.entry(*piece).or_insert((0, [x, y, x, y]));
        *count += 1;
        (*x0, *x1, *y1) = ((*x0).min(x), (*x1).max(x), (*y1).max(y));
        *y0 = (*y0).min(y);
    }
    let large = boxes.into_iter().filter(|(_, (count, _))| *count >= options.min_drawn_px.max(1));
    large.map(|(piece, (_, corners))| prompt(drawn, piece, corners, options)).collect()
}

fn prompt(drawn: &Map<Drawn>, piece: u32, [x0, y0, x1, y1]: [u32; 4], options: &PromptOptions) -> Prompt {
    let margin = |length: u32| (options.margin * length as f32).max(LEAST_MARGIN_PX) as u32;
    let (across, down) = (margin(x1 - x0), margin(y1 - y0));
    let (left, top) = (x0.saturating_sub(across), y0.saturating_sub(down));
    let (right, bottom) = ((x1 + 1 + across).min(drawn.width), (y1 + 1 + down).min(drawn.height));
    let window = [left, top, right - left, bottom - top];
    let part = cropped(drawn, window);
    let points = |is_wanted: &dyn Fn(Drawn) -> bool, count: usize| {
        let wanted =
            Map { width: part.width, height: part.height, values: part.values.iter().map(|d| is_wanted(*d)).collect() };
        let place = |at: usize| [(at as u32 % part.width + left) as f32, (at as u32 / part.width + top) as f32];
        spread(&wanted, options.inset_px, count).into_iter().map(|at| place(at).map(|v| v + 0.5)).collect()
    };
    let is_other = |what: Drawn| what != Drawn::Unknown && what != Drawn::Piece(piece);
    Prompt {
        piece,
        window_px: window,
        positive: points(&|what| what == Drawn::Piece(piece), options.positives),
        negative: points(&is_other, options.negatives),
    }
}

/// Pixels of a mask far from its edge and from one another: the deepest first, then always the farthest from all before.
fn spread(wanted: &Map<bool>, inset_px: f32, count: usize) -> Vec<usize> {
    let depth: Vec<f32> = signed_distance(wanted).values.iter().map(|distance| -distance).collect();
    let deepest = depth.iter().copied().fold(0.0, f32::max);
    let bound = inset_px.min(0.5 * deepest);
    let inner: Vec<usize> = (0..depth.len()).filter(|at| wanted.values[*at] && depth[*at] >= bound).collect();
    let choice: Vec<usize> = inner.iter().copied().step_by(inner.len().div_ceil(CHOICE).max(1)).collect();
    let place = |at: usize| [(at as u32 % wanted.width) as f32, (at as u32 / wanted.width) as f32];
    let first = choice.iter().copied().max_by(|a, b| depth[*a].total_cmp(&depth[*b]).then(b.cmp(a)));
    let mut gap = vec![f32::INFINITY; choice.len()];
    let mut chosen = Vec::new();
    let mut next = first;
    while let Some(at) = next.filter(|_| chosen.len() < count) {
        chosen.push(at);
        let [x, y] = place(at);
        for (gap, other) in gap.iter_mut().zip(&choice) {
            let [u, v] = place(*other);
            *gap = gap.min((u - x) * (u - x) + (v - y) * (v - y));
        }
        let farthest = (0..choice.len()).max_by(|a, b| gap[*a].total_cmp(&gap[*b]).then(b.cmp(a)));
        next = farthest.filter(|k| gap[*k] > 0.0).map(|k| choice[k]);
    }
    chosen
}

/// The answer that agrees most with what is drawn in the question's window (pixels of which nothing is known do not
/// count), and how much: shared over joined pixels. `None` where none agrees enough. Candidates have the window's size.
#[must_use]
pub fn chosen(
    candidates: &[Map<bool>],
    drawn: &Map<Drawn>,
    prompt: &Prompt,
    options: &PromptOptions,
) -> Option<(usize, f32)> {
    let part = cropped(drawn, prompt.window_px);
    let agreement = |mask: &Map<bool>| {
        let (mut shared, mut joined) = (0u32, 0u32);
        for (is_in, what) in mask.values.iter().zip(&part.values).filter(|(_, what)| **what != Drawn::Unknown) {
            let is_own = *what == Drawn::Piece(prompt.piece);
            shared += u32::from(*is_in && is_own);
            joined += u32::from(*is_in || is_own);
        }
        shared as f32 / joined.max(1) as f32
    };
    let fits = |mask: &Map<bool>| (mask.width, mask.height) == (part.width, part.height);
    let found = candidates.iter().enumerate().filter(|(_, mask)| fits(mask)).map(|(at, mask)| (at, agreement(mask)));
    found.max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0))).filter(|(_, share)| *share >= options.min_agreement)
}

/// A mask in which the buildings that were asked for are as answered: pixels of `given` go to the nearest piece drawn
/// inside of it, and those of pieces with an answer (a mask of its question's window) make way for it.
#[must_use]
pub fn prompted(given: &Map<bool>, drawn: &Map<Drawn>, answers: &[(Prompt, Map<bool>)]) -> Map<bool> {
    let is_answered: BTreeMap<u32, ()> = answers.iter().map(|(prompt, _)| (prompt.piece, ())).collect();
    let width = given.width as usize;
    let mut owner = vec![Drawn::Unknown; given.values.len()];
    let mut open = VecDeque::new();
    for (at, what) in drawn.values.iter().enumerate() {
        if given.values[at] && matches!(what, Drawn::Piece(_)) {
            owner[at] = *what;
            open.push_back(at);
        }
    }
    while let Some(at) = open.pop_front() {
        let x = at % width;
        let beside = [
            (x > 0).then(|| at - 1),
            (x + 1 < width).then(|| at + 1),
            at.checked_sub(width),
            Some(at + width).filter(|below| *below < owner.len()),
        ];
        for other in beside.into_iter().flatten() {
            if given.values[other] && owner[other] == Drawn::Unknown {
                owner[other] = owner[at];
                open.push_back(other);
            }
        }
    }
    let is_kept = |(is_in, owner): (&bool, &Drawn)| match owner {
        Drawn::Piece(piece) => *is_in && !is_answered.contains_key(piece),
        _ => *is_in,
    };
    let mut mask = Map {
        width: given.width,
        height: given.height,
        values: given.values.iter().zip(&owner).map(is_kept).collect(),
    };
    for (prompt, answer) in answers {
        let [x0, y0, ..] = prompt.window_px;
        for (at, _) in answer.values.iter().enumerate().filter(|(_, is_in)| **is_in) {
            mask.set(x0 + at as u32 % answer.width, y0 + at as u32 / answer.width, true);
        }
    }
    mask
}

#[cfg(test)]
mod tests;
