use super::*;
use crate::golden;

#[derive(serde::Deserialize)]
struct Crops {
    size: [u32; 2],
    layers: u32,
    boxes: Vec<Window>,
}

#[derive(serde::Deserialize)]
struct Goldens {
    boxes: Vec<Corners>,
    scores: Vec<f32>,
    kept: std::collections::BTreeMap<String, Vec<usize>>,
    grid4: Vec<[f64; 2]>,
    grid3: Vec<[f64; 2]>,
    crops: Vec<Crops>,
}

#[test]
fn near_copies_go_as_in_python() {
    let goldens: Goldens = golden::read("shapes.json");
    for (most, kept) in goldens.kept {
        let most = most.parse().expect("a number");
        assert_eq!(suppress(&goldens.boxes, &goldens.scores, most), kept, "{most}");
    }
}

#[test]
fn grids_and_crops_are_the_reference_s() {
    let goldens: Goldens = golden::read("shapes.json");
    for (count, wanted) in [(4, goldens.grid4), (3, goldens.grid3)] {
        let grid = point_grid(count);
        assert_eq!(grid.len(), wanted.len());
        for (got, wanted) in grid.iter().zip(&wanted) {
            assert!((got[0] - wanted[0]).abs() < 1e-12 && (got[1] - wanted[1]).abs() < 1e-12, "{got:?} {wanted:?}");
        }
    }
    for case in goldens.crops {
        assert_eq!(crops(case.size[0], case.size[1], case.layers), case.boxes);
    }
}

#[test]
fn tiles_cover_the_image_and_overlap() {
    let windows = tiles(4000, 1000, 1600, 0.2);
    assert_eq!(windows, [[0, 0, 1600, 1000], [1200, 0, 2800, 1000], [2400, 0, 4000, 1000]]);
    for side in [100, 333, 999, 1000] {
        let windows = tiles(1000, 700, side, 0.25);
        for (x, y) in [(0, 0), (999, 699), (500, 350), (333, 101)] {
            assert!(windows.iter().any(|[x0, y0, x1, y1]| (*x0..*x1).contains(&x) && (*y0..*y1).contains(&y)));
        }
        assert!(windows.iter().all(|window| window[2] <= 1000 && window[3] <= 700));
    }
}
