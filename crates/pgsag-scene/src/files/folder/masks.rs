//! Finding the mask of every photograph, under the namings in use.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::{read_photo_header, same_shape};
use crate::error::FileError;
use crate::files::Note;

/// The namings, for a photograph `a.jpg`, in the order of preference.
const CONVENTIONS: [&str; 5] = ["a.jpg.png", "a.png", "a.jpg", "a.mask.png", "a_mask.png"];

/// Folders deeper than this are not entered.
const DEEPEST: usize = 16;

pub(super) struct Found {
    pub(super) paths: Vec<Option<PathBuf>>,
    pub(super) convention: Option<&'static str>,
    pub(super) notes: Vec<Note>,
}

/// A mask and its width and height.
type SizedMask = (PathBuf, (u32, u32));

/// The names of the mask of a photograph, in the order of [`CONVENTIONS`].
fn candidates(name: &str) -> [String; 5] {
    let folder_end = name.rfind('/').map_or(0, |i| i + 1);
    let stem = match name[folder_end..].rfind('.') {
        Some(dot) if dot > 0 => &name[..folder_end + dot],
        _ => name,
    };
    [format!("{name}.png"), format!("{stem}.png"), name.into(), format!("{stem}.mask.png"), format!("{stem}_mask.png")]
}

/// Finds the masks of the named photographs; upper and lower case are the same.
pub(super) fn find(dir: &Path, names: &[&str]) -> Result<Found, FileError> {
    let files = list_files(dir)?;
    let by_name: BTreeMap<String, &PathBuf> = files.iter().map(|(name, path)| (name.to_lowercase(), path)).collect();
    let matches: Vec<[Option<&PathBuf>; 5]> = names
        .iter()
        .map(|name| candidates(name).map(|candidate| by_name.get(&candidate.to_lowercase()).copied()))
        .collect();
    let hits: Vec<usize> = (0..5).map(|c| matches.iter().filter(|found| found[c].is_some()).count()).collect();
    let best = (0..5).rev().max_by_key(|&c| hits[c]).unwrap_or(0);
    let mut mixed = 0;
    let choose = |found: &[Option<&PathBuf>; 5]| {
        let other = found.iter().flatten().next().copied();
        mixed += usize::from(found[best].is_none() && other.is_some());
        found[best].or(other).cloned()
    };
    let paths: Vec<Option<PathBuf>> = matches.iter().map(choose).collect();
    let (have, all) = (paths.iter().flatten().count(), names.len());
    let tried = CONVENTIONS.join(", ");
    let folder = dir.display();
    let mut notes = Vec::new();
    if have == 0 {
        let text =
            format!("{folder} holds no mask of any photograph; for a photograph a.jpg these were tried: {tried}");
        return Ok(Found { paths, convention: None, notes: vec![Note::new("mask-none-matched", text)] });
    }
    let named = CONVENTIONS[best];
    notes.push(Note::new(
        "mask-convention",
        format!("{have} of {all} photographs have a mask, named as {named} for a.jpg"),
    ));
    if mixed > 0 {
        notes.push(Note::new("mask-convention-mixed", format!("{mixed} masks are named otherwise (one of {tried})")));
    }
    Ok(Found { paths, convention: Some(named), notes })
}

/// All files below a folder with their names (`/` between folders), sorted.
pub(super) fn list_files(dir: &Path) -> Result<Vec<(String, PathBuf)>, FileError> {
    let mut files = Vec::new();
    let mut open = vec![(String::new(), dir.to_path_buf(), 0)];
    while let Some((prefix, folder, depth)) = open.pop() {
        let unreadable = |error: std::io::Error| FileError::Unreadable {
            file: folder.display().to_string(),
            reason: error.to_string(),
        };
        for entry in fs::read_dir(&folder).map_err(unreadable)? {
            let entry = entry.map_err(unreadable)?;
            let Ok(name) = entry.file_name().into_string() else { continue };
            let (name, path) = (format!("{prefix}{name}"), entry.path());
            if path.is_dir() && depth < DEEPEST {
                open.push((format!("{name}/"), path, depth + 1));
            } else if path.is_file() {
                files.push((name, path));
            }
        }
    }
    files.sort();
    Ok(files)
}

/// The masks that have the shape of their photograph but another size; an error where the shape differs.
pub(super) fn check_sizes(paths: &[Option<PathBuf>], sizes: &[(u32, u32)]) -> Result<Vec<SizedMask>, FileError> {
    let pairs: Vec<_> = paths.iter().zip(sizes).filter_map(|(path, size)| Some((path.as_ref()?, *size))).collect();
    let headers: Vec<_> = pairs.par_iter().map(|(path, _)| read_photo_header(path)).collect();
    let mut resized = Vec::new();
    for ((path, image), header) in pairs.into_iter().zip(headers) {
        let header = header?;
        let mask = (header.width, header.height);
        if mask == image {
            continue;
        }
        if mask.0 == 0 || mask.1 == 0 || !same_shape(mask, image) {
            return Err(FileError::Mismatch {
                file: path.display().to_string(),
                what: format!("the mask is {} x {}, its photograph {} x {}", mask.0, mask.1, image.0, image.1),
                cure: "make the mask from this photograph, at its size".into(),
            });
        }
        resized.push((path.clone(), mask));
    }
    Ok(resized)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_five_namings() {
        assert_eq!(
            candidates("s/ä.b.jpg"),
            ["s/ä.b.jpg.png", "s/ä.b.png", "s/ä.b.jpg", "s/ä.b.mask.png", "s/ä.b_mask.png"]
        );
        assert_eq!(candidates("s.x/plain")[1], "s.x/plain.png");
    }
}
