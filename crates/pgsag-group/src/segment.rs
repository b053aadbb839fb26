//! What a model that finds buildings in photographs must do, whoever it is: answer words with masks of a whole image, and
//! points with candidates for one thing. Paper 4.1: coarse masks by language (Eq. 5), refined ones by prompts.
//!
//! No model lives here. A wing that has one implements [`Segmenter`]; the stages take one where there is one.

use pgsag_scene::{Image, Map};

/// What a segmenter is asked for. Pixel `i` covers `[i, i + 1)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ask<'a> {
    /// Everything that the words name, such as `buildings.`
    Text(&'a str),
    /// The one thing on which all `positive` points lie and no `negative` one, in pixels of the image that is given.
    Points {
        /// On it.
        positive: &'a [[f32; 2]],
        /// On something else.
        negative: &'a [[f32; 2]],
    },
}

/// Finds things in images.
pub trait Segmenter: Sync {
    /// Masks of the image's size. An answer to words is every thing found, which may overlap; an answer to points are
    /// candidates for the same thing, the one the model believes in most first. Nothing found is an empty answer.
    ///
    /// # Errors
    /// [`SegmentError`] where the model cannot be asked.
    fn segment(&self, image: &Image, ask: &Ask<'_>) -> Result<Vec<Map<bool>>, SegmentError>;

    /// The number, from 1, of the segment that each pixel belongs to, whatever it shows; 0 for none. Of several the
    /// smallest counts. `None`: this model cannot tell.
    ///
    /// # Errors
    /// [`SegmentError`] where the model cannot be asked.
    fn everything(&self, _image: &Image) -> Result<Option<Map<u32>>, SegmentError> {
        Ok(None)
    }
}

/// Why there is no mask.
#[derive(Debug, thiserror::Error)]
pub enum SegmentError {
    /// The model itself failed.
    #[error("the model gave no mask: {what}; {cure}")]
    Model {
        /// What it said.
        what: String,
        /// What to do.
        cure: String,
    },
    /// A mask of another size than the image's.
    #[error("a mask of {found:?} pixels came back for an image of {asked:?}; the model's adapter is at fault")]
    Size {
        /// Width and height of the image.
        asked: [u32; 2],
        /// Width and height of the mask.
        found: [u32; 2],
    },
}

/// Asks, and holds the answer to the image's size.
///
/// # Errors
/// [`SegmentError`].
pub fn segment(segmenter: &dyn Segmenter, image: &Image, ask: &Ask<'_>) -> Result<Vec<Map<bool>>, SegmentError> {
    let asked = [image.width, image.height];
    let masks = segmenter.segment(image, ask)?;
    match masks.iter().map(|mask| [mask.width, mask.height]).find(|found| *found != asked) {
        Some(found) => Err(SegmentError::Size { asked, found }),
        None => Ok(masks),
    }
}

/// One mask of all things that words found in an image.
///
/// # Errors
/// [`SegmentError`].
pub fn named(segmenter: &dyn Segmenter, image: &Image, words: &str) -> Result<Map<bool>, SegmentError> {
    let mut all = Map::filled(image.width, image.height, false);
    for mask in segment(segmenter, image, &Ask::Text(words))? {
        all.values.iter_mut().zip(&mask.values).for_each(|(all, one)| *all |= one);
    }
    Ok(all)
}

#[cfg(test)]
pub(crate) mod flood;

#[cfg(test)]
mod tests {
    use super::flood::Flood;
    use super::*;

    struct Careless;

    impl Segmenter for Careless {
        fn segment(&self, _: &Image, _: &Ask<'_>) -> Result<Vec<Map<bool>>, SegmentError> {
            Ok(vec![Map::filled(3, 3, true)])
        }
    }

    #[test]
    fn words_find_all_things_and_points_one() {
        let mut image = Image::filled(30, 10, [20, 90, 20]);
        let roof = |image: &mut Image, from: u32| {
            (from..from + 6).for_each(|x| (2..8).for_each(|y| image.pixels[(y * 30 + x) as usize] = [180, 60, 50]));
        };
        roof(&mut image, 2);
        roof(&mut image, 18);
        let all = named(&Flood::default(), &image, "buildings.").expect("an answer");
        assert_eq!(all.values.iter().filter(|is_roof| **is_roof).count(), 72);
        let ask = Ask::Points { positive: &[[4.5, 4.5]], negative: &[] };
        let one = &segment(&Flood::default(), &image, &ask).expect("an answer")[0];
        assert!(one.at(2, 2) && one.at(7, 7) && !one.at(18, 4) && !one.at(12, 4));
    }

    #[test]
    fn a_mask_of_another_size_is_refused() {
        let image = Image::filled(4, 3, [0; 3]);
        let error = named(&Careless, &image, "buildings.").expect_err("another size");
        assert!(matches!(error, SegmentError::Size { asked: [4, 3], found: [3, 3] }), "{error}");
    }
}
