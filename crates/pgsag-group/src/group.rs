//! A group: what one worker needs, and nothing more.

use pgsag_scene::{Mask, Scene};
use serde::{Deserialize, Serialize};

use crate::vote::{Vote, VoteOptions};

/// Names a group in folders and files: `g012`, `bg03`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct GroupId {
    /// Buildings before background.
    pub kind: GroupKind,
    /// From 1, within its kind.
    pub number: u32,
}

/// What a group holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GroupKind {
    /// Building surface.
    Building,
    /// Everything else.
    Background,
}

impl std::fmt::Display for GroupId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.kind {
            GroupKind::Building => write!(f, "g{:03}", self.number),
            GroupKind::Background => write!(f, "bg{:02}", self.number),
        }
    }
}

impl std::str::FromStr for GroupId {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("{text} is not a group; groups are written g012 or bg03");
        let (kind, digits) = match text.strip_prefix("bg") {
            Some(digits) => (GroupKind::Background, digits),
            None => (GroupKind::Building, text.strip_prefix('g').ok_or_else(wrong)?),
        };
        Ok(Self { kind, number: digits.parse().map_err(|_| wrong())? })
    }
}

/// One view of a group: the window of its undistorted image that the group's mask touches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct GroupView {
    /// Index into `Scene::views`.
    pub view_index: u32,
    /// Left, top, width, height in pixels of the mask's image.
    pub window_px: [u32; 4],
    /// Pixels that take part in the losses.
    pub active_count: u64,
}

/// A unit of training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Group {
    /// Its name.
    pub id: GroupId,
    /// Subtracted before work in f32; world frame.
    pub origin_world: [f64; 3],
    /// Views in which it is seen, in the scene's order.
    pub views: Vec<GroupView>,
    /// Indices into `Scene::points`.
    pub points: Vec<u32>,
}

/// The smallest window around the active pixels, widened by `margin_px` (SSIM's reach is 5, multi-view patches' 3);
/// `None` where nothing is active.
#[must_use]
pub fn window_of(mask: &Mask, margin_px: u32) -> Option<[u32; 4]> {
    let width = mask.width as usize;
    let (mut left, mut right, mut top, mut bottom) = (mask.width, 0, mask.height, 0);
    for (y, row) in mask.classes.chunks(width.max(1)).enumerate() {
        let Some(first) = row.iter().position(|class| class.is_active()) else { continue };
        let last = row.iter().rposition(|class| class.is_active()).unwrap_or(first);
        left = left.min(first as u32);
        right = right.max(last as u32 + 1);
        top = top.min(y as u32);
        bottom = y as u32 + 1;
    }
    (right > left).then(|| {
        let (x0, y0) = (left.saturating_sub(margin_px), top.saturating_sub(margin_px));
        let (x1, y1) = ((right + margin_px).min(mask.width), (bottom + margin_px).min(mask.height));
        [x0, y0, x1 - x0, y1 - y0]
    })
}

/// Points of a building group: the reliable ones of the vote.
#[must_use]
pub fn building_points(votes: &[Vote], options: &VoteOptions) -> Vec<u32> {
    (0u32..).zip(votes).filter(|(_, vote)| vote.is_reliable(options)).map(|(index, _)| index).collect()
}

/// Points of the background: all that the vote does not call building.
#[must_use]
pub fn background_points(votes: &[Vote], options: &VoteOptions) -> Vec<u32> {
    (0u32..).zip(votes).filter(|(_, vote)| !vote.is_reliable(options)).map(|(index, _)| index).collect()
}

/// An origin for f32 work: the component-wise median of the points, or of the camera centres where there are none.
#[must_use]
pub fn origin_of(scene: &Scene, points: &[u32]) -> [f64; 3] {
    let positions: Vec<[f64; 3]> = if points.is_empty() {
        scene.views.iter().map(|view| view.center_world().to_array()).collect()
    } else {
        points.iter().map(|index| scene.points[*index as usize].position_world.to_array()).collect()
    };
    std::array::from_fn(|axis| {
        let mut values: Vec<f64> = positions.iter().map(|position| position[axis]).collect();
        pgsag_scene::numbers::median(&mut values).unwrap_or(0.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use pgsag_scene::PixelClass;

    #[test]
    fn names_go_there_and_back() {
        for name in ["g001", "g123", "bg03"] {
            assert_eq!(name.parse::<GroupId>().expect("a name").to_string(), name);
        }
        assert!("x1".parse::<GroupId>().is_err() && "g".parse::<GroupId>().is_err());
    }

    #[test]
    fn window_is_the_box_of_active_pixels_with_margin() {
        let mut mask = Mask::filled(30, 20, PixelClass::Free);
        mask.classes[5 * 30 + 7] = PixelClass::Inside;
        mask.classes[9 * 30 + 3] = PixelClass::Boundary;
        assert_eq!(window_of(&mask, 0), Some([3, 5, 5, 5]));
        assert_eq!(window_of(&mask, 4), Some([0, 1, 12, 13]));
        assert_eq!(window_of(&Mask::filled(30, 20, PixelClass::Occluded), 4), None);
    }
}
