//! When a group has learnt what it can: its photometric loss no longer falls from block to block. Method 8.14.
//!
//! A block is a whole number of rounds of the views, so that every view counts alike in each and blocks can be compared.
//! Blocks begin when density control has ended and all terms have their full weight; before that the loss may wait.

use crate::train::schedule::TrainOptions;

/// Blocks in a row that must hardly improve.
const STILL_BLOCKS: usize = 2;

/// The losses of the blocks so far; a part of the checkpoint.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Plateau {
    /// Mean photometric loss of every finished block.
    pub(crate) means: Vec<f32>,
    /// Sum over the block in progress.
    pub(crate) sum: f64,
    /// Steps of the block in progress.
    pub(crate) steps: u32,
}

impl Plateau {
    /// Takes notice of the photometric loss of a step.
    pub(crate) fn note(&mut self, loss: f64, iteration: u32, view_count: usize, options: &TrainOptions) {
        if options.plateau_share <= 0.0 || iteration <= options.settled_at() {
            return;
        }
        self.sum += loss;
        self.steps += 1;
        let views = (view_count as u32).max(1);
        if self.steps == options.plateau_steps.max(1).div_ceil(views) * views {
            self.means.push((self.sum / f64::from(self.steps)) as f32);
            (self.sum, self.steps) = (0.0, 0);
        }
    }

    /// Whether the last blocks hardly improved on those before them.
    pub(crate) fn is_reached(&self, options: &TrainOptions) -> bool {
        let is_still = |pair: &[f32]| pair[1] > (1.0 - options.plateau_share) * pair[0];
        let pairs = self.means.windows(2);
        options.plateau_share > 0.0 && pairs.len() >= STILL_BLOCKS && pairs.rev().take(STILL_BLOCKS).all(is_still)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options() -> TrainOptions {
        TrainOptions { iterations: 1000, plateau_share: 0.02, plateau_steps: 10, ..TrainOptions::default() }
    }

    /// The step at which a loss stops training on four views.
    fn stop(loss: impl Fn(u32) -> f64, options: &TrainOptions) -> Option<u32> {
        let mut plateau = Plateau::default();
        (1..=options.iterations).find(|iteration| {
            plateau.note(loss(*iteration), *iteration, 4, options);
            plateau.is_reached(options)
        })
    }

    #[test]
    fn a_loss_that_falls_goes_on_and_one_that_rests_stops_after_three_blocks() {
        let settled = options().settled_at();
        assert!((500..900).contains(&settled), "{settled}");
        // From a quarter less per block at first to 3 % less at the end.
        assert_eq!(stop(|iteration| 1.0 / (f64::from(iteration) - 650.0).abs().max(1.0), &options()), None);
        // Blocks are three rounds of four views; each view has a loss of its own.
        assert_eq!(stop(|iteration| 0.1 + 0.05 * f64::from(iteration % 4), &options()), Some(settled + 36));
        let late = |iteration| if iteration < settled + 60 { 1.0 / f64::from(iteration - settled + 1) } else { 0.001 };
        assert!(
            stop(|iteration| if iteration <= settled { 9.0 } else { late(iteration) }, &options())
                .is_some_and(|at| at > settled + 60)
        );
    }

    #[test]
    fn without_a_share_nothing_stops() {
        assert_eq!(stop(|_| 0.1, &TrainOptions { plateau_share: 0.0, ..options() }), None);
    }
}
