//! How reliable the points are: the distribution of votes against, as inline SVG. Paper Eq. 7 leaves the tolerance to
//! experience; here one sees where it cuts.

use std::fmt::Write as _;

use pgsag_group::{Vote, VoteOptions};

const WIDTH: f64 = 300.0;
const HEIGHT: f64 = 110.0;
/// Bars of the drawing.
const BARS: usize = 20;

/// The share of votes against of all potential points in twenty bars, with the tolerance as a line; `None` without votes.
/// With the paper's count in force the bars count votes instead of shares, the last one all that have more.
#[must_use]
pub fn distribution(votes: &[Vote], options: &VoteOptions) -> Option<String> {
    let mut bars = [0u64; BARS];
    for vote in votes.iter().filter(|vote| vote.is_potential()) {
        let all = vote.inside + vote.outside;
        let bar = match options.max_outside_count {
            Some(_) => vote.outside as usize,
            None => vote.outside as usize * BARS / all as usize,
        };
        bars[bar.min(BARS - 1)] += 1;
    }
    let most = bars.iter().copied().max().filter(|most| *most > 0)? as f64;
    let cut = match options.max_outside_count {
        Some(count) => f64::from(count) / BARS as f64,
        None => f64::from(options.max_outside_share),
    };
    let cut = WIDTH * cut.min(1.0);
    let mut svg = format!("<svg viewBox=\"-4 -4 {} {}\" role=\"img\">", WIDTH + 8.0, HEIGHT + 8.0);
    let side = WIDTH / BARS as f64;
    for (at, count) in bars.iter().enumerate() {
        // Low bars would vanish beside the first one, so heights are square roots.
        let height = HEIGHT * (*count as f64 / most).sqrt();
        // Writing to a string cannot fail.
        let _ = write!(
            svg,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{height:.1}\" fill=\"#2a78c8\"/>",
            side * at as f64,
            HEIGHT - height,
            side - 1.0,
        );
    }
    let _ = write!(svg, "<polyline points=\"{cut:.1},0 {cut:.1},{HEIGHT}\"/></svg>");
    Some(svg)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_stand_where_the_votes_are() {
        let sure = Vote { inside: 9, outside: 1 };
        let wrong = Vote { inside: 1, outside: 9 };
        let never = Vote { inside: 0, outside: 4 };
        let svg = distribution(&[sure, sure, sure, sure, wrong, never], &VoteOptions::default()).expect("votes");
        assert!(svg.contains("x=\"30.0\" y=\"0.0\"") && svg.contains("x=\"270.0\" y=\"55.0\""), "{svg}");
        assert!(svg.contains("points=\"90.0,0 90.0,110\""), "{svg}");
        assert_eq!(distribution(&[never], &VoteOptions::default()), None);
    }
}
