//! A SCENE folder: finds the model, the photographs, the masks and the frame, and checks them against each other.
//!
//! Nothing is decoded here but headers; [`SceneFolder::read_image`] and [`SceneFolder::read_mask`] decode one view on
//! demand. The folder is never written to. What was found, and what is missing, is said in notes.

use std::fs;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::camera::Pinhole;
use crate::camera::distortion::LensCamera;
use crate::camera::undistort::{pinhole_for, undistort, undistort_instances, undistort_mask};
use crate::error::FileError;
use crate::files::Note;
use crate::files::photo::{self, PhotoHeader};
use crate::files::raster;
use crate::image::Image;
use crate::maps::Map;
use crate::scene::{Scene, View};

mod masks;
mod models;
mod place;

/// A scene and where its pixels are.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFolder {
    /// Views sorted by name, points, frame.
    pub scene: Scene,
    /// Per view: the photograph.
    pub image_paths: Vec<PathBuf>,
    /// Per view: what the photograph's header says.
    pub headers: Vec<PhotoHeader>,
    /// Per view: its mask; `None` means unknown, not empty.
    pub mask_paths: Vec<Option<PathBuf>>,
    /// How the masks are named, such as `a.jpg.png`; `None` without masks.
    pub mask_convention: Option<&'static str>,
    /// What the owner should know.
    pub notes: Vec<Note>,
}

/// Opens a scene: COLMAP (`sparse/0`, `sparse`), OpenSfM / OpenDroneMap or nerfstudio, with `images/` and, where they
/// exist, `masks/` or `mask/`.
///
/// # Errors
/// [`FileError`] with file, place and cure: no model, a damaged file, a photograph that is missing or of another shape
/// than its camera, a mask of another shape than its photograph.
pub fn open_scene(dir: &Path) -> Result<SceneFolder, FileError> {
    let mut notes = Vec::new();
    let found = models::open(dir, &mut notes)?;
    let mut scene = found.scene;
    let headers = read_headers(&found.image_paths)?;
    fit_cameras(&mut scene, &headers, &found.image_paths, &mut notes)?;
    note_headers(&scene, &headers, &mut notes);
    scene.frame = place::find(dir, &scene.views, &headers, found.reference_lla, &mut notes)?;
    let count = scene.views.len();
    let mut folder = SceneFolder {
        scene,
        image_paths: found.image_paths,
        headers,
        mask_paths: vec![None; count],
        mask_convention: None,
        notes,
    };
    if found.mask_paths.iter().any(Option::is_some) {
        folder.mask_paths = found.mask_paths;
        folder.mask_convention = Some("mask_path of transforms.json");
        folder.check_masks()?;
    } else if let Some(masks) = ["masks", "mask"].iter().map(|name| dir.join(name)).find(|path| path.is_dir()) {
        folder.attach_masks(&masks)?;
    }
    Ok(folder)
}

impl SceneFolder {
    /// Looks for the masks of all views in a folder (any of the known namings), instead of those found so far.
    ///
    /// # Errors
    /// [`FileError`] where the folder cannot be read or a mask has another shape than its photograph.
    pub fn attach_masks(&mut self, masks_dir: &Path) -> Result<(), FileError> {
        let names: Vec<&str> = self.scene.views.iter().map(|view| view.name.as_str()).collect();
        let found = masks::find(masks_dir, &names)?;
        self.notes.extend(found.notes);
        self.mask_paths = found.paths;
        self.mask_convention = found.convention;
        self.check_masks()
    }

    fn check_masks(&mut self) -> Result<(), FileError> {
        let lenses = self.scene.views.iter().map(|view| (view.lens.width, view.lens.height));
        let sizes: Vec<(u32, u32)> = lenses.collect();
        let resized = masks::check_sizes(&self.mask_paths, &sizes)?;
        if let Some((path, size)) = resized.first() {
            let (count, path) = (resized.len(), path.display());
            let text = format!(
                "{count} masks have another size than their photographs and are resized to the nearest pixel \
                 (the first: {path}, {} x {})",
                size.0, size.1
            );
            self.notes.push(Note::new("mask-resized", text));
        }
        Ok(())
    }

    /// Decodes the photograph of a view, as it is on disk, lens distortion included.
    ///
    /// # Errors
    /// [`FileError`] where it cannot be read, or has changed its size since the scene was opened.
    pub fn read_image(&self, view: usize) -> Result<Image, FileError> {
        let path = &self.image_paths[view];
        let (file, bytes) = read_file(path)?;
        let image = raster::decode_image(&file, &bytes)?;
        let lens = &self.scene.views[view].lens;
        if (image.width, image.height) != (lens.width, lens.height) {
            return Err(size_mismatch(&file, (image.width, image.height), lens));
        }
        Ok(image)
    }

    /// Decodes the photograph of a view and removes the distortion: the image of `scene.views[view].camera`.
    ///
    /// # Errors
    /// As [`Self::read_image`].
    pub fn read_undistorted_image(&self, view: usize) -> Result<Image, FileError> {
        let View { lens, camera, .. } = &self.scene.views[view];
        let image = self.read_image(view)?;
        Ok(if lens.model.is_pinhole() { image } else { undistort(&image, lens, camera) })
    }

    /// Decodes the mask of a view at the size of its photograph: true = building; `None` where there is no mask.
    ///
    /// # Errors
    /// [`FileError`] where it cannot be read or decoded.
    pub fn read_mask(&self, view: usize) -> Result<Option<Map<bool>>, FileError> {
        let Some(path) = &self.mask_paths[view] else {
            return Ok(None);
        };
        let (file, bytes) = read_file(path)?;
        let mask = raster::decode_mask(&file, &bytes)?;
        let lens = &self.scene.views[view].lens;
        let same = (mask.width, mask.height) == (lens.width, lens.height);
        Ok(Some(if same { mask } else { mask.resized_nearest(lens.width, lens.height) }))
    }

    /// Decodes the mask of a view as instance numbers (0 = no building) and removes the distortion; `None` where there is
    /// no mask.
    ///
    /// # Errors
    /// As [`Self::read_mask`]; also where the raster is in colour.
    pub fn read_undistorted_instances(&self, view: usize) -> Result<Option<Map<u16>>, FileError> {
        let Some(path) = &self.mask_paths[view] else {
            return Ok(None);
        };
        let (file, bytes) = read_file(path)?;
        let View { lens, camera, .. } = &self.scene.views[view];
        let found = raster::decode_instances(&file, &bytes)?;
        let same = (found.width, found.height) == (lens.width, lens.height);
        let found = if same { found } else { found.resized_nearest(lens.width, lens.height) };
        Ok(Some(if lens.model.is_pinhole() { found } else { undistort_instances(&found, lens, camera) }))
    }

    /// Decodes the mask of a view and removes the distortion; `None` where there is no mask.
    ///
    /// # Errors
    /// As [`Self::read_mask`].
    pub fn read_undistorted_mask(&self, view: usize) -> Result<Option<Map<bool>>, FileError> {
        let View { lens, camera, .. } = &self.scene.views[view];
        let mask = self.read_mask(view)?;
        Ok(mask.map(|mask| if lens.model.is_pinhole() { mask } else { undistort_mask(&mask, lens, camera) }))
    }
}

/// The bytes of a file, with its name for errors.
///
/// # Errors
/// [`FileError`] where the operating system refuses.
pub fn read_file(path: &Path) -> Result<(String, Vec<u8>), FileError> {
    let file = path.display().to_string();
    match fs::read(path) {
        Ok(bytes) => Ok((file, bytes)),
        Err(error) => Err(FileError::Unreadable { file, reason: error.to_string() }),
    }
}

fn read_headers(paths: &[PathBuf]) -> Result<Vec<PhotoHeader>, FileError> {
    let headers: Vec<_> = paths.par_iter().map(|path| read_photo_header(path)).collect();
    headers.into_iter().collect()
}

/// The header of a photograph on disk; no pixel is read.
///
/// # Errors
/// [`FileError`] where the file cannot be opened or is no image.
pub fn read_photo_header(path: &Path) -> Result<PhotoHeader, FileError> {
    let name = path.display().to_string();
    let file = fs::File::open(path)
        .map_err(|error| FileError::Unreadable { file: name.clone(), reason: error.to_string() })?;
    photo::read_header(&name, &mut BufReader::new(file))
}

fn size_mismatch(file: &str, (width, height): (u32, u32), lens: &LensCamera) -> FileError {
    FileError::Mismatch {
        file: file.into(),
        what: format!("{width} x {height} pixels, but its camera is {} x {}", lens.width, lens.height),
        cure: "use the photographs that the model was computed from (or all of them resized alike)".into(),
    }
}

/// Makes the cameras as large as their photographs, where the one is the other resized.
fn fit_cameras(
    scene: &mut Scene,
    headers: &[PhotoHeader],
    paths: &[PathBuf],
    notes: &mut Vec<Note>,
) -> Result<(), FileError> {
    let mut moved: Vec<Option<(Pinhole, Pinhole)>> = vec![None; scene.views.len()];
    for (index, header) in headers.iter().enumerate() {
        let View { lens, camera, .. } = &mut scene.views[index];
        let size = (header.width, header.height);
        if size == (lens.width, lens.height) {
            continue;
        }
        if size.0 == 0 || size.1 == 0 || !same_shape(size, (lens.width, lens.height)) {
            return Err(size_mismatch(&paths[index].display().to_string(), size, lens));
        }
        if moved.iter().all(Option::is_none) {
            let (path, old) = (paths[index].display(), (lens.width, lens.height));
            let text = format!(
                "photographs are resized against the model, whose cameras are resized likewise (the first: {path}, \
                 {} x {} instead of {} x {})",
                size.0, size.1, old.0, old.1
            );
            notes.push(Note::new("camera-rescaled", text));
        }
        *lens = lens.resized(size.0, size.1);
        let old = std::mem::replace(camera, pinhole_for(lens));
        moved[index] = Some((old, *camera));
    }
    if moved.iter().all(Option::is_none) {
        return Ok(());
    }
    for seen in scene.points.iter_mut().flat_map(|point| &mut point.track) {
        if let Some((old, new)) = &moved[seen.view_index as usize] {
            let ray = old.ray(f64::from(seen.xy_px[0]), f64::from(seen.xy_px[1]));
            seen.xy_px = [(ray.x * new.fx + new.cx) as f32, (ray.y * new.fy + new.cy) as f32];
        }
    }
    Ok(())
}

/// Whether two sizes differ by one factor for both sides, to within a pixel of the larger.
pub(crate) fn same_shape((w0, h0): (u32, u32), (w1, h1): (u32, u32)) -> bool {
    let cross = (u64::from(w0) * u64::from(h1)).abs_diff(u64::from(h0) * u64::from(w1));
    cross <= u64::from(w0.max(w1)).max(u64::from(h0.max(h1)))
}

fn note_headers(scene: &Scene, headers: &[PhotoHeader], notes: &mut Vec<Note>) {
    let turned = headers.iter().filter(|header| header.orientation.is_some_and(|value| value > 1)).count();
    if turned > 0 {
        let text = format!("{turned} photographs carry an EXIF orientation; it is ignored, as COLMAP ignores it");
        notes.push(Note::new("exif-orientation-ignored", text));
    }
    let lenses = scene.views.iter().filter(|view| !view.lens.model.is_pinhole()).count();
    if lenses > 0 {
        let text = format!("{lenses} photographs have lens distortion, which is removed on the fly");
        notes.push(Note::new("lens-distortion", text));
    }
}

#[cfg(test)]
mod tests;
