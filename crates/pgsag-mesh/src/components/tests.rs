//! Parts of meshes of squares.

use super::*;

/// Squares of one unit at `(x, y)`, each two faces with vertices of its own.
fn squares(at: &[[f64; 2]]) -> Mesh {
    let mut mesh = Mesh::default();
    for [x, y] in at {
        let base = mesh.vertices.len() as u32;
        mesh.vertices.extend([[*x, *y, 0.0], [x + 1.0, *y, 0.0], [x + 1.0, y + 1.0, 0.0], [*x, y + 1.0, 0.0]]);
        mesh.faces.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        mesh.buildings.extend([base / 4 + 1; 2]);
    }
    mesh
}

#[test]
fn parts_are_numbered_by_first_faces() {
    let mesh = crate::merge::merge(&[squares(&[[0.0, 0.0], [5.0, 0.0], [1.0, 0.0]])]);
    assert_eq!(label_components(&mesh), [0, 0, 1, 1, 0, 0]);
}

#[test]
fn small_parts_are_dropped_and_listed() {
    let mesh = crate::merge::merge(&[squares(&[[0.0, 0.0], [5.0, 0.0], [1.0, 0.0]])]);
    let (kept, dropped) = drop_small(mesh.clone(), &ComponentOptions { min_area: 1.5, min_faces: 1 });
    assert_eq!((kept.faces.len(), kept.vertices.len()), (4, 6));
    assert_eq!(kept.buildings, [1, 1, 3, 3]);
    assert_eq!(dropped.len(), 1);
    assert_eq!((dropped[0].faces, dropped[0].area), (2, 1.0));
    assert!((dropped[0].center[0] - 5.5).abs() < 1e-12);
    assert_eq!(largest(&mesh, 1), kept);
    let (none, _) = drop_small(mesh.clone(), &ComponentOptions { min_area: 0.0, min_faces: 5 });
    assert!(none.faces.is_empty() && none.vertices.is_empty());
}

#[test]
fn pieces_of_plan_view_ignore_height_and_gaps_below_a_cell() {
    let mut mesh = squares(&[[0.0, 0.0], [1.2, 0.0], [4.0, 0.0], [4.0, 0.0]]);
    mesh.vertices[12..].iter_mut().for_each(|v| v[2] = 9.0);
    let pieces = plan_pieces(&mesh, DVec3::Z, 0.5, |face| face != 7).unwrap();
    assert_eq!(pieces[0..4], [pieces[0]; 4]);
    assert_eq!(pieces[4..7], [pieces[4]; 3]);
    assert_ne!(pieces[0], pieces[4]);
    assert_eq!(pieces[7], 0);
    assert!(plan_pieces(&mesh, DVec3::Z, 0.0, |_| true).is_err());
}
