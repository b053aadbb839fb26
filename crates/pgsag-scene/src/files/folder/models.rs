//! Which model a folder holds, and where its photographs are.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::masks::list_files;
use super::read_file;
use crate::error::FileError;
use crate::files::Note;
use crate::files::colmap::{Encoding, Model};
use crate::scene::Scene;

/// A model and its photographs.
pub(super) struct Found {
    pub(super) scene: Scene,
    pub(super) image_paths: Vec<PathBuf>,
    /// Masks that the model itself names.
    pub(super) mask_paths: Vec<Option<PathBuf>>,
}

const TRIED: &str = "sparse/0/cameras.bin, sparse/0/cameras.txt, sparse/cameras.bin, sparse/cameras.txt";

/// Opens the first model there is.
pub(super) fn open(dir: &Path, notes: &mut Vec<Note>) -> Result<Found, FileError> {
    for folder in ["sparse/0", "sparse"] {
        if let Some((path, encoding)) = find_colmap(&dir.join(folder), notes) {
            let scene = read_colmap(&path, encoding)?;
            return with_images(dir, scene, notes);
        }
    }
    Err(FileError::Missing {
        file: dir.display().to_string(),
        what: format!("no camera model was found; tried {TRIED}"),
        cure: "run structure-from-motion (COLMAP, OpenSfM, …) and put its model there".into(),
    })
}

fn find_colmap(folder: &Path, notes: &mut Vec<Note>) -> Option<(PathBuf, Encoding)> {
    let has = |encoding: Encoding| folder.join(encoding.file_names()[0]).is_file();
    let (binary, text) = (has(Encoding::Binary), has(Encoding::Text));
    if binary && text {
        let text = format!("{} holds the model in binary and as text; the binary files are read", folder.display());
        notes.push(Note::new("model-binary-preferred", text));
    }
    let encoding = if binary { Encoding::Binary } else { Encoding::Text };
    (binary || text).then(|| (folder.to_path_buf(), encoding))
}

fn read_colmap(folder: &Path, encoding: Encoding) -> Result<Scene, FileError> {
    let [cameras, images, points] = encoding.file_names().map(|name| read_file(&folder.join(name)));
    let (cameras, images, points) = (cameras?, images?, points?);
    let files = [&cameras, &images, &points].map(|(name, bytes)| (name.as_str(), bytes.as_slice()));
    let model = Model::decode(encoding, files)?;
    model.into_scene([&images.0, &points.0])
}

/// The photographs of a model in `images/`.
fn with_images(dir: &Path, scene: Scene, notes: &mut Vec<Note>) -> Result<Found, FileError> {
    let folder = dir.join("images");
    if !folder.is_dir() {
        return Err(FileError::Missing {
            file: folder.display().to_string(),
            what: "the folder of the photographs is missing".into(),
            cure: format!("put the {} photographs of the model there", scene.views.len()),
        });
    }
    let image_paths: Vec<PathBuf> = scene.views.iter().map(|view| folder.join(&view.name)).collect();
    let missing: Vec<&PathBuf> = image_paths.iter().filter(|path| !path.is_file()).collect();
    if let Some(first) = missing.first() {
        return Err(FileError::Missing {
            file: first.display().to_string(),
            what: format!("{} of the model's {} photographs are missing", missing.len(), image_paths.len()),
            cure: "put them there under the names of the model, or remove them from the model".into(),
        });
    }
    let known: BTreeSet<&Path> = image_paths.iter().map(PathBuf::as_path).collect();
    let extra = list_files(&folder)?.into_iter().filter(|(_, path)| !known.contains(path.as_path())).count();
    if extra > 0 {
        let text = format!("{extra} files in {} have no pose in the model and are not used", folder.display());
        notes.push(Note::new("image-unregistered", text));
    }
    let mask_paths = vec![None; image_paths.len()];
    Ok(Found { scene, image_paths, mask_paths })
}
