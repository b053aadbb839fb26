use super::*;

#[test]
fn positions_decay_to_the_final_share() {
    let options = TrainOptions::fast();
    let first = options.rates_at(1, 2.0).means;
    let last = options.rates_at(options.iterations, 2.0).means;
    assert!((first - 2.0 * options.rates.position_gsd).abs() < 1e-6);
    assert!((last / first - options.rates.position_final).abs() < 1e-6);
}

#[test]
fn degree_rises_and_stops_at_what_is_stored() {
    let options = TrainOptions::paper();
    let degrees = [1, 1000, 1001, 2001, 3001, 30_000].map(|i| options.sh_degree_at(i, 3));
    assert_eq!(degrees, [0, 0, 1, 2, 3, 3]);
    assert_eq!(options.sh_degree_at(30_000, 2), 2);
}

#[test]
fn geometry_starts_ramps_and_its_gate_shrinks() {
    let options = TrainOptions::paper();
    let before = options.weights_at(7000);
    assert_eq!((before.normal, before.geometric, before.ncc), (0.0, 0.0, 0.0));
    let half = options.weights_at(7500);
    assert!((half.ncc - 0.1).abs() < 1e-4 && half.geometric_gate_px < 4.0 && half.geometric_gate_px > 3.0);
    let full = options.weights_at(30_000);
    assert_eq!((full.normal, full.geometric, full.ncc), (0.01, 0.05, 0.2));
    assert!((full.geometric_gate_px - 1.0).abs() < 1e-6);
}

#[test]
fn any_count_from_500_up_has_a_sane_calendar() {
    for iterations in [500, 777, 3000, 9999, 10_000, 30_000] {
        let options = TrainOptions { iterations, ..TrainOptions::default() };
        let densified = (1..=iterations).filter(|i| options.densifies_at(*i)).count();
        assert!(densified >= 2 && densified <= iterations as usize / 200 + 1, "{iterations}: {densified}");
        let resets = (1..=iterations).filter(|i| options.resets_opacity_at(*i)).count();
        assert_eq!(resets > 0, iterations >= 10_000, "{iterations}: {resets}");
        assert!((1..=iterations).any(|i| options.weights_at(i).ncc > 0.0));
        assert!(!options.trims_at(iterations));
    }
}

#[test]
fn culling_waits_for_every_view_after_a_reset() {
    let options = TrainOptions { iterations: 30_000, ..TrainOptions::default() };
    assert!(options.culls_at(3000, 50));
    assert!(!options.culls_at(3100, 50));
    assert!(options.culls_at(3500, 50));
    assert!(!options.culls_at(3500, 800));
    assert!(options.culls_at(3800, 800));
}

#[test]
fn options_survive_toml_and_refuse_nonsense() {
    let text = serde_json::to_string(&TrainOptions::fast()).expect("plain numbers");
    assert_eq!(serde_json::from_str::<TrainOptions>(&text).expect("own text"), TrainOptions::fast());
    assert_eq!(serde_json::from_str::<TrainOptions>("{}").expect("all defaults"), TrainOptions::default());
    assert!(serde_json::from_str::<TrainOptions>(r#"{"iteration": 5}"#).is_err());
    let bad = TrainOptions { geometric_start: 1.5, ..TrainOptions::default() };
    assert!(bad.check().is_err_and(|e| e.to_string().contains("geometric_start")));
    assert!(TrainOptions::paper().check().is_ok());
}
