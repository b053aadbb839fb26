//! What ends a command, and with which exit code.
//!
//! A [`UserError`] is one line that names file, place, cause and cure, and exits 2; so is a [`FileError`]. An
//! [`Interrupted`] job has saved its state: Ctrl-C exits 130, a supervisor that wants the job back later 75. Anything
//! else exits 1.

use std::path::Path;

use pgsag_models::ModelError;
use pgsag_scene::error::FileError;

/// Bad input or usage: one line, exit 2.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {cause}; {cure}")]
pub struct UserError {
    /// File (and the place in it), option, or folder.
    pub place: String,
    /// What is wrong.
    pub cause: String,
    /// What to do about it.
    pub cure: String,
}

impl UserError {
    /// An error at a place in words.
    #[must_use]
    pub fn new(place: impl Into<String>, cause: impl Into<String>, cure: impl Into<String>) -> Self {
        Self { place: place.into(), cause: cause.into(), cure: cure.into() }
    }

    /// An error of a file or folder.
    #[must_use]
    pub fn at(path: &Path, cause: impl Into<String>, cure: impl Into<String>) -> Self {
        Self::new(path.display().to_string(), cause, cure)
    }
}

/// Work stopped on request; its state is saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("stopped on request; the same command goes on from here")]
pub struct Interrupted {
    /// 130 after Ctrl-C, 75 where the supervisor is expected to start the job again.
    pub exit_code: u8,
}

/// The exit code that `error` asks for.
#[must_use]
pub fn exit_code(error: &anyhow::Error) -> u8 {
    for cause in error.chain() {
        if let Some(stopped) = cause.downcast_ref::<Interrupted>() {
            return stopped.exit_code;
        }
        let is_bad_input = cause.downcast_ref::<ModelError>().is_some_and(ModelError::is_bad_input);
        if is_bad_input || cause.is::<UserError>() || cause.is::<FileError>() {
            return 2;
        }
    }
    1
}

/// `error` as one line, without what only a developer wants to see.
#[must_use]
pub fn one_line(error: &anyhow::Error) -> String {
    for cause in error.chain() {
        if cause.is::<UserError>() || cause.is::<FileError>() || cause.is::<ModelError>() {
            return cause.to_string().replace('\n', " ");
        }
        if let Some(file) = cause.downcast_ref::<FileError>() {
            return file.to_string();
        }
    }
    format!("{error:#}").replace('\n', " ")
}

#[cfg(test)]
mod tests {
    use anyhow::Context as _;

    use super::*;

    #[test]
    fn user_errors_keep_their_code_and_line_through_context() {
        let error = anyhow::Error::new(UserError::new("a.jpg: mask", "is 3 x 4", "export it at 6 x 8"));
        let error = Err::<(), _>(error).context("masks").expect_err("made");
        assert_eq!(exit_code(&error), 2);
        assert_eq!(one_line(&error), "a.jpg: mask: is 3 x 4; export it at 6 x 8");
    }

    #[test]
    fn a_damaged_file_is_bad_input() {
        let file = FileError::Unreadable { file: "a.bin".into(), reason: "gone".into() };
        let error = Err::<(), _>(anyhow::Error::new(file)).context("import").expect_err("made");
        assert_eq!(exit_code(&error), 2);
        assert!(one_line(&error).starts_with("a.bin: cannot be read (gone); "), "{}", one_line(&error));
    }

    #[test]
    fn interruption_keeps_its_code() {
        let error = anyhow::Error::new(Interrupted { exit_code: 75 }).context("train g001");
        assert_eq!(exit_code(&error), 75);
        assert_eq!(exit_code(&anyhow::anyhow!("disk")), 1);
    }
}
