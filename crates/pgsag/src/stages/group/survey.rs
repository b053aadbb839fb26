//! What every view shows of every group: a depth buffer of the coarse points says whose surface each pixel is, groups
//! get windows with their classes, and the views that serve a group best are kept.

use anyhow::Result;
use glam::DVec3;
use pgsag_group::collar::collars;
use pgsag_group::distance::signed_distance;
use pgsag_group::group::origin_of;
use pgsag_group::surface::{NO_POINT, Seen};
use pgsag_group::territory::{
    Share, Standing, background_share, building_share, coverage, cropped, territory, window_of,
};
use pgsag_group::{Group, GroupId, GroupKind, GroupView, Label};
use pgsag_scene::numbers::median;
use pgsag_scene::{Map, Pinhole, Scene};
use rayon::prelude::*;

use super::divide::Division;
use super::{is_trainable, samplings, write_share};
use crate::config::Config;
use crate::photographs::training_camera;
use crate::run::stage::Job;
use crate::stages::masks::MaskState;
use crate::stages::refine::{building_of, edges_of};

/// Pixels around a group's mask that come along: SSIM reaches 5, patches of the multi-view terms 3.
const MARGIN_PX: u32 = 16;
/// A view with fewer pixels of a group tells nothing of it.
const MIN_ACTIVE: usize = 24;
/// A view that shows at least this share of its image belongs to a group however little of the group that is.
const MIN_IMAGE_SHARE: f64 = 0.002;

/// Who looks at all views.
pub(super) struct Patrol<'a, 'j> {
    pub(super) job: &'a Job<'j>,
    pub(super) config: &'a Config,
    pub(super) scene: &'a Scene,
    pub(super) normals: &'a [[f32; 3]],
    pub(super) states: &'a [MaskState],
    pub(super) used: &'a [bool],
}

/// A group before its views are known.
struct Draft {
    kind: GroupKind,
    /// Core, then halo.
    points: Vec<u32>,
    core_count: usize,
}

/// Who owns each point, and who has it in its halo.
struct Claims {
    /// `[points]` index of the draft; `u32::MAX` for nobody's.
    owner: Vec<u32>,
    /// `[points + 1]` and the drafts, by point.
    halo_starts: Vec<u32>,
    halo: Vec<u32>,
}

impl Claims {
    fn of(drafts: &[Draft], point_count: usize) -> Self {
        let mut owner = vec![u32::MAX; point_count];
        let mut pairs = Vec::new();
        for (number, draft) in (0u32..).zip(drafts) {
            let (core, halo) = draft.points.split_at(draft.core_count);
            core.iter().for_each(|point| owner[*point as usize] = number);
            pairs.extend(halo.iter().map(|point| (*point, number)));
        }
        pairs.sort_unstable();
        let mut halo_starts = vec![0; point_count + 1];
        pairs.iter().for_each(|(point, _)| halo_starts[*point as usize + 1] += 1);
        (1..halo_starts.len()).for_each(|at| halo_starts[at] += halo_starts[at - 1]);
        Self { owner, halo_starts, halo: pairs.into_iter().map(|(_, number)| number).collect() }
    }

    fn halo_of(&self, point: u32) -> &[u32] {
        let at = point as usize;
        &self.halo[self.halo_starts[at] as usize..self.halo_starts[at + 1] as usize]
    }

    fn standing(&self, point: u32, draft: u32) -> Standing {
        match point {
            NO_POINT => Standing::Outside,
            _ if self.owner[point as usize] == draft => Standing::Core,
            _ if self.halo_of(point).contains(&draft) => Standing::Halo,
            _ => Standing::Outside,
        }
    }

    /// The drafts that have a pixel on a map of points.
    fn present(&self, points: &Map<u32>) -> Vec<u32> {
        let mut found = Vec::new();
        let mut last = NO_POINT;
        for &point in points.values.iter().filter(|point| **point != NO_POINT) {
            if point != last {
                found.extend(Some(self.owner[point as usize]).filter(|owner| *owner != u32::MAX));
                found.extend(self.halo_of(point));
                last = point;
            }
            if found.len() > 1 << 16 {
                found.sort_unstable();
                found.dedup();
            }
        }
        found.sort_unstable();
        found.dedup();
        found
    }
}

/// A view of a draft.
type Sighting = (u32, GroupView);

impl Patrol<'_, '_> {
    /// All groups with their views; shares are written into the job's folder.
    pub(super) fn groups(&self, division: &Division, labels: &[Label]) -> Result<Vec<Group>> {
        let drafts = self.drafts(division);
        let claims = Claims::of(&drafts, self.scene.points.len());
        (0..drafts.len()).try_for_each(|number| std::fs::create_dir(self.folder(number)))?;
        let views: Vec<usize> = (0..self.scene.views.len()).filter(|view| self.used[*view]).collect();
        let done = std::sync::atomic::AtomicU64::new(0);
        let look = |&view: &usize| -> Result<Vec<Sighting>> {
            self.job.check()?;
            let found = self.look(view, division, &drafts, &claims, labels)?;
            let done = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            self.job.advance(done, views.len() as u64, "views");
            Ok(found)
        };
        let mut seen: Vec<Vec<GroupView>> = vec![Vec::new(); drafts.len()];
        for sightings in views.par_iter().map(look).collect::<Result<Vec<_>>>()? {
            sightings.into_iter().for_each(|(draft, view)| seen[draft as usize].push(view));
        }
        self.finish(drafts, seen)
    }

    fn drafts(&self, division: &Division) -> Vec<Draft> {
        let collars = self.collars(division);
        let buildings = division.clusters.iter().zip(&collars).map(|(cluster, collar)| Draft {
            kind: GroupKind::Building,
            points: cluster.core.iter().chain(&cluster.halo).chain(collar).copied().collect(),
            core_count: cluster.core.len(),
        });
        let plan = |point: &u32| division.frame.plan(self.scene.points[*point as usize].position_world);
        let grounds = division.grounds.iter().map(|ground| {
            let own = division.background.iter().filter(|point| ground.block.owns(plan(point)));
            let mut points: Vec<u32> = own.copied().collect();
            let core_count = points.len();
            let beside = |point: &&u32| ground.block.reaches(plan(point)) && !ground.block.owns(plan(point));
            points.extend(division.background.iter().filter(beside));
            Draft { kind: GroupKind::Background, points, core_count }
        });
        buildings.chain(grounds).collect()
    }

    /// The ground about every cluster of buildings.
    fn collars(&self, division: &Division) -> Vec<Vec<u32>> {
        let views = (0..self.scene.views.len()).filter(|view| self.used[*view]);
        let mut gsds: Vec<f64> =
            views.flat_map(|view| samplings(self.scene, view, &division.background, self.config)).collect();
        let reach = match self.config.groups.collar_px {
            px if px > 0.0 => median(&mut gsds).map_or(0.0, |gsd| (px * gsd).max(2.0 * division.surface.spacing)),
            _ => 0.0,
        };
        let cores: Vec<&[u32]> = division.clusters.iter().map(|cluster| cluster.core.as_slice()).collect();
        let positions: Vec<DVec3> = self.scene.points.iter().map(|point| point.position_world).collect();
        collars(&cores, &division.background, &positions, &division.frame, reach)
    }

    fn folder(&self, draft: usize) -> std::path::PathBuf {
        self.job.output().join(format!("draft{draft}"))
    }

    /// One view: its shares of all groups.
    fn look(
        &self,
        view: usize,
        division: &Division,
        drafts: &[Draft],
        claims: &Claims,
        labels: &[Label],
    ) -> Result<Vec<Sighting>> {
        let camera = training_camera(&self.scene.views[view].camera, self.config.image_width);
        let pose = &self.scene.views[view].camera_from_world;
        let seen = division.surface.render(&division.surface.buffer_camera(&camera, pose), pose, |_| true);
        let known = match self.states[view] {
            MaskState::Unknown => None,
            _ => building_of(&self.job.input("refine"), view)?,
        };
        let ward = Ward { patrol: self, view, camera, seen, division, drafts, claims };
        let building = match &known {
            Some(building) => building.clone(),
            // Other views' votes say where the buildings are; such a view serves the background alone.
            None => ward.drawn(labels),
        };
        let mut found = Vec::new();
        if known.is_some() {
            let edges = edges_of(&self.job.input("refine"), view)?;
            ward.buildings(&building, edges.as_ref(), labels, &mut found)?;
        }
        ward.grounds(&building, &mut found)?;
        Ok(found)
    }

    /// Chooses views, gives names, moves folders.
    fn finish(&self, drafts: Vec<Draft>, seen: Vec<Vec<GroupView>>) -> Result<Vec<Group>> {
        let (mut groups, mut lost) = (Vec::new(), 0);
        let mut numbers = std::collections::BTreeMap::new();
        for (number, (draft, views)) in drafts.into_iter().zip(seen).enumerate() {
            debug_assert!(views.is_sorted_by(|a, b| a.view_index < b.view_index), "a view shows a group once");
            let is_out = |view: &GroupView| self.config.is_held_out(view.view_index as usize);
            let (held_out, views): (Vec<_>, Vec<_>) = views.into_iter().partition(is_out);
            let views = best_views(views, self.config.groups.max_views);
            if !is_trainable(draft.core_count, views.len()) {
                lost += draft.core_count;
                std::fs::remove_dir_all(self.folder(number))?;
                continue;
            }
            let next = numbers.entry(draft.kind).or_insert(0);
            *next += 1;
            let id = GroupId { kind: draft.kind, number: *next };
            std::fs::rename(self.folder(number), self.job.output().join(id.to_string()))?;
            let origin_world = origin_of(self.scene, &draft.points[..draft.core_count]);
            let Draft { points, core_count, .. } = draft;
            groups.push(Group { id, origin_world, views, held_out, points, core_count, steps_share: 1.0 });
        }
        if lost > 0 {
            self.job.warn(format!("{lost} points lie in groups that fewer than two images see; these are left out"));
        }
        for (kind, words) in [(GroupKind::Building, "building"), (GroupKind::Background, "background")] {
            if !numbers.contains_key(&kind) {
                self.job.warn(format!("the masks leave no {words} to reconstruct"));
            }
        }
        Ok(groups)
    }
}

/// The views that see most, most squarely and most finely, in the scene's order.
fn best_views(mut views: Vec<GroupView>, most: usize) -> Vec<GroupView> {
    if views.len() > most {
        let finest = views.iter().map(|view| view.gsd).fold(f32::INFINITY, f32::min).max(1e-30);
        let score = |view: &GroupView| {
            let squareness = libm::cosf(view.incidence_deg.to_radians()).max(0.1);
            view.seen_share * squareness * (finest / view.gsd.max(finest))
        };
        views.sort_by(|a, b| score(b).total_cmp(&score(a)).then(a.view_index.cmp(&b.view_index)));
        views.truncate(most);
        views.sort_by_key(|view| view.view_index);
    }
    views
}

/// One view at work.
struct Ward<'a, 'p, 'j> {
    patrol: &'a Patrol<'p, 'j>,
    view: usize,
    /// Of the training image.
    camera: Pinhole,
    seen: Seen,
    division: &'a Division,
    drafts: &'a [Draft],
    claims: &'a Claims,
}

impl Ward<'_, '_, '_> {
    /// Where the points alone say that buildings are.
    fn drawn(&self, labels: &[Label]) -> Map<bool> {
        let everywhere = Map::filled(self.camera.width, self.camera.height, true);
        let points = territory(&self.seen, &everywhere, |point| labels[point as usize] != Label::Unknown);
        let is_building = |point: &u32| *point != NO_POINT && labels[*point as usize] == Label::Building;
        Map { width: points.width, height: points.height, values: points.values.iter().map(is_building).collect() }
    }

    fn kind(&self, draft: u32) -> Option<GroupKind> {
        self.drafts.get(draft as usize).map(|draft| draft.kind)
    }

    fn buildings(
        &self,
        building: &Map<bool>,
        edges: Option<&Map<bool>>,
        labels: &[Label],
        found: &mut Vec<Sighting>,
    ) -> Result<()> {
        let owner = |point: u32| self.claims.owner[point as usize];
        let is_building = |point: u32| self.kind(owner(point)) == Some(GroupKind::Building);
        // Buildings beyond the area of interest are nobody's, but their pixels are theirs.
        let is_beyond = |point: u32| owner(point) == u32::MAX && labels[point as usize] == Label::Building;
        let mut points = territory(&self.seen, building, |point| is_building(point) || is_beyond(point));
        let creases = self.add_collars(&mut points, building, is_building);
        let is_building = |draft: &u32| self.kind(*draft) == Some(GroupKind::Building);
        for draft in self.claims.present(&points).into_iter().filter(is_building) {
            let standing = self.standing(&points, draft);
            let Some(view) = self.sighting(&standing, draft, true) else { continue };
            let pose = &self.patrol.scene.views[self.view].camera_from_world;
            let members = &self.drafts[draft as usize].points;
            let hidden = coverage(&self.division.surface, members, &self.seen, pose, &self.camera);
            let share = building_share(&standing, view.window_px, &hidden, &self.patrol.config.refine);
            let inner = creases.values.iter().enumerate();
            let inner = inner.map(|(at, crease)| *crease || edges.is_some_and(|edges| edges.values[at])).collect();
            let inner = Map { width: creases.width, height: creases.height, values: inner };
            let share = Share { inner_edges: cropped(&inner, view.window_px), ..share };
            found.push((draft, self.kept(draft, view, &share)?));
        }
        Ok(())
    }

    /// Outside of the buildings: the points of the ground that lie in a group's collar. What is returned is near the edge
    /// between both, where the surface has a crease that the normal loss would round.
    fn add_collars(&self, points: &mut Map<u32>, building: &Map<bool>, is_building: impl Fn(u32) -> bool) -> Map<bool> {
        let outside = building.mapped(|is_building| !is_building);
        let ground = territory(&self.seen, &outside, |point| !is_building(point));
        let mut collar = Map::filled(building.width, building.height, false);
        for (at, ground) in ground.values.iter().enumerate() {
            if *ground != NO_POINT && !self.claims.halo_of(*ground).is_empty() {
                (points.values[at], collar.values[at]) = (*ground, true);
            }
        }
        let band_px = self.patrol.config.refine.band_px;
        let near = |map: &Map<bool>| signed_distance(map).mapped(|far| *far <= band_px);
        let (near_collar, near_building) = (near(&collar), near(building));
        let both = near_collar.values.iter().zip(&near_building.values).map(|(a, b)| *a && *b).collect();
        Map { width: building.width, height: building.height, values: both }
    }

    fn grounds(&self, building: &Map<bool>, found: &mut Vec<Sighting>) -> Result<()> {
        let first = self.division.clusters.len();
        let drafts: Vec<u32> = (first as u32..self.drafts.len() as u32).collect();
        let points = (drafts.len() > 1).then(|| {
            let domain = Map::filled(self.camera.width, self.camera.height, true);
            let is_ground = |point: u32| self.kind(self.claims.owner[point as usize]) == Some(GroupKind::Background);
            territory(&self.seen, &domain, is_ground)
        });
        let airy = self.airy(&drafts);
        for draft in airy {
            let standing = match &points {
                Some(points) => self.standing(points, draft),
                None => Map::filled(self.camera.width, self.camera.height, Standing::Core),
            };
            let Some(view) = self.sighting(&standing, draft, false) else { continue };
            let share = background_share(building, &standing, view.window_px, &self.patrol.config.refine);
            if share.mask.active_count() >= MIN_ACTIVE {
                found.push((draft, self.kept(draft, view, &share)?));
            }
        }
        Ok(())
    }

    /// The blocks whose airspace fills enough of the view, and always the one that fills most.
    fn airy(&self, drafts: &[u32]) -> Vec<u32> {
        let (frame, view) = (&self.division.frame, &self.patrol.scene.views[self.view]);
        let center = frame.plan(view.center_world());
        let share = |ground: &super::divide::Ground| {
            if ground.block.reaches(center) {
                1.0
            } else {
                ground.airspace.share(frame, &self.camera, &view.camera_from_world)
            }
        };
        let shares: Vec<f64> = self.division.grounds.iter().map(share).collect();
        let most = shares.iter().copied().fold(0.0, f64::max);
        let bound = self.patrol.config.blocks.min_airspace.min(most);
        drafts.iter().zip(shares).filter(|(_, share)| *share >= bound).map(|(draft, _)| *draft).collect()
    }

    fn standing(&self, points: &Map<u32>, draft: u32) -> Map<Standing> {
        let values = points.values.iter().map(|point| self.claims.standing(*point, draft)).collect();
        Map { width: points.width, height: points.height, values }
    }

    /// The view of a group: window and how well it sees; `None` where that is too little.
    fn sighting(&self, standing: &Map<Standing>, draft: u32, is_choosy: bool) -> Option<GroupView> {
        let is_active = standing.values.iter().map(|standing| *standing != Standing::Outside).collect();
        let active = Map { width: standing.width, height: standing.height, values: is_active };
        let count = active.values.iter().filter(|is_active| **is_active).count();
        let window_px = window_of(&active, MARGIN_PX).filter(|_| count >= MIN_ACTIVE)?;
        let view = self.seen_by(
            draft,
            GroupView {
                view_index: self.view as u32,
                window_px,
                active_count: count as u64,
                seen_share: 0.0,
                gsd: 0.0,
                incidence_deg: 0.0,
                azimuth_deg: 0.0,
            },
        );
        let is_large = count as f64 >= MIN_IMAGE_SHARE * self.camera.pixel_count() as f64;
        (!is_choosy || is_large || view.seen_share >= self.patrol.config.groups.min_seen_share).then_some(view)
    }

    /// Fills in what the group's points say of the view.
    fn seen_by(&self, draft: u32, view: GroupView) -> GroupView {
        let points = &self.drafts[draft as usize].points;
        let pose = &self.patrol.scene.views[self.view].camera_from_world;
        let tolerance = f64::from(self.patrol.config.vote.depth_tolerance);
        // A few thousand points tell shares and medians as well as all.
        let step = points.len().div_ceil(4000).max(1);
        let (mut asked, mut gsds, mut angles) = (0, Vec::new(), Vec::new());
        for &point in points.iter().step_by(step) {
            asked += 1;
            let at = pose.transform_point(self.division.surface.position(point));
            let is_in = self.camera.project(at).is_some_and(|px| self.camera.contains(px));
            if !is_in || !self.division.surface.is_seen(&self.seen, at, tolerance) {
                continue;
            }
            gsds.push(at.z / self.camera.focal_px());
            if let Some(normal) = self.patrol.normals.get(point as usize) {
                let normal = pose.rotation * DVec3::from_array(normal.map(f64::from));
                angles.push(libm::acos((-normal.dot(at.normalize_or_zero())).clamp(-1.0, 1.0)).to_degrees());
            }
        }
        let axis = pose.rotation.inverse() * DVec3::Z;
        let along = self.division.frame.plan(axis);
        let azimuth = if along.length() > 0.17 { libm::atan2(along.x, along.y).to_degrees() } else { 0.0 };
        GroupView {
            seen_share: gsds.len() as f32 / asked.max(1) as f32,
            gsd: median(&mut gsds).unwrap_or(0.0) as f32,
            incidence_deg: median(&mut angles).unwrap_or(0.0) as f32,
            azimuth_deg: azimuth as f32,
            ..view
        }
    }

    /// Writes a share; the view with its exact count.
    fn kept(&self, draft: u32, view: GroupView, share: &Share) -> Result<GroupView> {
        write_share(&self.patrol.folder(draft as usize), self.view, share)?;
        Ok(GroupView { active_count: share.mask.active_count() as u64, ..view })
    }
}
