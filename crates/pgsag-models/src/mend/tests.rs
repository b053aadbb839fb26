use super::*;

fn mask(rows: &[&str]) -> Map<bool> {
    let values = rows.iter().flat_map(|row| row.bytes().map(|letter| letter == b'#')).collect();
    Map { width: rows[0].len() as u32, height: rows.len() as u32, values }
}

fn mended(rows: &[&str], how: Mending) -> Map<bool> {
    let mut mask = mask(rows);
    mend(&mut mask, &how);
    mask
}

#[test]
fn holes_are_filled_but_bays_are_not() {
    let how = Mending { hole_px: 2, ..Mending::default() };
    assert_eq!(mended(&["#####", "#.#.#", "#####", "#.###"], how), mask(&["#####", "#####", "#####", "#.###"]));
    let large = ["#####", "#...#", "#####"];
    assert_eq!(mended(&large, how), mask(&large));
}

#[test]
fn specks_go_and_edges_grow() {
    let how = Mending { speck_px: 3, grow_px: 1, ..Mending::default() };
    let got = mended(&["#.....", "......", "...##.", "...##.", "......"], how);
    assert_eq!(got, mask(&["......", "..####", "..####", "..####", "..####"]));
}
