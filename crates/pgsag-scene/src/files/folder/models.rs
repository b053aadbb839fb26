//! Which model a folder holds, and where its photographs are.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::masks::list_files;
use super::{read_file, read_photo_header};
use crate::error::FileError;
use crate::files::colmap::{Encoding, Model};
use crate::files::{Note, nerfstudio, opensfm, ply};
use crate::points::SparsePoint;
use crate::scene::Scene;

/// A model and its photographs.
pub(super) struct Found {
    pub(super) scene: Scene,
    pub(super) image_paths: Vec<PathBuf>,
    /// Masks that the model itself names.
    pub(super) mask_paths: Vec<Option<PathBuf>>,
    /// Origin of a local east-north-up frame in metres, where the model itself names it.
    pub(super) reference_lla: Option<[f64; 3]>,
}

const RECONSTRUCTIONS: [&str; 2] = ["reconstruction.json", "opensfm/reconstruction.json"];
const TRIED: &str = "sparse/0/cameras.bin, sparse/0/cameras.txt, sparse/cameras.bin, sparse/cameras.txt, \
                     reconstruction.json, opensfm/reconstruction.json, transforms.json";

/// Opens the first model there is.
pub(super) fn open(dir: &Path, notes: &mut Vec<Note>) -> Result<Found, FileError> {
    for folder in ["sparse/0", "sparse"] {
        if let Some((path, encoding)) = find_colmap(&dir.join(folder), notes) {
            let scene = read_colmap(&path, encoding)?;
            return with_images(dir, scene, notes);
        }
    }
    if let Some(path) = RECONSTRUCTIONS.iter().map(|name| dir.join(name)).find(|path| path.is_file()) {
        return open_opensfm(dir, &path, notes);
    }
    let transforms = dir.join("transforms.json");
    if transforms.is_file() {
        return open_nerfstudio(dir, &transforms);
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
    check_present(&image_paths)?;
    let known: BTreeSet<&Path> = image_paths.iter().map(PathBuf::as_path).collect();
    let extra = list_files(&folder)?.into_iter().filter(|(_, path)| !known.contains(path.as_path())).count();
    if extra > 0 {
        let text = format!("{extra} files in {} have no pose in the model and are not used", folder.display());
        notes.push(Note::new("image-unregistered", text));
    }
    let mask_paths = vec![None; image_paths.len()];
    Ok(Found { scene, image_paths, mask_paths, reference_lla: None })
}

fn check_present(image_paths: &[PathBuf]) -> Result<(), FileError> {
    let missing: Vec<&PathBuf> = image_paths.iter().filter(|path| !path.is_file()).collect();
    match missing.first() {
        None => Ok(()),
        Some(first) => Err(FileError::Missing {
            file: first.display().to_string(),
            what: format!("{} of the model's {} photographs are missing", missing.len(), image_paths.len()),
            cure: "put them there under the names of the model, or remove them from the model".into(),
        }),
    }
}

fn open_opensfm(dir: &Path, path: &Path, notes: &mut Vec<Note>) -> Result<Found, FileError> {
    let (file, bytes) = read_file(path)?;
    let mut read = opensfm::parse(&file, &bytes)?;
    notes.append(&mut read.notes);
    let tracks = path.with_file_name("tracks.csv");
    if tracks.is_file() {
        let (file, bytes) = read_file(&tracks)?;
        read.add_tracks(&file, &bytes)?;
    } else {
        notes.push(Note::new(
            "tracks-missing",
            format!("{} is missing: no one knows who saw a point", tracks.display()),
        ));
    }
    let reference_lla = read.reference_lla;
    Ok(Found { reference_lla, ..with_images(dir, read.scene, notes)? })
}

/// The path of a photograph as `transforms.json` names it; Blender leaves the extension out.
fn with_extension(path: PathBuf) -> PathBuf {
    let named = |extension: &str| PathBuf::from(format!("{}.{extension}", path.display()));
    let candidates = ["png", "jpg", "jpeg", "PNG", "JPG"].map(named);
    if path.is_file() { path } else { candidates.into_iter().find(|path| path.is_file()).unwrap_or(path) }
}

fn open_nerfstudio(dir: &Path, path: &Path) -> Result<Found, FileError> {
    let (file, bytes) = read_file(path)?;
    let mut image_size = |image: &str| {
        let header = read_photo_header(&with_extension(dir.join(image))).ok()?;
        Some((header.width, header.height))
    };
    let mut read = nerfstudio::parse(&file, &bytes, &mut image_size)?;
    if let Some(points) = &read.points_file {
        let (file, bytes) = read_file(&dir.join(points))?;
        let cloud = ply::read_cloud(&file, &bytes)?;
        let points = cloud.positions.iter().enumerate().map(|(i, position)| SparsePoint {
            position_world: read.applied.undo((*position).into()),
            color: cloud.colors.get(i).copied().unwrap_or([128; 3]),
            error_px: 0.0,
            track: Vec::new(),
        });
        read.scene.points = points.collect();
    }
    let image_paths: Vec<PathBuf> = read.image_files.iter().map(|image| with_extension(dir.join(image))).collect();
    check_present(&image_paths)?;
    let mask_paths: Vec<Option<PathBuf>> =
        read.mask_files.iter().map(|mask| mask.as_ref().map(|mask| dir.join(mask))).collect();
    Ok(Found { scene: read.scene, image_paths, mask_paths, reference_lla: None })
}
