//! The backend as a whole, on whatever card is there: a software one in continuous integration.
//!
//! Without any adapter these tests say so and pass, unless `PGSAG_REQUIRE_GPU=1`.

mod conformance;
mod device;
mod steps;
mod training;

use std::sync::OnceLock;

use pgsag_gpu::{DeviceChoice, Gpu, GpuOptions};

/// One device for all tests of this binary: opening one takes longer than most of them.
pub(crate) fn gpu() -> Option<&'static Gpu> {
    static DEVICE: OnceLock<Option<Gpu>> = OnceLock::new();
    let open = || {
        let options = |device| GpuOptions { device, ..GpuOptions::default() };
        let found = Gpu::new(&options(DeviceChoice::Best)).or_else(|_| Gpu::new(&options(DeviceChoice::Software)));
        found.map_err(|error| missing(&error.to_string())).ok()
    };
    DEVICE.get_or_init(open).as_ref()
}

/// Says that nothing is tested; fails where that is not allowed.
fn missing(why: &str) {
    let required = std::env::var("PGSAG_REQUIRE_GPU").is_ok_and(|value| value == "1");
    assert!(!required, "PGSAG_REQUIRE_GPU=1, and {why}");
    eprintln!("SKIPPED, NOT TESTED: {why}. Install mesa-vulkan-drivers for a software adapter.");
}
