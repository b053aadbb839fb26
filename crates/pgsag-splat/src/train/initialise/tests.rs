use super::*;

fn grid(n: usize, spacing: f64) -> Vec<InitialPoint> {
    (0..n * n)
        .map(|i| InitialPoint {
            position_world: [(i % n) as f64 * spacing + 1000.0, (i / n) as f64 * spacing + 2000.0, 5.0],
            color: [255, 0, 128],
            normal: None,
        })
        .collect()
}

#[test]
fn scales_are_spacings_and_colours_survive() {
    let cloud = initialise(&grid(10, 0.25), [1000.0, 2000.0, 0.0], &InitialiseOptions::default()).expect("points");
    assert_eq!(cloud.len(), 100);
    let inner = 55;
    assert!((libm::expf(cloud.log_scales[inner][0]) - 0.25).abs() < 1e-6);
    assert!((libm::expf(cloud.log_scales[inner][2]) - 0.025).abs() < 1e-6, "the grid is flat");
    assert_eq!(cloud.means[inner], [1.25, 1.25, 5.0]);
    assert_eq!(cloud.harmonics.len(), 100 * 9 * 3);
    let red = f64::from(cloud.harmonics[inner * 27]) * SH_C0 + 0.5;
    assert!((red - 1.0).abs() < 1e-6);
    let opacity = 1.0 / (1.0 + libm::expf(-cloud.opacity_logits[inner]));
    assert!((opacity - 0.1).abs() < 1e-6);
}

#[test]
fn duplicates_isolated_and_broken_points_are_dropped() {
    let mut points = grid(10, 0.25);
    points.push(points[3]);
    points.push(InitialPoint { position_world: [1e5, 0.0, 0.0], ..points[0] });
    points.push(InitialPoint { position_world: [f64::NAN, 0.0, 0.0], ..points[0] });
    let cloud = initialise(&points, [1000.0, 2000.0, 0.0], &InitialiseOptions::default()).expect("points");
    assert_eq!(cloud.len(), 100);
}

#[test]
fn many_points_on_one_line_of_the_grid_do_not_upset_the_tree() {
    let points: Vec<InitialPoint> = (0..500)
        .map(|i| InitialPoint { position_world: [0.0, 0.0, f64::from(i)], color: [0; 3], normal: None })
        .collect();
    let cloud = initialise(&points, [0.0; 3], &InitialiseOptions::default()).expect("points");
    assert_eq!(cloud.len(), 500);
    assert_eq!(cloud.rotations[7], [1.0, 0.0, 0.0, 0.0], "a line has no plane");
}

#[test]
fn given_normals_turn_the_thin_axis() {
    let mut points = grid(4, 1.0);
    for point in &mut points {
        point.normal = Some([0.0, -3.0, 4.0]);
    }
    let cloud = initialise(&points, [0.0; 3], &InitialiseOptions::default()).expect("points");
    let [w, x, y, z] = cloud.rotations[5].map(f64::from);
    let axis = glam::DQuat::from_xyzw(x, y, z, w) * glam::DVec3::Z;
    assert!((axis - glam::DVec3::new(0.0, -0.6, 0.8)).length() < 1e-6);
}

#[test]
fn too_few_points_are_refused() {
    let points = vec![grid(2, 1.0)[0]; 9];
    assert!(matches!(initialise(&points, [0.0; 3], &InitialiseOptions::default()), Err(TrainError::Empty(_))));
}

#[test]
fn eigenvectors_diagonalise() {
    let a = [[4.0, 1.0, -2.0], [1.0, 3.0, 0.5], [-2.0, 0.5, 1.0]];
    let (values, v) = symmetric_eigen(a);
    for k in 0..3 {
        for row in 0..3 {
            let product: f64 = (0..3).map(|c| a[row][c] * v[c][k]).sum();
            assert!((product - values[k] * v[row][k]).abs() < 1e-10);
        }
    }
}
