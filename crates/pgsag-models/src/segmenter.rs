//! The wing's side of the narrow waist: [`Segmenter`] as the stages ask it.

use pgsag_group::segment::{Ask, SegmentError, Segmenter};
use pgsag_scene::{Image, Map};

use crate::enlarge::mark;
use crate::error::ModelError;
use crate::everything::{EverythingOptions, segments};
use crate::grounding::Prompt;
use crate::language::LanguageSegmenter;
use crate::sam::{PointKind, PointPrompt};

/// Answers words with a detector and a segmenter, points with the segmenter.
pub struct Wing {
    /// The networks.
    pub networks: LanguageSegmenter,
    /// Thresholds; the words come with the question.
    pub prompt: Prompt,
}

impl From<ModelError> for SegmentErrorOf {
    fn from(error: ModelError) -> Self {
        Self(error)
    }
}

/// A model's error on its way to the stages.
struct SegmentErrorOf(ModelError);

impl From<SegmentErrorOf> for SegmentError {
    fn from(SegmentErrorOf(error): SegmentErrorOf) -> Self {
        let (what, cure) = error.parts();
        Self::Model { what, cure }
    }
}

impl Segmenter for Wing {
    /// Words are answered with one mask of all that was found; points with the masks that the network offers, best first.
    fn segment(&self, image: &Image, ask: &Ask<'_>) -> Result<Vec<Map<bool>>, SegmentError> {
        Ok(match ask {
            Ask::Text(words) => {
                let prompt = Prompt { text: (*words).to_owned(), ..self.prompt.clone() };
                let found = self.networks.find::<SegmentErrorOf>(image, &prompt, &|| Ok(()))?;
                if found.detections.is_empty() { Vec::new() } else { vec![found.mask] }
            }
            Ask::Points { positive, negative } => self.candidates(image, positive, negative)?,
        })
    }

    fn everything(&self, image: &Image) -> Result<Option<Map<u32>>, SegmentError> {
        let go_on = || Ok::<(), SegmentErrorOf>(());
        let mut found = segments(&self.networks.segmenter, image, &EverythingOptions::default(), &go_on)?;
        found.sort_by_key(|segment| std::cmp::Reverse(segment.area_px));
        let mut number = Map::filled(image.width, image.height, 0);
        (1..).zip(&found).for_each(|(own, segment)| segment.paint(&mut number, own));
        Ok(Some(number))
    }
}

impl Wing {
    fn candidates(
        &self,
        image: &Image,
        positive: &[[f32; 2]],
        negative: &[[f32; 2]],
    ) -> Result<Vec<Map<bool>>, SegmentErrorOf> {
        let mut points: Vec<_> = positive.iter().map(|at| (*at, PointKind::Positive)).collect();
        points.extend(negative.iter().map(|at| (*at, PointKind::Negative)));
        let segmenter = &self.networks.segmenter;
        let embedding = segmenter.embed(image)?;
        let mut masks = Vec::new();
        for found in segmenter.decode(&embedding, &[PointPrompt { points }])? {
            let mut order: Vec<usize> = (0..found.masks.len()).collect();
            order.sort_by(|&a, &b| found.scores[b].total_cmp(&found.scores[a]).then(a.cmp(&b)));
            for token in order {
                let mut mask = Map::filled(image.width, image.height, false);
                mark(found.logits(token), &mut mask, [0, 0, image.width, image.height]);
                masks.push(mask);
            }
        }
        Ok(masks)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::test_picture;

    #[test]
    fn words_points_and_everything_are_answered_at_the_image_s_size() {
        let prompt = Prompt { box_threshold: 0.5, ..Prompt::default() };
        let wing = Wing { networks: crate::language::tests::networks(), prompt };
        let image = test_picture(11, 220, 150);
        let named = wing.segment(&image, &Ask::Text("buildings.")).expect("an answer");
        let ask = Ask::Points { positive: &[[50.0, 60.0]], negative: &[[5.0, 5.0]] };
        let candidates = wing.segment(&image, &ask).expect("an answer");
        assert_eq!((named.len(), candidates.len()), (1, 4));
        assert!(named.iter().chain(&candidates).all(|mask| (mask.width, mask.height) == (220, 150)));
        let numbers = wing.everything(&image).expect("an answer").expect("it can");
        assert_eq!((numbers.width, numbers.height), (220, 150));
        assert!(wing.segment(&image, &Ask::Text(" ")).is_err());
    }
}
