//! Buffers on a card: counted, refused with the number where they cannot fit, lent again, read back.

use std::ops::Deref;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, PoisonError};

use bytemuck::Pod;
use pgsag_splat::backend::{BackendError, Result};
use wgpu::BufferUsages;

use crate::device::Device;

/// What is allocated, and what may be.
#[derive(Debug)]
pub(crate) struct Ledger {
    card: String,
    /// No buffer is larger, bytes.
    largest: u64,
    limit: Option<u64>,
    used: AtomicU64,
    most: AtomicU64,
}

impl Ledger {
    pub(crate) fn new(card: String, largest: u64, limit: Option<u64>) -> Self {
        Self { card, largest, limit, used: AtomicU64::new(0), most: AtomicU64::new(0) }
    }

    /// Bytes now and at most.
    pub(crate) fn used(&self) -> (u64, u64) {
        (self.used.load(Relaxed), self.most.load(Relaxed))
    }

    /// Largest buffer, bytes.
    pub(crate) fn largest(&self) -> u64 {
        self.largest
    }

    fn take(&self, what: &str, bytes: u64) -> Result<()> {
        let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
        if bytes > self.largest {
            return Err(BackendError::TooLarge(format!(
                "{what} take {:.0} MiB, but a buffer of {} holds at most {:.0} MiB; train smaller groups",
                mib(bytes),
                self.card,
                mib(self.largest)
            )));
        }
        let used = self.used.fetch_add(bytes, Relaxed) + bytes;
        if let Some(limit) = self.limit.filter(|&limit| used > limit) {
            self.used.fetch_sub(bytes, Relaxed);
            return Err(BackendError::TooLarge(format!(
                "{what} take {:.0} MiB, which with {:.0} MiB in use is more than the {:.0} MiB allowed on {}; train smaller groups",
                mib(bytes),
                mib(used - bytes),
                mib(limit),
                self.card
            )));
        }
        self.most.fetch_max(used, Relaxed);
        Ok(())
    }
}

/// A buffer that gives its bytes back to the ledger.
#[derive(Debug)]
pub(crate) struct Buffer {
    raw: wgpu::Buffer,
    ledger: Arc<Ledger>,
}

impl Deref for Buffer {
    type Target = wgpu::Buffer;

    fn deref(&self) -> &wgpu::Buffer {
        &self.raw
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        self.ledger.used.fetch_sub(self.raw.size(), Relaxed);
    }
}

/// Sizes of scratch buffers, eight to an octave: few enough to fit again, close enough to waste little.
fn size_class(bytes: u64) -> u64 {
    let bytes = bytes.max(256);
    bytes.next_multiple_of((1 << bytes.ilog2()) / 8)
}

/// From here on an allocation is watched for running out of memory.
const WATCHED: u64 = 1 << 20;

impl Device {
    /// A storage buffer of zeros, at least 16 bytes. `what` in the plural, for the refusal.
    pub(crate) fn buffer(&self, what: &'static str, bytes: u64) -> Result<Buffer> {
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST | BufferUsages::INDIRECT;
        self.allocated(what, bytes, usage)
    }

    fn allocated(&self, what: &'static str, bytes: u64, usage: BufferUsages) -> Result<Buffer> {
        self.check()?;
        let size = bytes.max(16).next_multiple_of(16);
        self.ledger.take(what, size)?;
        let scope = (size >= WATCHED).then(|| self.wgpu.push_error_scope(wgpu::ErrorFilter::OutOfMemory));
        let raw = self.wgpu.create_buffer(&wgpu::BufferDescriptor {
            label: Some(what),
            size,
            usage,
            mapped_at_creation: false,
        });
        let buffer = Buffer { raw, ledger: Arc::clone(&self.ledger) };
        match scope.and_then(|scope| pollster::block_on(scope.pop())) {
            Some(error) => Err(BackendError::TooLarge(format!(
                "{what} take {} MiB, and {} has no more memory ({error}); {} MiB are in use",
                size >> 20,
                self.adapter.name,
                self.ledger.used().0 >> 20
            ))),
            None => Ok(buffer),
        }
    }

    /// A storage buffer with these values.
    pub(crate) fn buffer_with<T: Pod>(&self, what: &'static str, values: &[T]) -> Result<Buffer> {
        let buffer = self.buffer(what, size_of_val(values) as u64)?;
        self.write(&buffer, 0, values);
        Ok(buffer)
    }

    /// Writes values from a byte on; before anything that is submitted later.
    pub(crate) fn write<T: Pod>(&self, buffer: &Buffer, first: u64, values: &[T]) {
        if !values.is_empty() {
            self.queue.write_buffer(buffer, first, bytemuck::cast_slice(values));
        }
    }

    /// A uniform buffer with this value.
    pub(crate) fn uniform<T: Pod>(&self, value: &T) -> Result<Buffer> {
        let bytes = size_of::<T>() as u64;
        let buffer = self.allocated("uniforms", bytes, BufferUsages::UNIFORM | BufferUsages::COPY_DST)?;
        self.queue.write_buffer(&buffer, 0, bytemuck::bytes_of(value));
        Ok(buffer)
    }

    /// A storage buffer of at least this size with any contents, lent until its `Arc` is dropped.
    pub(crate) fn scratch(&self, what: &'static str, bytes: u64) -> Result<Arc<Buffer>> {
        let mut pool = self.pool.lock().unwrap_or_else(PoisonError::into_inner);
        let size = size_class(bytes).min(self.ledger.largest()).max(bytes);
        let free = pool.iter().find(|buffer| Arc::strong_count(buffer) == 1 && buffer.size() == size);
        if let Some(buffer) = free {
            return Ok(Arc::clone(buffer));
        }
        let buffer = Arc::new(self.buffer(what, size)?);
        pool.push(Arc::clone(&buffer));
        Ok(buffer)
    }

    /// Gives free scratch buffers back: after the sizes that are asked for have changed.
    pub(crate) fn trim(&self) {
        let mut pool = self.pool.lock().unwrap_or_else(PoisonError::into_inner);
        pool.retain(|buffer| Arc::strong_count(buffer) > 1);
    }

    /// Waits until the card has done everything.
    pub(crate) fn wait(&self) -> Result<()> {
        let failed = |error: wgpu::PollError| BackendError::Device(format!("{}: {error}", self.adapter.name));
        self.wgpu.poll(wgpu::PollType::wait_indefinitely()).map_err(failed)?;
        self.check()
    }

    /// Reads values back; waits for the card.
    pub(crate) fn read<T: Pod>(&self, buffer: &wgpu::Buffer, first: u64, count: usize) -> Result<Vec<T>> {
        let mut parts = self.read_many(&[(buffer, first, (count * size_of::<T>()) as u64)])?;
        Ok(bytemuck::pod_collect_to_vec(&parts.pop().unwrap_or_default()))
    }

    /// Reads parts of buffers back, `(buffer, first byte, bytes)`, with one wait.
    pub(crate) fn read_many(&self, parts: &[(&wgpu::Buffer, u64, u64)]) -> Result<Vec<Vec<u8>>> {
        let total: u64 = parts.iter().map(|part| part.2).sum();
        if total == 0 {
            return Ok(vec![Vec::new(); parts.len()]);
        }
        let staging = self.wgpu.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read back"),
            size: total,
            usage: BufferUsages::MAP_READ | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self.wgpu.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut at = 0;
        for (buffer, first, bytes) in parts.iter().filter(|part| part.2 > 0) {
            encoder.copy_buffer_to_buffer(buffer, *first, &staging, at, *bytes);
            at += bytes;
        }
        self.queue.submit([encoder.finish()]);
        let (sender, receiver) = std::sync::mpsc::channel();
        staging.slice(..).map_async(wgpu::MapMode::Read, move |result| {
            // Nobody listens any more where the wait below failed.
            let _ = sender.send(result);
        });
        let failed = |why: String| BackendError::Device(format!("{}: {why}", self.adapter.name));
        self.wgpu.poll(wgpu::PollType::wait_indefinitely()).map_err(|error| failed(error.to_string()))?;
        self.check()?;
        let mapped = receiver.recv().map_err(|error| failed(error.to_string()))?;
        mapped.map_err(|error| failed(error.to_string()))?;
        let view = staging.slice(..).get_mapped_range().map_err(|error| failed(error.to_string()))?;
        let mut at = 0;
        let cut = |bytes: u64| {
            let part = view[at..at + bytes as usize].to_vec();
            at += bytes as usize;
            part
        };
        Ok(parts.iter().map(|part| part.2).map(cut).collect())
    }
}
