//! A ledger of two rows over a file of four lines.

use super::*;

const CODE: &str = "\
/// Eq. 4.
pub fn depth<T: Number>(d: T) -> T { d }
#[test]
#[expect(clippy::float_cmp, reason = \"exact\")]
fn depth_is_identity() {}
fn not_a_test() {}
";

fn read(path: &str) -> Option<String> {
    matches!(path, "crates/pgsag-splat/src/equations/plane.rs" | "crates/pgsag-mesh/src/tsdf.rs")
        .then(|| CODE.to_owned())
}

fn faults_of(row: &str) -> Vec<String> {
    let ledger = format!(
        "text\n\n| paper | function | test | stand |\n|---|:--|---|---|\n{row}\n\n| other | table |\n|---|---|\n| x | y |\n"
    );
    let (row_count, faults) = check(&ledger, &read);
    assert_eq!(row_count, 1);
    faults
}

#[test]
fn living_names_pass() {
    let row = "| Eq. 4 | `equations/plane.rs::depth` | `pgsag-mesh/src/tsdf.rs::depth_is_identity` | a \\| b |";
    assert!(faults_of(row).is_empty(), "{:?}", faults_of(row));
}

#[test]
fn a_dead_function_fails() {
    let faults = faults_of("| Eq. 4 | `equations/plane.rs::dep` | `equations/plane.rs::depth_is_identity` | |");
    assert_eq!(
        faults,
        ["line 5: `equations/plane.rs::dep`: crates/pgsag-splat/src/equations/plane.rs has no function `dep`"]
    );
}

#[test]
fn a_function_is_no_test() {
    let faults = faults_of("| Eq. 4 | `equations/plane.rs::depth` | `equations/plane.rs::not_a_test` | |");
    assert!(faults[0].contains("no test `not_a_test`"), "{faults:?}");
}

#[test]
fn a_missing_file_or_name_fails() {
    assert!(
        faults_of("| 4 | `equations/no.rs::depth` | `equations/plane.rs::depth_is_identity` | |")[0]
            .contains("no file")
    );
    assert!(faults_of("| 4 | `equations/plane.rs::depth` | by eye | |")[0].contains("no test is named"));
}

#[test]
fn an_empty_ledger_has_no_rows() {
    assert_eq!(check("# paper\n\n| a | b |\n|---|---|\n| 1 | 2 |\n", &read).0, 0);
}
