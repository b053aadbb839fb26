//! Photographs and masks: sharpness, exposure, coverage.

use pgsag_scene::Image;
use pgsag_scene::files::folder::SceneFolder;
use pgsag_scene::numbers::median;
use rayon::prelude::*;

use super::{Finding, Severity, some_of};
use crate::photographs::training_camera;

/// Longest side at which sharpness is compared, so that image size does not matter.
const LONGEST_PX: u32 = 1000;
/// An image is blurred where the variance of its Laplacian is below this share of the median of all.
const BLUR_SHARE: f64 = 0.3;
/// Mean brightness may differ from the median by this factor.
const EXPOSURE_FACTOR: f64 = 1.5;

/// Photographs that are decoded; of more, an even sample. Masks are all read.
const MAX_DECODED: usize = 200;

/// What one photograph and its mask say.
struct Look {
    /// Sharpness and brightness, where the photograph was decoded.
    photograph: Option<[f64; 2]>,
    /// Share of building pixels; `None` without a mask.
    building: Option<f64>,
}

/// Findings about pixels; files that cannot be read are findings, too.
pub(super) fn findings(scene: &SceneFolder) -> Vec<Finding> {
    let mut found = Vec::new();
    let step = scene.scene.views.len().div_ceil(MAX_DECODED).max(1);
    let looks: Vec<Result<Look, String>> =
        (0..scene.scene.views.len()).into_par_iter().map(|view| look(scene, view, view % step == 0)).collect();
    for error in looks.iter().filter_map(|look| look.as_ref().err()) {
        found.push(Finding::new(Severity::Error, "file-unreadable", error.clone(), "replace the file"));
    }
    let named = scene.scene.views.iter().zip(&looks);
    let known: Vec<(&str, &Look)> =
        named.filter_map(|(view, look)| Some((view.name.as_str(), look.as_ref().ok()?))).collect();
    let photographs: Vec<(&str, [f64; 2])> =
        known.iter().filter_map(|(name, look)| Some((*name, look.photograph?))).collect();
    if step > 1 {
        let text = format!("{} of {} photographs were looked at", photographs.len(), looks.len());
        found.push(Finding::new(Severity::Note, "photographs-sampled", text, ""));
    }
    compared(&photographs, &mut found);
    masks(&known, &mut found);
    found
}

/// Photographs against the median of all.
fn compared(photographs: &[(&str, [f64; 2])], found: &mut Vec<Finding>) {
    let middle =
        |k: usize| median(&mut photographs.iter().map(|(_, values)| values[k]).collect::<Vec<_>>()).unwrap_or(0.0);
    let (sharp, bright) = (middle(0), middle(1));
    let named = |test: &dyn Fn(&[f64; 2]) -> bool| -> Vec<&str> {
        photographs.iter().filter(|(_, values)| test(values)).map(|(name, _)| *name).collect()
    };
    let blurred = named(&|[sharpness, _]| *sharpness < BLUR_SHARE * sharp);
    if !blurred.is_empty() {
        let text = format!(
            "{} images are much less sharp than the others: {}",
            blurred.len(),
            some_of(blurred.iter().copied())
        );
        found.push(Finding::new(Severity::Warning, "blur", text, "leave them out if others cover the place"));
    }
    let uneven =
        named(&|[_, brightness]| *brightness > EXPOSURE_FACTOR * bright || brightness * EXPOSURE_FACTOR < bright);
    if !uneven.is_empty() {
        let text = format!(
            "{} images are much brighter or darker than the others: {}",
            uneven.len(),
            some_of(uneven.iter().copied())
        );
        found.push(Finding::new(
            Severity::Warning,
            "exposure",
            text,
            "fly with fixed exposure; training corrects what it can",
        ));
    }
}

fn masks(known: &[(&str, &Look)], found: &mut Vec<Finding>) {
    let share = |(_, look): &&(&str, &Look)| look.building;
    let missing: Vec<&str> = known.iter().filter(|entry| share(entry).is_none()).map(|(name, _)| *name).collect();
    if missing.len() == known.len() {
        let cure = "put masks into SCENE/masks (a.jpg.png, a.png, a_mask.png …; 128 and above = building)";
        found.push(Finding::new(Severity::Warning, "masks-none", "no masks: buildings will not be separated", cure));
        return;
    }
    if !missing.is_empty() {
        let text = format!("{} images have no mask: {}", missing.len(), some_of(missing.iter().copied()));
        found.push(Finding::new(
            Severity::Warning,
            "mask-missing",
            text,
            "they are used for the background only; add masks",
        ));
    }
    let empty: Vec<&str> = known.iter().filter(|entry| share(entry) == Some(0.0)).map(|(name, _)| *name).collect();
    if !empty.is_empty() {
        let text = format!("{} masks say that there is no building: {}", empty.len(), some_of(empty.iter().copied()));
        found.push(Finding::new(Severity::Note, "mask-empty", text, "remove those masks if that is not so"));
    }
    let mut shares: Vec<f64> = known.iter().filter_map(|(_, look)| look.building).collect();
    let text = format!(
        "{} masks, half of them mark more than {:.0} % of the image",
        shares.len(),
        100.0 * median(&mut shares).unwrap_or(0.0)
    );
    found.push(Finding::new(Severity::Note, "masks", text, ""));
}

fn look(scene: &SceneFolder, view: usize, decode: bool) -> Result<Look, String> {
    let mask = scene.read_mask(view).map_err(|error| error.to_string())?;
    let count = |values: &[bool]| values.iter().filter(|inside| **inside).count() as f64 / values.len().max(1) as f64;
    let building = mask.map(|mask| count(&mask.values));
    let mut photograph = None;
    if decode {
        let image = scene.read_image(view).map_err(|error| error.to_string())?;
        let camera = training_camera(&scene.scene.views[view].camera, LONGEST_PX);
        let image = if image.width > camera.width { image.resized(camera.width, camera.height) } else { image };
        photograph = Some([sharpness(&image), brightness(&image)]);
    }
    Ok(Look { photograph, building })
}

fn luma(pixel: [u8; 3]) -> f64 {
    0.299 * f64::from(pixel[0]) + 0.587 * f64::from(pixel[1]) + 0.114 * f64::from(pixel[2])
}

fn brightness(image: &Image) -> f64 {
    image.pixels.iter().map(|pixel| luma(*pixel)).sum::<f64>() / image.pixels.len().max(1) as f64
}

/// Variance of the Laplacian, squared grey levels.
fn sharpness(image: &Image) -> f64 {
    let (mut sum, mut square, mut count) = (0.0, 0.0, 0.0);
    for y in 1..image.height.saturating_sub(1) {
        for x in 1..image.width.saturating_sub(1) {
            let at = |dx: i64, dy: i64| luma(image.at((i64::from(x) + dx) as u32, (i64::from(y) + dy) as u32));
            let laplacian = at(-1, 0) + at(1, 0) + at(0, -1) + at(0, 1) - 4.0 * at(0, 0);
            sum += laplacian;
            square += laplacian * laplacian;
            count += 1.0;
        }
    }
    if count > 0.0 { square / count - (sum / count) * (sum / count) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkerboard_is_sharp_and_its_mean_is_not() {
        let mut board = Image::filled(32, 32, [0; 3]);
        for (at, pixel) in board.pixels.iter_mut().enumerate() {
            if (at / 32 + at % 32) % 2 == 0 {
                *pixel = [200; 3];
            }
        }
        assert!(sharpness(&board) > 1e4);
        assert!(sharpness(&Image::filled(32, 32, [100; 3])) < 1e-9);
        assert!((brightness(&board) - 100.0).abs() < 1e-9);
    }
}
