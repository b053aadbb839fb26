use super::*;

#[test]
fn the_reference_conforms_to_itself_and_every_term_speaks() {
    let report = check(Reference::new);
    assert!(report.passed(), "{report}");
    let norm = |name: String| report.comparisons.iter().find(|c| c.name == name).map_or(0.0, |c| c.norm);
    for scene in scenes::all() {
        let scene = scene.name;
        for (term, value) in
            [("normal", "L_ban"), ("geometric", "L_mvgeo"), ("NCC", "L_mvrgb"), ("load", "σ of the load")]
        {
            assert!(norm(format!("{scene}: {term}: {value}")) > 0.0, "{scene}: {term} is 0");
        }
        for kind in ["means", "scales", "rotations", "opacities", "harmonics"] {
            assert!(norm(format!("{scene}: all terms: gradient of {kind}")) > 0.0, "{scene}: {kind}");
        }
    }
    assert!(norm("masked: free opacity: free opacity".into()) > 0.0);
}

#[test]
fn a_backend_with_another_cut_is_caught() {
    let report = check(|limits| Reference::new(Limits { alpha_cut: 2.0 * limits.alpha_cut + 0.003, ..limits }));
    assert!(!report.passed());
}
