//! Sewing, naming and parting.

use super::*;

fn square(x: f64) -> Mesh {
    Mesh {
        vertices: vec![[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x + 1.0, 1.0, 0.0], [x, 1.0, 0.0]],
        faces: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

#[test]
fn equal_vertices_become_one_and_properties_are_filled() {
    let mut colored = square(1.0);
    colored.colors = vec![[9; 3]; 4];
    colored.groups = vec![4; 2];
    let mesh = merge(&[square(0.0), colored]);
    assert_eq!((mesh.vertices.len(), mesh.faces.len()), (6, 4));
    assert_eq!(mesh.colors[1..], [[0; 3], [0; 3], [0; 3], [9; 3], [9; 3]]);
    assert_eq!(mesh.groups, [0, 0, 4, 4]);
    assert!(mesh.buildings.is_empty());
}

#[test]
fn faces_take_the_label_of_the_nearest_point() {
    let mut mesh = merge(&[square(0.0), square(1.0), square(9.0)]);
    let points = [[0.5, 0.5, 0.0], [1.5, 0.5, 0.1]];
    assign_from_points(&mut mesh, &points, &[(3, 1), (5, 2)], 1.0).unwrap();
    assert_eq!(mesh.buildings, [3, 3, 5, 5, 0, 0]);
    assert_eq!(mesh.groups, [1, 1, 2, 2, 0, 0]);
    let parts = split_by_building(&mesh);
    assert_eq!(parts.keys().copied().collect::<Vec<_>>(), [3, 5]);
    assert_eq!((parts[&5].vertices.len(), &parts[&5].groups), (4, &vec![2, 2]));
    assert_eq!(parts[&5].vertices[parts[&5].faces[0][0] as usize], [1.0, 0.0, 0.0]);
    assert!(assign_from_points(&mut mesh, &points, &[], 1.0).is_err());
}
