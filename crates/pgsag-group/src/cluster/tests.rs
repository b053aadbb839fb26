//! Clusters against towns whose division is known.

use super::*;

/// A flat roof of points a step of 0.5 apart, `[x0, x1] × [y0, y1]` at a height.
fn roof(points: &mut Vec<DVec3>, [x0, x1]: [f64; 2], [y0, y1]: [f64; 2], height: f64) {
    let (columns, rows) = (((x1 - x0) / 0.5) as u32, ((y1 - y0) / 0.5) as u32);
    for row in 0..rows {
        for column in 0..columns {
            points.push(DVec3::new(x0 + 0.5 * f64::from(column), y0 + 0.5 * f64::from(row), height));
        }
    }
}

fn divided(points: &[DVec3], max_points: usize) -> Clusters {
    let indices: Vec<u32> = (0..points.len() as u32).collect();
    let frame = PlanFrame::new(DVec3::Z);
    let plan: Vec<DVec2> = points.iter().map(|p| frame.plan(*p)).collect();
    let density = Density::measure(&plan, 0.5, [2.0, 8.0], None);
    let rules = ClusterRules {
        eps: density.eps,
        min_neighbors: density.min_neighbors,
        min_points: 150,
        max_points,
        halo: 6.0,
        height_step: 1.0,
    };
    clusters(&indices, points, &frame, &rules)
}

#[test]
fn houses_apart_are_clusters_of_their_own_and_strays_are_noise() {
    let mut points = Vec::new();
    roof(&mut points, [0.0, 10.0], [0.0, 10.0], 5.0);
    roof(&mut points, [20.0, 28.0], [0.0, 10.0], 6.0);
    points.push(DVec3::new(60.0, 60.0, 3.0));
    let found = divided(&points, usize::MAX);
    assert_eq!(found.clusters.iter().map(|c| c.core.len()).collect::<Vec<_>>(), [400, 320]);
    assert!(found.clusters.iter().all(|cluster| cluster.halo.is_empty()));
    assert_eq!((found.noise.as_slice(), found.cuts, found.found), ([720].as_slice(), 0, 2));
}

#[test]
fn a_shed_joins_the_house_beside_it() {
    let mut points = Vec::new();
    roof(&mut points, [0.0, 10.0], [0.0, 10.0], 5.0);
    roof(&mut points, [14.0, 19.0], [0.0, 5.0], 3.0);
    let found = divided(&points, usize::MAX);
    assert_eq!((found.clusters.len(), found.merged), (1, 1));
    assert_eq!(found.clusters[0].core.len(), points.len());
}

#[test]
fn cuts_follow_height_steps_and_cores_never_overlap() {
    let mut points = Vec::new();
    roof(&mut points, [0.0, 9.0], [0.0, 8.0], 5.0);
    roof(&mut points, [9.0, 20.0], [0.0, 8.0], 9.0);
    let found = divided(&points, 450);
    assert_eq!((found.clusters.len(), found.cuts), (2, 1));
    let mut owners = vec![0; points.len()];
    for cluster in &found.clusters {
        let height = points[cluster.core[0] as usize].z;
        let alike = cluster.core.iter().filter(|i| (points[**i as usize].z - height).abs() < 0.1).count();
        assert!(alike as f64 > 0.93 * cluster.core.len() as f64, "the cut is at the step");
        cluster.core.iter().for_each(|index| owners[*index as usize] += 1);
        assert!(!cluster.halo.is_empty() && cluster.halo.iter().all(|index| !cluster.core.contains(index)));
    }
    assert!(owners.iter().all(|count| *count == 1));
}

#[test]
fn every_piece_fits_the_budget() {
    let mut points = Vec::new();
    roof(&mut points, [0.0, 60.0], [0.0, 30.0], 5.0);
    let found = divided(&points, 700);
    assert!(found.clusters.iter().all(|cluster| cluster.core.len() <= 700));
    assert_eq!(found.clusters.iter().map(|cluster| cluster.core.len()).sum::<usize>(), points.len());
    assert!(found.clusters.len() <= 24, "{} pieces", found.clusters.len());
}
