//! Two software adapters stand in for two graphics cards.
//!
//! Where there is no software adapter the test says so and passes, unless `PGSAG_REQUIRE_GPU=1`.

#![cfg(target_os = "linux")]

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Where drivers announce themselves to the Vulkan loader.
const ANNOUNCED_IN: [&str; 3] = ["/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d"];

/// The software driver, announced twice: two adapters.
fn two_cards(folder: &Path) -> Option<String> {
    let entries = ANNOUNCED_IN.iter().filter_map(|folder| fs::read_dir(folder).ok()).flatten().filter_map(Result::ok);
    let found = entries.map(|entry| entry.path()).find(|path| {
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        // Of drivers for other processors that lie beside it none can be loaded.
        name.starts_with("lvp_icd") && (name.contains(std::env::consts::ARCH) || name == "lvp_icd.json")
    })?;
    let twice = ["first.json", "second.json"].map(|name| folder.join(name));
    for path in &twice {
        fs::copy(&found, path).expect("copied");
    }
    Some(twice.map(|path| path.display().to_string()).join(":"))
}

/// Processes that train on a device for this run: (pid, device).
fn trainers(run: &Path) -> Vec<(u32, String)> {
    let of_process = |pid: u32| {
        let line = fs::read(format!("/proc/{pid}/cmdline")).ok()?;
        let words: Vec<String> =
            line.split(|byte| *byte == 0).map(|w| String::from_utf8_lossy(w).into_owned()).collect();
        let is_ours = words.get(1..3).is_some_and(|words| words == ["job", "train"])
            && words.iter().any(|word| Path::new(word) == run);
        let device = words.iter().position(|word| word == "--device").and_then(|at| words.get(at + 1))?;
        is_ours.then(|| (pid, device.clone()))
    };
    let processes = fs::read_dir("/proc").expect("Linux").filter_map(Result::ok);
    processes.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).filter_map(of_process).collect()
}

#[test]
fn two_cards_train_at_once_and_the_death_of_one_process_costs_a_retry() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let Some(drivers) = two_cards(folder.path()) else {
        assert!(std::env::var("PGSAG_REQUIRE_GPU").map_or(true, |value| value != "1"), "no software adapter");
        return eprintln!("SKIPPED, NOT TESTED: no software adapter. Install mesa-vulkan-drivers.");
    };
    let (town, run) = (folder.path().join("town"), folder.path().join("run"));
    let mut command = Command::new(env!("CARGO_BIN_EXE_pgsag"));
    command.args(["town", "--houses", "2", "--row-houses", "0", "--views", "12", "--points", "700", "--width", "96"]);
    command.args(["--height", "64", "--gsd", "0.4", "--exact-masks", "--no-depth", "-o"]).arg(&town);
    assert!(command.output().expect("runs").status.success());
    let mut command = Command::new(env!("CARGO_BIN_EXE_pgsag"));
    command.arg("reconstruct").arg(&town).arg("-o").arg(&run).args([
        "--preset",
        "fast",
        "--iterations",
        "200",
        "--json",
    ]);
    command.args(["--set", "coarse.stereo=false", "--device", "gpu:0,gpu:1", "--until", "train"]);
    command.env("VK_DRIVER_FILES", &drivers).env("VK_ICD_FILENAMES", &drivers);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("starts");
    let mut victim = None;
    for _ in 0..6000 {
        std::thread::sleep(Duration::from_millis(50));
        let training = trainers(&run);
        let devices: BTreeSet<&str> = training.iter().map(|(_, device)| device.as_str()).collect();
        if devices.len() == 2 {
            // A while into its work.
            std::thread::sleep(Duration::from_secs(1));
            victim = training.into_iter().find(|(_, device)| device == "gpu:1");
            break;
        }
        if child.try_wait().expect("asked").is_some() {
            break;
        }
    }
    let killed = victim.map(|(pid, _)| Command::new("kill").arg("-KILL").arg(pid.to_string()).status().expect("kill"));
    let output = child.wait_with_output().expect("ends");
    let said = format!("{}\n{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(killed.is_some_and(|status| status.success()), "two devices never trained at once: {said}");
    assert!(output.status.success(), "{said}");
    assert!(said.contains("was killed by the system"), "{said}");
    let trained = fs::read_dir(run.join("07-train")).expect("a stage").filter_map(Result::ok);
    let finished = trained.filter(|job| job.path().join("manifest.json").exists()).count();
    assert!(finished >= 2, "{finished} jobs are finished: {said}");
}
