//! Graphics cards: which there are, and one that is opened.
//!
//! A device is a value: nothing is global, two may work side by side in one process. It owns the queue, the compiled
//! kernels and the ledger of its memory.

use std::sync::{Arc, Mutex, PoisonError};

use pgsag_splat::backend::{BackendError, Result};
use wgpu::{Backends, DeviceType, Features};

use crate::memory::Ledger;
use crate::profile::Profile;
use crate::record::Kernels;

/// A graphics card, or a program that plays one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Adapter {
    /// Position among those listed; may change between machines and boots.
    pub index: usize,
    /// As the driver says it.
    pub name: String,
    /// `discrete`, `integrated`, `virtual`, `software` or `other`.
    pub kind: &'static str,
    /// `vulkan`, `metal`, ….
    pub api: String,
    /// Driver and version.
    pub driver: String,
    /// `0000:65:00.0`: the same whoever lists; empty where there is no bus.
    pub pci_bus_id: String,
    /// Largest buffer that a kernel may see, bytes.
    pub largest_binding: u64,
    /// Lanes of a subgroup, least and most.
    pub subgroup: (u32, u32),
    /// What is missing for this crate; empty where it can be used.
    pub missing: Vec<&'static str>,
}

impl Adapter {
    /// Whether it computes on the processor: right results, no speed.
    #[must_use]
    pub fn is_software(&self) -> bool {
        self.kind == "software"
    }
}

/// Which device to open.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The first real one that can be used, discrete before integrated.
    #[default]
    Best,
    /// By position among [`adapters`]; also a software one.
    Index(usize),
    /// By PCI bus id.
    Pci(String),
    /// The first software one: for tests.
    Software,
}

/// Features that kernels rely on.
const NEEDED: [(Features, &str); 1] = [(Features::SUBGROUP, "subgroup operations")];
/// Features that are used where they are.
const WANTED: Features = Features::SHADER_FLOAT32_ATOMIC.union(Features::TIMESTAMP_QUERY);
/// Storage buffers of the largest kernel (`adam`).
const STORAGE_BUFFERS: u32 = 18;

/// All adapters of this machine.
#[must_use]
pub fn adapters() -> Vec<Adapter> {
    found(&instance()).iter().enumerate().map(|(index, adapter)| described(index, adapter)).collect()
}

fn instance() -> wgpu::Instance {
    wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: Backends::VULKAN | Backends::METAL,
        // Our own counters decide every launch; they are within limits by construction.
        flags: wgpu::InstanceFlags::empty(),
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    })
}

fn found(instance: &wgpu::Instance) -> Vec<wgpu::Adapter> {
    pollster::block_on(instance.enumerate_adapters(Backends::VULKAN | Backends::METAL))
}

fn described(index: usize, adapter: &wgpu::Adapter) -> Adapter {
    let (info, limits, features) = (adapter.get_info(), adapter.limits(), adapter.features());
    let mut missing: Vec<&str> =
        NEEDED.iter().filter(|(feature, _)| !features.contains(*feature)).map(|(_, name)| *name).collect();
    if limits.max_storage_buffers_per_shader_stage < STORAGE_BUFFERS {
        missing.push("18 storage buffers per kernel");
    }
    if limits.max_compute_invocations_per_workgroup < 256 || limits.max_compute_workgroup_storage_size < 32 << 10 {
        missing.push("workgroups of 256 with 32 KiB of shared memory");
    }
    Adapter {
        index,
        name: info.name,
        kind: match info.device_type {
            DeviceType::DiscreteGpu => "discrete",
            DeviceType::IntegratedGpu => "integrated",
            DeviceType::VirtualGpu => "virtual",
            DeviceType::Cpu => "software",
            DeviceType::Other => "other",
        },
        api: info.backend.to_string(),
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
        pci_bus_id: info.device_pci_bus_id,
        largest_binding: limits.max_storage_buffer_binding_size,
        subgroup: (info.subgroup_min_size, info.subgroup_max_size),
        missing,
    }
}

/// Position of the chosen adapter.
fn choose(all: &[Adapter], choice: &DeviceChoice) -> Result<usize> {
    let usable = |adapter: &&Adapter| adapter.missing.is_empty();
    let first = |kind: &str| all.iter().filter(usable).find(|adapter| adapter.kind == kind);
    let picked = match choice {
        DeviceChoice::Best => ["discrete", "integrated", "virtual", "other"].iter().find_map(|kind| first(kind)),
        DeviceChoice::Software => first("software"),
        DeviceChoice::Index(index) => all.get(*index),
        DeviceChoice::Pci(id) => all.iter().find(|adapter| adapter.pci_bus_id.eq_ignore_ascii_case(id)),
    };
    let Some(adapter) = picked else {
        let names: Vec<String> =
            all.iter().map(|adapter| format!("{} ({}, {})", adapter.name, adapter.kind, adapter.api)).collect();
        let seen = if names.is_empty() { "no adapter at all".to_owned() } else { names.join(", ") };
        return Err(BackendError::Device(format!("no GPU as asked for ({choice:?}); this machine shows {seen}")));
    };
    match adapter.missing.as_slice() {
        [] => Ok(adapter.index),
        missing => Err(BackendError::Device(format!("{} lacks {}", adapter.name, missing.join(" and ")))),
    }
}

/// An opened card.
pub(crate) struct Device {
    pub(crate) wgpu: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    pub(crate) adapter: Adapter,
    pub(crate) ledger: Arc<Ledger>,
    pub(crate) kernels: Kernels,
    /// Whether f32 atomics are the card's own.
    pub(crate) float_atomics: bool,
    /// Buffers that are lent again and again.
    pub(crate) pool: Mutex<Vec<Arc<crate::memory::Buffer>>>,
    /// Launches are timed while it is there.
    pub(crate) profile: Mutex<Option<Profile>>,
    /// The first error that came outside of any call.
    fault: Arc<Mutex<Option<String>>>,
}

impl Device {
    /// Opens an adapter with its own limits; `memory_limit` bytes at most are allocated on it.
    pub(crate) fn open(choice: &DeviceChoice, memory_limit: Option<u64>) -> Result<Self> {
        let found = found(&instance());
        let all: Vec<Adapter> = found.iter().enumerate().map(|(index, adapter)| described(index, adapter)).collect();
        let index = choose(&all, choice)?;
        let (adapter, card) = (all[index].clone(), &found[index]);
        let needed = NEEDED.iter().fold(Features::empty(), |sum, (feature, _)| sum | *feature);
        let limits = card.limits();
        let (wgpu, queue) = pollster::block_on(card.request_device(&wgpu::DeviceDescriptor {
            label: Some("pgsag"),
            required_features: needed | (WANTED & card.features()),
            required_limits: limits.clone(),
            ..wgpu::DeviceDescriptor::default()
        }))
        .map_err(|error| BackendError::Device(format!("{} cannot be opened: {error}", adapter.name)))?;
        let fault = Arc::new(Mutex::new(None));
        let noted = Arc::clone(&fault);
        wgpu.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            let mut first = noted.lock().unwrap_or_else(PoisonError::into_inner);
            first.get_or_insert_with(|| error.to_string());
        }));
        let largest = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        Ok(Self {
            float_atomics: wgpu.features().contains(Features::SHADER_FLOAT32_ATOMIC),
            ledger: Arc::new(Ledger::new(adapter.name.clone(), largest, memory_limit)),
            kernels: Kernels::default(),
            pool: Mutex::default(),
            profile: Mutex::default(),
            wgpu,
            queue,
            adapter,
            fault,
        })
    }

    /// Threads of a workgroup of the integer kernels: eight of the narrowest subgroups, 32 to 256.
    pub(crate) fn group(&self) -> u32 {
        (8 * self.adapter.subgroup.0).clamp(32, 256)
    }

    /// The error that happened since, if any.
    pub(crate) fn check(&self) -> Result<()> {
        match self.fault.lock().unwrap_or_else(PoisonError::into_inner).clone() {
            Some(message) => Err(BackendError::Device(format!("{}: {message}", self.adapter.name))),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests;
