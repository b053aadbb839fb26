//! Every shader is a valid program, with every way of adding, where no device is.

use naga::valid::{Capabilities, ValidationFlags, Validator};

use crate::record::Kernel;

fn all_kernels() -> Vec<&'static Kernel> {
    [crate::adam::KERNELS, crate::cloud::KERNELS, crate::losses::KERNELS, crate::render::KERNELS, crate::sort::KERNELS]
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
