//! Plates with a pane that only closing faces fill.

use super::*;

/// A plate of `side` x `side` squares; those in `pane` (columns, rows) close a gap and bulge upwards by `bulge`.
fn plate(side: u32, pane: impl Fn(u32, u32) -> bool, bulge: f64) -> Mesh {
    let mut mesh = Mesh::default();
    for y in 0..=side {
        for x in 0..=side {
            let is_inner = [(0, 0), (1, 0), (0, 1), (1, 1)]
                .iter()
                .all(|(i, j)| x >= *i && y >= *j && x - i < side && y - j < side && pane(x - i, y - j));
            mesh.vertices.push([f64::from(x), f64::from(y), if is_inner { bulge } else { 0.0 }]);
            mesh.colors.push(if is_inner { [0; 3] } else { [200, 100, 50] });
        }
    }
    for y in 0..side {
        for x in 0..side {
            let at = y * (side + 1) + x;
            let (right, up) = (at + 1, at + side + 1);
            mesh.faces.extend([[at, right, up], [right, up + 1, up]]);
            mesh.closed.extend([u32::from(pane(x, y)); 2]);
            let group = if pane(x, y) { 0 } else { 1 + u32::from(x >= side / 2) };
            mesh.groups.extend([group; 2]);
        }
    }
    mesh
}

fn square(low: u32, high: u32) -> impl Fn(u32, u32) -> bool {
    move |x, y| (low..high).contains(&x) && (low..high).contains(&y)
}

#[test]
fn a_narrow_gap_is_closed_taut_with_the_colours_and_groups_around_it() {
    let (mesh, gaps) = close_gaps(plate(20, square(7, 13), 3.0), 16.0);
    assert_eq!(gaps.faces, 72);
    assert!((gaps.area - 36.0).abs() < 1e-6, "{gaps:?}");
    assert!(mesh.vertices.iter().all(|vertex| vertex[2].abs() < 1e-6));
    assert!(mesh.colors.iter().all(|color| *color == [200, 100, 50]));
    assert_eq!(mesh.faces.len(), 800);
    assert!(mesh.groups.iter().all(|group| *group != 0));
    let center = |face: usize| mesh.triangle(face).iter().map(|corner| corner[0]).sum::<f64>() / 3.0;
    for face in (0..800).filter(|face| !mesh.is_measured(*face)) {
        let is_right = center(face) > 10.0;
        assert_eq!(mesh.groups[face], 1 + u32::from(is_right), "at {}", center(face));
    }
}

#[test]
fn a_gap_between_a_building_and_the_ground_is_ground() {
    let mut mesh = plate(20, square(7, 13), 0.0);
    mesh.buildings = mesh.groups.clone();
    let labels = |mesh: &mut Mesh| [&mut mesh.groups, &mut mesh.buildings].map(std::mem::take);
    let closing = |mesh: &Mesh| (0..mesh.faces.len()).filter(|face| !mesh.is_measured(*face)).collect::<Vec<_>>();
    // One measured square beside the gap is of the ground.
    for face in 0..mesh.faces.len() {
        let [x, y, _] = mesh.triangle(face)[0];
        if (6.0..=7.0).contains(&x) && (9.0..=10.0).contains(&y) && mesh.is_measured(face) {
            (mesh.groups[face], mesh.buildings[face]) = (0, 0);
        }
    }
    let (mut found, gaps) = close_gaps(mesh.clone(), 8.0);
    let at = closing(&found);
    assert_eq!(at.len(), gaps.faces);
    for labels in labels(&mut found) {
        assert!(at.iter().all(|face| labels[*face] == 0));
        assert!(labels.iter().filter(|label| **label == 0).count() < at.len() + 10, "measured labels stay");
    }
}

#[test]
fn what_a_cube_drops_the_whole_would_drop() {
    // A narrow pane and a wide one; nothing is decided near the plate's right side, where another cube might go on.
    let pane =
        |x: u32, y: u32| square(4, 8)(x, y) || ((12..26).contains(&x) && (4..18).contains(&y)) || (x >= 34 && y >= 30);
    let mesh = plate(40, pane, 0.0);
    let dropped = drop_wide(mesh.clone(), 6.0, |center| 40.0 - center.x);
    assert!(dropped.faces.len() < mesh.faces.len() - 200, "{} of {}", dropped.faces.len(), mesh.faces.len());
    let (whole, parts) = (close_gaps(mesh.clone(), 6.0), close_gaps(dropped, 6.0));
    assert_eq!(whole.1.faces, parts.1.faces);
    assert!((whole.1.area - parts.1.area).abs() < 1e-9);
    assert_eq!(whole.0.closed.iter().sum::<u32>(), whole.1.faces as u32);
    assert!(drop_wide(mesh.clone(), 6.0, |_| 0.0).closed == mesh.closed, "nothing can be told");
}

#[test]
fn what_a_cube_has_decided_stays_unless_it_hung_on_a_crumb() {
    let decided = drop_wide(plate(20, square(7, 13), 0.0), 8.0, |_| f64::INFINITY);
    assert_eq!(decided.closed.iter().filter(|closed| **closed == DECIDED).count(), 72);
    let crumbs = |min_faces| crate::components::ComponentOptions { min_area: 0.0, min_faces };
    let (kept, dropped) = crate::components::drop_small(decided.clone(), &crumbs(10));
    assert!(dropped.is_empty() && kept.closed == decided.closed);
    assert_eq!(close_gaps(kept, 8.0).1.faces, 72);
    // The whole plate is a crumb.
    let (kept, dropped) = crate::components::drop_small(decided.clone(), &crumbs(10_000));
    assert_eq!((dropped.len(), kept.closed.iter().filter(|closed| **closed == DECIDED).count()), (1, 72));
    assert!(close_gaps(kept, 8.0).0.faces.is_empty());
}

#[test]
fn a_wide_gap_stays_open_and_so_does_the_end_of_the_surface() {
    let (mesh, gaps) = close_gaps(plate(20, square(4, 16), 0.0), 4.0);
    assert!(gaps.area < 8.0, "its corners alone: {gaps:?}");
    assert!((0..mesh.faces.len()).filter(|face| mesh.is_measured(*face)).count() == 2 * (400 - 144));
    // A pane at the plate's edge has an open end: of a slot as deep as wide nothing is left.
    let (mesh, gaps) = close_gaps(plate(20, |x, y| x < 4 && (8..12).contains(&y), 0.0), 10.0);
    assert_eq!(gaps, Gaps::default());
    assert_eq!(mesh.faces.len(), 2 * (400 - 16));
}

#[test]
fn a_slot_is_closed_up_to_its_wide_end() {
    // 2 wide from column 4 to 14, then a square of 12.
    let pane = |x: u32, y: u32| {
        ((4..14).contains(&x) && (19..21).contains(&y)) || ((14..26).contains(&x) && (14..26).contains(&y))
    };
    let (mesh, gaps) = close_gaps(plate(40, pane, 0.0), 6.0);
    assert!(gaps.area > 10.0 && gaps.area < 32.0, "{gaps:?}");
    let reaches = (0..mesh.faces.len()).filter(|face| !mesh.is_measured(*face)).map(|face| mesh.triangle(face)[0][0]);
    assert!(reaches.clone().fold(f64::INFINITY, f64::min) < 5.0, "the narrow end is closed");
}

#[test]
fn what_was_measured_stays_as_it_is() {
    let mut mesh = plate(6, |_, _| false, 0.0);
    assert_eq!(close_gaps(mesh.clone(), 5.0).0, mesh);
    mesh.closed.clear();
    assert_eq!(close_gaps(mesh.clone(), 5.0).0, mesh);
    // Closing faces that touch nothing measured are dropped.
    let mut mesh = plate(6, |_, _| true, 0.0);
    mesh.groups = vec![0; mesh.faces.len()];
    assert!(close_gaps(mesh.clone(), 50.0).0.faces.is_empty());
}
