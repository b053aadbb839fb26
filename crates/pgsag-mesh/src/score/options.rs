//! What is judged, against what, and how.

use std::collections::BTreeMap;

use pgsag_scene::Mesh;
use serde::{Deserialize, Serialize};

use super::panoptic::Panoptic;

/// The truth that a mesh is judged against. Coordinates in the scene's frame and units.
#[derive(Clone, Copy, Debug)]
pub enum Truth<'a> {
    /// Distances are taken to its triangles; recall is judged at area-uniform points on it.
    Mesh(&'a Mesh),
    /// Distances are taken to its nearest point.
    Cloud(&'a [[f64; 3]]),
    /// Precision against `scene`, where samples nearest to a surface that is no building are left out; recall against
    /// `visible`.
    Folder {
        /// All true triangles with `buildings` (0 = not a building).
        scene: &'a Mesh,
        /// Points on true building surfaces that can be seen.
        visible: &'a [[f64; 3]],
        /// Building of every visible point.
        building: &'a [u32],
    },
}

/// Whose rules are followed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Protocol {
    /// Ours: point to surface wherever the truth has one.
    #[default]
    Pgsag,
    /// PG-SAG's paper: samples and truth 0.35 m apart, threshold 0.6 m, point to point (method 4.3).
    PgSag,
    /// CityGaussianV2 on GauU-Scene: ICP with scale, threshold 1.5 mean truth spacings (method 4.2).
    #[serde(rename = "citygs-v2")]
    CitygsV2,
    /// Tanks and Temples as PGSR runs it: vertices only, ICP with scale (method 4.1).
    TanksAndTemples,
}

impl Protocol {
    /// As the command line and `score.json` spell it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Pgsag => "pgsag",
            Self::PgSag => "pg-sag",
            Self::CitygsV2 => "citygs-v2",
            Self::TanksAndTemples => "tanks-and-temples",
        }
    }
}

/// Whether the mesh is moved onto the truth first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Align {
    /// Judged where it lies.
    #[default]
    None,
    /// Rotation and translation by point-to-point ICP.
    Icp,
    /// Rotation, translation and scale.
    IcpScale,
}

/// How to score. Lengths in metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScoreOptions {
    /// Whose rules; those other than ours overrule the rest as published.
    pub protocol: Protocol,
    /// A point counts where it is at most this far away.
    pub thresholds_m: Vec<f64>,
    /// One sample per this length squared; `None` = a third of the smallest threshold.
    pub spacing_m: Option<f64>,
    /// Alignment before judging.
    pub align: Align,
    /// Only what lies in this polygon (scene x and y) is judged.
    pub crop: Option<Vec<[f64; 2]>>,
    /// Seed of samples and bootstrap.
    pub seed: u64,
    /// Draws of the bootstrap over buildings; 0 = none.
    pub bootstrap: u32,
    /// Metres per scene unit.
    pub metres_per_unit: f64,
    /// Away from the ground, scene frame: parts roofs from facades.
    pub up: [f64; 3],
    /// Mean distances are taken of distances cut to this.
    pub mean_cap_m: f64,
    /// Half width of the band along true edges.
    pub edge_band_m: f64,
    /// Side of the cells of plan view in which buildings are compared.
    pub plan_cell_m: f64,
}

impl Default for ScoreOptions {
    fn default() -> Self {
        Self {
            protocol: Protocol::Pgsag,
            thresholds_m: vec![0.1, 0.2, 0.3, 0.6],
            spacing_m: None,
            align: Align::None,
            crop: None,
            seed: 0,
            bootstrap: 1000,
            metres_per_unit: 1.0,
            up: [0.0, 0.0, 1.0],
            mean_cap_m: 2.0,
            edge_band_m: 0.5,
            plan_cell_m: 0.25,
        }
    }
}

/// One row of the score.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ThresholdScore {
    /// Metres.
    pub threshold_m: f64,
    /// Share of the mesh's samples within the threshold of the truth.
    pub precision: f64,
    /// Share of the truth's points within the threshold of the mesh.
    pub recall: f64,
    /// Harmonic mean of the two.
    pub f1: f64,
    /// 95 % interval of `precision` over drawn sets of buildings; absent with fewer than two.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub precision_interval: Option<[f64; 2]>,
    /// The same of `recall`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recall_interval: Option<[f64; 2]>,
    /// The same of `f1`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub f1_interval: Option<[f64; 2]>,
    /// The truth is a cloud sparser than half the threshold: the figures say more about it than about the mesh.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub truth_too_sparse: bool,
}

/// Order statistics of distances, metres. `None` where there are none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// How many.
    pub count: u64,
    /// Median with sign: positive = outside of the surface measured to; absent against clouds.
    pub signed_median: Option<f64>,
    /// Mean distance, each cut to `mean_cap_m`.
    pub mean: Option<f64>,
    /// 68 % are nearer.
    pub p68: Option<f64>,
    /// 90 % are nearer.
    pub p90: Option<f64>,
    /// 95 % are nearer.
    pub p95: Option<f64>,
}

/// Distances of all points, and of those by what part of the true surface they are nearest to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Distances {
    /// All.
    #[serde(flatten)]
    pub all: Spread,
    /// Nearest to a true face less than 70 degrees steep, off the edges.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub roof: Option<Spread>,
    /// Nearest to a steeper true face, off the edges.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub facade: Option<Spread>,
    /// Within the band along the true edges (folds of more than 30 degrees between building faces).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edge: Option<Spread>,
}

/// The score of one true building.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BuildingScore {
    /// Number in the truth.
    pub building: u32,
    /// Samples of the mesh whose nearest true surface is this building.
    pub samples: u64,
    /// Truth points of this building.
    pub truth_points: u64,
    /// One row per threshold.
    pub scores: Vec<ThresholdScore>,
    /// Of the samples.
    pub accuracy_m: Spread,
    /// Of the truth points.
    pub completeness_m: Spread,
}

/// `score.json`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Whose rules.
    pub protocol: String,
    /// One sample per this squared, metres.
    pub spacing_m: f64,
    /// One row per threshold.
    pub scores: Vec<ThresholdScore>,
    /// From mesh to truth.
    pub accuracy_m: Distances,
    /// From truth to mesh.
    pub completeness_m: Distances,
    /// In the order of their numbers; empty where the truth knows no buildings.
    pub per_building: Vec<BuildingScore>,
    /// Fingerprints of what was judged, by name; filled by the caller.
    pub inputs: BTreeMap<String, String>,
    /// Samples left out because their nearest true surface is not a building.
    pub left_out: u64,
    /// Whether buildings are told apart as in the truth; absent where mesh or truth knows none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panoptic: Option<Panoptic>,
    /// Share of the points that building groups own whose nearest true surface is no building; filled by the caller.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub points_off_buildings: Option<f64>,
    /// Mean distance between neighbouring points of a truth cloud, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub truth_spacing_m: Option<f64>,
    /// The motion that was applied to the mesh (row-major, scene units), where alignment was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alignment: Option<[[f64; 4]; 4]>,
    /// What the reader must know, in sentences.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}
