//! Every rule has an example that must fail and a near miss that must pass.

use super::*;

fn messages(path: &str, text: &str) -> Vec<String> {
    check(&Source::new(path, text)).into_iter().map(|finding| finding.message).collect()
}

/// `text` breaks exactly one rule, at the line that holds `HERE`.
#[track_caller]
fn breaks(path: &str, text: &str, part_of_message: &str) {
    let findings = check(&Source::new(path, text));
    assert_eq!(findings.len(), 1, "{findings:?}");
    assert!(findings[0].message.contains(part_of_message), "{findings:?}");
    let expected = text.lines().position(|line| line.contains("HERE")).map_or(1, |index| index + 1);
    assert_eq!(findings[0].line, expected, "{findings:?}");
}

#[track_caller]
fn passes(path: &str, text: &str) {
    assert_eq!(messages(path, text), Vec::<String>::new());
}

const TRAIN: &str = "crates/pgsag-splat/src/train/trainer.rs";
const PLANE: &str = "crates/pgsag-splat/src/equations/plane.rs";
const VOTE: &str = "crates/pgsag-group/src/vote.rs";

#[test]
fn a_long_file_is_refused() {
    let text = format!("//! x\n{}", "\n".repeat(600));
    assert_eq!(messages(VOTE, &text), ["601 lines; a chapter has at most 600"]);
    passes(VOTE, &format!("//! x\n{}", "\n".repeat(599)));
}

#[test]
fn a_file_without_a_header_is_refused() {
    breaks(VOTE, "/// HERE\nfn a() {}", "opens with");
    passes("crates/pgsag-group/src/vote/tests.rs", "use super::*;");
}

#[test]
fn unfinished_marks_are_refused() {
    breaks(VOTE, "//! x\n// TO\u{44}O: HERE", "open an issue");
    breaks(VOTE, "//! x\nfn a() { /* HERE FIX\u{4d}E */ }", "open an issue");
    breaks(VOTE, "//! x\nfn a() { todo!() } // HERE", "no stubs");
    breaks(VOTE, "//! x\nfn a() { unimplemented!() } // HERE", "no stubs");
    passes(VOTE, "//! x\nconst A: &str = \"TODO\";\n// TODOS are a list\nfn todo() {}");
}

#[test]
fn attributes_say_why() {
    breaks(VOTE, "//! x\n#[ignore] // HERE\nfn a() {}", "without a reason");
    breaks(VOTE, "//! x\n#[allow(dead_code)] // HERE\nfn a() {}", "without a reason");
    breaks(VOTE, "//! x\n#![expect( // HERE\n    dead_code\n)]\nfn a() {}", "without a reason");
    passes(
        VOTE,
        "//! x\n#[ignore = \"an hour\"]\n#[expect(dead_code, reason = \"x\")]\n#[derive(Clone)]\nfn allow() {}",
    );
}

#[test]
fn unsafe_has_no_room_here() {
    breaks(VOTE, "//! x\nfn a() { unsafe { b() } } // HERE", "outside of pgsag-gpu");
    passes(VOTE, "//! unsafe in words\n#![forbid(unsafe_code)]\nconst A: &str = \"unsafe\";");
    passes("crates/pgsag-gpu/src/device.rs", "//! x\nfn a() { unsafe { b() } }");
}

#[test]
fn a_library_does_not_print() {
    breaks(VOTE, "//! x\nfn a() { eprintln!(\"x\"); } // HERE", "does not print");
    passes(VOTE, "//! x\n#[cfg(test)]\nmod tests { fn a() { println!(); } }");
    passes("crates/pgsag/src/main.rs", "//! x\nfn main() { eprintln!(); }");
}

#[test]
fn the_device_is_asked_for_in_one_place() {
    breaks("crates/pgsag/src/config.rs", "//! x\n#[cfg(feature = \"gpu\")] // HERE\nfn a() {}", "engine.rs");
    passes("crates/pgsag/src/engine.rs", "//! x\n#[cfg(feature = \"gpu\")]\nfn a() {}");
}

#[test]
fn sister_crates_do_not_meet() {
    breaks(VOTE, "//! x\nuse pgsag_splat::SplatCloud; // HERE", "replaced alone");
    breaks("crates/pgsag-mesh/src/fuse.rs", "//! x\nfn a(b: &pgsag_group::Group) {} // HERE", "replaced alone");
    breaks("crates/pgsag-scene/src/pose.rs", "//! x\nuse pgsag_mesh::tsdf; // HERE", "floor 1");
    passes(VOTE, "//! x\nuse pgsag_scene::{Mask, Scene};");
}

#[test]
fn the_schedule_names_no_device() {
    breaks(TRAIN, "//! x\nuse crate::{backend::Backend, cpu::Cpu}; // HERE", "written once");
    breaks(TRAIN, "//! x\nuse super::super::reference::Reference; // HERE", "written once");
    passes(TRAIN, "//! x\nuse crate::Backend;\n#[cfg(test)]\nmod tests {\n    use crate::reference::Reference;\n}");
    passes("crates/pgsag-splat/src/train/tests.rs", "//! x\nuse crate::cpu::Cpu;");
}

#[test]
fn equations_are_pure() {
    breaks(PLANE, "//! x\nfn a() { Vec::new(); } // HERE", "pure");
    breaks(PLANE, "//! x\nuse crate::Backend; // HERE", "pure");
    passes(PLANE, "//! x\nuse super::number::Number;\nuse crate::backend::ViewCamera;");
}

#[test]
fn the_waist_knows_no_device() {
    breaks("crates/pgsag-splat/src/backend.rs", "//! x\nuse crate::cpu; // HERE", "narrow waist");
    passes("crates/pgsag-splat/src/backend.rs", "//! x\nuse crate::cloud::SplatCloud;");
}

#[test]
fn devices_do_not_know_one_another() {
    breaks("crates/pgsag-splat/src/cpu/tiles.rs", "//! x\nuse crate::reference; // HERE", "no twin");
    passes("crates/pgsag-splat/src/conformance.rs", "//! x\nuse crate::{cpu::Cpu, reference::Reference};");
}

#[test]
fn the_runner_names_no_stage() {
    breaks("crates/pgsag/src/run/plan.rs", "//! x\nuse crate::stages::vote; // HERE", "toy stages");
    breaks("crates/pgsag/src/run/plan.rs", "//! x\nfn a() { b(\"vote\") } // HERE", "names the stage");
    passes(
        "crates/pgsag/src/run/plan.rs",
        "//! x\nfn a() { b(\"vote for it\") }\n#[cfg(test)]\nmod tests { const A: &str = \"vote\"; }",
    );
    passes("crates/pgsag/src/pipeline.rs", "//! x\nuse crate::stages::vote;");
}

#[test]
fn libraries_open_no_files() {
    breaks(VOTE, "//! x\nfn a() { std::fs::read(\"x\"); } // HERE", "product's");
    breaks("crates/pgsag-scene/src/mask.rs", "//! x\nuse std::fs::File; // HERE", "`files`");
    passes("crates/pgsag-scene/src/files/raster.rs", "//! x\nuse std::fs::File;");
    passes("crates/pgsag/src/run/manifest.rs", "//! x\nuse std::fs::File;");
}

#[test]
fn empty_names_and_scripts_are_refused() {
    let paths = [
        "crates/a/src/utils.rs",
        "crates/a/src/glue/b.rs",
        "tools/run.sh",
        "scripts/run.py",
        "data/readme.md",
        "crates/a/tests/golden/b.py",
        "tools/export.py",
    ];
    let findings = text::forbidden_names(&paths.map(str::to_owned));
    assert_eq!(findings.iter().map(|finding| finding.path.as_str()).collect::<Vec<_>>(), paths[..4]);
}

#[test]
fn manifests_keep_the_floors() {
    let lints = "[lints]\nworkspace = true\n";
    let bad = format!(
        "[package]\nname = \"pgsag-mesh\"\n{lints}[dependencies]\npgsag-scene.workspace = true\npgsag-splat.workspace = true\n"
    );
    let findings = manifests::check("crates/pgsag-mesh/Cargo.toml", &bad);
    assert_eq!(
        findings,
        [Finding::new("crates/pgsag-mesh/Cargo.toml", 7, "`pgsag-mesh` must not depend on `pgsag-splat`")]
    );
    let dev =
        format!("[package]\nname = \"pgsag-group\"\n{lints}[dev-dependencies]\npgsag-mesh = {{ path = \"x\" }}\n");
    assert_eq!(manifests::check("crates/pgsag-group/Cargo.toml", &dev).len(), 1);
    let tool = format!("[package]\nname = \"xtask\"\n{lints}[dependencies]\nserde = \"1\"\n");
    assert!(manifests::check("xtask/Cargo.toml", &tool)[0].message.contains("std only"));
    assert!(manifests::check("crates/new/Cargo.toml", "name = \"new\"")[0].message.contains("no place in the house"));
    assert!(manifests::check("crates/pgsag-scene/Cargo.toml", "name = \"pgsag-scene\"")[0].message.contains("lints"));
}

#[test]
fn lines_are_counted_without_comments() {
    let source = Source::new("crates/pgsag-mesh/src/a.rs", "//! x\n\nfn a() {}\n#[cfg(test)]\nmod tests {\n}\n");
    assert_eq!(lines_by_crate(&[source])["pgsag-mesh"], (1, 3));
}
