//! Expressions as crates spell them, and a list that must refuse.

use super::*;

fn list() -> Vec<String> {
    ["MIT", "Apache-2.0", "Unicode-3.0", "Apache-2.0 WITH LLVM-exception"].map(str::to_owned).to_vec()
}

#[test]
fn expressions_are_read_as_spdx() {
    for good in [
        "MIT",
        "MIT/Apache-2.0",
        "Apache-2.0 / MIT",
        "GPL-3.0 OR MIT",
        "(MIT OR Apache-2.0) AND Unicode-3.0",
        "Apache-2.0 WITH LLVM-exception",
        "MIT OR Apache-2.0 OR LGPL-2.1-or-later",
    ] {
        assert!(is_allowed(good, &list()), "{good}");
    }
    for bad in ["GPL-3.0", "MIT AND GPL-3.0", "", "(MIT", "MIT)", "MIT OR", "MIT WITH Odd-exception", "LicenseRef-mine"]
    {
        assert!(!is_allowed(bad, &list()), "{bad}");
    }
}

#[test]
fn and_binds_tighter_than_or() {
    assert!(is_allowed("MIT OR MIT AND GPL-3.0", &list()));
    assert!(!is_allowed("GPL-2.0 OR MIT AND GPL-3.0", &list()));
}

#[test]
fn the_list_is_read_past_comments_and_lines() {
    let deny = "[licenses]\nallow = [\n    \"MIT\", # \"GPL-3.0\"\n    \"Zlib\",\n]\n[bans]\ndeny = [\"openssl\"]\n";
    assert_eq!(allow_list(deny), ["MIT", "Zlib"]);
    assert_eq!(allow_list("allow = [\"MIT\"]\nx = [\"no\"]"), ["MIT"]);
}

#[test]
fn a_package_without_a_licence_is_refused() {
    let metadata = r#"{"packages":[{"name":"a","version":"1.0.0","license":"MIT"},
        {"name":"b","version":"2.0.0","license":null},{"name":"c","version":"3.0.0","license":"AGPL-3.0"}]}"#;
    let (count, refused) = check(metadata, &list()).unwrap();
    assert_eq!(count, 3);
    assert_eq!(refused, ["b 2.0.0: no licence given", "c 3.0.0: AGPL-3.0"]);
}

#[test]
fn no_package_at_all_is_an_error() {
    assert!(check("{}", &list()).is_err());
}
