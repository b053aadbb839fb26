//! Buffers that come back: whoever needs one takes any, so that no page is asked of the system twice.

use std::sync::{Mutex, PoisonError};

/// Buffers that nobody uses at the moment.
#[derive(Debug, Default)]
pub struct Spare<B>(Mutex<Vec<B>>);

impl<B: Default> Spare<B> {
    /// Lends a buffer, with whatever it holds, to some work.
    pub fn lend<R>(&self, work: impl FnOnce(&mut B) -> R) -> R {
        let waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut buffer = waiting.unwrap_or_default();
        let result = work(&mut buffer);
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(buffer);
        result
    }
}

/// A clone has none.
impl<B> Clone for Spare<B> {
    fn clone(&self) -> Self {
        Self(Mutex::default())
    }
}
