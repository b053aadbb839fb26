//! The narrow waist: all that a device must do. It knows no schedule, no file, no group.
//!
//! Contract: inputs are finite and sized as documented; `conformance` defines "correct". The device keeps its buffers,
//! the host keeps the decisions: densification, schedules, neighbours and stopping live in `train`.

use pgsag_scene::{Image, Map, Mask};

use crate::cloud::SplatCloud;

/// What a device can fail at.
#[derive(Debug, thiserror::Error)]
pub enum BackendError {
    /// The work does not fit; the message says what and by how much.
    #[error("the device cannot hold this: {0}")]
    TooLarge(String),
    /// A value stopped being finite; training must not go on.
    #[error("{0} is not finite")]
    NotFinite(&'static str),
    /// The device itself failed.
    #[error("device: {0}")]
    Device(String),
}

/// Shorthand of this crate's device results.
pub type Result<T> = std::result::Result<T, BackendError>;

/// A pinhole and its pose in the group's frame (world axes about the cloud's origin).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewCamera {
    /// Intrinsics of the raster that is rendered (a crop has a shifted principal point).
    pub pinhole: pgsag_scene::Pinhole,
    /// Rows of camera_from_group's rotation W.
    pub rotation: [[f64; 3]; 3],
    /// camera_from_group's translation t: p_camera = W · p_group + t.
    pub translation: [f64; 3],
    /// Gaussians nearer than this are not drawn, scene units.
    pub near: f64,
}

/// Per-channel affine exposure: what is compared with the photograph is `gain · rendered + bias`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// R G B factor.
    pub gain: [f32; 3],
    /// R G B offset, in units of full scale 1.
    pub bias: [f32; 3],
}

impl Exposure {
    /// No correction.
    pub const NEUTRAL: Self = Self { gain: [1.0; 3], bias: [0.0; 3] };
}

/// What a view brings to training.
#[derive(Clone, Debug)]
pub struct TrainingView {
    /// Of the (cropped, resized) image.
    pub camera: ViewCamera,
    /// The photograph, same size as the camera.
    pub image: Image,
    /// Classes for this group, same size; `None`: every pixel is inside.
    pub mask: Option<Mask>,
    /// `[H, W]` true on edges inside the object (roof ridges, label borders), where the normal weight is lowered too;
    /// `None`: no inner edges are known.
    pub inner_edges: Option<Map<bool>>,
}

impl TrainingView {
    /// `[H, W]` mean absolute difference over the channels between a render, as `exposure` has it, and the photograph, of
    /// 0 to 1; `None` where nothing is trained.
    #[must_use]
    pub fn errors(&self, rendered: &[[f32; 3]], exposure: &Exposure) -> Vec<Option<f32>> {
        let error = |at: usize, photographed: [u8; 3]| {
            let exposed = |k: usize| exposure.gain[k] * rendered[at][k] + exposure.bias[k];
            (0..3).map(|k| (exposed(k) - f32::from(photographed[k]) / 255.0).abs()).sum::<f32>() / 3.0
        };
        let is_active = |at: usize| self.mask.as_ref().is_none_or(|mask| mask.classes[at].is_active());
        let pixels = self.image.pixels.iter().enumerate();
        pixels.map(|(at, photographed)| is_active(at).then(|| error(at, *photographed))).collect()
    }
}

/// Where blending begins and ends; every backend takes them in its constructor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Contributions below this alpha are skipped. 3DGS: 1/255. Proofs lower it, so that differences meet no cut.
    pub alpha_cut: f32,
    /// A pixel stops before the entry that would bring its transmittance below this. 3DGS: 1e-4.
    pub transmittance_stop: f32,
}

impl Default for Limits {
    fn default() -> Self {
        Self { alpha_cut: 1.0 / 255.0, transmittance_stop: 1e-4 }
    }
}

/// What to compute beside colour. Nothing is paid for what is not asked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RenderOptions {
    /// Degree of harmonics in use, at most the cloud's.
    pub sh_degree: u8,
    /// Render normal, opacity-sum and distance (five more channels).
    pub planes: bool,
    /// Count the blended entries per pixel (load balance, Eq. 9).
    pub load: bool,
    /// Keep what `backward` needs.
    pub gradient: bool,
    /// Accumulate density statistics in the backward pass of this render.
    pub statistics: bool,
    /// Count in the cloud's statistics the Gaussians that are blended somewhere while the transmittance (before them)
    /// is above 0.5 (multi-view trim): at most once per render.
    pub observe: bool,
    /// With `planes`: colours are not read and get no gradient (a neighbour whose planes alone are compared). A device may
    /// leave them out: their map is empty then.
    pub without_color: bool,
    /// Draw the `Free` pixels too (for `LossWeights::free_opacity`). Drawn are else the active pixels alone.
    pub free_pixels: bool,
}

/// A render, read back. Maps have the camera's size; masked-out pixels are 0 in every map.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaneMaps {
    /// Linear combination of colours, before exposure; black background.
    pub color: Map<[f32; 3]>,
    /// Blended normal N, camera frame, not normalised, facing the camera (z < 0). Empty map (0 x 0) without `planes`.
    pub normal: Map<[f32; 3]>,
    /// Blended plane distance D, scene units. Empty without `planes`.
    pub distance: Map<f32>,
    /// Sum of blending weights, 1 − T.
    pub opacity: Map<f32>,
    /// Unbiased depth −D / (N · r), z-depth in scene units; 0 where undefined. Eq. 4. Empty without `planes`.
    pub depth: Map<f32>,
    /// Blended entries per pixel. Empty without `load`.
    pub load: Map<f32>,
}

/// Which reading of the paper where text and published code differ (docs/paper.md).
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reading {
    /// The printed equations.
    Paper,
    /// The published code's form, mended as docs/paper.md says.
    Code,
}

/// Weights and forms of every term of Eq. 10-11; a weight of 0 switches the term off and costs nothing.
/// The default is the published code's reading, mended as docs/paper.md says.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossWeights {
    /// Share of L1 in the photometric term. 3DGS: 0.8.
    pub l1: f32,
    /// Share of 1 − SSIM. 3DGS: 0.2.
    pub dssim: f32,
    /// λ3, flattening: mean over visible Gaussians of the smallest scale, in units of `scene_scale`. Paper: 100.
    pub flatness: f32,
    /// λ4, boundary-aware normal (Eq. 8). Code 0.015, paper 0.01.
    pub normal: f32,
    /// Weight of boundary and inner-edge pixels in Eq. 8. Paper: 0.1.
    pub normal_boundary: f32,
    /// Multiply Eq. 8 by PGSR's image-gradient weight (1 − g)².
    pub normal_image_gradient: bool,
    /// λ1, multi-view geometric consistency. Code 0.03, paper 0.05.
    pub geometric: f32,
    /// Reprojection error beyond which a pixel does not count, pixels. PGSR: 1; annealed from 4.
    pub geometric_gate_px: f32,
    /// λ2, multi-view NCC. Code 0.15, paper 0.2.
    pub ncc: f32,
    /// At most so many patches a step. PGSR: 102 400.
    pub ncc_patches: u32,
    /// λ of Eq. 9/10, gradient-constrained load balance, entering as λ/(1−λ)·s·σ. Paper: 0.41. Default 0 = off.
    pub load: f32,
    /// Penalty on the opacity of `Free` pixels within the raster (floaters past the silhouette).
    pub free_opacity: f32,
    /// Squared norm in Eq. 8 and division by the image gradient in Eq. 9 (paper), or L1 and multiplication (code).
    pub reading: Reading,
    /// Average photometric and normal terms over the active pixels; false: over the full frame, as the published code.
    pub mean_over_mask: bool,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self {
            l1: 0.8,
            dssim: 0.2,
            flatness: 100.0,
            normal: 0.015,
            normal_boundary: 0.1,
            normal_image_gradient: true,
            geometric: 0.03,
            geometric_gate_px: 1.0,
            ncc: 0.15,
            ncc_patches: 102_400,
            load: 0.0,
            free_opacity: 0.0,
            reading: Reading::Code,
            mean_over_mask: true,
        }
    }
}

/// What one step compares.
pub struct Sample<'a, B: Backend + ?Sized> {
    /// The reference view.
    pub view: &'a B::View,
    /// Its render; `losses` writes the gradient of the loss into it.
    pub render: &'a mut B::Render,
    /// A neighbour and its render, for the multi-view terms.
    pub neighbor: Option<(&'a B::View, &'a mut B::Render)>,
    /// Exposure of the reference view.
    pub exposure: Exposure,
    /// What counts how much.
    pub weights: &'a LossWeights,
    /// One scene length (median depth), which makes lengths in losses unit-free; scene units.
    pub scene_scale: f32,
    /// Decides which patches are drawn.
    pub seed: u64,
}

/// Values of the terms, unweighted, and the gradient of the exposure.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LossValues {
    /// Weighted sum of all.
    pub total: f32,
    /// Mean absolute difference.
    pub l1: f32,
    /// 1 − mean SSIM.
    pub dssim: f32,
    /// Mean smallest scale over visible Gaussians, in `scene_scale`s.
    pub flatness: f32,
    /// Eq. 8.
    pub normal: f32,
    /// Mean weighted reprojection error, pixels.
    pub geometric: f32,
    /// Share of active pixels that pass the geometric gate.
    pub geometric_valid: f32,
    /// Mean weighted 1 − NCC².
    pub ncc: f32,
    /// Patches kept.
    pub ncc_patches: u32,
    /// Eq. 9, before scaling.
    pub load: f32,
    /// Mean opacity over free pixels.
    pub free_opacity: f32,
    /// d total / d gain.
    pub d_gain: [f32; 3],
    /// d total / d bias.
    pub d_bias: [f32; 3],
}

/// Adam step sizes of one step, per kind of parameter; means per Gaussian in scene units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Scene units.
    pub means: f32,
    /// Log units.
    pub scales: f32,
    /// Quaternion units.
    pub rotations: f32,
    /// Logit units.
    pub opacity: f32,
    /// Degree-0 coefficients.
    pub color: f32,
    /// Higher coefficients.
    pub harmonics: f32,
    /// Step only the Gaussians that the last `backward` gave a gradient; the others, and their moments, stay as they are.
    pub sparse: bool,
}

/// Per-Gaussian sums since the last `statistics`, from renders with the flags set. `[N]` each.
///
/// A Gaussian *covers* a pixel where it is blended in it: alpha at least the cut, before the pixel stops.
/// Gradients are of the loss without its load-balance part (else texture-less places would split), multiplied by the
/// count of pixels over which the photometric term averages (active pixels, or all with `mean_over_mask` off).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DensityStatistics {
    /// Sum over visible steps of | d(per-pixel-SUM of the loss) / d(u, v) | / pixels covered: independent of resolution and crop.
    pub gradient: Vec<f32>,
    /// The same with absolute values per pixel (AbsGS).
    pub absolute_gradient: Vec<f32>,
    /// Steps in which the Gaussian was visible: covered at least one drawn pixel. `flatness` averages over the same.
    pub visible_count: Vec<u32>,
    /// Largest projected radius (3 sigma), pixels.
    pub radius_px: Vec<f32>,
    /// Renders with `observe` in which it was blended while T > 0.5.
    pub observed_count: Vec<u32>,
}

/// A Gaussian born from another: clone or child of a split. Everything not said here is copied from the parent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Birth {
    /// Index before reshaping.
    pub parent: u32,
    /// Added to the parent's mean, scene units.
    pub offset: [f32; 3],
    /// Added to the three log scales.
    pub log_scale_shift: f32,
    /// The new opacity logit; `None`: the parent's.
    pub opacity_logit: Option<f32>,
}

/// Clone, split, prune by index. The new cloud is `keep` in order, then `births`; moments of births are 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DensityPlan {
    /// Indices that stay, ascending.
    pub keep: Vec<u32>,
    /// Appended, in order.
    pub births: Vec<Birth>,
    /// Where given, opacities (births too) are lowered to at most this value and the moments of all opacities are
    /// zeroed (opacity reset).
    pub opacity_ceiling: Option<f32>,
}

/// Everything needed to go on as if nothing had happened: parameters, Adam moments, statistics.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OptimizerState {
    /// Parameters.
    pub cloud: SplatCloud,
    /// First moments, laid out as the parameters: a cloud of moments.
    pub first: SplatCloud,
    /// Second moments.
    pub second: SplatCloud,
    /// Sums since the last reset.
    pub statistics: DensityStatistics,
}

impl OptimizerState {
    /// A cloud that has not been trained yet: zero moments, empty statistics.
    #[must_use]
    pub fn fresh(cloud: SplatCloud) -> Self {
        let zero = SplatCloud {
            means: vec![[0.0; 3]; cloud.len()],
            log_scales: vec![[0.0; 3]; cloud.len()],
            rotations: vec![[0.0; 4]; cloud.len()],
            opacity_logits: vec![0.0; cloud.len()],
            harmonics: vec![0.0; cloud.harmonics.len()],
            ..cloud
        };
        let statistics = DensityStatistics::empty(cloud.len());
        Self { first: zero.clone(), second: zero, statistics, cloud }
    }
}

impl DensityStatistics {
    /// Nothing gathered yet for `count` Gaussians.
    #[must_use]
    pub fn empty(count: usize) -> Self {
        Self {
            gradient: vec![0.0; count],
            absolute_gradient: vec![0.0; count],
            visible_count: vec![0; count],
            radius_px: vec![0.0; count],
            observed_count: vec![0; count],
        }
    }
}

/// All that a device must do.
pub trait Backend {
    /// Parameters, gradients, Adam moments, statistics. Device-resident.
    type Cloud;
    /// Camera, colour, mask, weights. Device-resident.
    type View;
    /// Maps, their gradients, and what `backward` needs.
    type Render;

    /// Moves parameters to the device with zero moments.
    ///
    /// # Errors
    /// Where the device cannot hold them.
    fn upload(&self, state: &OptimizerState) -> Result<Self::Cloud>;

    /// Reads everything back.
    ///
    /// # Errors
    /// Where the device fails.
    fn download(&self, cloud: &Self::Cloud) -> Result<OptimizerState>;

    /// Moves a view to the device and derives its weights (image gradient, boundary band, active tiles).
    ///
    /// # Errors
    /// Where the device cannot hold it.
    fn prepare(&self, view: &TrainingView) -> Result<Self::View>;

    /// Draws the cloud. With a view, only tiles that its mask touches are binned, sorted or rendered.
    ///
    /// # Errors
    /// Where the device fails.
    fn render(
        &self,
        cloud: &Self::Cloud,
        camera: &ViewCamera,
        mask: Option<&Self::View>,
        options: &RenderOptions,
    ) -> Result<Self::Render>;

    /// Reads a render back, for depth, tests and the report.
    ///
    /// # Errors
    /// Where the device fails.
    fn read(&self, render: &Self::Render) -> Result<PlaneMaps>;

    /// Values of all terms with weight; writes d total / d render into the sample's renders.
    ///
    /// # Errors
    /// Where a value stops being finite.
    fn losses(&self, cloud: &Self::Cloud, sample: &mut Sample<'_, Self>) -> Result<LossValues>;

    /// Gradients of the sample's renders back to the cloud, the flattening term included. Overwrites the cloud's
    /// gradients; adds to its statistics.
    ///
    /// # Errors
    /// Where the device fails.
    fn backward(&self, cloud: &mut Self::Cloud, sample: &Sample<'_, Self>) -> Result<()>;

    /// The gradients of the last `backward`, laid out as the parameters: for proofs and conformance.
    ///
    /// # Errors
    /// Where the device fails.
    fn gradients(&self, cloud: &Self::Cloud) -> Result<SplatCloud>;

    /// One Adam step with the gradients of the last `backward`; `step` counts from 1.
    ///
    /// # Errors
    /// Where a parameter stops being finite.
    fn adam(&self, cloud: &mut Self::Cloud, rates: &Rates, step: u32) -> Result<()>;

    /// The statistics since the last call that reset them.
    ///
    /// # Errors
    /// Where the device fails.
    fn statistics(&self, cloud: &mut Self::Cloud, reset: bool) -> Result<DensityStatistics>;

    /// Clone, split, prune by index. Statistics are reset.
    ///
    /// # Errors
    /// Where the device cannot hold the result.
    fn reshape(&self, cloud: &mut Self::Cloud, plan: &DensityPlan) -> Result<()>;
}
