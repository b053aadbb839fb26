//! Pictures of meshes whose looks are known.

use super::*;

fn camera() -> Pinhole {
    Pinhole { width: 40, height: 30, fx: 40.0, fy: 40.0, cx: 20.0, cy: 15.0 }
}

/// A square at depth `z`, `half` to either side, facing a camera at the origin that looks along z.
fn square(z: f64, half: f64) -> Mesh {
    Mesh {
        vertices: vec![[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]],
        faces: vec![[0, 2, 1], [0, 3, 2]],
        ..Mesh::default()
    }
}

#[test]
fn a_square_covers_the_pixels_it_covers() {
    let seen = visibility(&square(4.0, 0.5), &camera(), &RigidTransform::IDENTITY);
    // 0.5 / 4 * 40 = 5 pixels to either side of the centre.
    let covered = seen.face.values.iter().filter(|f| **f != NO_FACE).count();
    assert_eq!(covered, 100);
    assert!(seen.face.at(15, 10) != NO_FACE && seen.face.at(14, 10) == NO_FACE && seen.face.at(25, 10) == NO_FACE);
    assert!((seen.depth.at(20, 15) - 4.0).abs() < 1e-6);
    assert_eq!(seen.depth.at(0, 0), 0.0);
}

#[test]
fn faces_smaller_than_a_pixel_cover_what_one_large_face_does() {
    let whole = visibility(&square(4.0, 0.7), &camera(), &RigidTransform::IDENTITY);
    let cells = 97;
    let at = |i: usize| -0.7 + 1.4 * i as f64 / cells as f64;
    let mut fine = Mesh::default();
    for y in 0..=cells {
        fine.vertices.extend((0..=cells).map(|x| [at(x), at(y), 4.0]));
    }
    let row = cells as u32 + 1;
    for corner in (0..cells as u32).flat_map(|y| (0..cells as u32).map(move |x| y * row + x)) {
        fine.faces.extend([[corner, corner + row + 1, corner + 1], [corner, corner + row, corner + row + 1]]);
    }
    let pieces = visibility(&fine, &camera(), &RigidTransform::IDENTITY);
    let covered = |seen: &Visibility| seen.face.values.iter().map(|face| *face != NO_FACE).collect::<Vec<_>>();
    assert_eq!(covered(&pieces), covered(&whole));
}

#[test]
fn nearer_faces_hide_farther_ones_in_any_order() {
    let far_first = crate::merge::merge(&[square(4.0, 1.0), square(2.0, 0.25)]);
    let near_first = crate::merge::merge(&[square(2.0, 0.25), square(4.0, 1.0)]);
    let one = visibility(&far_first, &camera(), &RigidTransform::IDENTITY);
    let other = visibility(&near_first, &camera(), &RigidTransform::IDENTITY);
    assert_eq!(one.depth, other.depth);
    assert!((one.depth.at(20, 15) - 2.0).abs() < 1e-6 && (one.depth.at(12, 15) - 4.0).abs() < 1e-6);
}

#[test]
fn depth_of_a_slope_is_that_of_its_plane_even_through_the_camera() {
    // The plane y = 1 from behind the camera to far away.
    let floor = Mesh {
        vertices: vec![[-50.0, 1.0, -50.0], [50.0, 1.0, -50.0], [50.0, 1.0, 50.0], [-50.0, 1.0, 50.0]],
        faces: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    };
    let seen = visibility(&floor, &camera(), &RigidTransform::IDENTITY);
    for y in 17..30 {
        let expected = 40.0 / (f64::from(y) + 0.5 - 15.0);
        for x in 0..40 {
            assert!((f64::from(seen.depth.at(x, y)) / expected - 1.0).abs() < 1e-5, "{x} {y}");
        }
    }
    assert!((0..40).all(|x| seen.depth.at(x, 14) == 0.0));
}

#[test]
fn paints_differ_and_backs_are_red() {
    let mut mesh = square(4.0, 5.0);
    mesh.colors = vec![[10, 20, 30]; 4];
    mesh.buildings = vec![1, 2];
    let look = |mesh: &Mesh, paint| render(mesh, &camera(), &RigidTransform::IDENTITY, paint, [0; 3]);
    assert!(look(&mesh, Paint::Color).pixels.iter().all(|p| *p == [10, 20, 30]));
    let shape = look(&mesh, Paint::Shape).at(20, 5);
    assert!(shape[0] < shape[1] + 10);
    let houses = look(&mesh, Paint::Building);
    assert_ne!(houses.at(38, 2), houses.at(1, 28));
    mesh.faces.iter_mut().for_each(|f| f.swap(1, 2));
    let back = look(&mesh, Paint::Shape).at(20, 5);
    assert!(back[0] > back[1] + 20);
}
