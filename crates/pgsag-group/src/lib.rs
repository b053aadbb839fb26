//! Which pixels and points are which building: the paper's section 4.1.
//!
//! `distance` measures from the mask's edge, `surface` knows what hides what, `vote` scores the points (Eq. 6-7), `label`
//! extends the reliable ones, `fringe` knows how far past their edges they are drawn, `refine` turns masks into four pixel classes, `edges`
//! finds what parts buildings inside of them, `segment`
//! and `prompts` ask a model where there is one, `dbscan`, `cluster`, `collar` and `blocks` divide the
//! scene, `territory` says whose pixel is whose, `group` says what one worker needs. Values in, values out: masks come
//! through closures, one view at a time, so that no more than one full image is held per thread.

pub mod blocks;
pub mod cluster;
pub mod collar;
pub mod dbscan;
pub mod distance;
pub mod edges;
pub mod fringe;
pub mod geometry;
pub mod ground;
pub mod group;
pub mod label;
pub mod plan;
pub mod prompts;
pub mod refine;
pub mod segment;
pub mod superpixel;
pub mod surface;
pub mod territory;
pub mod vote;

pub use group::{Group, GroupId, GroupKind, GroupView};
pub use label::Label;
pub use segment::{Ask, SegmentError, Segmenter};
pub use vote::{Vote, VoteOptions};
