//! Masks corrected by hand: points and boxes per photograph, asked of the segmenter, added to a mask or taken from it.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context as _, Result};
use pgsag_models::enlarge::mark;
use pgsag_models::sam::{PointKind, PointPrompt};
use pgsag_models::{MaskChoice, Sam2};
use pgsag_scene::files::raster::decode_mask;
use pgsag_scene::{Image, Map};
use serde::{Deserialize, Serialize};

use crate::error::UserError;

/// One thing, pixels of the photograph.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Edit {
    /// On it.
    positive: Vec<[f32; 2]>,
    /// Not on it.
    negative: Vec<[f32; 2]>,
    /// Left, top, right, bottom of a box around it.
    #[serde(rename = "box")]
    corners: Option<[f32; 4]>,
    /// Taken from the mask instead of added to it.
    subtract: bool,
}

/// The file: names of photographs and what is to be changed in each.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Edits {
    file: String,
    images: BTreeMap<String, Vec<Edit>>,
}

impl Edits {
    pub(super) fn read(path: &Path) -> Result<Self> {
        let cure = "see docs/models.md for its form";
        let text = std::fs::read_to_string(path).map_err(|cause| UserError::at(path, cause.to_string(), cure))?;
        let images = serde_json::from_str(&text).map_err(|cause| UserError::at(path, cause.to_string(), cure))?;
        Ok(Self { file: path.display().to_string(), images })
    }

    pub(super) fn of(&self, name: &str) -> Option<&[Edit]> {
        self.images.get(name).map(Vec::as_slice)
    }

    pub(super) fn must_be_among(&self, names: &[String]) -> Result<()> {
        match self.images.keys().find(|name| !names.contains(name)) {
            None => Ok(()),
            Some(name) => {
                let cause = format!("{name:?} is no photograph of that folder");
                Err(UserError::new(self.file.clone(), cause, "name photographs by their path below IMAGES").into())
            }
        }
    }
}

/// The mask that is there already.
pub(super) fn mask_before(path: &Path) -> Result<Option<Map<bool>>> {
    if !path.is_file() {
        return Ok(None);
    }
    let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
    Ok(Some(decode_mask(&path.display().to_string(), &bytes)?))
}

/// Asks for each thing, in the file's order.
pub(super) fn apply(
    segmenter: &Sam2,
    (name, image): (&str, &Image),
    before: Option<Map<bool>>,
    edits: &[Edit],
) -> Result<Map<bool>> {
    let size = (image.width, image.height);
    let mut mask = before.filter(|mask| (mask.width, mask.height) == size);
    let mut mask = mask.take().unwrap_or_else(|| Map::filled(size.0, size.1, false));
    let embedding = segmenter.embed(image)?;
    let is_inside = |[x, y]: [f32; 2]| (0.0..=size.0 as f32).contains(&x) && (0.0..=size.1 as f32).contains(&y);
    for edit in edits {
        if let Some(at) = edit.positive.iter().chain(&edit.negative).find(|at| !is_inside(**at)) {
            let place = format!("the point {at:?}");
            let cause = format!("lies outside of {name}, {} x {} pixels", size.0, size.1);
            return Err(UserError::new(place, cause, "points are pixels of the photograph").into());
        }
        let mut prompt = edit.corners.map(|corners| PointPrompt::from_box(&corners)).unwrap_or_default();
        prompt.points.extend(edit.positive.iter().map(|at| (*at, PointKind::Positive)));
        prompt.points.extend(edit.negative.iter().map(|at| (*at, PointKind::Negative)));
        // One click could mean several things; several points, or a box, mean one.
        let choice = if prompt.points.len() == 1 { MaskChoice::Best } else { MaskChoice::Single };
        let found = &segmenter.decode(&embedding, &[prompt])?[0];
        let mut thing = Map::filled(size.0, size.1, false);
        mark(found.logits(found.chosen(choice)), &mut thing, [0, 0, size.0, size.1]);
        for (value, inside) in mask.values.iter_mut().zip(&thing.values) {
            *value = if edit.subtract { *value && !inside } else { *value || *inside };
        }
    }
    Ok(mask)
}
