//! Photographs of a known plane, with a mesh that lies beside it.

use glam::DQuat;

use super::*;

/// Smooth and never alike twice within reach.
fn texture(x: f64, y: f64) -> f64 {
    let wave = |fx: f64, fy: f64, phase: f64| libm::sin(fx * x + fy * y + phase);
    128.0
        + 30.0 * wave(7.1, 2.3, 0.0)
        + 25.0 * wave(-3.7, 9.2, 1.0)
        + 20.0 * wave(7.3, -6.1, 2.0)
        + 15.0 * wave(9.0, 5.0, 3.0)
}

/// The plane that the photographs show: through `(0, 0, 10)`, leaning.
const NORMAL: DVec3 = DVec3::new(0.2, -0.1, -1.0);

fn camera() -> Pinhole {
    Pinhole { width: 160, height: 120, fx: 150.0, fy: 150.0, cx: 80.0, cy: 60.0 }
}

fn poses() -> [RigidTransform; 2] {
    let turned = RigidTransform { rotation: DQuat::from_rotation_y(0.1), translation: DVec3::new(-1.0, 0.3, 0.0) };
    [RigidTransform::IDENTITY, turned]
}

fn photograph(pose: &RigidTransform, bright: impl Fn(f64, f64) -> f64) -> Image {
    let (camera, world_from_camera) = (camera(), pose.inverse());
    let origin = pose.origin_of_a();
    let mut image = Image::filled(camera.width, camera.height, [0; 3]);
    for (at, pixel) in image.pixels.iter_mut().enumerate() {
        let ray = camera.ray((at % 160) as f64 + 0.5, (at / 160) as f64 + 0.5);
        let ray = world_from_camera.rotation * ray;
        let hit = origin + ray * ((DVec3::new(0.0, 0.0, 10.0) - origin).dot(NORMAL) / ray.dot(NORMAL));
        *pixel = [bright(hit.x, hit.y).round() as u8; 3];
    }
    image
}

/// A quadrilateral of the plane, moved along its normal by `outside`, between two values of x.
fn sheet(outside: f64, from_x: f64, to_x: f64) -> Mesh {
    let normal = NORMAL.normalize();
    let at = |x: f64, y: f64| {
        let z = 10.0 + (NORMAL.x * x + NORMAL.y * y);
        (DVec3::new(x, y, z) + normal * outside).into()
    };
    Mesh {
        vertices: vec![at(from_x, -9.0), at(to_x, -9.0), at(to_x, 9.0), at(from_x, 9.0)],
        faces: vec![[0, 2, 1], [0, 3, 2]],
        ..Mesh::default()
    }
}

fn views(mesh: &Mesh, bright: [&dyn Fn(f64, f64) -> f64; 2]) -> [FlowView; 2] {
    let poses = poses();
    [0, 1].map(|k| FlowView::new(mesh, camera(), poses[k], &photograph(&poses[k], bright[k])))
}

fn measured(patches: &[Patch]) -> Vec<[f64; 4]> {
    let of = |patch: &Patch| match patch.verdict {
        Verdict::Measured { residual_px, noise_px, outside, noise } => Some([residual_px, noise_px, outside, noise]),
        _ => None,
    };
    patches.iter().filter_map(of).collect()
}

fn median_of(found: &[[f64; 4]], k: usize) -> f64 {
    pgsag_scene::numbers::median(&mut found.iter().map(|one| one[k]).collect::<Vec<_>>()).expect("some")
}

#[test]
fn a_mesh_that_is_off_is_found_to_be_off_by_that_much() {
    let options = FlowOptions::default();
    for outside in [0.0, 0.15, -0.1] {
        let [a, b] = views(&sheet(outside, -9.0, 9.0), [&texture, &texture]);
        for patches in [residual_flow(&a, &b, &options), residual_flow(&b, &a, &options)] {
            let found = measured(&patches);
            assert!(found.len() > 150 && found.len() * 10 > patches.len() * 9, "{} of {}", found.len(), patches.len());
            assert!((median_of(&found, 2) - outside).abs() < 0.004, "{outside} {}", median_of(&found, 2));
            // A tenth of a unit moves a patch by 0.15 pixels; grey levels are whole numbers.
            let (noise_px, noise) = (median_of(&found, 1), median_of(&found, 3));
            assert!(noise_px < 0.1 && noise < 0.05, "{noise_px} {noise}");
        }
    }
    let [a, b] = views(&sheet(0.1, -9.0, 9.0), [&texture, &texture]);
    let found = measured(&residual_flow(&a, &b, &options));
    assert!(median_of(&found, 0) < -0.1, "nearer surface lies the other way: {}", median_of(&found, 0));
    let [a, b] = views(&sheet(3.0, -9.0, 9.0), [&texture, &texture]);
    let patches = residual_flow(&a, &b, &options);
    assert!(measured(&patches).len() * 5 < patches.len(), "beyond the search nothing is measured");
}

#[test]
fn plain_patches_and_strangers_are_told_apart() {
    let mesh = sheet(0.0, -9.0, 9.0);
    let [a, b] = views(&mesh, [&|_, _| 100.0, &|_, _| 100.0]);
    let patches = residual_flow(&a, &b, &FlowOptions::default());
    assert!(!patches.is_empty() && patches.iter().all(|patch| patch.verdict == Verdict::Plain));
    let [a, b] = views(&mesh, [&texture, &|x, y| texture(y + 40.0, 1.7 * x)]);
    let patches = residual_flow(&a, &b, &FlowOptions::default());
    let lost = patches.iter().filter(|patch| patch.verdict == Verdict::Lost).count();
    assert!(lost * 10 > patches.len() * 8, "{lost} of {}", patches.len());
}

#[test]
fn what_the_other_view_does_not_see_is_not_judged() {
    // A wall between B and the left half of the sheet, which A looks past.
    let sheet = sheet(0.0, -9.0, 9.0);
    let wall = Mesh {
        vertices: vec![[0.6, -2.0, 1.5], [0.6, 2.0, 1.5], [0.6, 2.0, 9.0], [0.6, -2.0, 9.0]],
        faces: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    };
    let both = crate::merge::merge(&[sheet.clone(), wall]);
    let [a, open] = views(&sheet, [&texture, &texture]);
    let poses = poses();
    let hidden = FlowView::new(&both, camera(), poses[1], &photograph(&poses[1], texture));
    let options = FlowOptions::default();
    let (all, some) = (residual_flow(&a, &open, &options), residual_flow(&a, &hidden, &options));
    assert!(some.len() * 10 < all.len() * 8, "{} of {}", some.len(), all.len());
    assert!(some.iter().all(|patch| all.contains(patch)), "and nothing else changes");
}
