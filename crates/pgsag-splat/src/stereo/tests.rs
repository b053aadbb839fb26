//! Stereo on a textured tilted plane with exact truth.

use glam::{DQuat, DVec3};

use super::*;

const SIZE: (u32, u32) = (96, 72);

/// The plane n · X = −d in the world (= reference camera) frame.
const NORMAL: [f64; 3] = [0.3, -0.2, -0.93];
const DISTANCE: f64 = 9.0;

fn texture(x: f64, y: f64) -> f32 {
    let wave = |a: f64, b: f64| libm::sin(a * x + b * y);
    (0.5 + 0.1 * wave(5.0, 3.1) + 0.12 * wave(-3.0, 7.3) + 0.1 * wave(11.0, -6.0) + 0.08 * wave(17.0, 13.0)) as f32
}

fn photograph(center: DVec3, gain: f32) -> StereoView {
    let camera = Pinhole { width: SIZE.0, height: SIZE.1, fx: 110.0, fy: 110.0, cx: 47.0, cy: 37.0 };
    let camera_from_world =
        RigidTransform { rotation: DQuat::from_rotation_y(0.02 * center.x), translation: DVec3::ZERO };
    let camera_from_world = RigidTransform { translation: -(camera_from_world.rotation * center), ..camera_from_world };
    let mut gray = Map::filled(SIZE.0, SIZE.1, 0.0);
    let world_from_camera = camera_from_world.inverse();
    let normal = DVec3::from_array(NORMAL).normalize();
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let direction = world_from_camera.rotation * camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let at = center + direction * ((-DISTANCE - normal.dot(center)) / normal.dot(direction));
            gray.set(x, y, gain * texture(at.x, at.y));
        }
    }
    StereoView { camera, camera_from_world, gray }
}

fn true_depth(view: &StereoView, x: u32, y: u32) -> f64 {
    let ray = view.camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
    -DISTANCE / DVec3::from_array(NORMAL).normalize().dot(ray)
}

fn estimated(options: &StereoOptions) -> (StereoView, StereoDepth) {
    let reference = photograph(DVec3::ZERO, 1.0);
    let neighbors = [photograph(DVec3::new(1.2, 0.1, 0.0), 0.8), photograph(DVec3::new(-1.1, 0.6, 0.2), 1.1)];
    let prior = Prior { seeds: &[[20.0, 20.0, 9.0]], depth_range: [4.0, 20.0] };
    let depth = estimate(&reference, &neighbors.each_ref(), &prior, options, 1);
    (reference, depth)
}

/// Relative errors of depth away from the border, half and four fifths of them below; 1 where nothing was found.
fn errors(options: &StereoOptions) -> (f64, f64) {
    let (reference, found) = estimated(options);
    let mut errors: Vec<f64> = Vec::new();
    for y in 8..SIZE.1 - 8 {
        for x in 12..SIZE.0 - 12 {
            let depth = f64::from(found.depth.at(x, y));
            errors.push(if depth > 0.0 { (depth / true_depth(&reference, x, y) - 1.0).abs() } else { 1.0 });
        }
    }
    [0.5, 0.8].map(|q| pgsag_scene::numbers::quantile(&mut errors, q).expect("some")).into()
}

#[test]
fn plane_is_found_to_a_fraction_of_a_pixel() {
    let (half, most) = errors(&StereoOptions::default());
    // One pixel of disparity at baseline 1.2 and depth 9 is 6.8 % of the depth.
    assert!(half < 0.004 && most < 0.02, "{half} {most}");
}

#[test]
fn half_size_first_finds_the_same_plane() {
    let (half, most) = errors(&StereoOptions { smallest_px: 40, ..StereoOptions::default() });
    assert!(half < 0.004 && most < 0.02, "{half} {most}");
}

#[test]
fn number_of_threads_does_not_matter() {
    let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("threads");
    let one = pool(1).install(|| estimated(&StereoOptions::default())).1;
    let two = pool(2).install(|| estimated(&StereoOptions::default())).1;
    assert!(one == two);
}

#[test]
fn nearest_seed_is_the_nearest_for_nearly_every_pixel() {
    let seeds = [[3.2, 4.1, 1.0], [80.0, 10.0, 1.0], [40.0, 60.0, 1.0], [44.0, 60.0, 1.0], [500.0, 1.0, 1.0]];
    let found = nearest_seed(SIZE.0, SIZE.1, &seeds).expect("seeds");
    let reach = |n: usize, x: u32, y: u32| libm::hypotf(seeds[n][0] - x as f32 - 0.5, seeds[n][1] - y as f32 - 0.5);
    let wrong = (0..SIZE.0 * SIZE.1).filter(|index| {
        let (x, y) = (index % SIZE.0, index / SIZE.0);
        let best = (0..4).map(|n| reach(n, x, y)).fold(f32::INFINITY, f32::min);
        reach(found[*index as usize] as usize, x, y) > best + 1.5
    });
    assert_eq!(wrong.count(), 0);
    assert!(nearest_seed(4, 4, &[]).is_none());
}

#[test]
fn thinning_keeps_the_best_of_a_cell_and_both_sides_of_a_wall() {
    let point = |x: f64, normal_x: f32, cost: f32| SurfacePoint {
        position_world: [x, 0.5, 0.5],
        normal_world: [normal_x, 0.0, 0.0],
        color: [0; 3],
        cost,
        view: 0,
    };
    let kept =
        thin_points([point(0.2, 1.0, 0.3), point(0.4, 1.0, 0.1), point(0.6, -1.0, 0.2), point(5.0, 1.0, 0.9)], 1.0);
    assert_eq!(kept.iter().map(|p| p.cost).collect::<Vec<_>>(), [0.2, 0.1, 0.9]);
}

#[test]
fn confirmed_depth_is_better_than_raw_and_refuses_a_liar() {
    let views = [DVec3::ZERO, DVec3::new(1.2, 0.1, 0.0), DVec3::new(-1.1, 0.6, 0.2)].map(|at| photograph(at, 1.0));
    let exact = |view: &StereoView| {
        let world_from_camera = view.camera_from_world.inverse();
        let normal = DVec3::from_array(NORMAL).normalize();
        let center = view.camera_from_world.origin_of_a();
        let mut depth = Map::filled(SIZE.0, SIZE.1, 0.0);
        for (x, y) in (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y))) {
            let direction = world_from_camera.rotation * view.camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
            depth.set(x, y, ((-DISTANCE - normal.dot(center)) / normal.dot(direction)) as f32);
        }
        StereoDepth { normal: Map::filled(SIZE.0, SIZE.1, [0.0; 3]), cost: depth.clone(), depth }
    };
    let mut found = views.each_ref().map(exact);
    found[0].depth.set(50, 40, found[0].depth.at(50, 40) * 1.1);
    let neighbors = [(&views[1], &found[1]), (&views[2], &found[2])];
    let kept = confirmed((&views[0], &found[0]), &neighbors, &CheckOptions::default());
    assert_eq!(kept.at(50, 40), 0.0);
    assert!((f64::from(kept.at(48, 40)) / true_depth(&views[0], 48, 40) - 1.0).abs() < 0.01);
    assert_eq!(confirmed((&views[0], &found[0]), &neighbors[..1], &CheckOptions::default()).at(48, 40), 0.0);
}
