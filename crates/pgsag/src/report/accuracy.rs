//! Accuracy without truth as rows of a table: who was asked, of what, and what the answer was.

use pgsag_mesh::evidence::Spread;
use serde_json::{Value, json};

use crate::stages::score::evidence::{Evidence, FlowPart, PointsPart};

/// What the page shows.
#[must_use]
pub fn shown(evidence: &Evidence) -> Value {
    let centimetres = |value: Option<f64>| number(value, 100.0, 1);
    let metric = |spread: &Spread| {
        json!([centimetres(spread.bias), centimetres(spread.sigma), centimetres(spread.noise), centimetres(spread.net)])
    };
    let flow_row = |name: String, part: &FlowPart| {
        json!({
            "name": name, "count": part.patches, "judged": percent(part.judged), "lost": percent(part.lost),
            "bias_px": number(part.residual_px.bias, 1.0, 3), "sigma_px": number(part.residual_px.sigma, 1.0, 3),
            "metric": metric(&part.surface_m),
        })
    };
    let points_row = |name: String, part: &PointsPart| {
        json!({
            "name": name, "count": part.surface_m.count, "metric": metric(&part.surface_m),
            "median": number(part.normalised_median, 1.0, 2), "sigma": number(part.normalised_sigma, 1.0, 2),
            "within": part.within_two_sigma.map_or_else(|| "–".into(), percent),
        })
    };
    let flow = evidence.flow.as_ref().map(|flow| {
        let mut rows = vec![
            flow_row("everything".into(), &flow.all),
            flow_row("buildings".into(), &flow.buildings),
            flow_row("background".into(), &flow.background),
        ];
        rows.extend(flow.per_building.iter().map(|(number, part)| flow_row(format!("building {number}"), part)));
        json!({"held_out": flow.held_out, "pairs": flow.pairs, "rows": rows})
    });
    let points = evidence.points.as_ref().map(|points| {
        let mut rows = vec![
            points_row("everything".into(), &points.all),
            points_row("buildings".into(), &points.buildings),
            points_row("background".into(), &points.background),
        ];
        rows.extend(points.per_building.iter().map(|(number, part)| points_row(format!("building {number}"), part)));
        json!({
            "withheld": points.withheld, "unfit": points.unfit, "without_mesh": points.without_mesh,
            "noise_px": number(points.noise_px, 1.0, 2), "rows": rows,
        })
    });
    let of = &evidence.structure;
    let planes = [("roofs", &of.roofs), ("facades", &of.facades)].map(|(name, part)| {
        json!({"name": name, "count": part.count, "rms": number(part.rms_gsd, 1.0, 2), "p90": number(part.p90_gsd, 1.0, 2)})
    });
    let edges = json!({
        "count": of.edges.count, "buildings": of.edges.buildings,
        "width": number(of.edges.width_gsd, 1.0, 2), "p90": number(of.edges.p90_gsd, 1.0, 2),
    });
    json!({"gsd": number(Some(evidence.gsd_m), 100.0, 1), "flow": flow, "points": points, "planes": planes, "edges": edges})
}

fn number(value: Option<f64>, factor: f64, digits: usize) -> String {
    value.map_or_else(|| "–".into(), |value| format!("{:.digits$}", value * factor))
}

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stages::score::evidence::{FlowEvidence, PointsEvidence};

    #[test]
    fn rows_are_in_centimetres_and_what_is_unknown_is_a_dash() {
        let spread = Spread { count: 4, bias: Some(-0.012), sigma: Some(0.05), noise: Some(0.03), net: Some(0.04) };
        let part = FlowPart { patches: 9, judged: 0.5, surface_m: spread, ..FlowPart::default() };
        let flow = FlowEvidence { all: part, per_building: [(7, part)].into(), ..FlowEvidence::default() };
        let evidence =
            Evidence { gsd_m: 0.2, flow: Some(flow), points: Some(PointsEvidence::default()), ..Evidence::default() };
        let found = shown(&evidence);
        assert_eq!(found["gsd"], "20.0");
        assert_eq!(found["flow"]["rows"][0]["metric"], json!(["-1.2", "5.0", "3.0", "4.0"]));
        assert_eq!(found["flow"]["rows"][3]["name"], "building 7");
        assert_eq!(
            (&found["flow"]["rows"][0]["judged"], &found["points"]["rows"][0]["within"]),
            (&json!("50 %"), &json!("–"))
        );
        assert_eq!(shown(&Evidence::default())["flow"], Value::Null);
    }
}
