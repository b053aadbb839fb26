//! Curves of the live logs as inline SVG.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde_json::Value;

const WIDTH: f64 = 300.0;
const HEIGHT: f64 = 110.0;

/// A curve of one key.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// The key of the log.
    pub name: String,
    /// The drawing.
    pub svg: String,
    /// Its last value.
    pub last: f64,
}

/// One curve per key of a log; keys that are 0 throughout are left out.
#[must_use]
pub fn curves(log: &str) -> Vec<Curve> {
    let mut series: BTreeMap<String, Vec<(f64, f64)>> = BTreeMap::new();
    for line in log.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok()) {
        let Some(iteration) = line.get("iteration").and_then(Value::as_f64) else { continue };
        for (key, value) in line.as_object().into_iter().flatten() {
            if let (Some(value), false) = (value.as_f64(), matches!(key.as_str(), "iteration" | "seconds")) {
                series.entry(key.clone()).or_default().push((iteration, value));
            }
        }
    }
    series
        .into_iter()
        .filter(|(_, points)| points.iter().any(|(_, value)| *value != 0.0))
        .map(|(name, points)| {
            let last = points.last().map_or(0.0, |(_, value)| *value);
            Curve { svg: drawn(&points), last, name }
        })
        .collect()
}

fn drawn(points: &[(f64, f64)]) -> String {
    let bounds = |of: fn(&(f64, f64)) -> f64| {
        let values = points.iter().map(of);
        (values.clone().fold(f64::INFINITY, f64::min), values.fold(f64::NEG_INFINITY, f64::max))
    };
    let ((x0, x1), (y0, y1)) = (bounds(|point| point.0), bounds(|point| point.1));
    let place = |value: f64, low: f64, high: f64| if high > low { (value - low) / (high - low) } else { 0.5 };
    let mut line = String::new();
    for (x, y) in points {
        let (u, v) = (WIDTH * place(*x, x0, x1), HEIGHT * (1.0 - place(*y, y0, y1)));
        // Writing to a string cannot fail.
        let _ = write!(line, "{u:.1},{v:.1} ");
    }
    format!(
        "<svg viewBox=\"-4 -4 {} {}\" role=\"img\"><polyline points=\"{}\"/><text x=\"0\" y=\"8\">{y1:.4}</text>\
         <text x=\"0\" y=\"{HEIGHT}\">{y0:.4}</text></svg>",
        WIDTH + 8.0,
        HEIGHT + 8.0,
        line.trim_end()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_is_a_curve_per_term_that_was_on() {
        let log = "{\"iteration\":100,\"seconds\":1.0,\"loss\":0.5,\"load\":0.0}\nbroken\n{\"iteration\":200,\"loss\":0.25,\"load\":0}";
        let found = curves(log);
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].name.as_str(), found[0].last), ("loss", 0.25));
        assert!(found[0].svg.contains("points=\"0.0,0.0 300.0,110.0\""), "{}", found[0].svg);
    }
}
