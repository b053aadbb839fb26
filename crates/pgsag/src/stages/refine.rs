//! `refine`: masks to the pixel classes that training works with, per kind of group.

use std::path::Path;

use anyhow::Result;
use pgsag_group::GroupKind;
use pgsag_group::refine::{background_classes, building_classes};
use pgsag_scene::Mask;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::import::Imported;
use super::masks::{mask_of, states};
use super::{
    batch_file, batch_views, batches, config, encode_classes, read_classes, read_json, view_file, write, write_json,
};
use crate::run::Run;
use crate::run::artifact::Artifact;
use crate::run::stage::{Cost, Job, JobPlan};

/// Which views of a batch have classes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Classes {
    /// Indices of the views.
    pub views: Vec<usize>,
}

impl Artifact for Classes {
    const FORMAT: &'static str = "pgsag-classes";
    const VERSION: u32 = 1;

    fn read(folder: &Path) -> Result<Self> {
        read_json(&folder.join("classes.json"))
    }

    fn write(&self, folder: &Path) -> Result<()> {
        write_json(&folder.join("classes.json"), self)
    }
}

/// The end of a class raster's name.
fn kind_name(kind: GroupKind) -> &'static str {
    match kind {
        GroupKind::Building => "building.png",
        GroupKind::Background => "background.png",
    }
}

/// The classes of a view for a kind of group; `None` where its mask is unknown.
///
/// # Errors
/// Where the raster is damaged.
pub fn classes_of(stage_folder: &Path, view_index: usize, kind: GroupKind) -> Result<Option<Mask>> {
    let path = batch_file(stage_folder, view_index, kind_name(kind));
    if path.exists() { read_classes(&path).map(Some) } else { Ok(None) }
}

pub(crate) fn jobs(run: &Run) -> Result<Vec<JobPlan>> {
    let imported = Imported::read(&run.stage_folder("import"))?;
    let pixels = imported.scene.views.iter().map(|view| view.camera.pixel_count() as u64).max().unwrap_or(0);
    let threads = rayon::current_num_threads() as u64;
    Ok(batches(imported.scene.views.len(), &["import", "masks"], |count| Cost {
        memory_bytes: (64 << 20) + 24 * pixels * threads,
        disk_bytes: count as u64 * pixels / 20,
        cpu_secs: count as f64 * pixels as f64 * 120e-9,
    }))
}

pub(crate) fn run(job: &Job<'_>) -> Result<()> {
    let options = config(job.run)?.refine;
    let imported: Imported = job.read("import")?;
    let view_count = imported.scene.views.len();
    let states = states(job, view_count)?;
    let masks = job.input("masks");
    let classes = |&view: &usize| -> Result<Option<usize>> {
        job.check()?;
        let Some(mask) = mask_of(&masks, view, states[view])? else { return Ok(None) };
        let of = |kind| match kind {
            GroupKind::Building => building_classes(&mask, &options),
            GroupKind::Background => background_classes(&mask, &options),
        };
        for kind in [GroupKind::Building, GroupKind::Background] {
            write(&job.output().join(view_file(view, kind_name(kind))), &encode_classes(&of(kind)))?;
        }
        Ok(Some(view))
    };
    let views = batch_views(job, view_count).par_iter().map(classes).collect::<Result<Vec<_>>>()?;
    job.write(&Classes { views: views.into_iter().flatten().collect() })
}
