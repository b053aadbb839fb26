//! What every point is, once all votes are counted: the reliable points of Eq. 7, extended to points that too few views
//! have judged, and cleared of strays that their surroundings contradict.

use std::collections::HashMap;

use glam::DVec3;

use crate::vote::{Vote, VoteOptions};

/// What a point lies on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Label {
    /// Nobody can tell.
    #[default]
    Unknown = 0,
    /// Not a building.
    Background = 1,
    /// A building.
    Building = 2,
}

/// A point whose surroundings hold at least so many judged points …
const MIN_WITNESSES: u32 = 8;
/// … of which less than this share agree with it, is a stray.
const STRAY_SHARE: f64 = 0.2;

/// `[points]` labels. `reach` is how far surroundings go, scene units (a few spacings of the points).
#[must_use]
pub fn labels(positions: &[DVec3], votes: &[Vote], options: &VoteOptions, reach: f64) -> Vec<Label> {
    let judged = |vote: &Vote| match vote {
        vote if vote.is_reliable(options) => Label::Building,
        vote if vote.outside > 0 && vote.inside + vote.outside >= options.min_inside => Label::Background,
        _ => Label::Unknown,
    };
    let first: Vec<Label> = votes.iter().map(judged).collect();
    settled(positions, &first, reach)
}

/// Labels after a look around: unknown points take the majority of the judged ones within reach, strays the opposite.
#[must_use]
pub fn settled(positions: &[DVec3], labels: &[Label], reach: f64) -> Vec<Label> {
    use rayon::prelude::*;
    let cell = |at: DVec3| (at / reach).floor().to_array().map(|v| v as i64);
    let mut counts: HashMap<[i64; 3], [u32; 2]> = HashMap::new();
    for (at, label) in positions.iter().zip(labels).filter(|(_, label)| **label != Label::Unknown) {
        counts.entry(cell(*at)).or_default()[usize::from(*label == Label::Building)] += 1;
    }
    let around = |at: DVec3| {
        let [x, y, z] = cell(at);
        let mut sum = [0; 2];
        for step in 0..27 {
            let key = [x - 1 + step % 3, y - 1 + step / 3 % 3, z - 1 + step / 9];
            if let Some(count) = counts.get(&key) {
                (sum[0], sum[1]) = (sum[0] + count[0], sum[1] + count[1]);
            }
        }
        sum
    };
    let settle = |(at, label): (&DVec3, &Label)| {
        let [background, building] = around(*at);
        let all = background + building;
        let majority = if building > background { Label::Building } else { Label::Background };
        let agreeing = match label {
            Label::Unknown => 0,
            Label::Background => background,
            Label::Building => building,
        };
        let is_stray = all >= MIN_WITNESSES && f64::from(agreeing) < STRAY_SHARE * f64::from(all);
        match label {
            Label::Unknown if all > 0 => majority,
            _ if is_stray => majority,
            label => *label,
        }
    };
    positions.par_iter().zip(labels).map(settle).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_without_votes_follow_their_surroundings_and_strays_give_in() {
        let mut positions: Vec<DVec3> =
            (0..100).map(|i| DVec3::new(f64::from(i % 10), f64::from(i / 10), 0.0)).collect();
        let roof = Vote { inside: 5, outside: 0 };
        let ground = Vote { inside: 0, outside: 5 };
        let mut votes: Vec<Vote> = (0..100).map(|i| if i % 10 < 5 { roof } else { ground }).collect();
        votes[22] = ground;
        votes[77] = Vote::default();
        positions.push(DVec3::splat(1000.0));
        votes.push(Vote::default());
        let found = labels(&positions, &votes, &VoteOptions::default(), 1.0);
        assert_eq!((found[21], found[22], found[77]), (Label::Building, Label::Building, Label::Background));
        assert_eq!(found[100], Label::Unknown);
        assert_eq!((found[4], found[5]), (Label::Building, Label::Background), "the border stays");
    }
}
