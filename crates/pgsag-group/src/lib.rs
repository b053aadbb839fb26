//! Which pixels and points are which building: the paper's section 4.1.
//!
//! `distance` measures from the mask's edge, `vote` scores the sparse points (Eq. 6-7), `refine` turns masks into four
//! pixel classes, `group` says what one worker needs. Values in, values out: masks come through closures, one view at
//! a time, so that no more than one full image is held.

pub mod distance;
pub mod group;
pub mod refine;
pub mod vote;

pub use group::{Group, GroupId, GroupKind, GroupView};
pub use vote::{Vote, VoteOptions};
