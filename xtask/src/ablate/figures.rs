//! What a finished run comes to, read from its own files.

use std::path::Path;

use super::read;
use crate::Result;
use crate::json::Json;

/// The figures of one row on one scene.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Figures {
    /// F1 of buildings at 0.1 m and 0.2 m.
    pub(super) f1: [f64; 2],
    /// Mean distance from mesh to truth, metres.
    pub(super) accuracy_m: f64,
    /// Mean distance from truth to mesh, metres.
    pub(super) completeness_m: f64,
    /// Mean distance from mesh to truth within half a metre of the truth's edges, metres (the paper's Fig. 5).
    pub(super) edge_m: f64,
    pub(super) gaussians: f64,
    /// Of all jobs, those that the base had done among them.
    pub(super) cpu_secs: f64,
}

const MEMBERS: [&str; 7] = ["f1_0.1", "f1_0.2", "accuracy_m", "completeness_m", "edge_m", "gaussians", "cpu_secs"];

impl Figures {
    fn values(&self) -> [f64; 7] {
        let [fine, coarse] = self.f1;
        [fine, coarse, self.accuracy_m, self.completeness_m, self.edge_m, self.gaussians, self.cpu_secs]
    }

    fn of_values([fine, coarse, accuracy_m, completeness_m, edge_m, gaussians, cpu_secs]: [f64; 7]) -> Self {
        Self { f1: [fine, coarse], accuracy_m, completeness_m, edge_m, gaussians, cpu_secs }
    }

    /// Reads score and manifests.
    pub(super) fn of_run(run: &Path) -> Result<Self> {
        let score = read(&run.join("result/score.json"))?;
        let f1 = |threshold: f64| -> Result<f64> {
            let row = score.get("scores").map_or(&[][..], Json::list).iter().find(|row| {
                row.get("threshold_m").and_then(number).is_some_and(|found| (found - threshold).abs() < 1e-9)
            });
            row.and_then(|row| row.get("f1")).and_then(number).ok_or(format!("no F1 at {threshold} m"))
        };
        let mean = |side: &str| {
            let found = score.get(side).and_then(|side| side.get("mean")).and_then(number);
            found.ok_or(format!("no mean in {side}"))
        };
        let (mut cpu_secs, mut gaussians) = (0.0, 0.0);
        for stage in folders(run)? {
            for folder in [vec![stage.clone()], folders(&stage)?].concat() {
                let manifest = folder.join("manifest.json");
                if manifest.exists() {
                    let measured = read(&manifest)?;
                    let measured = measured.get("measured").and_then(|measured| measured.get("cpu_secs"));
                    cpu_secs += measured.and_then(number).unwrap_or(0.0);
                }
                let trained = folder.join("train.json");
                if trained.exists() {
                    gaussians += read(&trained)?.get("gaussians").and_then(number).unwrap_or(0.0);
                }
            }
        }
        let (accuracy_m, completeness_m) = (mean("accuracy_m")?, mean("completeness_m")?);
        let edge = score.get("accuracy_m").and_then(|side| side.get("edge")).and_then(|edge| edge.get("mean"));
        let edge_m = edge.and_then(number).ok_or("no mean at edges")?;
        Ok(Self { f1: [f1(0.1)?, f1(0.2)?], accuracy_m, completeness_m, edge_m, gaussians, cpu_secs })
    }

    pub(super) fn to_json(self) -> Json {
        let member = |(name, value): (&str, f64)| (name.to_owned(), Json::Number(format!("{value}")));
        Json::Object(MEMBERS.into_iter().zip(self.values()).map(member).collect())
    }

    /// For the next time, with what decided it.
    pub(super) fn to_text(self, commit: &str, identity: &str) -> String {
        let text = |text: &str| Json::Text(text.into());
        let members = vec![
            ("commit".into(), text(commit)),
            ("identity".into(), text(identity)),
            ("figures".into(), self.to_json()),
        ];
        format!("{}\n", Json::Object(members))
    }

    /// Commit and figures that [`Self::to_text`] wrote, if the same decided them.
    pub(super) fn remembered(text: &str, identity: &str) -> Option<(String, Self)> {
        let kept = Json::parse(text).ok()?;
        if kept.get("identity")?.text()? != identity {
            return None;
        }
        let figures = kept.get("figures")?;
        let mut values = [0.0; 7];
        for (value, name) in values.iter_mut().zip(MEMBERS) {
            *value = figures.get(name).and_then(number)?;
        }
        Some((kept.get("commit")?.text()?.to_owned(), Self::of_values(values)))
    }
}

/// Folders in a folder.
fn folders(of: &Path) -> Result<Vec<std::path::PathBuf>> {
    let fault = |cause: std::io::Error| format!("{}: {cause}", of.display());
    let mut found = Vec::new();
    for entry in std::fs::read_dir(of).map_err(fault)? {
        let entry = entry.map_err(fault)?;
        // The result is a second name of what lies in the stages.
        if entry.path().is_dir() && entry.file_name() != "result" {
            found.push(entry.path());
        }
    }
    Ok(found)
}

fn number(value: &Json) -> Option<f64> {
    if let Json::Number(digits) = value { digits.parse().ok() } else { None }
}
