//! Density clustering in plan view (Ester et al. 1996). Paper 4.1: "clustering nearby buildings into sub-groups".
//!
//! Points carry weights, so that a dense cloud can be thinned to one point per small cell first; then every
//! neighbourhood holds a bounded number of points and the whole is linear in them.

use std::collections::HashMap;

use glam::DVec2;

/// Sets that grow together; the smallest member stands for its set.
pub(crate) struct Sets(Vec<u32>);

impl Sets {
    pub(crate) fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    pub(crate) fn find(&mut self, mut at: u32) -> u32 {
        while self.0[at as usize] != at {
            self.0[at as usize] = self.0[self.0[at as usize] as usize];
            at = self.0[at as usize];
        }
        at
    }

    pub(crate) fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

/// Points by the cells of a grid, for looking around.
pub(crate) struct Neighborhoods<'a> {
    points: &'a [DVec2],
    side: f64,
    order: Vec<u32>,
    ranges: HashMap<[i64; 2], (u32, u32)>,
}

impl<'a> Neighborhoods<'a> {
    /// For looking as far as `side`.
    pub(crate) fn new(points: &'a [DVec2], side: f64) -> Self {
        let key = |at: u32| cell_of(points[at as usize], side);
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        order.sort_by_key(|at| (key(*at), *at));
        let mut ranges = HashMap::new();
        let mut start = 0;
        for chunk in order.chunk_by(|a, b| key(*a) == key(*b)) {
            ranges.insert(key(chunk[0]), (start, start + chunk.len() as u32));
            start += chunk.len() as u32;
        }
        Self { points, side, order, ranges }
    }

    /// Points within `side` of a place and their squared distances, cell by cell.
    pub(crate) fn near(&self, at: DVec2) -> impl Iterator<Item = (u32, f64)> {
        let [x, y] = cell_of(at, self.side);
        let cells = (-1..=1).flat_map(move |dy| (-1..=1).map(move |dx| [x + dx, y + dy]));
        let members = cells.filter_map(|cell| self.ranges.get(&cell));
        let all = members.flat_map(|(start, end)| &self.order[*start as usize..*end as usize]);
        all.map(move |other| (*other, self.points[*other as usize].distance_squared(at)))
            .filter(|(_, squared)| *squared <= self.side * self.side)
    }
}

fn cell_of(at: DVec2, side: f64) -> [i64; 2] {
    [(at.x / side).floor() as i64, (at.y / side).floor() as i64]
}

/// `[points]` the cluster of each point, from 0 in the order of their first core points; `None` is noise. A point is core
/// if the weights within `eps` of it, its own included, reach `min_weight`; others join the nearest core point in reach.
#[must_use]
pub fn dbscan(points: &[DVec2], weights: &[f64], eps: f64, min_weight: f64) -> Vec<Option<u32>> {
    use rayon::prelude::*;
    let around = Neighborhoods::new(points, eps);
    let weight = |at: &DVec2| around.near(*at).map(|(other, _)| weights[other as usize]).sum::<f64>();
    let is_core: Vec<bool> = points.par_iter().map(|at| weight(at) >= min_weight).collect();
    let mut sets = Sets::new(points.len());
    for (index, at) in points.iter().enumerate().filter(|(index, _)| is_core[*index]) {
        for (other, _) in around.near(*at).filter(|(other, _)| is_core[*other as usize]) {
            sets.join(index as u32, other);
        }
    }
    let mut number = vec![u32::MAX; points.len()];
    let mut next = 0;
    for index in (0..points.len()).filter(|index| is_core[*index]) {
        let root = sets.find(index as u32) as usize;
        if number[root] == u32::MAX {
            number[root] = next;
            next += 1;
        }
        number[index] = number[root];
    }
    let border = |at: DVec2| {
        let cores = around.near(at).filter(|(other, _)| is_core[*other as usize]);
        cores.min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0))).map(|(other, _)| number[other as usize])
    };
    (0..points.len()).map(|i| if is_core[i] { Some(number[i]) } else { border(points[i]) }).collect()
}

#[cfg(test)]
mod tests {
    use pgsag_scene::numbers::SplitMix64;

    use super::*;

    /// By the definition, comparing all pairs.
    fn brute_force(points: &[DVec2], weights: &[f64], eps: f64, min_weight: f64) -> Vec<Option<u32>> {
        let near = |a: usize, b: usize| points[a].distance_squared(points[b]) <= eps * eps;
        let count = points.len();
        let weight = |a: usize| (0..count).filter(|b| near(a, *b)).map(|b| weights[b]).sum::<f64>();
        let core: Vec<bool> = (0..count).map(|a| weight(a) >= min_weight).collect();
        let mut label = vec![None; count];
        let mut next = 0;
        for first in 0..count {
            if !core[first] || label[first].is_some() {
                continue;
            }
            let mut open = vec![first];
            while let Some(a) = open.pop() {
                label[a] = Some(next);
                open.extend((0..count).filter(|b| core[*b] && near(a, *b) && label[*b].is_none()));
            }
            next += 1;
        }
        for a in (0..count).filter(|a| !core[*a]) {
            let cores = (0..count).filter(|b| core[*b] && near(a, *b));
            let distance = |b: &usize| points[a].distance_squared(points[*b]);
            label[a] = cores.min_by(|b, c| distance(b).total_cmp(&distance(c)).then(b.cmp(c))).and_then(|b| label[b]);
        }
        label
    }

    #[test]
    fn clusters_equal_brute_force_on_random_clouds() {
        for seed in 0..12 {
            let mut stream = SplitMix64::new(seed);
            let points: Vec<DVec2> = (0..150)
                .map(|i| {
                    let center = f64::from(i % 4) * 5.0 - 8.0;
                    DVec2::new(center + stream.normal(), center * 0.3 + 1.4 * stream.normal())
                })
                .collect();
            let weights: Vec<f64> = points.iter().map(|_| 1.0 + stream.below(3) as f64).collect();
            let (eps, min_weight) = (stream.range(0.3, 1.2), stream.range(3.0, 12.0));
            let found = dbscan(&points, &weights, eps, min_weight);
            assert_eq!(found, brute_force(&points, &weights, eps, min_weight), "seed {seed}");
        }
    }

    #[test]
    fn two_crowds_and_a_lonely_point() {
        let crowd = |x: f64| (0..9).map(move |i| DVec2::new(x + f64::from(i % 3), f64::from(i / 3)));
        let points: Vec<DVec2> = crowd(0.0).chain(crowd(20.0)).chain([DVec2::new(10.0, 1.0)]).collect();
        let found = dbscan(&points, &[1.0; 19], 1.5, 4.0);
        assert!(found[..9].iter().all(|label| *label == Some(0)) && found[9..18].iter().all(|label| *label == Some(1)));
        assert_eq!(found[18], None);
    }
}
