//! The lexer on the corners of Rust's grammar that would fool a search.

use super::*;

fn paths_of(code: &str) -> Vec<String> {
    Source::new("a.rs", code).paths().into_iter().map(|(_, parts)| parts.join("::")).collect()
}

#[test]
fn comments_and_literals_are_blanked_and_kept_aside() {
    let source = Source::new("a.rs", "let a = \"unsafe \\\" x\"; // unsafe\n/* un /* in */ safe */ let b = 'u';");
    assert!(!source.code.contains("unsafe") && !source.code.contains("safe"));
    assert_eq!(source.literals, [(1, "unsafe \\\" x".to_owned())]);
    assert_eq!(source.comments[0], (1, "// unsafe".to_owned()));
    assert_eq!(source.comments[1].0, 2);
    assert!(source.code.ends_with("let b = ' ';"));
}

#[test]
fn raw_strings_lifetimes_and_byte_characters() {
    let source =
        Source::new("a.rs", "fn f<'a>(x: &'a str) { g(r#\"a \" unsafe\"#, br\"unsafe\", b'\"', '\\'', '\"'); h() }");
    assert!(!source.code.contains("unsafe"));
    assert!(source.code.contains("fn f<'a>(x: &'a str)") && source.code.contains("h() }"));
    assert_eq!(source.literals.len(), 2);
}

#[test]
fn a_word_that_ends_in_r_is_no_raw_string() {
    let source = Source::new("a.rs", "number\"x\"; y");
    assert_eq!(source.literals, [(1, "x".to_owned())]);
    assert!(source.code.ends_with("; y"));
}

#[test]
fn use_trees_are_spelled_out() {
    let code = "use crate::{cpu::{Cpu, lanes as l}, train::*};\nuse glam;\nlet x = a::b::<f32>(c::d);";
    assert_eq!(paths_of(code), ["crate::cpu::Cpu", "crate::cpu::lanes", "crate::train", "glam", "a::b", "c::d"]);
}

#[test]
fn a_match_arm_is_no_use_group() {
    assert_eq!(paths_of("match x { Kind::A => 1, _ => 2 } loop { y }"), ["Kind::A"]);
}

#[test]
fn test_modules_are_test_lines() {
    let source = Source::new("a.rs", "fn a() {}\n#[cfg(test)]\nmod tests {\n    fn b() {}\n}\nfn c() {}\n");
    let product: Vec<usize> = source.product_lines().map(|(line, _)| line).collect();
    assert_eq!(product, [1, 6]);
    let outside = Source::new("a.rs", "#[cfg(test)]\nmod tests;\nfn c() {}\n");
    assert!(!outside.is_test_line(3));
}

#[test]
fn a_file_declared_for_tests_is_test_code() {
    let mut sources = vec![
        Source::new("crates/a/src/equations.rs", "#[cfg(test)]\nmod proof;\nmod plane;\n"),
        Source::new("crates/a/src/equations/proof.rs", ""),
        Source::new("crates/a/src/equations/plane.rs", ""),
        Source::new("crates/a/tests/it.rs", ""),
    ];
    mark_test_modules(&mut sources);
    assert_eq!(sources.iter().map(|source| source.is_test).collect::<Vec<_>>(), [false, true, false, true]);
}
