//! The shaders of the losses, each of the parts that it needs.

use crate::record::Kernel;

macro_rules! kernel {
    ($(#[$doc:meta])* $name:ident, $file:literal, [$($part:literal),*] $(, $adds:literal)?) => {
        $(#[$doc])*
        pub(super) const $name: Kernel = Kernel {
            name: concat!("loss_", $file),
            parts: &[
                include_str!("../../shaders/loss_params.wgsl"),
                $(include_str!(concat!("../../shaders/loss_", $part, ".wgsl")),)*
                include_str!(concat!("../../shaders/loss_", $file, ".wgsl")),
            ],
            adds: &[$($adds)?],
        };
    };
}

/// Image gradient and windows of a view.
pub(super) const VIEW: Kernel =
    Kernel { name: "loss_view", parts: &[include_str!("../../shaders/loss_view.wgsl")], adds: &[] };
/// Level of full texture of a view.
pub(super) const FULL: Kernel =
    Kernel { name: "loss_full", parts: &[include_str!("../../shaders/loss_full.wgsl")], adds: &[] };

kernel!(
    /// 1 − SSIM and its derivatives per window.
    SSIM, "ssim", ["pixels", "tiles", "window", "sum"]
);
kernel!(
    /// L1 and SSIM to the gradient of colour.
    COLOR, "color", ["pixels", "tiles", "window", "sum"]
);
kernel!(
    /// Eq. 8, and what pixels give to their neighbours' depths.
    NORMAL, "normal", ["pixels", "tiles", "traits", "planes", "sum"]
);
kernel!(
    /// Eq. 8's gradient of depth to N and D.
    SLANT, "slant", ["pixels", "tiles", "planes", "depth"]
);
kernel!(
    /// There and back between two views.
    GEOMETRIC, "geometric", ["pixels", "tiles", "sum"], "links"
);
kernel!(
    /// One view's gradient of depth to N and D.
    CARRY, "carry", ["pixels", "tiles", "planes", "depth"]
);
kernel!(
    /// Pixels that patches may be centred on.
    MARK, "mark", ["marks"]
);
kernel!(
    /// Their numbers.
    RANK, "rank", ["marks"]
);
kernel!(
    /// Patches drawn and compared.
    NCC, "ncc", ["pixels", "planes", "marks", "draw", "sum"]
);
kernel!(
    /// Their gradients to N and D.
    PATCHES, "patches", []
);
kernel!(
    /// Opacity of free pixels.
    FREE, "free", ["pixels", "sum"]
);
kernel!(
    /// Moments of Eq. 9.
    LOAD, "load", ["pixels", "traits", "balance", "sum"]
);
kernel!(
    /// Gradient of Eq. 9.
    LEVEL, "level", ["pixels", "traits", "balance"]
);
kernel!(
    /// Sums of sums.
    REDUCE, "reduce", []
);
kernel!(
    /// Values of all terms.
    TOTAL, "total", []
);

/// Kernels of this room.
#[cfg(test)]
pub(crate) const KERNELS: &[&Kernel] = &[
    &VIEW, &FULL, &SSIM, &COLOR, &NORMAL, &SLANT, &GEOMETRIC, &CARRY, &MARK, &RANK, &NCC, &PATCHES, &FREE, &LOAD,
    &LEVEL, &REDUCE, &TOTAL,
];
