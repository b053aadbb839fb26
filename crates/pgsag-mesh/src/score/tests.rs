//! Scores against counts made by hand.

use glam::{DQuat, DVec3};
use pgsag_scene::Mesh;
use pgsag_scene::numbers::SplitMix64;

use super::crop::{in_polygon, thinned};
use super::surface::{Surface, Target, Walk};
use super::*;

/// The rectangle `[x0, x1] x [0, 1]` at height `z`, facing up.
fn plate(x0: f64, x1: f64, z: f64) -> Mesh {
    Mesh {
        vertices: vec![[x0, 0.0, z], [x1, 0.0, z], [x1, 1.0, z], [x0, 1.0, z]],
        faces: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

/// A closed box.
fn boxed(low: [f64; 3], high: [f64; 3]) -> Mesh {
    let vertices = (0..8).map(|c| std::array::from_fn(|a| if c >> a & 1 == 1 { high[a] } else { low[a] })).collect();
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let faces = quads.iter().flat_map(|q: &[u32; 4]| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
    Mesh { vertices, faces, ..Mesh::default() }
}

fn labelled(mut mesh: Mesh, building: u32) -> Mesh {
    mesh.buildings = vec![building; mesh.faces.len()];
    mesh
}

fn options(thresholds_m: &[f64]) -> ScoreOptions {
    ScoreOptions { thresholds_m: thresholds_m.to_vec(), spacing_m: Some(0.02), ..ScoreOptions::default() }
}

#[track_caller]
fn near(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} is not {expected} within {tolerance}");
}

#[test]
fn a_lifted_plate_is_within_the_larger_threshold_only() {
    let (mesh, truth) = (plate(0.0, 2.0, 0.15), plate(0.0, 2.0, 0.0));
    let score = score(&mesh, &Truth::Mesh(&truth), &options(&[0.1, 0.2])).unwrap();
    assert_eq!((score.scores[0].precision, score.scores[0].recall, score.scores[0].f1), (0.0, 0.0, 0.0));
    assert_eq!((score.scores[1].precision, score.scores[1].recall, score.scores[1].f1), (1.0, 1.0, 1.0));
    assert_eq!(score.accuracy_m.all.count, 5000);
    near(score.accuracy_m.all.signed_median.unwrap(), 0.15, 1e-6);
    near(score.completeness_m.all.signed_median.unwrap(), -0.15, 1e-6);
    near(score.accuracy_m.all.mean.unwrap(), 0.15, 1e-6);
}

#[test]
fn half_a_plate_is_precise_but_half_complete() {
    let (mesh, truth) = (plate(0.0, 1.0, 0.0), plate(0.0, 2.0, 0.0));
    let row = &score(&mesh, &Truth::Mesh(&truth), &options(&[0.1])).unwrap().scores[0];
    assert_eq!(row.precision, 1.0);
    near(row.recall, 0.55, 0.005);
    near(row.f1, 2.0 * 0.55 / 1.55, 0.005);
    let row = &score(&truth, &Truth::Mesh(&mesh), &options(&[0.1])).unwrap().scores[0];
    near(row.precision, 0.55, 0.005);
    assert_eq!(row.recall, 1.0);
}

#[test]
fn units_scale_out() {
    let (mesh, truth) = (plate(0.0, 1.0, 0.0), plate(0.0, 2.0, 0.0));
    let in_metres = score(&mesh, &Truth::Mesh(&truth), &options(&[0.1])).unwrap();
    let mut kilo = options(&[100.0]);
    kilo.spacing_m = Some(20.0);
    kilo.metres_per_unit = 1000.0;
    let in_units = score(&mesh, &Truth::Mesh(&truth), &kilo).unwrap();
    assert_eq!(in_metres.scores[0].recall, in_units.scores[0].recall);
}

/// Ground under everything, house 1 on the left, house 2 on the right.
fn street() -> (Mesh, Vec<[f64; 3]>, Vec<u32>) {
    let ground = labelled(plate(-1.0, 4.0, 0.0), 0);
    let roofs = [labelled(plate(0.0, 1.0, 1.0), 1), labelled(plate(2.0, 3.0, 1.0), 2)];
    let mut visible = Vec::new();
    let mut building = Vec::new();
    for i in 0..100 {
        let at = f64::from(i) / 100.0 + 0.005;
        visible.extend([[at, 0.5, 1.0], [2.0 + at, 0.5, 1.0]]);
        building.extend([1, 2]);
    }
    (crate::merge::merge(&[ground, roofs[0].clone(), roofs[1].clone()]), visible, building)
}

#[test]
fn samples_nearest_to_the_ground_are_left_out() {
    let (scene, visible, building) = street();
    let truth = Truth::Folder { scene: &scene, visible: &visible, building: &building };
    let mesh = crate::merge::merge(&[plate(0.0, 1.0, 1.05), plate(2.0, 2.5, 1.35), plate(-1.0, 0.0, 0.2)]);
    let score = score(&mesh, &truth, &options(&[0.1, 0.4])).unwrap();
    near(score.left_out as f64, 2500.0, 1.0);
    near(score.scores[0].precision, 2.0 / 3.0, 0.001);
    near(score.scores[1].precision, 1.0, 0.0);
    near(score.scores[0].recall, 0.5, 0.0);
    // Half of house 2 has a mesh 0.35 above; 0.4 reaches sqrt(0.4^2 - 0.35^2) = 0.194 past its end.
    near(score.scores[1].recall, 0.5 + 0.5 * (0.5 + 0.194), 0.006);
    let [one, two] = &score.per_building[..] else { panic!("two buildings") };
    assert_eq!((one.building, one.scores[0].precision, one.scores[0].recall), (1, 1.0, 1.0));
    assert_eq!((two.building, two.scores[0].precision, two.scores[0].recall), (2, 0.0, 0.0));
    assert_eq!(two.truth_points, 100);
    // Drawing house 1 twice gives 1, house 2 twice gives 0.
    assert_eq!(score.scores[0].f1_interval, Some([0.0, 1.0]));
}

#[test]
fn parts_of_a_house_are_told_apart() {
    let truth = labelled(boxed([0.0; 3], [4.0, 4.0, 4.0]), 7);
    let mesh = boxed([-0.05; 3], [4.05, 4.05, 4.05]);
    let score = score(&mesh, &Truth::Mesh(&truth), &options(&[0.1])).unwrap();
    let [roof, facade, edge] = [&score.completeness_m.roof, &score.completeness_m.facade, &score.completeness_m.edge]
        .map(|p| p.clone().unwrap());
    // Inner 3 x 3 squares of top and bottom, of four walls, and the rest.
    let all = score.completeness_m.all.count as f64;
    near(roof.count as f64 / all, 2.0 * 9.0 / 96.0, 0.002);
    near(facade.count as f64 / all, 4.0 * 9.0 / 96.0, 0.002);
    assert_eq!(roof.count + facade.count + edge.count, score.completeness_m.all.count);
    near(facade.signed_median.unwrap(), -0.05, 1e-6);
    near(score.accuracy_m.roof.unwrap().signed_median.unwrap(), 0.05, 1e-6);
}

#[test]
fn folds_below_thirty_degrees_are_no_edges() {
    let truth = boxed([0.0; 3], [4.0, 4.0, 4.0]);
    let shallow = Mesh {
        vertices: vec![
            [0.0, 0.0, 0.0],
            [2.0, 0.0, 0.5],
            [2.0, 4.0, 0.5],
            [0.0, 4.0, 0.0],
            [4.0, 0.0, 0.0],
            [4.0, 4.0, 0.0],
        ],
        faces: vec![[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]],
        ..Mesh::default()
    };
    assert!(edges::Edges::new(&truth).within(DVec3::new(4.3, 2.0, 4.3), 0.5));
    assert!(!edges::Edges::new(&truth).within(DVec3::new(2.0, 2.0, 4.0), 0.5));
    assert!(!edges::Edges::new(&shallow).within(DVec3::new(2.0, 2.0, 0.5), 0.5));
}

#[test]
fn a_sparse_cloud_is_said_to_be_sparse() {
    let cloud: Vec<_> =
        (0..40).flat_map(|i| (0..20).map(move |j| [f64::from(i) * 0.05, f64::from(j) * 0.05, 0.0])).collect();
    let score = score(&plate(0.0, 2.0, 0.0), &Truth::Cloud(&cloud), &options(&[0.06, 0.2])).unwrap();
    near(score.truth_spacing_m.unwrap(), 0.05, 1e-9);
    assert_eq!((score.scores[0].truth_too_sparse, score.scores[1].truth_too_sparse), (true, false));
    assert_eq!(score.notes.len(), 1);
    assert_eq!(score.scores[1].recall, 1.0);
    assert!(score.accuracy_m.all.signed_median.is_none() && score.accuracy_m.roof.is_none());
}

#[test]
fn cropping_judges_the_inside_alone() {
    let (mesh, truth) = (plate(0.0, 1.0, 0.0), plate(0.0, 2.0, 0.0));
    let mut left = options(&[0.1]);
    left.crop = Some(vec![[-1.0, -1.0], [1.0, -1.0], [1.0, 2.0], [-1.0, 2.0]]);
    let row = &score(&mesh, &Truth::Mesh(&truth), &left).unwrap().scores[0];
    assert_eq!((row.precision, row.recall), (1.0, 1.0));
    // Of two true buildings the mesh has the one that lies inside.
    let housed = |mesh: Mesh, building: u32| Mesh { buildings: vec![building; mesh.faces.len()], ..mesh };
    let truth = crate::merge::merge(&[housed(plate(0.0, 1.0, 0.0), 1), housed(plate(3.0, 4.0, 0.0), 2)]);
    let quality = |options: &ScoreOptions| {
        score(&housed(mesh.clone(), 7), &Truth::Mesh(&truth), options).unwrap().panoptic.map(|found| found.quality)
    };
    assert_eq!(quality(&left), Some(1.0));
    assert!(quality(&options(&[0.1])) < Some(0.7));
    assert!(in_polygon(&[[0.0, 0.0], [2.0, 0.0], [1.0, 2.0]], 1.0, 1.0));
    assert!(!in_polygon(&[[0.0, 0.0], [2.0, 0.0], [1.0, 2.0]], 1.9, 1.0));
}

#[test]
fn icp_undoes_a_motion() {
    let truth = crate::merge::merge(&[boxed([0.0; 3], [4.0, 3.0, 2.0]), boxed([5.0, 0.0, 0.0], [7.0, 4.0, 5.0])]);
    let moved = |scale: f64| {
        let motion =
            Similarity { scale, rotation: DQuat::from_rotation_z(0.02), translation: DVec3::new(0.3, -0.2, 0.3) };
        Mesh { vertices: truth.vertices.iter().map(|v| motion.apply(*v)).collect(), ..truth.clone() }
    };
    let with = |align, mesh: &Mesh| {
        let options = ScoreOptions { align, ..options(&[0.2]) };
        score(mesh, &Truth::Mesh(&truth), &ScoreOptions { spacing_m: Some(0.05), ..options }).unwrap()
    };
    let judged = with(Align::Icp, &moved(1.0));
    assert!(judged.scores[0].f1 > 0.999, "{:?}", judged.scores);
    assert!(with(Align::None, &moved(1.0)).scores[0].f1 < 0.5);
    let judged = with(Align::IcpScale, &moved(1.03));
    assert!(judged.scores[0].f1 > 0.999, "{:?} {:?}", judged.scores, judged.alignment);
}

#[test]
fn horn_finds_the_exact_motion() {
    let motion = Similarity {
        scale: 1.7,
        rotation: DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 2.0),
        translation: DVec3::new(3.0, -1.0, 9.0),
    };
    let mut random = SplitMix64::new(1);
    let pairs: Vec<_> = (0..20)
        .map(|_| [random.range(-1.0, 1.0), random.range(-1.0, 1.0), random.range(-1.0, 1.0)])
        .map(|p| (DVec3::from(p), DVec3::from(motion.apply(p))))
        .collect();
    let found = align::best_motion(&pairs, true);
    near(found.scale, 1.7, 1e-12);
    assert!(pairs.iter().all(|(p, q)| DVec3::from(found.apply((*p).into())).distance(*q) < 1e-12));
}

#[test]
fn published_protocols_follow_their_rules() {
    let (mesh, truth) = (plate(0.0, 40.0, 0.3), plate(0.0, 40.0, 0.0));
    let by =
        |protocol| score(&mesh, &Truth::Mesh(&truth), &ScoreOptions { protocol, ..ScoreOptions::default() }).unwrap();
    let paper = by(Protocol::PgSag);
    assert_eq!((paper.protocol.as_str(), paper.spacing_m, paper.scores.len()), ("pg-sag", 0.35, 1));
    assert_eq!(paper.scores[0].threshold_m, 0.6);
    near(paper.scores[0].f1, 1.0, 0.01);
    assert!(paper.alignment.is_none());
    let citygs = by(Protocol::CitygsV2);
    assert!(citygs.scores[0].threshold_m > 0.3 && citygs.scores[0].threshold_m < 0.6, "{:?}", citygs.scores);
    assert!(citygs.alignment.is_some());
    let tanks = by(Protocol::TanksAndTemples);
    assert_eq!((tanks.scores.len(), tanks.accuracy_m.all.count), (4, 4));
}

#[test]
fn walking_changes_no_distance() {
    let mut random = SplitMix64::new(9);
    let mut point = || [random.range(0.0, 5.0), random.range(0.0, 5.0), random.range(0.0, 5.0)];
    let vertices: Vec<[f64; 3]> = (0..300).map(|_| point()).collect();
    let mesh = Mesh { faces: (0..100).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect(), vertices, ..Mesh::default() };
    let surface = Surface::new(&mesh, "soup").unwrap();
    let mut walk = Walk::default();
    for _ in 0..500 {
        let at = DVec3::from(point());
        let one = surface.nearest_within(at, f64::MAX).unwrap();
        assert_eq!(walk.nearest(&surface, at).unwrap().distance, one.distance);
    }
}

#[test]
fn thinning_takes_the_mean_of_each_voxel() {
    let points = [[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [1.0, 0.0, 0.0]];
    assert_eq!(thinned(&points, 1.0), vec![[0.1, 0.0, 0.0], [1.0, 0.0, 0.0]]);
}

#[test]
fn nonsense_is_refused_and_nothing_is_judged_as_nothing() {
    let truth = plate(0.0, 2.0, 0.0);
    assert!(score(&truth, &Truth::Mesh(&truth), &options(&[])).is_err());
    assert!(score(&truth, &Truth::Mesh(&truth), &options(&[-1.0])).is_err());
    assert!(score(&truth, &Truth::Mesh(&Mesh::default()), &options(&[0.1])).is_err());
    assert!(score(&truth, &Truth::Cloud(&[]), &options(&[0.1])).is_err());
    let unlabelled = Truth::Folder { scene: &truth, visible: &[], building: &[] };
    assert!(score(&truth, &unlabelled, &options(&[0.1])).is_err());
    let nothing = score(&Mesh::default(), &Truth::Mesh(&truth), &options(&[0.1])).unwrap();
    assert_eq!((nothing.scores[0].precision, nothing.scores[0].recall, nothing.scores[0].f1), (0.0, 0.0, 0.0));
    assert_eq!(nothing.notes.len(), 1);
}

#[test]
fn distances_are_green_on_the_truth_and_red_off_it() {
    let truth = plate(0.0, 2.0, 0.0);
    let (near, far) = (distance_color(0.0, 0.5), distance_color(3.0, 0.5));
    assert!(near[1] > near[0] && far[0] > far[1] && distance_color(0.5, 0.5) == far);
    let places = [[1.0, 1.0, 3.0], [1.0, 1.0, 0.0]].map(DVec3::from);
    for cap in [9.0, 0.5] {
        let from_mesh = distances_from_mesh(&truth, &places, cap);
        assert_eq!(from_mesh, distances_from_truth(&Truth::Mesh(&truth), &places, cap).unwrap());
        assert!((from_mesh[0] - cap.min(3.0)).abs() < 1e-12 && from_mesh[1] < 1e-12);
        let cloud = distances_from_truth(&Truth::Cloud(&truth.vertices), &places, cap).unwrap();
        assert!((cloud[0] - cap.min(libm::sqrt(10.0))).abs() < 1e-12, "{cloud:?}");
    }
    assert_eq!(distances_from_mesh(&Mesh::default(), &places, 2.0), [2.0, 2.0]);
}
