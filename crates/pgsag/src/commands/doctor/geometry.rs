//! Cameras and points: how many, how well they fit, how much they overlap, how fine they see.

use pgsag_scene::numbers::{median, quantile};
use pgsag_scene::{RigidTransform, Scene};
use pgsag_splat::train::{NeighborOptions, neighbors_of};

use super::{Finding, Severity, some_of};

/// Reprojection errors above this spoil native-resolution matching.
const MAX_RESIDUAL_PX: f64 = 1.5;
/// Images with fewer observed points than this hang loosely in the model.
const MIN_POINTS: usize = 100;

/// Findings about the model.
pub(super) fn findings(scene: &Scene) -> Vec<Finding> {
    let mut found = Vec::new();
    let count = scene.views.len();
    if count < 3 {
        let text = format!("{count} images with cameras");
        found.push(Finding::new(Severity::Error, "images-few", text, "give at least three, better hundreds"));
    }
    if scene.points.len() < 100 {
        let text = format!("{} sparse points", scene.points.len());
        found.push(Finding::new(Severity::Warning, "points-few", text, "export the model with its points"));
    }
    lenses(scene, &mut found);
    scale(scene, &mut found);
    residuals(scene, &mut found);
    overlap(scene, &mut found);
    found
}

fn lenses(scene: &Scene, found: &mut Vec<Finding>) {
    let mut models: Vec<String> = scene.views.iter().map(|view| format!("{:?}", view.lens.model)).collect();
    models.sort();
    models.dedup();
    let removed =
        if scene.views.iter().all(|view| view.lens.model.is_pinhole()) { "none to remove" } else { "removed by us" };
    let text = format!("camera models: {}; distortion: {removed}", models.join(", "));
    found.push(Finding::new(Severity::Note, "lens", text, ""));
}

fn scale(scene: &Scene, found: &mut Vec<Finding>) {
    let unit = scene.frame.metres_per_unit;
    if unit.is_none() {
        let cure = "add georef.json, GPS tags or a geo-registered model if metres matter";
        found.push(Finding::new(Severity::Warning, "scale-unknown", "the scale of the scene is unknown", cure));
    }
    let mut distances: Vec<f64> =
        observations(scene).map(|(_, camera_depth, focal_px, _)| camera_depth / focal_px).collect();
    let spread = (quantile(&mut distances, 0.05), median(&mut distances), quantile(&mut distances, 0.95));
    if let (Some(low), Some(middle), Some(high)) = spread {
        let (scale, name) = unit.map_or((1.0, "scene units"), |scale| (scale, "m"));
        let text = format!(
            "ground sampling distance {:.4} {name} (5 % below {:.4}, 5 % above {:.4})",
            scale * middle,
            scale * low,
            scale * high
        );
        found.push(Finding::new(Severity::Note, "gsd", text, ""));
    }
}

/// View, depth, focal length and reprojection error of every observation in front of its camera.
fn observations(scene: &Scene) -> impl Iterator<Item = (usize, f64, f64, f64)> + '_ {
    let poses: Vec<RigidTransform> = scene.views.iter().map(|view| view.camera_from_world).collect();
    scene.points.iter().flat_map(move |point| {
        let poses = poses.clone();
        point.track.iter().filter_map(move |seen| {
            let view = &scene.views[seen.view_index as usize];
            let at = poses[seen.view_index as usize].transform_point(point.position_world);
            let px = view.camera.project(at)?;
            let error = libm::hypot(px.x - f64::from(seen.xy_px[0]), px.y - f64::from(seen.xy_px[1]));
            Some((seen.view_index as usize, at.z, view.camera.focal_px(), error))
        })
    })
}

fn residuals(scene: &Scene, found: &mut Vec<Finding>) {
    let mut errors = vec![Vec::new(); scene.views.len()];
    for (view, _, _, error) in observations(scene) {
        errors[view].push(error);
    }
    if errors.iter().all(Vec::is_empty) {
        let cure = "export the model with its observations; masks then vote by depth alone";
        found.push(Finding::new(Severity::Warning, "tracks-none", "points keep no observations", cure));
        return;
    }
    let name = |view: usize| scene.views[view].name.as_str();
    let loose: Vec<usize> = (0..errors.len()).filter(|view| errors[*view].len() < MIN_POINTS).collect();
    if !loose.is_empty() {
        let names = some_of(loose.iter().map(|view| name(*view)).collect::<Vec<_>>().into_iter());
        let text = format!("{} images observe fewer than {MIN_POINTS} points: {names}", loose.len());
        found.push(Finding::new(Severity::Warning, "points-few-in-image", text, "leave them out, or match them again"));
    }
    let mut middles: Vec<(usize, f64)> =
        errors.iter_mut().enumerate().filter_map(|(view, list)| Some((view, median(list)?))).collect();
    let mut all: Vec<f64> = middles.iter().map(|(_, error)| *error).collect();
    let text = format!("median reprojection error {:.2} px", median(&mut all).unwrap_or(0.0));
    found.push(Finding::new(Severity::Note, "residual", text, ""));
    middles.retain(|(_, error)| *error > MAX_RESIDUAL_PX);
    if !middles.is_empty() {
        let names = some_of(middles.iter().map(|(view, _)| name(*view)).collect::<Vec<_>>().into_iter());
        let text = format!("{} images miss their points by more than {MAX_RESIDUAL_PX} px: {names}", middles.len());
        found.push(Finding::new(
            Severity::Warning,
            "residual-large",
            text,
            "adjust the model again, or leave them out",
        ));
    }
}

fn overlap(scene: &Scene, found: &mut Vec<Finding>) {
    let views: Vec<u32> = (0..scene.views.len() as u32).collect();
    let neighbors = neighbors_of(scene, &views, &NeighborOptions::default());
    let lonely: Vec<&str> = scene
        .views
        .iter()
        .zip(&neighbors)
        .filter(|(_, list)| list.is_empty())
        .map(|(view, _)| view.name.as_str())
        .collect();
    if !lonely.is_empty() {
        let text = format!("{} images overlap with no other: {}", lonely.len(), some_of(lonely.iter().copied()));
        found.push(Finding::new(
            Severity::Warning,
            "view-isolated",
            text,
            "fly with 80 % overlap along and 60 % across",
        ));
    }
    let mut counts: Vec<f64> = neighbors.iter().map(|list| list.len() as f64).collect();
    if let Some(middle) = median(&mut counts) {
        found.push(Finding::new(
            Severity::Note,
            "overlap",
            format!("half of the images have at least {middle:.0} useful neighbours"),
            "",
        ));
    }
    let mut lengths: Vec<f64> =
        scene.points.iter().map(|point| point.track.len() as f64).filter(|length| *length > 0.0).collect();
    if let Some(middle) = median(&mut lengths).filter(|middle| *middle < 3.0) {
        let text = format!("half of the points are seen by {middle:.0} images or fewer");
        found.push(Finding::new(Severity::Warning, "tracks-short", text, "fly with more overlap"));
    }
}
