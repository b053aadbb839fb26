//! Undistorted photographs at the size of training, decoded on demand into a byte-bounded cache of windows.
//!
//! What was costly to make is also kept as plain bytes in `RUN/cache/`, which may be deleted at any time.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context as _, Result};
use pgsag_scene::files::folder::SceneFolder;
use pgsag_scene::{Image, Map, Pinhole};

use crate::config::Config;
use crate::run::artifact;
use crate::run::stage::Job;
use crate::stages::import::{Imported, Photo};

/// The camera of an image whose longest side is at most `longest_px` (0: as it is).
#[must_use]
pub fn training_camera(camera: &Pinhole, longest_px: u32) -> Pinhole {
    let longest = camera.width.max(camera.height);
    if longest_px == 0 || longest <= longest_px {
        return *camera;
    }
    let scaled =
        |side: u32| ((u64::from(side) * u64::from(longest_px) + u64::from(longest) / 2) / u64::from(longest)).max(1);
    camera.resized(scaled(camera.width) as u32, scaled(camera.height) as u32)
}

type Key = (usize, [u32; 4]);

#[derive(Default)]
struct Kept {
    clock: u64,
    bytes: u64,
    images: BTreeMap<Key, (u64, Arc<Image>)>,
}

/// All photographs of a scene.
pub struct Photographs {
    folder: SceneFolder,
    photos: Vec<Photo>,
    cameras: Vec<Pinhole>,
    spill: PathBuf,
    bound_bytes: u64,
    kept: Mutex<Kept>,
}

impl Photographs {
    /// The photographs of a run, keeping at most `bound_bytes` of them in memory.
    #[must_use]
    pub fn new(imported: &Imported, config: &Config, job: &Job<'_>, bound_bytes: u64) -> Self {
        Self::sized(imported, config, job, bound_bytes, config.image_width)
    }

    /// The same with another longest side than that of training (0: original).
    #[must_use]
    pub fn sized(imported: &Imported, config: &Config, job: &Job<'_>, bound_bytes: u64, longest_px: u32) -> Self {
        let cameras = imported.scene.views.iter().map(|view| training_camera(&view.camera, longest_px));
        Self {
            folder: imported.folder(config.scene.as_ref()),
            photos: imported.photos.clone(),
            cameras: cameras.collect(),
            spill: job.run.folder.join("cache"),
            bound_bytes,
            kept: Mutex::default(),
        }
    }

    /// The camera of a whole training image.
    #[must_use]
    pub fn camera(&self, view_index: usize) -> Pinhole {
        self.cameras[view_index]
    }

    /// The window `[left, top, width, height]` of a training image.
    ///
    /// # Errors
    /// Where the photograph cannot be read.
    pub fn window(&self, view_index: usize, window_px: [u32; 4]) -> Result<Arc<Image>> {
        let key = (view_index, window_px);
        if let Some(image) = self.recall(&key) {
            return Ok(image);
        }
        let image = Arc::new(match self.read_spilled(&key) {
            Some(image) => image,
            None => {
                let image = self.decode(view_index)?;
                let [x0, y0, width, height] = window_px;
                let image = if (width, height) == (image.width, image.height) {
                    image
                } else {
                    image.cropped(x0, y0, width, height)
                };
                self.spill(&key, &image)?;
                image
            }
        });
        self.keep(key, &image);
        Ok(image)
    }

    /// A whole training image.
    ///
    /// # Errors
    /// Where the photograph cannot be read.
    pub fn whole(&self, view_index: usize) -> Result<Arc<Image>> {
        let camera = self.cameras[view_index];
        self.window(view_index, [0, 0, camera.width, camera.height])
    }

    fn decode(&self, view_index: usize) -> Result<Image> {
        let image = self.folder.read_undistorted_image(view_index)?;
        let camera = &self.cameras[view_index];
        let same = (image.width, image.height) == (camera.width, camera.height);
        Ok(if same { image } else { image.resized(camera.width, camera.height) })
    }

    fn recall(&self, key: &Key) -> Option<Arc<Image>> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.clock += 1;
        let clock = kept.clock;
        kept.images.get_mut(key).map(|(used, image)| {
            *used = clock;
            Arc::clone(image)
        })
    }

    fn keep(&self, key: Key, image: &Arc<Image>) {
        let bytes = 3 * image.pixels.len() as u64;
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        while kept.bytes + bytes > self.bound_bytes {
            let oldest = kept.images.iter().map(|(key, (used, _))| (*used, *key)).min();
            let Some((_, oldest)) = oldest else { return };
            if let Some((_, gone)) = kept.images.remove(&oldest) {
                kept.bytes -= 3 * gone.pixels.len() as u64;
            }
        }
        kept.clock += 1;
        let clock = kept.clock;
        if kept.images.insert(key, (clock, Arc::clone(image))).is_none() {
            kept.bytes += bytes;
        }
    }

    fn spill_path(&self, key: &Key) -> PathBuf {
        let (view_index, [x0, y0, width, height]) = key;
        let camera = &self.cameras[*view_index];
        let lens = serde_json::to_string(&self.folder.scene.views[*view_index].lens).unwrap_or_default();
        let print = artifact::fingerprint_words([self.photos[*view_index].fingerprint.as_str(), lens.as_str()]);
        self.spill.join(format!("{print}.{}x{}.{x0}.{y0}.{width}x{height}.rgb", camera.width, camera.height))
    }

    /// Whether making the image took more than decoding it.
    fn is_costly(&self, view_index: usize) -> bool {
        let view = &self.folder.scene.views[view_index];
        let camera = &self.cameras[view_index];
        !view.lens.model.is_pinhole() || (camera.width, camera.height) != (view.camera.width, view.camera.height)
    }

    fn read_spilled(&self, key: &Key) -> Option<Image> {
        let bytes = fs::read(self.spill_path(key)).ok()?;
        let (pixels, hash) = bytes.split_last_chunk::<32>()?;
        let [_, _, width, height] = key.1;
        let is_sound = pixels.len() == 3 * width as usize * height as usize && blake3::hash(pixels).as_bytes() == hash;
        is_sound.then(|| Image { width, height, pixels: bytemuck::cast_slice(pixels).to_vec() })
    }

    fn spill(&self, key: &Key, image: &Image) -> Result<()> {
        if !self.is_costly(key.0) {
            return Ok(());
        }
        fs::create_dir_all(&self.spill).with_context(|| format!("{}", self.spill.display()))?;
        let pixels: &[u8] = bytemuck::cast_slice(&image.pixels);
        let mut bytes = pixels.to_vec();
        bytes.extend_from_slice(blake3::hash(pixels).as_bytes());
        artifact::write_whole(&self.spill_path(key), &bytes)
    }
}

/// A building mask of the undistorted image at the size of training.
#[must_use]
pub fn training_mask(mask: &Map<bool>, camera: &Pinhole) -> Map<bool> {
    if (mask.width, mask.height) == (camera.width, camera.height) {
        return mask.clone();
    }
    mask.resized(camera.width, camera.height)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_side_is_kept_and_small_images_are_not_enlarged() {
        let camera = Pinhole { width: 4000, height: 3000, fx: 3500.0, fy: 3500.0, cx: 2000.0, cy: 1500.0 };
        let small = training_camera(&camera, 1000);
        assert_eq!((small.width, small.height, small.fx), (1000, 750, 875.0));
        assert_eq!(training_camera(&camera, 0), camera);
        assert_eq!(training_camera(&camera, 9000), camera);
    }
}
