//! Every building of a view, asked for by points on a crop of the original photograph. Method 8.15.

use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context as _, Result};
use pgsag_group::plan::PlanFrame;
use pgsag_group::prompts::{Drawn, Prompt, PromptOptions, chosen, pieces, prompted, prompts};
use pgsag_group::segment::{Ask, Segmenter, segment};
use pgsag_group::surface::NO_POINT;
use pgsag_scene::{Image, Map};

use super::Pencil;
use crate::config::Config;
use crate::lengths::Lengths;
use crate::photographs::Photographs;
use crate::run::stage::Job;

/// Least height step that parts two buildings, metres.
const STEP_M: f64 = 1.0;
/// Steepest roof within one building, rise over run.
const STEEPEST: f64 = 1.5;
/// Side of the cells of plan view, distances between points.
const CELL_SPACINGS: f64 = 3.0;

/// Who asks.
pub(super) struct Asker<'a> {
    pencil: &'a Pencil<'a>,
    segmenter: &'a dyn Segmenter,
    /// At their original size.
    originals: Photographs,
    /// `[points]`.
    pieces: Vec<Drawn>,
    options: PromptOptions,
    asked: AtomicUsize,
    believed: AtomicUsize,
}

impl<'a> Asker<'a> {
    pub(super) fn new(job: &Job<'_>, config: &Config, pencil: &'a Pencil<'a>, segmenter: &'a dyn Segmenter) -> Self {
        let scene = &pencil.imported.scene;
        let positions: Vec<_> = (0..pencil.surface.len() as u32).map(|index| pencil.surface.position(index)).collect();
        let cell = CELL_SPACINGS * pencil.surface.spacing;
        let step = Lengths::of(scene).units(STEP_M).max(STEEPEST * cell);
        Self {
            pencil,
            segmenter,
            originals: Photographs::sized(pencil.imported, config, job, 0, 0),
            pieces: pieces(&positions, &pencil.labels, &PlanFrame::new(scene.frame.up_world), cell, step),
            options: PromptOptions::default(),
            asked: AtomicUsize::new(0),
            believed: AtomicUsize::new(0),
        }
    }

    /// A mask with each building that is drawn in this view as the model sees it, where the votes agree with the model.
    pub(super) fn mended(&self, view: usize, given: &Map<bool>) -> Result<Map<bool>> {
        let seen = self.pencil.seen(view);
        let what = |point: &u32| if *point == NO_POINT { Drawn::Unknown } else { self.pieces[*point as usize] };
        let (width, height) = (seen.point.width, seen.point.height);
        let small = Map { width, height, values: seen.point.values.iter().map(what).collect::<Vec<Drawn>>() };
        let drawn = small.resized_nearest(given.width, given.height);
        let questions = prompts(&drawn, &self.options);
        let original = if questions.is_empty() { return Ok(given.clone()) } else { self.originals.whole(view)? };
        let mut answers = Vec::new();
        for question in questions {
            self.asked.fetch_add(1, Ordering::Relaxed);
            let mut candidates = self
                .candidates(&original, given, &question)
                .with_context(|| self.pencil.imported.scene.views[view].name.clone())?;
            if let Some((best, _)) = chosen(&candidates, &drawn, &question, &self.options) {
                self.believed.fetch_add(1, Ordering::Relaxed);
                answers.push((question, candidates.swap_remove(best)));
            }
        }
        Ok(prompted(given, &drawn, &answers))
    }

    /// What the model says of a question, asked on the original photograph, at the size of the question's window.
    fn candidates(&self, original: &Image, given: &Map<bool>, question: &Prompt) -> Result<Vec<Map<bool>>> {
        let scale =
            [f64::from(original.width) / f64::from(given.width), f64::from(original.height) / f64::from(given.height)];
        let [x0, y0, width, height] = question.window_px;
        let at = |place: u32, axis: usize| (f64::from(place) * scale[axis]).round() as u32;
        let (left, top) = (at(x0, 0), at(y0, 1));
        let crop = original.cropped(left, top, at(x0 + width, 0) - left, at(y0 + height, 1) - top);
        let local = |points: &[[f32; 2]]| -> Vec<[f32; 2]> {
            let place = |value: f32, axis: usize, corner: u32, size: u32| {
                (f64::from(value) * scale[axis] - f64::from(corner)).clamp(0.0, f64::from(size) - 0.5) as f32
            };
            points.iter().map(|p| [place(p[0], 0, left, crop.width), place(p[1], 1, top, crop.height)]).collect()
        };
        let (positive, negative) = (local(&question.positive), local(&question.negative));
        let masks = segment(self.segmenter, &crop, &Ask::Points { positive: &positive, negative: &negative })?;
        Ok(masks.into_iter().map(|mask| mask.resized(width, height)).collect())
    }

    pub(super) fn told(&self) -> String {
        let (asked, believed) = (self.asked.load(Ordering::Relaxed), self.believed.load(Ordering::Relaxed));
        format!(
            "the model was asked for {asked} buildings in their images; {believed} of its answers agree with the votes"
        )
    }
}
