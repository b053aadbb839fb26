//! What can be wrong with a model, a bundle or a question: one line that names the file, what is wrong and the cure.

use std::fmt::Display;
use std::path::Path;

/// Why a network could not be used. Every message is one line.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ModelError {
    /// A file is missing, unreadable, damaged or not what was promised.
    #[error("{file}: {what}; {cure}")]
    File {
        /// Name of the file or folder.
        file: String,
        /// What is wrong.
        what: String,
        /// What to do about it.
        cure: String,
    },
    /// A graph that would load but compute something else than it should, or that nothing here understands.
    #[error("{file}: {what}; {cure}")]
    Refused {
        /// Name of the graph's file.
        file: String,
        /// Why it is refused.
        what: String,
        /// What to do about it.
        cure: String,
    },
    /// A question that cannot be asked: an empty prompt, a point outside of the image.
    #[error("{what}; {cure}")]
    Question {
        /// What is wrong with it.
        what: String,
        /// What to do about it.
        cure: String,
    },
    /// The runtime could not be started or stopped on the way.
    #[error("{runtime}: {what}; {cure}")]
    Runtime {
        /// Its name.
        runtime: String,
        /// Its words.
        what: String,
        /// What to do about it.
        cure: String,
    },
}

impl ModelError {
    pub(crate) fn file(path: &Path, what: impl Display, cure: &str) -> Self {
        Self::File { file: path.display().to_string(), what: one_line(what), cure: cure.into() }
    }

    pub(crate) fn refused(path: &Path, what: impl Display, cure: &str) -> Self {
        Self::Refused { file: path.display().to_string(), what: one_line(what), cure: cure.into() }
    }

    pub(crate) fn question(what: impl Display, cure: &str) -> Self {
        Self::Question { what: one_line(what), cure: cure.into() }
    }

    pub(crate) fn runtime(name: &str, what: impl Display, cure: &str) -> Self {
        Self::Runtime { runtime: name.into(), what: one_line(what), cure: cure.into() }
    }

    /// What is wrong, the place with it, and what to do about it.
    #[must_use]
    pub fn parts(&self) -> (String, String) {
        match self {
            Self::File { file: place, what, cure }
            | Self::Refused { file: place, what, cure }
            | Self::Runtime { runtime: place, what, cure } => (format!("{place}: {what}"), cure.clone()),
            Self::Question { what, cure } => (what.clone(), cure.clone()),
        }
    }

    /// Whether what the user gave is to blame, not the machine.
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        !matches!(self, Self::Runtime { what, .. } if what.starts_with(RUN_FAILED))
    }
}

/// How the message of a computation that broke begins.
pub(crate) const RUN_FAILED: &str = "the computation stopped";

fn one_line(what: impl Display) -> String {
    what.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}
