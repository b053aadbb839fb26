//! Rows without runs.

use super::*;

fn done(name: &'static str, set: &'static [&'static str], seed: u32, f1: f64) -> Done {
    let row = Row { name, what: name, set, seed };
    let figures = Figures { f1: [f1 - 0.1, f1], accuracy_m: 0.04, gaussians: 1000.0, ..Figures::default() };
    Done { scene: "town", row, commit: "abc".into(), figures: Some(figures) }
}

#[test]
fn a_row_counts_where_it_leaves_the_spread_of_the_seeds() {
    let base = [done("base", &[], 0, 0.95), done("base-seed-1", &[], 1, 0.96), done("base-seed-2", &[], 2, 0.955)];
    let small = done("small", &["a=1"], 0, 0.960);
    let large = done("large", &["b=2"], 0, 0.930);
    let failed = Done { figures: None, ..done("failed", &["c=3"], 0, 0.0) };
    let all: Vec<Done> = base.into_iter().chain([small, large, failed]).collect();
    let page = table::page(&["town"], &all, 800);
    assert!(page.contains("differ by 0.0100 in F1 at 0.1 m and 0.0100 at 0.2 m"), "{page}");
    assert!(page.contains("| small | `a=1` | 0.860 (+0.005) |") && page.contains("| **large** |"), "{page}");
    assert!(page.contains("Commits: abc. Seeds"), "{page}");
    assert!(page.contains("| failed | `c=3` | failed |"), "{page}");
    let list = Json::parse(&table::list(&all, 800)).expect("JSON");
    assert_eq!(list.list().len(), 6);
    assert_eq!(list.list()[4].get("counts"), Some(&Json::Bool(true)));
    assert_eq!(list.list()[3].get("counts"), Some(&Json::Bool(false)));
    let without_seeds = table::page(&["town"], &all[..1], 800);
    assert!(without_seeds.contains("| base | seed 0 | 0.850 | 0.950 |"), "{without_seeds}");
}

#[test]
fn figures_are_remembered_by_what_decided_them() {
    let figures = Figures {
        f1: [0.5, 0.75],
        accuracy_m: 0.03,
        completeness_m: 0.05,
        edge_m: 0.06,
        gaussians: 12.0,
        cpu_secs: 90.5,
    };
    let text = figures.to_text("abc", "800 0 []");
    assert_eq!(Figures::remembered(&text, "800 0 []"), Some(("abc".into(), figures)));
    assert_eq!(Figures::remembered(&text, "900 0 []"), None);
    assert_eq!(Figures::remembered("{", "abc"), None);
}

#[test]
fn words_are_understood_and_rows_are_known() {
    let words = |text: &str| text.split(' ').map(str::to_owned).collect::<Vec<_>>();
    let typed = wish(&words("--rows no-ncc,load --iterations 60 --tiny")).expect("good");
    assert_eq!((typed.iterations, typed.tiny), (60, true));
    let names: Vec<&str> = chosen(&typed).expect("known").iter().map(|row| row.name).collect();
    assert_eq!(names, ["base", "base-seed-1", "base-seed-2", "no-ncc", "load"]);
    assert!(wish(&words("--rows")).is_err() && wish(&words("--row x")).is_err());
    assert!(chosen(&wish(&words("--rows nothing")).expect("good")).is_err());
    let all = rows();
    assert!(all.iter().enumerate().all(|(k, row)| all[..k].iter().all(|other| other.name != row.name)));
    assert!(
        all.iter()
            .flat_map(|row| row.set)
            .all(|set| set.split_once('=').is_some_and(|(key, _)| key.contains('.') || key == "image_width"))
    );
}

#[test]
fn widths_are_shares_of_the_scene() {
    let scene = Scene { name: "town", folder: PathBuf::new(), width: 320, words: Vec::new() };
    assert_eq!(assignment("image_width=1/4", &scene), "image_width=80");
    assert_eq!(assignment("surface.voxel_gsd=1.5", &scene), "surface.voxel_gsd=1.5");
}

#[test]
fn linked_files_are_the_same_and_locks_stay() {
    let folder = std::env::temp_dir().join(format!("pgsag-ablate-{}", std::process::id()));
    let (from, to) = (folder.join("a"), folder.join("b"));
    make(&from.join("stage")).expect("made");
    write(&from.join("stage/x"), "1").expect("written");
    write(&from.join("lock"), "me").expect("written");
    linked(&from, &to).expect("linked");
    assert_eq!(std::fs::read_to_string(to.join("stage/x")).expect("there"), "1");
    assert!(!to.join("lock").exists());
    remove(&folder).expect("removed");
}
