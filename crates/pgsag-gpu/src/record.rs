//! Kernels and their launches: WGSL compiled once per set of constants, launches recorded into one submission.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use pgsag_splat::backend::Result;

use crate::device::Device;
use crate::memory::Buffer;

/// A compute shader: its entry point is `main`, its bindings are group 0.
#[derive(Debug)]
pub(crate) struct Kernel {
    /// As profiles call it.
    pub(crate) name: &'static str,
    /// WGSL, joined in this order.
    pub(crate) parts: &'static [&'static str],
    /// Arrays of `FloatCell` to which `<name>_add(index, value)` adds atomically.
    pub(crate) adds: &'static [&'static str],
}

impl Kernel {
    /// The whole text, with f32 atomics of the card or by compare and exchange.
    pub(crate) fn text(&self, float_atomics: bool) -> String {
        let mut text = self.parts.join("\n");
        if !self.adds.is_empty() {
            text +=
                if float_atomics { "\nalias FloatCell = atomic<f32>;\n" } else { "\nalias FloatCell = atomic<u32>;\n" };
        }
        for array in self.adds {
            text += &if float_atomics {
                format!("fn {array}_add(at: u32, x: f32) {{ atomicAdd(&{array}[at], x); }}\n")
            } else {
                format!(
                    "fn {array}_add(at: u32, x: f32) {{
                        var old = atomicLoad(&{array}[at]);
                        loop {{
                            let sum = bitcast<u32>(bitcast<f32>(old) + x);
                            let tried = atomicCompareExchangeWeak(&{array}[at], old, sum);
                            if tried.exchanged {{ break; }}
                            old = tried.old_value;
                        }}
                    }}\n"
                )
            };
        }
        text
    }
}

/// Value of an `override`.
pub(crate) type Constant = (&'static str, u32);

/// Name of a kernel and its constants.
type Key = (&'static str, Vec<Constant>);

/// Compiled kernels.
#[derive(Default)]
pub(crate) struct Kernels {
    modules: Mutex<HashMap<&'static str, Arc<wgpu::ShaderModule>>>,
    pipelines: Mutex<HashMap<Key, Arc<wgpu::ComputePipeline>>>,
}

/// How many workgroups.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Groups<'a> {
    /// So many.
    Count(u64),
    /// As three numbers in a buffer say, from this byte on.
    Indirect(&'a wgpu::Buffer, u64),
}

/// Workgroups along x, where there are too many for one dimension.
const ROW: u64 = 32_768;

impl Device {
    /// The text as this device compiles it.
    fn module(&self, kernel: &Kernel) -> Arc<wgpu::ShaderModule> {
        let mut modules = self.kernels.modules.lock().unwrap_or_else(PoisonError::into_inner);
        let compiled = modules.entry(kernel.name).or_insert_with(|| {
            let descriptor = wgpu::ShaderModuleDescriptor {
                label: Some(kernel.name),
                source: wgpu::ShaderSource::Wgsl(kernel.text(self.float_atomics).into()),
            };
            Arc::new(self.compiled(descriptor))
        });
        Arc::clone(compiled)
    }

    #[expect(unsafe_code, reason = "naga's run-time checks cost registers in every loop of every kernel")]
    fn compiled(&self, descriptor: wgpu::ShaderModuleDescriptor<'_>) -> wgpu::ShaderModule {
        if self.adapter.is_software() {
            return self.wgpu.create_shader_module(descriptor);
        }
        // SAFETY: the text is ours, in this crate. Every loop ends (bounds are counts, or a tile's list), and every index
        // is below a count that the buffer was made for; the tests run the same text with all checks on.
        unsafe { self.wgpu.create_shader_module_trusted(descriptor, wgpu::ShaderRuntimeChecks::unchecked()) }
    }

    fn pipeline(&self, kernel: &Kernel, constants: &[Constant]) -> Arc<wgpu::ComputePipeline> {
        let key = (kernel.name, constants.to_vec());
        let mut pipelines = self.kernels.pipelines.lock().unwrap_or_else(PoisonError::into_inner);
        let made = pipelines.entry(key).or_insert_with(|| {
            let module = self.module(kernel);
            let standing = [("GROUP", self.group()), ("SUBGROUP", self.adapter.subgroup.0)];
            let named = |name: &str| kernel.parts.iter().any(|part| part.contains(&format!("override {name}:")));
            let all = standing.iter().chain(constants).filter(|(name, _)| named(name));
            let values: Vec<(&str, f64)> = all.map(|(name, value)| (*name, f64::from(*value))).collect();
            Arc::new(self.wgpu.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(kernel.name),
                layout: None,
                module: &module,
                entry_point: Some("main"),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants: &values,
                    // Every kernel sets what it reads.
                    zero_initialize_workgroup_memory: false,
                },
                cache: None,
            }))
        });
        Arc::clone(made)
    }

    /// Begins a submission.
    pub(crate) fn record(&self, label: &'static str) -> Recorder<'_> {
        let descriptor = wgpu::CommandEncoderDescriptor { label: Some(label) };
        Recorder {
            device: self,
            encoder: self.wgpu.create_command_encoder(&descriptor),
            pass: None,
            kept: Vec::new(),
            launches: 0,
        }
    }
}

/// Launches in order; each sees what those before it wrote.
pub(crate) struct Recorder<'a> {
    device: &'a Device,
    encoder: wgpu::CommandEncoder,
    pass: Option<wgpu::ComputePass<'static>>,
    /// Scratch that launches see: not lent to another thread before they are submitted.
    kept: Vec<Arc<Buffer>>,
    launches: u32,
}

impl Recorder<'_> {
    /// A scratch buffer, lent until its `Arc` is dropped and this is submitted.
    pub(crate) fn scratch(&mut self, what: &'static str, bytes: u64) -> Result<Arc<Buffer>> {
        let buffer = self.device.scratch(what, bytes)?;
        self.kept.push(Arc::clone(&buffer));
        Ok(buffer)
    }

    /// Keeps scratch of an earlier submission from being lent before this one is submitted.
    pub(crate) fn keep(&mut self, buffers: impl IntoIterator<Item = Arc<Buffer>>) {
        self.kept.extend(buffers);
    }

    /// Launches a kernel on buffers in the order of its bindings.
    pub(crate) fn run(&mut self, kernel: &Kernel, buffers: &[&Buffer], groups: Groups<'_>) {
        self.run_with(kernel, &[], buffers, groups);
    }

    /// The same with values for its `override`s.
    pub(crate) fn run_with(
        &mut self,
        kernel: &Kernel,
        constants: &[Constant],
        buffers: &[&Buffer],
        groups: Groups<'_>,
    ) {
        if matches!(groups, Groups::Count(0)) {
            return;
        }
        let pipeline = self.device.pipeline(kernel, constants);
        let entries: Vec<wgpu::BindGroupEntry<'_>> = buffers
            .iter()
            .enumerate()
            .map(|(at, buffer)| wgpu::BindGroupEntry { binding: at as u32, resource: buffer.as_entire_binding() })
            .collect();
        let bound = self.device.wgpu.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(kernel.name),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        let mut profile = self.device.profile.lock().unwrap_or_else(PoisonError::into_inner);
        let timed = profile.as_mut().and_then(|profile| Some((profile.next(kernel.name)?, &profile.queries)));
        if timed.is_some() {
            self.pass = None;
        }
        let descriptor = wgpu::ComputePassDescriptor {
            label: None,
            timestamp_writes: timed.map(|(first, query_set)| wgpu::ComputePassTimestampWrites {
                query_set,
                beginning_of_pass_write_index: Some(first),
                end_of_pass_write_index: Some(first + 1),
            }),
        };
        let encoder = &mut self.encoder;
        let pass = self.pass.get_or_insert_with(|| encoder.begin_compute_pass(&descriptor).forget_lifetime());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bound, &[]);
        match groups {
            Groups::Count(count) if count <= ROW => pass.dispatch_workgroups(count as u32, 1, 1),
            Groups::Count(count) => pass.dispatch_workgroups(ROW as u32, count.div_ceil(ROW) as u32, 1),
            Groups::Indirect(buffer, offset) => pass.dispatch_workgroups_indirect(buffer, offset),
        }
        if timed.is_some() {
            self.pass = None;
        }
        self.launches += 1;
    }

    /// Sets a buffer to zero.
    pub(crate) fn clear(&mut self, buffer: &Buffer, bytes: u64) {
        self.pass = None;
        self.encoder.clear_buffer(buffer, 0, Some(bytes.next_multiple_of(4).min(buffer.size())));
    }

    /// Hands everything to the card, and returns how many launches it was.
    pub(crate) fn submit(mut self) -> u32 {
        self.pass = None;
        self.device.queue.submit([self.encoder.finish()]);
        self.launches
    }
}
