use super::*;

fn square() -> Mesh {
    Mesh {
        vertices: vec![[0.1, 0.0, 5e6], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
        colors: vec![[1, 2, 3], [4, 5, 6], [7, 8, 9], [255, 0, 1]],
        faces: vec![[0, 1, 2], [0, 2, 3]],
        buildings: vec![3, 70_000],
        groups: vec![0, 12],
        closed: vec![0, 1],
    }
}

#[test]
fn a_mesh_survives_its_file() {
    let bare = Mesh { vertices: square().vertices, faces: square().faces, ..Mesh::default() };
    for mesh in [square(), bare, Mesh::default()] {
        let mut bytes = Vec::new();
        write_mesh(&mut bytes, &mesh, &["made\nby a test".into()]).unwrap();
        assert_eq!(read_mesh("a.ply", &bytes).unwrap(), mesh);
        assert_eq!(Ply::parse("a.ply", &bytes).unwrap().comments, ["made by a test"]);
    }
}

#[test]
fn the_header_of_a_mesh_is_as_promised() {
    let mut bytes = Vec::new();
    write_mesh(&mut bytes, &square(), &[]).unwrap();
    let header = String::from_utf8_lossy(&bytes[..bytes.len() - 4 * 27 - 2 * 25]).into_owned();
    assert_eq!(
        header,
        "ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty double x\nproperty double y\n\
         property double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face 2\n\
         property list uchar int vertex_indices\nproperty uint building\nproperty uint group\nproperty uint closed\nend_header\n"
    );
}

#[test]
fn a_cloud_and_a_table_survive_their_files() {
    let attributes = vec![("building".into(), vec![7, u32::MAX])];
    let cloud = Cloud { positions: vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6e6]], colors: vec![[9; 3]; 2], attributes };
    let mut bytes = Vec::new();
    write_cloud(&mut bytes, &cloud, &[]).unwrap();
    assert_eq!(read_cloud("a.ply", &bytes).unwrap(), cloud);
    assert_eq!(cloud.attribute("building"), Some([7, u32::MAX].as_slice()));

    let names = vec!["x".into(), "opacity".into()];
    let comments = vec!["origin_world 1 -2.5 3e6".into()];
    let table = FloatTable { names, values: vec![1.0, 2.0, f32::NAN, 4.0], comments };
    let mut bytes = Vec::new();
    write_floats(&mut bytes, &table).unwrap();
    let back = read_floats("a.ply", &bytes).unwrap();
    assert_eq!(bytemuck::cast_slice::<_, u8>(&back.values), bytemuck::cast_slice::<_, u8>(&table.values));
    assert_eq!((back.row_count(), back.column("opacity")), (2, Some(1)));
    assert_eq!(origin_world(&back.comments), Some([1.0, -2.5, 3e6]));
}

const QUAD: &str = "ply\nformat FORMAT 1.0\nobj_info x\nelement vertex 4\nproperty float x\nproperty float y\n\
                    property short z\nproperty list uchar float weights\nelement camera 1\nproperty char kind\n\
                    element face 1\nproperty list ushort uint vertex_index\nproperty uchar building\nend_header\n";

#[test]
fn ascii_and_big_endian_polygons_become_fans() {
    let ascii = QUAD.replace("FORMAT", "ascii") + "0 0 -5 0\n1 0 0 1 .5\n1 1 0 2 1 2 0 1 0 0\n-3\n4 0 1 2 3 9\n";
    let mut big = QUAD.replace("FORMAT", "binary_big_endian").replace('\n', "\r\n").into_bytes();
    for (x, y, z) in [(0.0f32, 0.0f32, -5i16), (1.0, 0.0, 0), (1.0, 1.0, 0), (0.0, 1.0, 0)] {
        big.extend(x.to_be_bytes());
        big.extend(y.to_be_bytes());
        big.extend(z.to_be_bytes());
        big.push(0);
    }
    big.extend([253, 0, 4]);
    [0u32, 1, 2, 3].iter().for_each(|index| big.extend(index.to_be_bytes()));
    big.push(9);
    for bytes in [ascii.into_bytes(), big] {
        let mesh = read_mesh("q.ply", &bytes).unwrap();
        assert_eq!(mesh.vertices, [[0.0, 0.0, -5.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
        assert_eq!(mesh.faces, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.buildings, [9, 9]);
    }
}

#[test]
fn hostile_headers_are_refused_at_once() {
    let head = "ply\nformat binary_little_endian 1.0\n";
    for (body, words) in [
        ("element vertex 18446744073709551615\nproperty float x\nend_header\n", "announced"),
        ("element vertex 4000000000\nproperty list uint double x\nend_header\nabcd", "announced"),
        ("element face 1\nproperty list uint uchar x\nend_header\n\u{7f}\u{7f}\u{7f}\u{7f}", "does not fit"),
        ("element face 1\nproperty list float uchar x\nend_header\n", "whole number"),
        ("property float x\n", "before any element"),
        ("element vertex\n", "no count"),
        ("end_heade\n", "unknown keyword"),
        ("element vertex 1\nproperty float x\n", "no end"),
        ("element vertex 1\nproperty float x\nend_header\nabcd", "x, y or z is missing"),
        ("element a 9999999999999\nend_header\n", "no vertices"),
    ] {
        let error = read_mesh("h.ply", format!("{head}{body}").as_bytes()).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains("h.ply"), "{body}: {error}");
    }
}

#[test]
fn wrong_indices_and_places_are_refused() {
    let mut mesh = square();
    mesh.faces[1][2] = 4;
    let mut bytes = Vec::new();
    write_mesh(&mut bytes, &mesh, &[]).unwrap();
    let error = read_mesh("a.ply", &bytes).unwrap_err().to_string();
    assert!(error.contains("face 1 leads to vertex 4"), "{error}");
    mesh = square();
    mesh.vertices[2][1] = f64::NAN;
    bytes.clear();
    write_mesh(&mut bytes, &mesh, &[]).unwrap();
    assert!(read_mesh("a.ply", &bytes).unwrap_err().to_string().contains("vertex 2"));
}

/// Hands over few bytes at a time.
struct Drops<'a>(&'a [u8]);

impl Read for Drops<'_> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let count = into.len().min(self.0.len()).min(7001);
        into[..count].copy_from_slice(&self.0[..count]);
        self.0 = &self.0[count..];
        Ok(count)
    }
}

#[test]
fn a_mesh_comes_through_windows_as_it_is() {
    let count = 3 * ROWS_AT_ONCE as u32 + 17;
    let mesh = Mesh {
        vertices: (0..count).map(|i| [f64::from(i) + 0.25, -f64::from(i), 1e6]).collect(),
        colors: (0..count).map(|i| [i as u8, (i >> 8) as u8, 7]).collect(),
        faces: (2..count).map(|i| [i, i - 1, i - 2]).collect(),
        groups: (2..count).collect(),
        ..Mesh::default()
    };
    let mut bytes = Vec::new();
    write_mesh(&mut bytes, &mesh, &[]).unwrap();
    assert!(bytes.len() > 2 << 20, "more than two windows");
    assert_eq!(read_mesh_from("a.ply", &mut Drops(&bytes), bytes.len() as u64).unwrap(), mesh);
    // A file that has become shorter since it was measured.
    let short = &bytes[..bytes.len() - 1];
    let error = read_mesh_from("a.ply", &mut Drops(short), bytes.len() as u64).unwrap_err().to_string();
    assert!(error.contains("ends within the rows"), "{error}");

    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {count}\nproperty double x\nproperty double y\nproperty double z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nelement face {}\n\
         property list uchar int vertex_indices\nproperty uint group\nend_header\n",
        mesh.faces.len()
    );
    for ([x, y, z], [r, g, b]) in mesh.vertices.iter().zip(&mesh.colors) {
        text += &format!("{x} {y} {z} {r} {g}\t{b}\r\n");
    }
    for ([a, b, c], group) in mesh.faces.iter().zip(&mesh.groups) {
        text += &format!("3 {a} {b} {c} {group}\n");
    }
    assert!(text.len() > 2 << 20, "more than two windows");
    assert_eq!(read_mesh_from("a.ply", &mut Drops(text.as_bytes()), text.len() as u64).unwrap(), mesh);
}
