//! A whole run: it finishes, it is good enough, it does nothing twice, and the number of threads does not matter.

use pgsag_scene::Map;
use pgsag_scene::files::raster::{decode_instances, encode_instances_png};

use super::*;

#[test]
fn a_town_becomes_buildings_with_a_score() {
    let (folder, result, _) = reference();
    for name in [
        "city.ply",
        "buildings.ply",
        "buildings/b001.ply",
        "buildings/b002.ply",
        "city.glb",
        "buildings.geojson",
        "gaussians/g001.ply",
        "gaussians/bg01.ply",
        "georef.json",
        "score.json",
        "evidence.json",
    ] {
        assert!(result.contains_key(name), "{name} is missing: {:?}", result.keys());
    }
    let score: Value = serde_json::from_slice(&result["score.json"]).expect("JSON");
    let f1 = score["scores"][3]["f1"].as_f64().expect("a number");
    assert!(f1 > 0.6, "F1 at {} m is {f1}", score["scores"][3]["threshold_m"]);
    let identity = &score["panoptic"];
    assert_eq!((&identity["found"], &identity["matched"]), (&Value::from(2), &Value::from(2)), "{identity}");
    assert!(identity["quality"].as_f64().is_some_and(|quality| quality > 0.6), "{identity}");
    assert!(score["points_off_buildings"].as_f64().is_some_and(|share| share < 0.1), "{score}");
    let report = fs::read_to_string(folder.path().join("run/result/report.html")).expect("a report");
    assert!(report.contains("data:image/jpeg;base64,"), "pictures");
    assert!(report.contains("<polyline"), "curves");
    assert!(report.contains("panoptic quality 0.") && report.contains("2 clusters of building points"), "identity");
    assert!(!report.contains("http://") && !report.contains("https://"), "offline");
}

#[test]
fn given_instances_name_the_buildings() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let (run, instances) = (folder.path().join("run"), folder.path().join("instances"));
    fs::create_dir(&instances).expect("a folder");
    for entry in fs::read_dir(town().join("truth/instances")).expect("instances").map(|entry| entry.expect("an entry"))
    {
        let found = decode_instances("truth", &fs::read(entry.path()).expect("a raster")).expect("sound");
        let values = found.values.iter().map(|number| [0, 70, 9][usize::from(*number)]).collect();
        let renamed = encode_instances_png(&Map { values, ..found });
        fs::write(instances.join(entry.file_name()), renamed).expect("written");
    }
    let mut command = reconstruct(town(), &run);
    command.args(["--iterations", "60", "--set"]).arg(format!("instances={}", instances.display()));
    finish(command);
    let result = result_of(&run);
    let names: Vec<&String> = result.keys().filter(|name| name.starts_with("buildings/")).collect();
    assert_eq!(names, ["buildings/b009.ply", "buildings/b070.ply"]);
    let score: Value = serde_json::from_slice(&result["score.json"]).expect("JSON");
    assert_eq!(score["panoptic"]["matched"], 2, "{}", score["panoptic"]);
}

#[test]
fn a_finished_run_does_nothing_and_a_changed_setting_only_what_it_must() {
    let (folder, ..) = reference();
    let copy = tempfile::tempdir().expect("temporary folder");
    let run = copy.path().join("run");
    let copied = Command::new("cp").arg("-r").arg(folder.path().join("run")).arg(&run).status().expect("cp");
    assert!(copied.success());
    let again = finish(reconstruct(town(), &run));
    assert_eq!(last_line(&again)["ran"], 0, "{}", words(&again));
    let mut finer = reconstruct(town(), &run);
    finer.args(["--set", "surface.voxel_gsd=1.5"]);
    // The cubes' surface, the merged city, its score and the report.
    assert_eq!(last_line(&finish(finer))["ran"], 4);
    let plan = finish({
        let mut plan = pgsag(["plan"]);
        plan.arg(&run).args(["--set", "train.weights.ncc=0.1"]);
        plan
    });
    assert!(words(&plan).contains("train.weights.ncc: 0.15"), "{}", words(&plan));
    let status = finish({
        let mut status = pgsag(["status"]);
        status.arg(&run);
        status
    });
    assert!(words(&status).contains("0 running, 0 waiting, 0 failed"), "{}", words(&status));
}

#[test]
fn two_threads_and_two_jobs_give_the_same_bytes_as_one() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = folder.path().join("run");
    let mut command = reconstruct(town(), &run);
    command.args(["--threads", "2", "--jobs", "2"]);
    finish(command);
    assert_eq!(differing(&result_of(&run), &reference().1), Vec::<String>::new());
}

#[test]
fn without_masks_there_is_one_surface_and_it_is_said() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = folder.path().join("run");
    let mut command = reconstruct(town(), &run);
    command.args(["--masks", "none", "--iterations", "60", "--holdout", "6"]);
    let output = finish(command);
    assert!(words(&output).contains("buildings are not separated"), "{}", words(&output));
    let result = result_of(&run);
    assert_eq!(result["city.ply"], result["buildings.ply"]);
    assert!(!result.contains_key("buildings/b001.ply"));
    let summary = fs::read_to_string(run.join("07-train/g001/train.json")).expect("a summary");
    let summary: Value = serde_json::from_str(&summary).expect("JSON");
    assert_eq!(summary["held_out"].as_array().map(Vec::len), Some(2), "every sixth of twelve");
}

#[test]
fn a_result_says_how_good_it_is_without_truth_and_against_another() {
    let (folder, result, _) = reference();
    let evidence: Value = serde_json::from_slice(&result["evidence.json"]).expect("JSON");
    let flow = &evidence["flow"];
    assert_eq!(flow["held_out"], false);
    let count = |of: &Value| of["patches"].as_u64().expect("a number");
    assert!(count(&flow["all"]) > 500 && count(&flow["buildings"]) > 50, "{flow}");
    assert_eq!(count(&flow["all"]), count(&flow["buildings"]) + count(&flow["background"]));
    let bias = flow["all"]["surface_m"]["bias"].as_f64().expect("a number");
    assert!(bias.abs() < 0.4, "less than a ground sampling distance: {bias}");
    assert!((evidence["gsd_m"].as_f64().expect("a number") - 0.4).abs() < 0.15, "{}", evidence["gsd_m"]);
    assert_eq!(evidence["points"], Value::Null, "without stereo no point can be spared");
    let report = fs::read_to_string(folder.path().join("run/result/report.html")).expect("a report");
    for words in ["Accuracy without truth", "they have been fitted", "residuals between photographs", "surface normals"]
    {
        assert!(report.contains(words), "{words}");
    }
    assert!(report.contains("truth by its distance from the surface"), "there is a truth");
    let mesh = folder.path().join("run/result/buildings.ply");
    let against = finish({
        let mut score = pgsag(["score", "--json"]);
        score.arg(&mesh).arg("--against").arg(&mesh);
        score
    });
    let found = last_line(&against);
    assert_eq!(found["from_first_m"]["alone"], 0.0, "{found}");
    assert!(found["from_first_m"]["p95"].as_f64().expect("a number") < 1e-6, "{found}");
}
