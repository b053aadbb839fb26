//! The backend: what a step asks of the card, in the order of the waist.

use std::sync::{Arc, Mutex, PoisonError};

use pgsag_splat::SplatCloud;
use pgsag_splat::backend::{
    Backend, BackendError, DensityPlan, DensityStatistics, Limits, LossValues, OptimizerState, PlaneMaps, Rates,
    RenderOptions, Result, Sample, TrainingView, ViewCamera,
};

use crate::adam;
use crate::backward::{self, Backward, Race};
use crate::cloud::GpuCloud;
use crate::device::{Adapter, Device, DeviceChoice};
use crate::losses;
use crate::memory::Buffer;
use crate::profile::KernelTime;
use crate::render::{GpuRender, Room, Scene};
use crate::view::{GpuView, Tiles};

/// How [`Gpu`] works.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GpuOptions {
    /// Which card.
    pub device: DeviceChoice,
    /// Where blending begins and ends.
    pub limits: Limits,
    /// The way back.
    pub backward: Backward,
    /// Most bytes to allocate on the card; `None`: as many as it has.
    pub memory_limit: Option<u64>,
}

/// The backend on one graphics card.
pub struct Gpu {
    pub(crate) device: Arc<Device>,
    limits: Limits,
    pub(crate) backward: Backward,
    pub(crate) race: Race,
    pub(crate) room: Room,
    /// Tiles of the last raster that was drawn whole.
    whole: Mutex<Option<Arc<Tiles>>>,
    /// Stands for pixels where all are drawn.
    no_pixels: Arc<Buffer>,
}

impl std::fmt::Debug for Gpu {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Gpu").field("adapter", &self.device.adapter).finish_non_exhaustive()
    }
}

impl Gpu {
    /// Opens a card.
    ///
    /// # Errors
    /// Where there is none as asked for; the message lists those that are there.
    pub fn new(options: &GpuOptions) -> Result<Self> {
        let device = Arc::new(Device::open(&options.device, options.memory_limit)?);
        Self::on(device, options.limits, options.backward)
    }

    /// A second backend on the same card, with its own limits of blending and way back.
    ///
    /// # Errors
    /// Where the card has no memory left.
    pub fn with(&self, limits: Limits, backward: Backward) -> Result<Self> {
        Self::on(Arc::clone(&self.device), limits, backward)
    }

    fn on(device: Arc<Device>, limits: Limits, backward: Backward) -> Result<Self> {
        let no_pixels = Arc::new(device.buffer("pixels", 0)?);
        Ok(Self {
            device,
            limits,
            backward,
            race: Race::default(),
            room: Room::default(),
            whole: Mutex::default(),
            no_pixels,
        })
    }

    /// On the card of the unit tests, which must be there.
    #[cfg(test)]
    pub(crate) fn for_tests() -> Self {
        let index = crate::tests::device().map_or(0, |device| device.adapter.index);
        let options = GpuOptions { device: DeviceChoice::Index(index), ..GpuOptions::default() };
        Self::new(&options).expect("it was opened before")
    }

    /// The card.
    #[must_use]
    pub fn adapter(&self) -> &Adapter {
        &self.device.adapter
    }

    /// Bytes allocated on the card now, and at most so far.
    #[must_use]
    pub fn memory(&self) -> (u64, u64) {
        self.device.ledger.used()
    }

    /// Times every launch until [`Gpu::end_profile`], up to two thousand. Launches are then far apart: their sum is less
    /// than what a step takes.
    ///
    /// # Errors
    /// Where the card has no timestamps.
    pub fn begin_profile(&self) -> Result<()> {
        self.device.begin_profile()
    }

    /// What each kernel has taken since [`Gpu::begin_profile`].
    ///
    /// # Errors
    /// Where the card fails.
    pub fn end_profile(&self) -> Result<Vec<KernelTime>> {
        self.device.end_profile()
    }

    /// Waits until the card has done everything.
    ///
    /// # Errors
    /// Where the card fails.
    pub fn wait(&self) -> Result<()> {
        self.device.wait()
    }

    /// Draws a render again whose pairs did not fit, with room for all.
    pub(crate) fn redraw(&self, render: &mut GpuRender) -> Result<()> {
        render.frame = Arc::new(render.scene.draw(&self.device, &self.room, false)?);
        render.touched = false;
        Ok(())
    }

    /// Drawn tiles, pixels and which of them are drawn.
    fn raster(
        &self,
        camera: &ViewCamera,
        view: Option<&GpuView>,
        free_pixels: bool,
    ) -> Result<(Arc<Tiles>, Arc<Buffer>, u32)> {
        let (width, height) = (camera.pinhole.width, camera.pinhole.height);
        if let Some(view) = view {
            let (tiles, drawn) = match view.with_free.as_ref().filter(|_| free_pixels) {
                Some(tiles) => (tiles, 2),
                None => (&view.active, 1),
            };
            if (tiles.width, tiles.height) != (width, height) {
                return Err(BackendError::Device(format!(
                    "a camera of {width} x {height} pixels cannot draw a view of {} x {}",
                    tiles.width, tiles.height
                )));
            }
            return Ok((Arc::clone(tiles), Arc::clone(&view.pixels), drawn));
        }
        let mut whole = self.whole.lock().unwrap_or_else(PoisonError::into_inner);
        let tiles = match whole.take().filter(|tiles| (tiles.width, tiles.height) == (width, height)) {
            Some(tiles) => tiles,
            None => Arc::new(Tiles::new(&self.device, width, height, |_| true)?),
        };
        Ok((Arc::clone(whole.insert(tiles)), Arc::clone(&self.no_pixels), 0))
    }
}

impl Backend for Gpu {
    type Cloud = GpuCloud;
    type View = GpuView;
    type Render = GpuRender;

    fn upload(&self, state: &OptimizerState) -> Result<GpuCloud> {
        GpuCloud::new(&self.device, state)
    }

    fn download(&self, cloud: &GpuCloud) -> Result<OptimizerState> {
        cloud.state()
    }

    fn prepare(&self, view: &TrainingView) -> Result<GpuView> {
        GpuView::new(&self.device, view)
    }

    fn render(
        &self,
        cloud: &GpuCloud,
        camera: &ViewCamera,
        mask: Option<&GpuView>,
        options: &RenderOptions,
    ) -> Result<GpuRender> {
        let (tiles, pixels, drawn) = self.raster(camera, mask, options.free_pixels)?;
        let scene = Scene {
            camera: *camera,
            options: RenderOptions { sh_degree: options.sh_degree.min(cloud.sh_degree), ..*options },
            limits: self.limits,
            values: Arc::clone(&cloud.values),
            statistics: Arc::clone(&cloud.statistics),
            count: cloud.count,
            tiles,
            pixels,
            drawn,
        };
        let frame = Arc::new(scene.draw(&self.device, &self.room, options.gradient)?);
        Ok(GpuRender { scene, frame, touched: false, d_flatness: 0.0 })
    }

    fn read(&self, render: &GpuRender) -> Result<PlaneMaps> {
        let short: Vec<u32> = self.device.read(&render.frame.counters.sizes, 12, 1)?;
        if short == [0] {
            return render.scene.read(&self.device, &render.frame);
        }
        let frame = render.scene.draw(&self.device, &self.room, false)?;
        render.scene.read(&self.device, &frame)
    }

    fn losses(&self, cloud: &GpuCloud, sample: &mut Sample<'_, Self>) -> Result<LossValues> {
        losses::evaluate(self, cloud, sample)
    }

    fn backward(&self, cloud: &mut GpuCloud, sample: &Sample<'_, Self>) -> Result<()> {
        backward::backward(self, cloud, sample)
    }

    fn gradients(&self, cloud: &GpuCloud) -> Result<SplatCloud> {
        adam::gradients(cloud)
    }

    fn adam(&self, cloud: &mut GpuCloud, rates: &Rates, step: u32) -> Result<()> {
        adam::step(cloud, rates, step)
    }

    fn statistics(&self, cloud: &mut GpuCloud, reset: bool) -> Result<DensityStatistics> {
        cloud.check_finite()?;
        let statistics = cloud.statistics_now()?;
        if reset {
            cloud.reset_statistics();
        }
        Ok(statistics)
    }

    fn reshape(&self, cloud: &mut GpuCloud, plan: &DensityPlan) -> Result<()> {
        cloud.reshape(plan)
    }
}
