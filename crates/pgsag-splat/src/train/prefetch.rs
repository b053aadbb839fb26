//! Photographs that the next step will ask for are decoded while this one computes: one thread, a short queue.
//!
//! What is fetched depends on nothing but the order of the steps, and a view is the same whoever decodes it, so results are
//! those of a run without.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

use crate::backend::TrainingView;
use crate::train::trainer::ViewSource;
use crate::train::{Result, TrainError};

/// Views that are asked for ahead at most: the next reference and its neighbour, and those of the step before where they
/// were not used. Bounds the memory that waits.
const MOST_AHEAD: usize = 4;

type Found = (usize, Result<Arc<TrainingView>>);

/// Views under way.
pub(crate) struct Prefetch {
    ask: Sender<usize>,
    found: Receiver<Found>,
    /// Asked for and not received.
    waiting: Vec<usize>,
    /// Received and not used.
    ready: Vec<Found>,
}

impl Prefetch {
    /// Starts the thread, which ends when the value is dropped.
    pub(crate) fn start<'scope>(scope: &'scope std::thread::Scope<'scope, '_>, views: &'scope dyn ViewSource) -> Self {
        let (ask, asked) = channel();
        let (give, found) = channel();
        scope.spawn(move || {
            for index in asked {
                if give.send((index, views.view(index))).is_err() {
                    break;
                }
            }
        });
        Self { ask, found, waiting: Vec::new(), ready: Vec::new() }
    }

    /// Has a view decoded, unless it is under way or too much is.
    pub(crate) fn want(&mut self, index: usize) {
        let is_known = self.waiting.contains(&index) || self.ready.iter().any(|(ready, _)| *ready == index);
        if !is_known && self.waiting.len() + self.ready.len() < MOST_AHEAD && self.ask.send(index).is_ok() {
            self.waiting.push(index);
        }
    }

    /// A view: what was fetched of it, or what `views` says now.
    pub(crate) fn take(&mut self, views: &dyn ViewSource, index: usize) -> Result<Arc<TrainingView>> {
        while self.waiting.contains(&index) {
            let Ok(found) = self.found.recv() else {
                return Err(TrainError::Empty("the thread that reads photographs has ended"));
            };
            self.waiting.retain(|waiting| *waiting != found.0);
            self.ready.push(found);
        }
        match self.ready.iter().position(|(ready, _)| *ready == index) {
            Some(at) => self.ready.swap_remove(at).1,
            None => views.view(index),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::trainer::fake::FakeViews;

    #[test]
    fn what_was_wanted_is_taken_once_and_anything_else_is_read_at_once() {
        let views = FakeViews::ring(6, 8);
        std::thread::scope(|scope| {
            let mut ahead = Prefetch::start(scope, &views);
            (0..6).for_each(|index| ahead.want(index));
            assert_eq!(ahead.waiting.len(), MOST_AHEAD);
            ahead.want(3);
            assert_eq!(ahead.waiting.len(), MOST_AHEAD);
            for index in [5, 3, 0] {
                let found = ahead.take(&views, index).expect("fakes do not fail");
                assert_eq!(found.camera, views.camera(index));
            }
            assert!(ahead.ready.iter().all(|(index, _)| *index == 1 || *index == 2));
            ahead.want(0);
            assert!(ahead.waiting.contains(&0), "a view that was taken can be wanted again");
        });
    }
}
