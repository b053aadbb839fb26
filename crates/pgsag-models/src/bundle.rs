//! A model bundle: a folder with `manifest.toml`, the graphs, the tokenizer and a self-test.
//!
//! The manifest says what the graphs expect of a picture, under which licence the weights stand, and each file's size and
//! SHA-256. Nothing here touches a network.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::error::ModelError;
use crate::grounding::GroundingDino;
use crate::picture::PictureRules;
use crate::runtime::{Runtime, RuntimeKind, SessionOptions, open};
use crate::sam::Sam2;
use crate::wordpiece::WordPiece;

mod selftest;

#[cfg(test)]
pub(crate) use selftest::unmatched;
pub use selftest::{Comparison, verify_answers};

/// What a bundle does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BundleKind {
    /// Boxes by words.
    Detector,
    /// Masks of boxes and points.
    Segmenter,
}

/// What a file of a bundle is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FileRole {
    /// The detector's graph.
    Detector,
    /// The detector's `tokenizer.json`.
    Tokenizer,
    /// The segmenter's graph for images.
    Encoder,
    /// The segmenter's graph for prompts.
    Decoder,
    /// Weights that a graph keeps outside of itself.
    Weights,
    /// Seeded inputs and expected outputs.
    Selftest,
}

/// A file of a bundle.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BundleFile {
    /// What it is for.
    pub role: FileRole,
    /// Its name in the bundle's folder.
    pub name: String,
    /// Its size.
    pub bytes: u64,
    /// Its SHA-256, 64 hexadecimal digits.
    pub sha256: String,
}

/// What a text may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextRules {
    /// Most tokens that the detector reads, `[CLS]` and `[SEP]` counted.
    pub longest: usize,
}

/// `manifest.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// The bundle's name.
    pub name: String,
    /// What it does.
    pub kind: BundleKind,
    /// Licence of the weights.
    pub licence: String,
    /// Where the weights come from.
    pub source: String,
    /// Revision of that source, 40 hexadecimal digits, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub revision: Option<String>,
    /// What wrote the graphs, with versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exporter: Option<String>,
    /// What the network expects of a picture.
    pub image: PictureRules,
    /// What the network expects of a text; detectors only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<TextRules>,
    /// All files but the manifest.
    pub files: Vec<BundleFile>,
}

/// The manifest's file name.
pub const MANIFEST: &str = "manifest.toml";

/// A bundle on disk.
#[derive(Clone, Debug)]
pub struct Bundle {
    /// Its folder.
    pub folder: PathBuf,
    /// Its manifest.
    pub manifest: Manifest,
}

/// A file's SHA-256, in hexadecimal.
///
/// # Errors
/// [`ModelError::File`] where it cannot be read.
pub fn sha256_of(path: &Path) -> Result<String, ModelError> {
    let unreadable = |cause| ModelError::file(path, format!("cannot be read ({cause})"), "check the path");
    let mut file = std::fs::File::open(path).map_err(unreadable)?;
    let mut hasher = Sha256::new();
    std::io::copy(&mut file, &mut hasher).map_err(unreadable)?;
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

impl Bundle {
    /// Reads a bundle's manifest.
    ///
    /// # Errors
    /// [`ModelError::File`] where it is missing or says what cannot be.
    pub fn open(folder: &Path) -> Result<Self, ModelError> {
        let path = folder.join(MANIFEST);
        let text = std::fs::read_to_string(&path).map_err(|cause| {
            let cure = "`pgsag models list` shows the bundles that are there, `pgsag models import` makes one";
            ModelError::file(&path, format!("no model bundle here ({cause})"), cure)
        })?;
        let cure = "mend the manifest, or export the bundle again";
        let manifest: Manifest = toml::from_str(&text).map_err(|cause| ModelError::file(&path, cause, cure))?;
        let is_plain = |name: &str| {
            let mut parts = Path::new(name).components();
            matches!((parts.next(), parts.next()), (Some(std::path::Component::Normal(_)), None))
        };
        if let Some(file) = manifest.files.iter().find(|file| !is_plain(&file.name)) {
            return Err(ModelError::file(&path, format!("file `{}` is not beside it", file.name), cure));
        }
        let positive = |value: &f32| value.is_finite() && *value > 0.0;
        let size_is_sane = |side: Option<u32>| side.is_none_or(|side| (1..=LARGEST_SIDE).contains(&side));
        let sides = [manifest.image.shortest, manifest.image.longest, manifest.image.square];
        let fixed = manifest.image.fixed.map_or([None; 2], |fixed| fixed.map(Some));
        if !manifest.image.std.iter().all(positive) || !sides.iter().chain(&fixed).all(|side| size_is_sane(*side)) {
            return Err(ModelError::file(&path, "[image] holds a size or a deviation that cannot be", cure));
        }
        Ok(Self { folder: folder.to_owned(), manifest })
    }

    /// The path of the file with a role.
    ///
    /// # Errors
    /// [`ModelError::File`] where the manifest names none.
    pub fn file(&self, role: FileRole) -> Result<PathBuf, ModelError> {
        let file = self.manifest.files.iter().find(|file| file.role == role).ok_or_else(|| {
            let what = format!("names no file of role {role:?}");
            ModelError::file(&self.folder.join(MANIFEST), what, "export the bundle again")
        })?;
        Ok(self.folder.join(&file.name))
    }

    /// Compares sizes, and hashes where `with_hashes`, with the manifest.
    ///
    /// # Errors
    /// [`ModelError::File`] naming the first file that differs.
    pub fn check_files(&self, with_hashes: bool) -> Result<(), ModelError> {
        let cure = "copy or fetch the file again";
        for file in &self.manifest.files {
            let path = self.folder.join(&file.name);
            let found = std::fs::metadata(&path).map_err(|cause| ModelError::file(&path, cause, cure))?.len();
            if found != file.bytes {
                let what = format!("{found} bytes, the manifest says {}", file.bytes);
                return Err(ModelError::file(&path, what, cure));
            }
            if with_hashes {
                let found = sha256_of(&path)?;
                if !found.eq_ignore_ascii_case(&file.sha256) {
                    let what = format!("SHA-256 is {found}, the manifest says {}", file.sha256);
                    return Err(ModelError::file(&path, what, cure));
                }
            }
        }
        Ok(())
    }

    /// Loads a detector.
    ///
    /// # Errors
    /// [`ModelError`] of its files or the runtime.
    pub fn detector(&self, engine: &Engine) -> Result<GroundingDino, ModelError> {
        self.must_be(BundleKind::Detector)?;
        let path = self.file(FileRole::Detector)?;
        if self.manifest.image.fixed.is_none() && self.file(FileRole::Selftest).is_err() {
            let what = "its sizes are open and no self-test covers two of them";
            return Err(ModelError::refused(&path, what, "add `fixed = [width, height]` to [image] in manifest.toml"));
        }
        let words = WordPiece::open(&self.file(FileRole::Tokenizer)?)?;
        let session = engine.open(&path)?;
        let longest = self.manifest.text.map_or(256, |text| text.longest);
        GroundingDino::new(&path, session, words, self.manifest.image.clone(), longest)
    }

    /// Loads a segmenter.
    ///
    /// # Errors
    /// [`ModelError`] of its files or the runtime.
    pub fn segmenter(&self, engine: &Engine) -> Result<Sam2, ModelError> {
        self.must_be(BundleKind::Segmenter)?;
        let paths = [self.file(FileRole::Encoder)?, self.file(FileRole::Decoder)?];
        let (encoder, decoder) = (engine.open(&paths[0])?, engine.open(&paths[1])?);
        Sam2::new([&paths[0], &paths[1]], encoder, decoder, self.manifest.image.clone())
    }

    fn must_be(&self, kind: BundleKind) -> Result<(), ModelError> {
        if self.manifest.kind == kind {
            return self.check_files(false);
        }
        let what = format!("a {:?}, wanted is a {kind:?}", self.manifest.kind).to_lowercase();
        Err(ModelError::file(&self.folder, what, "`pgsag models list` shows which bundle is which"))
    }
}

/// Larger pictures than this are never fed to a network, pixels.
const LARGEST_SIDE: u32 = 8192;

/// A runtime and how it loads.
#[derive(Clone)]
pub struct Engine {
    runtime: Arc<dyn Runtime>,
    kind: RuntimeKind,
    options: SessionOptions,
}

impl Engine {
    /// Starts a runtime.
    ///
    /// # Errors
    /// [`ModelError::Runtime`] where it is not there.
    pub fn new(kind: RuntimeKind, options: SessionOptions) -> Result<Self, ModelError> {
        Ok(Self { runtime: crate::runtime::runtime(kind)?, kind, options })
    }

    /// What computes, on one line.
    #[must_use]
    pub fn description(&self) -> String {
        self.runtime.description()
    }

    pub(crate) fn open(&self, path: &Path) -> Result<Box<dyn crate::Session>, ModelError> {
        open(self.runtime.as_ref(), self.kind, path, &self.options)
    }
}

/// The bundles below a folder, by name, with what is wrong with those that cannot be read.
#[must_use]
pub fn list(models: &Path) -> Vec<Result<Bundle, ModelError>> {
    let Ok(entries) = std::fs::read_dir(models) else { return Vec::new() };
    let mut folders: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    folders.retain(|folder| folder.join(MANIFEST).is_file());
    folders.sort();
    folders.iter().map(|folder| Bundle::open(folder)).collect()
}

#[cfg(test)]
mod tests;
