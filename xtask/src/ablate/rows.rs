//! The rows: what is switched, and with which keys. `pgsag config` knows every key.

/// Seeds of the base, whose spread a row must exceed.
pub(super) const SEEDS: [u32; 3] = [0, 1, 2];

/// One variant.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Row {
    /// Also its file.
    pub(super) name: &'static str,
    /// What the table says.
    pub(super) what: &'static str,
    /// `--set`, in order.
    pub(super) set: &'static [&'static str],
    pub(super) seed: u32,
}

impl Row {
    /// Whether it is the base under one of its seeds.
    pub(super) fn is_base(&self) -> bool {
        self.set.is_empty()
    }
}

/// Name, words, settings.
#[rustfmt::skip]
const VARIANTS: &[(&str, &str, &[&str])] = &[
    ("no-flatness", "no flatness loss", &["train.weights.flatness=0"]),
    ("no-normal", "no normal loss (Eq. 8)", &["train.weights.normal=0"]),
    ("no-band", "normal loss alike inside and on the mask's band", &["train.weights.normal_boundary=1"]),
    ("normal-inside-only", "normal loss not on the band at all", &["train.weights.normal_boundary=0"]),
    ("no-image-gradient", "normal loss not weighed by the image gradient", &["train.weights.normal_image_gradient=false"]),
    ("no-geometric", "no multi-view geometric loss", &["train.weights.geometric=0"]),
    ("geometric", "multi-view geometric loss as in the published code", &["train.weights.geometric=0.03"]),
    ("no-gate-anneal", "geometric gate 1 px from the start", &["train.geometric_gate_start_px=1"]),
    ("no-ncc", "no multi-view NCC loss", &["train.weights.ncc=0"]),
    ("ncc-0.15", "NCC weight of the published code", &["train.weights.ncc=0.15"]),
    ("ncc-0.3", "NCC weight 0.3", &["train.weights.ncc=0.3"]),
    ("ncc-0.6", "NCC weight 0.6", &["train.weights.ncc=0.6"]),
    ("ncc-1.2", "NCC weight 1.2", &["train.weights.ncc=1.2"]),
    ("no-multi-view", "neither geometric nor NCC", &["train.weights.geometric=0", "train.weights.ncc=0"]),
    ("load", "load balance (Eq. 9) on, as printed", &["train.weights.load=0.41"]),
    ("no-exposure", "no exposure compensation", &["train.exposure=false"]),
    ("paper-reading", "equations as printed, not as the authors' code has them", &["train.weights.reading=paper"]),
    ("no-density", "nothing is born", &["train.density.until=0", "train.density.from=0"]),
    ("density-3dgs", "born by the mean gradient only", &["train.density.absolute_gradient=1e30"]),
    ("density-abs", "born by absolute gradients only (AbsGS)", &["train.density.gradient=1e30"]),
    ("density-unbounded", "born as often as they ask (PGSR with AbsGS)", &["train.density.max_growth=1"]),
    ("growth-3x", "births of 15 % a time at most, not 5 %", &["train.density.max_growth=0.15"]),
    ("relocate", "the faint born again by opacity (3DGS-MCMC)", &["train.density.relocate=true"]),
    ("agreement-half", "born where half of ten views show an error (FastGS)", &["train.density.agreement=0.5"]),
    ("agreement-quarter", "born where a quarter of them do", &["train.density.agreement=0.25"]),
    ("growth-3x-agreement", "births of 15 %, where a quarter of them do", &["train.density.max_growth=0.15", "train.density.agreement=0.25"]),
    ("no-trim", "no multi-view trim", &["train.density.trim_interval=0"]),
    ("mean-over-image", "losses averaged over the window, not the mask", &["train.weights.mean_over_mask=false"]),
    ("neighbours-4", "four neighbours per view", &["neighbors.count=4"]),
    ("neighbours-wide", "neighbours at 20 degrees", &["neighbors.best_angle_deg=20"]),
    ("from-sparse", "begun from sparse points", &["coarse.stereo=false"]),
    ("all-points", "no sparse point kept back", &["coarse.withheld.share=0"]),
    ("no-collar", "buildings trained on their masks alone", &["groups.collar_px=0"]),
    ("all-steps", "every group takes all steps", &["groups.equal_looks=false"]),
    ("half-size", "images at half their width (Fig. 4)", &["image_width=1/2"]),
    ("quarter-size", "images at a quarter of their width", &["image_width=1/4"]),
    ("no-filter", "depths not checked against other views", &["filter.max_reprojection_px=1e6", "filter.max_relative_depth=1e6"]),
    ("single-full", "depths that one view alone sees weigh as any", &["filter.single_view_weight=1"]),
    ("gaps", "gaps and holes stay open", &["surface.max_gap_m=0", "buildings.max_hole_rim_m=0"]),
    ("gaps-3", "gaps of up to 3 m are closed, not 8", &["surface.max_gap_m=3"]),
    ("holes", "holes stay open", &["buildings.max_hole_rim_m=0"]),
    ("no-support", "surface also where no point is near", &["support.reach_spacings=0"]),
    ("steps-kept", "depth steps inside of a pixel kept", &["depth.max_step_gsd=1e6"]),
    ("no-free-space", "volume without free space", &["surface.tsdf.free_space_weight=0"]),
    ("free-space-0.1", "free space weighs a tenth", &["surface.tsdf.free_space_weight=0.1"]),
    ("free-space-full", "free space weighs as surface", &["surface.tsdf.free_space_weight=1"]),
    ("behind-2", "truncation 2 voxels behind", &["surface.tsdf.behind_voxels=2"]),
    ("behind-4", "truncation 4 voxels behind", &["surface.tsdf.behind_voxels=4"]),
    ("voxel-half", "voxel half a GSD", &["surface.voxel_gsd=0.5"]),
    ("voxel-1.5", "voxel 1.5 GSD", &["surface.voxel_gsd=1.5"]),
];

/// The base under its seeds, then every variant.
pub(super) fn rows() -> Vec<Row> {
    let names = ["base", "base-seed-1", "base-seed-2"];
    let base = names.iter().zip(SEEDS).map(|(name, seed)| Row { name, what: "preset fast", set: &[], seed });
    let variants = VARIANTS.iter().map(|(name, what, set)| Row { name, what, set, seed: SEEDS[0] });
    base.chain(variants).collect()
}
