//! A synthetic town as an ordinary SCENE folder with its truth beside it, and the knobs of `pgsag town`.
//!
//! `images/`, `sparse/0/*.bin`, `georef.json` (the frame); `truth/` as in any judged scene: `scene.ply`, `visible.ply`,
//! `masks/*.png` (255 = building), `instances/*.png` (16 bit), `depth/*.depth` (metres along the axis, 0 = sky), and
//! `town.json`, the knobs it was made with. The folder appears whole or not at all.

use std::fs;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use pgsag_scene::Map;
use pgsag_scene::files::colmap::{Encoding, Model};
use pgsag_scene::files::map::encode_map;
use pgsag_scene::files::ply::{Cloud, write_cloud, write_mesh};
use pgsag_scene::files::raster::{encode_instances_png, encode_jpeg, encode_mask_png, encode_png};
use pgsag_scene::synthetic::{Photograph, Town};

mod args;

pub use args::TownArgs;

/// Quality of JPEG photographs.
const JPEG_QUALITY: u8 = 93;

/// What is written beside the photographs and the model.
#[derive(Clone, Debug, PartialEq)]
pub struct FolderOptions {
    /// Also hand the exact masks out in `SCENE/masks`, as if a user had drawn them.
    pub masks: bool,
    /// Write the depth of every view to `truth/depth`.
    pub depth: bool,
    /// One visible truth point per square of this side, metres.
    pub visible_spacing_m: f64,
}

impl Default for FolderOptions {
    fn default() -> Self {
        Self { masks: false, depth: true, visible_spacing_m: 0.15 }
    }
}

/// Writes a town with the default [`FolderOptions`]. `progress` hears views done and views in all.
///
/// # Errors
/// The folder is there already and not empty, or a file cannot be written; then nothing is left behind.
pub fn write_town(town: &Town, folder: &Path, progress: &mut dyn FnMut(usize, usize)) -> Result<()> {
    write_town_with(town, &FolderOptions::default(), folder, progress)
}

/// Writes a town. `progress` hears views done and views in all.
///
/// # Errors
/// The folder is there already and not empty, or a file cannot be written; then nothing is left behind.
pub fn write_town_with(
    town: &Town,
    options: &FolderOptions,
    folder: &Path,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<()> {
    if fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some()) || folder.is_file() {
        bail!("{}: is there already and not empty; name another folder or remove it", folder.display());
    }
    let partial = partial_beside(folder)?;
    let written = write_all(town, options, &partial, progress).and_then(|()| {
        fs::rename(&partial, folder).with_context(|| format!("{}: cannot be put in place", folder.display()))
    });
    if written.is_err() {
        // Best effort: the error that matters is the one being returned.
        let _ = fs::remove_dir_all(&partial);
    }
    written
}

/// A new empty folder beside the wanted one, on the same file system.
fn partial_beside(folder: &Path) -> Result<PathBuf> {
    let name = folder.file_name().with_context(|| format!("{}: is no name for a new folder", folder.display()))?;
    let parent = folder.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let partial = parent.join(format!(".{}.partial.{}", name.to_string_lossy(), std::process::id()));
    // One of a killed process of the same number.
    if partial.exists() {
        fs::remove_dir_all(&partial).with_context(|| format!("{}: cannot be removed", partial.display()))?;
    }
    fs::create_dir_all(&partial).with_context(|| format!("{}: cannot be made", partial.display()))?;
    Ok(partial)
}

fn write_all(town: &Town, options: &FolderOptions, root: &Path, progress: &mut dyn FnMut(usize, usize)) -> Result<()> {
    write_model(town, root)?;
    write_truth(town, options, root)?;
    let count = town.scene.views.len();
    progress(0, count);
    for k in 0..count {
        write_view(town, options, root, k)?;
        progress(k + 1, count);
    }
    Ok(())
}

fn write_model(town: &Town, root: &Path) -> Result<()> {
    for (name, bytes) in Model::from_scene(&town.scene).encode(Encoding::Binary) {
        write_file(&root.join("sparse/0").join(name), &bytes)?;
    }
    fs::create_dir_all(root.join("images"))?;
    write_file(&root.join("georef.json"), &pgsag_scene::files::georef::write_georef(&town.scene.frame))
}

fn write_truth(town: &Town, options: &FolderOptions, root: &Path) -> Result<()> {
    let truth = root.join("truth");
    write_file(&truth.join("town.json"), &serde_json::to_vec_pretty(&town.options)?)?;
    let mesh = town.truth_mesh();
    write_stream(&truth.join("scene.ply"), |out| write_mesh(out, &mesh, &[]))?;
    let (positions, buildings) = town.visible_points(options.visible_spacing_m);
    let cloud = Cloud { positions, colors: Vec::new(), attributes: vec![("building".into(), buildings)] };
    write_stream(&truth.join("visible.ply"), |out| write_cloud(out, &cloud, &[]))
}

fn write_view(town: &Town, options: &FolderOptions, root: &Path, view_index: usize) -> Result<()> {
    let Photograph { image, instances, depth } = town.photograph(view_index);
    let name = &town.scene.views[view_index].name;
    let stem = Path::new(name).with_extension("");
    let truth = |folder: &str, suffix: &str| root.join("truth").join(folder).join(stem.with_extension(suffix));
    let encoded = if town.options.lossless { encode_png(&image) } else { encode_jpeg(&image, JPEG_QUALITY) };
    write_file(&root.join("images").join(name), &encoded)?;
    let values = instances.values.iter().map(|&number| number > 0).collect();
    let mask = encode_mask_png(&Map { width: instances.width, height: instances.height, values });
    write_file(&truth("masks", "png"), &mask)?;
    if options.masks {
        write_file(&root.join("masks").join(stem.with_extension("png")), &mask)?;
    }
    write_file(&truth("instances", "png"), &encode_instances_png(&instances))?;
    if options.depth {
        write_file(&truth("depth", "depth"), &encode_map(&depth))?;
    }
    Ok(())
}

/// Writes a file and the folders above it.
fn write_file(path: &Path, bytes: &[u8]) -> Result<()> {
    write_stream(path, |out| out.write_all(bytes))
}

fn write_stream(path: &Path, write: impl FnOnce(&mut BufWriter<fs::File>) -> std::io::Result<()>) -> Result<()> {
    let attempt = || {
        path.parent().map_or(Ok(()), fs::create_dir_all)?;
        let mut out = BufWriter::new(fs::File::create(path)?);
        write(&mut out)?;
        out.flush()
    };
    attempt().with_context(|| format!("{}: cannot be written", path.display()))
}

#[cfg(test)]
mod tests;
