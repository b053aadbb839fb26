//! From judged points to rows: shares within thresholds, order statistics, buildings, bootstrap.

use std::collections::BTreeMap;

use pgsag_scene::numbers::{SplitMix64, quantile};

use super::options::{BuildingScore, Distances, ScoreOptions, Spread, ThresholdScore};

/// What part of the true surface a point is nearest to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// Not told apart.
    Whole,
    Roof,
    Facade,
    Edge,
}

/// A point and how far it is from the other side.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Judged {
    /// Metres; negative = behind the surface measured to.
    pub distance_m: f32,
    pub building: u32,
    pub part: Part,
}

/// Points in the order in which they were judged: there are too many to hold them twice for the sake of one list.
pub(crate) type Parts = Vec<Vec<Judged>>;

/// Both directions.
pub(crate) struct Verdict {
    pub accuracy: Parts,
    pub completeness: Parts,
    /// Whether distances have a sign, in either direction.
    pub signed: [bool; 2],
}

/// Points within each threshold, and all of them.
#[derive(Clone, Default)]
struct Counts {
    near: Vec<[u64; 2]>,
    all: [u64; 2],
}

impl Counts {
    fn add(&mut self, other: &Self) {
        self.near.resize(other.near.len(), [0; 2]);
        for (mine, theirs) in self.near.iter_mut().zip(&other.near) {
            mine[0] += theirs[0];
            mine[1] += theirs[1];
        }
        self.all[0] += other.all[0];
        self.all[1] += other.all[1];
    }

    fn rows(&self, thresholds: &[f64]) -> Vec<ThresholdScore> {
        let share = |near: u64, all: u64| if all == 0 { 0.0 } else { near as f64 / all as f64 };
        thresholds
            .iter()
            .zip(&self.near)
            .map(|(&threshold_m, near)| {
                let (precision, recall) = (share(near[0], self.all[0]), share(near[1], self.all[1]));
                ThresholdScore { threshold_m, precision, recall, f1: harmonic(precision, recall), ..Default::default() }
            })
            .collect()
    }
}

fn harmonic(a: f64, b: f64) -> f64 {
    if a + b > 0.0 { 2.0 * a * b / (a + b) } else { 0.0 }
}

fn counts(verdict: &Verdict, thresholds: &[f64]) -> BTreeMap<u32, Counts> {
    let mut counts: BTreeMap<u32, Counts> = BTreeMap::new();
    for (side, points) in [&verdict.accuracy, &verdict.completeness].into_iter().enumerate() {
        for point in points.iter().flatten() {
            let of = counts.entry(point.building).or_default();
            of.near.resize(thresholds.len(), [0; 2]);
            of.all[side] += 1;
            for (near, threshold) in of.near.iter_mut().zip(thresholds) {
                near[side] += u64::from(f64::from(point.distance_m.abs()) <= *threshold);
            }
        }
    }
    counts
}

/// The rows over everything, with intervals where at least two buildings are known.
pub(crate) fn rows(verdict: &Verdict, options: &ScoreOptions) -> Vec<ThresholdScore> {
    let thresholds = &options.thresholds_m;
    let counts = counts(verdict, thresholds);
    let mut all = Counts { near: vec![[0; 2]; thresholds.len()], all: [0; 2] };
    counts.values().for_each(|of| all.add(of));
    let mut rows = all.rows(thresholds);
    let buildings: Vec<&Counts> = counts.iter().filter(|(id, _)| **id != 0).map(|(_, of)| of).collect();
    if buildings.len() < 2 || options.bootstrap == 0 {
        return rows;
    }
    let mut random = SplitMix64::new(options.seed ^ 0xB007_57A9);
    let draws: Vec<Vec<ThresholdScore>> = (0..options.bootstrap)
        .map(|_| {
            let mut sum = Counts::default();
            (0..buildings.len()).for_each(|_| sum.add(buildings[random.below(buildings.len())]));
            sum.rows(thresholds)
        })
        .collect();
    for (at, row) in rows.iter_mut().enumerate() {
        let interval = |value: fn(&ThresholdScore) -> f64| {
            let mut values: Vec<f64> = draws.iter().map(|draw| value(&draw[at])).collect();
            Some([quantile(&mut values, 0.025)?, quantile(&mut values, 0.975)?])
        };
        row.precision_interval = interval(|row| row.precision);
        row.recall_interval = interval(|row| row.recall);
        row.f1_interval = interval(|row| row.f1);
    }
    rows
}

/// One entry per building number other than 0.
pub(crate) fn per_building(verdict: &Verdict, options: &ScoreOptions) -> Vec<BuildingScore> {
    let by_building = |points: &Parts| {
        let mut map: BTreeMap<u32, Vec<f32>> = BTreeMap::new();
        let of_any = points.iter().flatten().filter(|p| p.building != 0);
        of_any.for_each(|p| map.entry(p.building).or_default().push(p.distance_m));
        map
    };
    let (accuracy, completeness) = (by_building(&verdict.accuracy), by_building(&verdict.completeness));
    let of = |map: &BTreeMap<u32, Vec<f32>>, id, signed| {
        spread(map.get(&id).map_or(&[][..], Vec::as_slice).iter().copied(), signed, options.mean_cap_m)
    };
    counts(verdict, &options.thresholds_m)
        .into_iter()
        .filter(|(building, _)| *building != 0)
        .map(|(building, counts)| BuildingScore {
            building,
            samples: counts.all[0],
            truth_points: counts.all[1],
            scores: counts.rows(&options.thresholds_m),
            accuracy_m: of(&accuracy, building, verdict.signed[0]),
            completeness_m: of(&completeness, building, verdict.signed[1]),
        })
        .collect()
}

/// Distances of all, and by part where parts are known.
pub(crate) fn distances(points: &Parts, signed: bool, cap: f64) -> Distances {
    let those = |keep: &dyn Fn(&Judged) -> bool| {
        spread(points.iter().flatten().filter(|p| keep(p)).map(|p| p.distance_m), signed, cap)
    };
    let part = |part: Part| Some(those(&|p| p.part == part)).filter(|spread| spread.count > 0);
    Distances { all: those(&|_| true), roof: part(Part::Roof), facade: part(Part::Facade), edge: part(Part::Edge) }
}

fn spread(points: impl Iterator<Item = f32>, signed: bool, cap: f64) -> Spread {
    let mut values: Vec<f32> = points.collect();
    let count = values.len() as u64;
    let at = |q: f64, values: &mut [f32]| {
        let k = (values.len().saturating_sub(1) as f64 * q).round() as usize;
        (!values.is_empty()).then(|| f64::from(*values.select_nth_unstable_by(k, f32::total_cmp).1))
    };
    let signed_median = if signed { at(0.5, &mut values) } else { None };
    values.iter_mut().for_each(|v| *v = v.abs());
    let [p68, p90, p95] = [0.68, 0.9, 0.95].map(|q| at(q, &mut values));
    let mean = (count > 0).then(|| values.iter().map(|v| f64::from(*v).min(cap)).sum::<f64>() / count as f64);
    Spread { count, signed_median, mean, p68, p90, p95 }
}
