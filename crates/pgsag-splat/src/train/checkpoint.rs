//! The complete state of a training run as versioned, checksummed bytes.
//!
//! Layout, little endian: magic, version, payload length, BLAKE3 of the payload, payload. Damage of any kind is an error,
//! never a panic, and nothing is allocated that the bytes do not back.

use crate::backend::{DensityStatistics, OptimizerState};
use crate::cloud::SplatCloud;
use crate::train::exposure::Exposures;
use crate::train::plateau::Plateau;
use crate::train::schedule::TrainOptions;
use crate::train::{Result, TrainError};

const MAGIC: &[u8; 8] = b"PGSAGCKP";
const VERSION: u32 = 2;
const HEADER: usize = 8 + 4 + 8 + 32;

/// Everything needed to go on as if nothing had happened.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    pub(crate) options: [u8; 32],
    pub(crate) seed: u64,
    pub(crate) iteration: u32,
    pub(crate) round: u32,
    pub(crate) stack: Vec<u32>,
    pub(crate) scene_scale: f32,
    pub(crate) gsd: f32,
    pub(crate) exposure_frozen: bool,
    pub(crate) exposures: Exposures,
    pub(crate) plateau: Plateau,
    pub(crate) state: OptimizerState,
}

/// Names a set of options: a run may only be resumed with the options it was begun with.
pub(crate) fn fingerprint(options: &TrainOptions) -> [u8; 32] {
    // Debug output names every field; memory bounds do not change results.
    let named = TrainOptions { view_cache_bytes: 0, ..options.clone() };
    *blake3::hash(format!("{named:?}").as_bytes()).as_bytes()
}

impl Checkpoint {
    /// Steps done.
    #[must_use]
    pub fn iteration(&self) -> u32 {
        self.iteration
    }

    /// The parameters now.
    #[must_use]
    pub fn cloud(&self) -> &SplatCloud {
        &self.state.cloud
    }

    /// Bytes that [`Self::from_bytes`] understands.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut payload = Writer(Vec::new());
        payload.0.extend_from_slice(&self.options);
        payload.u64(self.seed);
        payload.u32(self.iteration);
        payload.u32(self.round);
        payload.array(&self.stack);
        payload.array(&[self.scene_scale, self.gsd]);
        payload.u32(u32::from(self.exposure_frozen));
        payload.array(&self.exposures.values);
        payload.array(&self.exposures.first);
        payload.array(&self.exposures.second);
        payload.array(&self.exposures.steps);
        payload.array(&self.plateau.means);
        payload.u64(self.plateau.sum.to_bits());
        payload.u32(self.plateau.steps);
        for cloud in [&self.state.cloud, &self.state.first, &self.state.second] {
            payload.cloud(cloud);
        }
        let statistics = &self.state.statistics;
        payload.array(&statistics.gradient);
        payload.array(&statistics.absolute_gradient);
        payload.array(&statistics.visible_count);
        payload.array(&statistics.radius_px);
        payload.array(&statistics.observed_count);
        let payload = payload.0;
        let mut bytes = Vec::with_capacity(HEADER + payload.len());
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&(payload.len() as u64).to_le_bytes());
        bytes.extend_from_slice(blake3::hash(&payload).as_bytes());
        bytes.extend_from_slice(&payload);
        bytes
    }

    /// Reads what [`Self::to_bytes`] wrote.
    ///
    /// # Errors
    /// Where the bytes are cut, damaged, of another version, or contradict themselves.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let bad = |what: &str| TrainError::Checkpoint(format!("{what}; delete it and start from an earlier one"));
        let (header, payload) = bytes.split_at_checked(HEADER).ok_or_else(|| bad("shorter than its header"))?;
        if &header[..8] != MAGIC {
            return Err(bad("not a checkpoint of pgsag"));
        }
        if header[8..12] != VERSION.to_le_bytes() {
            return Err(bad("written by another version of pgsag"));
        }
        if header[12..20] != (payload.len() as u64).to_le_bytes() {
            return Err(bad("cut short"));
        }
        if header[20..] != blake3::hash(payload).as_bytes()[..] {
            return Err(bad("damaged: its checksum differs"));
        }
        let mut reader = Reader(payload);
        let checkpoint = reader.checkpoint().ok_or_else(|| bad("its arrays end too early"))?;
        if !reader.0.is_empty() || !checkpoint.is_consistent() {
            return Err(bad("its arrays do not fit together"));
        }
        Ok(checkpoint)
    }

    fn is_consistent(&self) -> bool {
        let count = self.state.cloud.len();
        let views = self.exposures.values.len();
        let clouds = [&self.state.cloud, &self.state.first, &self.state.second];
        let statistics = &self.state.statistics;
        clouds.iter().all(|cloud| {
            cloud.sh_degree == self.state.cloud.sh_degree
                && cloud.sh_degree <= 3
                && cloud.means.len() == count
                && cloud.log_scales.len() == count
                && cloud.rotations.len() == count
                && cloud.opacity_logits.len() == count
                && cloud.harmonics.len() == 3 * cloud.basis_count() * count
        }) && [statistics.gradient.len(), statistics.absolute_gradient.len(), statistics.radius_px.len()]
            .iter()
            .chain(&[statistics.visible_count.len(), statistics.observed_count.len()])
            .all(|length| *length == count)
            && self.exposures.first.len() == views
            && self.exposures.second.len() == views
            && self.exposures.steps.len() == views
            && self.stack.iter().all(|view| (*view as usize) < views)
    }
}

struct Writer(Vec<u8>);

impl Writer {
    fn u32(&mut self, value: u32) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    fn u64(&mut self, value: u64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    /// Length in items, then the items; little endian, as every machine that this crate is built for.
    fn array<T: bytemuck::NoUninit>(&mut self, items: &[T]) {
        self.u64(items.len() as u64);
        self.0.extend_from_slice(bytemuck::cast_slice(items));
    }

    fn cloud(&mut self, cloud: &SplatCloud) {
        self.array(&cloud.origin_world);
        self.u32(u32::from(cloud.sh_degree));
        self.array(&cloud.means);
        self.array(&cloud.log_scales);
        self.array(&cloud.rotations);
        self.array(&cloud.opacity_logits);
        self.array(&cloud.harmonics);
    }
}

struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take(&mut self, length: usize) -> Option<&[u8]> {
        let (taken, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(taken)
    }

    fn u32(&mut self) -> Option<u32> {
        self.take(4)?.try_into().ok().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take(8)?.try_into().ok().map(u64::from_le_bytes)
    }

    fn array<T: bytemuck::AnyBitPattern>(&mut self) -> Option<Vec<T>> {
        let length = usize::try_from(self.u64()?).ok()?;
        let bytes = self.take(length.checked_mul(size_of::<T>())?)?;
        Some(bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect())
    }

    fn fixed<T: bytemuck::AnyBitPattern, const N: usize>(&mut self) -> Option<[T; N]> {
        self.array::<T>()?.try_into().ok()
    }

    fn cloud(&mut self) -> Option<SplatCloud> {
        Some(SplatCloud {
            origin_world: self.fixed()?,
            sh_degree: u8::try_from(self.u32()?).ok()?,
            means: self.array()?,
            log_scales: self.array()?,
            rotations: self.array()?,
            opacity_logits: self.array()?,
            harmonics: self.array()?,
        })
    }

    fn checkpoint(&mut self) -> Option<Checkpoint> {
        let options = self.take(32)?.try_into().ok()?;
        let (seed, iteration, round) = (self.u64()?, self.u32()?, self.u32()?);
        let stack = self.array()?;
        let [scene_scale, gsd] = self.fixed()?;
        let exposure_frozen = self.u32()? != 0;
        let exposures =
            Exposures { values: self.array()?, first: self.array()?, second: self.array()?, steps: self.array()? };
        let plateau = Plateau { means: self.array()?, sum: f64::from_bits(self.u64()?), steps: self.u32()? };
        let (cloud, first, second) = (self.cloud()?, self.cloud()?, self.cloud()?);
        let statistics = DensityStatistics {
            gradient: self.array()?,
            absolute_gradient: self.array()?,
            visible_count: self.array()?,
            radius_px: self.array()?,
            observed_count: self.array()?,
        };
        let state = OptimizerState { cloud, first, second, statistics };
        Some(Checkpoint {
            options,
            seed,
            iteration,
            round,
            stack,
            scene_scale,
            gsd,
            exposure_frozen,
            exposures,
            plateau,
            state,
        })
    }
}

#[cfg(test)]
mod tests;
