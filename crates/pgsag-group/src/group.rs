//! A group: what one worker needs, and nothing more.

use pgsag_scene::Scene;
use serde::{Deserialize, Serialize};

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

/// One view of a group: the window of its undistorted image that the group's mask touches, and how it sees the group.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroupView {
    /// Index into `Scene::views`.
    pub view_index: u32,
    /// Left, top, width, height in pixels of the mask's image.
    pub window_px: [u32; 4],
    /// Pixels that take part in the losses.
    pub active_count: u64,
    /// Share of the group's points that the view sees, 0 to 1.
    pub seen_share: f32,
    /// Median ground sampling distance at those points, scene units per pixel.
    pub gsd: f32,
    /// Median angle between ray and surface normal at those points, degrees; 0 where no normals are known.
    pub incidence_deg: f32,
    /// Compass direction in which the view looks at the group, degrees in plan view; 0 where it looks straight down.
    pub azimuth_deg: f32,
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
    /// Views that see it but are kept out of training.
    pub held_out: Vec<GroupView>,
    /// Indices into `Scene::points`: first those of the core, then those of the halo.
    pub points: Vec<u32>,
    /// How many of `points` are the core's.
    pub core_count: usize,
    /// Share of a run's steps after which each of its points has been looked at as often as in one run on the whole scene,
    /// 0 to 1 ([`share_steps`]).
    #[serde(default = "all_steps")]
    pub steps_share: f32,
}

fn all_steps() -> f32 {
    1.0
}

/// Sets every group's `steps_share`. A step shows one view, and of a small group nearly all of it, of a large one a part:
/// the smaller takes fewer steps for as many looks at each point. Mean share of a group's points that a step shows, of the
/// whole scene over that of the group; `view_count` are the scene's views. Method.md 8.14.
pub fn share_steps(groups: &mut [Group], view_count: usize) {
    let looks = |group: &Group| group.views.iter().map(|view| f64::from(view.seen_share)).sum::<f64>();
    let points: f64 = groups.iter().map(|group| group.points.len() as f64).sum();
    let seen: f64 = groups.iter().map(|group| group.points.len() as f64 * looks(group)).sum();
    let of_scene = seen / (points * view_count as f64);
    for group in groups {
        let share = of_scene * group.views.len() as f64 / looks(group);
        group.steps_share = if share.is_finite() && share > 0.0 { share.min(1.0) as f32 } else { 1.0 };
    }
}

impl Group {
    /// The points that the group owns.
    #[must_use]
    pub fn core(&self) -> &[u32] {
        &self.points[..self.core_count]
    }
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

    #[test]
    fn names_go_there_and_back() {
        for name in ["g001", "g123", "bg03"] {
            assert_eq!(name.parse::<GroupId>().expect("a name").to_string(), name);
        }
        assert!("x1".parse::<GroupId>().is_err() && "g".parse::<GroupId>().is_err());
    }

    /// A group of so many points, of which each view sees a share.
    fn seen(point_count: u32, shares: &[f32]) -> Group {
        let view = |(view_index, seen_share): (u32, &f32)| GroupView {
            view_index,
            window_px: [0, 0, 4, 4],
            active_count: 16,
            seen_share: *seen_share,
            gsd: 0.1,
            incidence_deg: 0.0,
            azimuth_deg: 0.0,
        };
        Group {
            id: GroupId { kind: GroupKind::Building, number: 1 },
            origin_world: [0.0; 3],
            views: (0..).zip(shares).map(view).collect(),
            held_out: Vec::new(),
            points: (0..point_count).collect(),
            core_count: point_count as usize,
            steps_share: 1.0,
        }
    }

    #[test]
    fn steps_give_every_point_as_many_looks() {
        // Of 10 views 4 see half of the large group, 2 see all of the small one.
        let mut groups = [seen(300, &[0.5; 4]), seen(100, &[1.0; 2])];
        share_steps(&mut groups, 10);
        let of_scene = (300.0 * 2.0 + 100.0 * 2.0) / (400.0 * 10.0);
        assert!((groups[0].steps_share - of_scene / 0.5).abs() < 1e-6);
        assert!((groups[1].steps_share - of_scene).abs() < 1e-6);
        let looks = |group: &Group| {
            let seen: f32 = group.views.iter().map(|view| view.seen_share).sum();
            group.steps_share * seen / group.views.len() as f32
        };
        assert!((looks(&groups[0]) - looks(&groups[1])).abs() < 1e-6);
    }

    #[test]
    fn one_group_takes_all_steps_and_unknown_shares_change_nothing() {
        let mut groups = [seen(50, &[0.3; 7])];
        share_steps(&mut groups, 7);
        assert!((groups[0].steps_share - 1.0).abs() < 1e-6);
        let mut groups = [seen(50, &[0.0; 7])];
        share_steps(&mut groups, 7);
        assert!((groups[0].steps_share - 1.0).abs() < 1e-6);
    }
}
