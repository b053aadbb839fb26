//! Every shader is a valid program, with every way of adding, where no device is; launches on one where there is one.

use std::sync::OnceLock;

use naga::valid::{Capabilities, ValidationFlags, Validator};

use crate::device::{Device, DeviceChoice};
use crate::record::{Groups, Kernel};

/// One device for all unit tests; without any, says so, and fails under `PGSAG_REQUIRE_GPU=1`.
pub(crate) fn device() -> Option<&'static Device> {
    static DEVICE: OnceLock<Option<Device>> = OnceLock::new();
    let open = || {
        let found = Device::open(&DeviceChoice::Best, None).or_else(|_| Device::open(&DeviceChoice::Software, None));
        let missing = |why: &dyn std::fmt::Display| {
            let required = std::env::var("PGSAG_REQUIRE_GPU").is_ok_and(|value| value == "1");
            assert!(!required, "PGSAG_REQUIRE_GPU=1, and {why}");
            eprintln!("SKIPPED, NOT TESTED: {why}");
        };
        found.map_err(|error| missing(&error)).ok()
    };
    DEVICE.get_or_init(open).as_ref()
}

#[test]
fn more_workgroups_than_one_dimension_holds_are_all_launched() {
    const INDEX: Kernel = Kernel {
        name: "index",
        parts: &["@group(0) @binding(0) var<storage, read_write> out: array<atomic<u32>>;
            @compute @workgroup_size(1)
            fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
                let at = group.y * groups.x + group.x;
                if at < 70000u { atomicAdd(&out[at], at + 1u); }
            }"],
        adds: &[],
    };
    let Some(device) = device() else { return };
    let out = device.buffer("numbers", 4 * 70_000).expect("memory");
    let mut record = device.record("test");
    record.run(&INDEX, &[&out], Groups::Count(70_000));
    assert_eq!(record.submit(), 1);
    let found: Vec<u32> = device.read(&out, 0, 70_000).expect("numbers");
    assert!(found.iter().zip(1..).all(|(&found, at)| found == at));
}

#[test]
fn floats_are_added_atomically_with_and_without_the_cards_help() {
    const ADD: Kernel = Kernel {
        name: "add",
        parts: &["@group(0) @binding(0) var<storage, read_write> out: array<FloatCell>;
            @compute @workgroup_size(64)
            fn main(@builtin(local_invocation_index) lane: u32) { out_add(lane % 3u, 0.5); }"],
        adds: &["out"],
    };
    let found = [Device::open(&DeviceChoice::Best, None), Device::open(&DeviceChoice::Software, None)];
    for mut device in found.into_iter().flatten() {
        for own in [true, false] {
            device.float_atomics &= own;
            let out = device.buffer("numbers", 12).expect("memory");
            let mut record = device.record("test");
            record.run(&ADD, &[&out], Groups::Count(10));
            record.submit();
            let found: Vec<f32> = device.read(&out, 0, 3).expect("numbers");
            assert_eq!(found, [110.0, 105.0, 105.0]);
            device.kernels = crate::record::Kernels::default();
        }
    }
}

fn all_kernels() -> Vec<&'static Kernel> {
    [
        crate::adam::KERNELS,
        crate::backward::KERNELS,
        crate::cloud::KERNELS,
        crate::losses::KERNELS,
        crate::render::KERNELS,
        crate::sort::KERNELS,
    ]
    .concat()
}

#[test]
fn every_shader_is_valid() {
    for kernel in all_kernels() {
        for float_atomics in [true, false] {
            if !float_atomics && kernel.adds.is_empty() {
                continue;
            }
            let text = kernel.text(float_atomics);
            let module = naga::front::wgsl::parse_str(&text)
                .unwrap_or_else(|error| panic!("{}: {}", kernel.name, error.emit_to_string(&text)));
            let mut capabilities = Capabilities::SUBGROUP;
            if float_atomics {
                capabilities |= Capabilities::SHADER_FLOAT32_ATOMIC;
            }
            let mut validator = Validator::new(ValidationFlags::all(), capabilities);
            validator.subgroup_stages(naga::valid::ShaderStages::COMPUTE);
            validator.subgroup_operations(naga::valid::SubgroupOperationSet::all());
            let valid = validator.validate(&module);
            assert!(
                valid.is_ok(),
                "{}: {}",
                kernel.name,
                valid.err().map_or(String::new(), |e| e.emit_to_string(&text))
            );
            assert_eq!(module.entry_points.len(), 1, "{}", kernel.name);
            assert_eq!(module.entry_points[0].name, "main", "{}", kernel.name);
        }
    }
}

#[test]
fn kernels_have_names_of_their_own() {
    let mut names: Vec<&str> = all_kernels().iter().map(|kernel| kernel.name).collect();
    names.sort_unstable();
    let count = names.len();
    names.dedup();
    assert_eq!(names.len(), count);
}
