//! The suite that any backend must pass.

use pgsag_gpu::Backward;
use pgsag_splat::conformance;

use crate::gpu;

fn conforms(backward: Backward) {
    let Some(gpu) = gpu() else { return };
    let report = conformance::check(|limits| gpu.with(limits, backward).expect("memory for one more backend"));
    eprintln!("{}: {report}", gpu.adapter().name);
    assert!(report.passed(), "{report}");
}

#[test]
fn the_card_conforms_to_the_reference_by_pixels() {
    conforms(Backward::Pixels);
}

#[test]
fn the_card_conforms_to_the_reference_by_gaussians() {
    conforms(Backward::Gaussians);
}
