//! THE TABLE: thirteen rows, read top to bottom.

use crate::run::artifact::Artifact;
use crate::run::stage::{Job, Per, Stage};
use crate::stages::{
    coarse, depth, fuse, group, import, masks, merge, mesh, no_sources, refine, report, score, train, vote,
};

/// A row that depends on nothing outside the run and nothing of the device; the rest is said in the table.
const fn row<A: Artifact>(
    name: &'static str,
    reads: &'static [&'static str],
    per: Per,
    slice: &'static [&'static str],
    jobs: fn(&crate::run::Run) -> anyhow::Result<Vec<crate::run::stage::JobPlan>>,
    run: fn(&Job<'_>) -> anyhow::Result<()>,
) -> Stage {
    Stage {
        name,
        reads,
        per,
        slice,
        on_backend: false,
        format: (A::FORMAT, A::VERSION),
        code: 1,
        publishes: None,
        sources: no_sources,
        jobs,
        run,
    }
}

/// What the views and the pixels of a run depend on.
const IMAGES: &str = "image_width";

/// From photographs to the result, in order.
#[rustfmt::skip]
pub static PIPELINE: &[Stage] = &[
    Stage { sources: import::sources,
    ..row::<import::Imported>("import", &[], Per::Whole, &["metres_per_unit"], import::jobs, import::run) },
    Stage { code: 3,
    ..row::<coarse::Coarse>("coarse", &["import"], Per::Whole, &["coarse", "neighbors", "holdout", "images", IMAGES], coarse::jobs, coarse::run) },
    Stage { sources: masks::sources, code: 4,
    ..row::<masks::MaskList>("masks", &["import", "coarse"], Per::Image, &["masks", "instances", "geometry", "language", "refine.superpixel_px", IMAGES], masks::jobs, masks::run) },
    row::<vote::Votes>("vote", &["import", "coarse", "masks"], Per::Whole, &["vote"], vote::jobs, vote::run),
    Stage { sources: masks::models, code: 5,
    ..row::<refine::Classes>("refine", &["import", "coarse", "masks", "vote"], Per::Image, &["refine", "masks", "language", IMAGES], refine::jobs, refine::run) },
    Stage { sources: crate::stages::aoi::sources, code: 4,
    ..row::<group::Groups>("group", &["import", "coarse", "masks", "vote", "refine"], Per::Whole, &["vote.depth_tolerance", "refine", "groups", "blocks", "memory_limit", "initialise.sh_degree", "holdout", "images", IMAGES], group::jobs, group::run) },
    Stage { on_backend: true, code: 3,
    ..row::<train::Trained>("train", &["import", "coarse", "group"], Per::Group, &["seed", "train", "initialise", "neighbors", "holdout", "images", IMAGES], train::jobs, train::run) },
    Stage { on_backend: true, code: 2,
    ..row::<depth::DepthMaps>("depth", &["import", "coarse", "group", "train"], Per::Group, &["depth", "support", "filter", "neighbors", IMAGES], depth::jobs, depth::run) },
    Stage { code: 3,
    ..row::<fuse::Fused>("fuse", &["import", "refine", "group", "depth"], Per::Image, &["refine.overlap_px", "groups.collar_px", IMAGES], fuse::jobs, fuse::run) },
    row::<mesh::Surface>("mesh", &["import", "masks", "group", "fuse"], Per::Tile, &["surface", IMAGES], mesh::jobs, mesh::run),
    Stage { sources: crate::stages::aoi::sources, code: 4,
    ..row::<merge::Merged>("merge", &["import", "group", "mesh"], Per::Whole, &["buildings", "surface.max_gap_m", "surface.voxel_gsd", "surface.voxel_m"], merge::jobs, merge::run) },
    Stage { sources: score::sources, code: 5,
    ..row::<score::Scored>("score", &["import", "coarse", "group", "merge"], Per::Whole, &["score", "evidence", "memory_limit", "neighbors", "holdout", "images", "seed", IMAGES], score::jobs, score::run) },
    Stage { publishes: Some("result"),
    ..row::<report::Published>("report", &["import", "vote", "group", "train", "merge", "score"], Per::Whole, &["buildings", IMAGES], report::jobs, report::run) },
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[test]
    fn rows_read_only_rows_above_them_and_settings_that_exist() {
        let settings = Config::default().settings();
        for (at, stage) in PIPELINE.iter().enumerate() {
            for upstream in stage.reads {
                assert!(PIPELINE[..at].iter().any(|row| row.name == *upstream), "{} reads {upstream}", stage.name);
            }
            for key in stage.slice {
                assert!(settings.slice(&[key]).iter().next().is_some(), "{} reads setting {key}", stage.name);
            }
        }
        assert_eq!(PIPELINE.len(), 13);
    }
}
