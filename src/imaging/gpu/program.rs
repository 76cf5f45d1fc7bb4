//! Buffers, pipelines and the list of dispatches of a ping set, all made at open.
//!
//! In: a device, plan and tables. Out: [`Program::steps`] in the order of the stages, each ready to be encoded, and the
//! buffers by name. Never submits anything.

use super::device::{Gpu, Needs};
use super::params::{Params, ResultLayout, channel_stride};
use super::stage::{self, Access, Kernel};
use super::tables::{BitWindow, MaskEntries, PhaseRows, Steering};
use super::transform::{self, Pass};
use crate::imaging::backend::{BackendError, Stage};
use crate::imaging::plan::ImagingPlan;
use crate::signal::{MaskTable, SampleFormat};
use wgpu::util::DeviceExt;

/// The buffers. `Work*` carry complex rows from kernel to kernel in turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Resource {
    Raw,
    BitStreams,
    BitSums,
    Corrections,
    Pcm,
    BandTaps,
    WorkA,
    WorkB,
    Spectra,
    Reference,
    Gains,
    Turns,
    Beams,
    Hidden,
    Magnitudes,
    Smoothing,
    Entries,
    Rows,
    Ranges,
    Result,
}

const RESOURCE_COUNT: usize = Resource::Result as usize + 1;

/// What a buffer begins with.
enum Content<'a> {
    /// Zeros; so many bytes.
    Zeros(usize),
    /// A table.
    Table(&'a [u8]),
}

/// One dispatch.
#[derive(Debug)]
pub(super) struct Step {
    pub stage: Stage,
    pub pipeline: wgpu::ComputePipeline,
    pub bind_group: wgpu::BindGroup,
    pub groups: [u32; 3],
}

/// Everything that a ping set needs on the device.
#[derive(Debug)]
pub(super) struct Program {
    pub steps: Vec<Step>,
    pub params: wgpu::Buffer,
    buffers: Vec<wgpu::Buffer>,
    pub rows: PhaseRows,
    /// Buffer that holds the spectra of the directions after delay-and-sum.
    pub raw_stride: usize,
}

/// The tables and the passes, before there is a device: whether a plan can be done at all is known without one.
pub(super) struct Blueprint<'a> {
    plan: &'a ImagingPlan,
    pub params: Params,
    bits: BitWindow,
    rows: PhaseRows,
    steering: Steering,
    masks: MaskEntries,
    forward: Vec<Pass>,
    inverse: Vec<Pass>,
    layout: ResultLayout,
    raw_stride: usize,
}

impl<'a> Blueprint<'a> {
    /// # Errors
    /// [`BackendError::Unavailable`] where a length has no transform or the mask table does not fit the plan.
    pub(super) fn new(plan: &'a ImagingPlan, masks: &MaskTable) -> Result<Self, BackendError> {
        let passes = |len: usize| {
            transform::passes(len).ok_or_else(|| {
                BackendError::Unavailable(format!(
                    "a transform of {len} has a prime factor above 7, the largest allowed"
                ))
            })
        };
        let (forward, inverse) = (passes(plan.forward_len)?, passes(plan.inverse_len)?);
        let layout = ResultLayout::new(plan, masks);
        let (bits, rows) = (BitWindow::new(plan), PhaseRows::new(plan));
        let raw_len = |sensor| match plan.format {
            SampleFormat::Pdm | SampleFormat::PcmF32 => plan.raw_len(sensor),
            SampleFormat::PcmI16 => plan.raw_len(sensor).div_ceil(2),
        };
        let raw_stride = (0..plan.sensors.len()).map(raw_len).max().unwrap_or(1);
        Ok(Self {
            params: Params::new(plan, masks, &bits, &rows, raw_stride, &layout),
            masks: MaskEntries::new(plan, masks).map_err(BackendError::Unavailable)?,
            steering: Steering::new(plan),
            plan,
            bits,
            rows,
            forward,
            inverse,
            layout,
            raw_stride,
        })
    }

    /// Channels of all sensors, gaps included.
    fn channel_rows(&self) -> usize {
        self.plan.sensors.len() * channel_stride(self.plan)
    }

    /// Directions of all sensors.
    fn direction_rows(&self) -> usize {
        self.plan.sensors.len() * self.plan.grid.direction_count()
    }

    fn content(&self, resource: Resource) -> Content<'_> {
        use Content::{Table, Zeros};
        let plan = self.plan;
        let (channels, directions) = (self.channel_rows(), self.direction_rows());
        let pdm = plan.format == SampleFormat::Pdm;
        let smooth = !plan.smoothing_taps.is_empty();
        match resource {
            Resource::Raw => Zeros(4 * self.raw_stride * plan.sensors.len()),
            Resource::BitStreams => Zeros(if pdm { 4 * channels * self.bits.block_count } else { 4 }),
            Resource::BitSums => Table(bytemuck::cast_slice(&self.bits.sums)),
            Resource::Corrections => Table(bytemuck::cast_slice(&self.bits.corrections)),
            Resource::Pcm => Zeros(4 * channels * plan.band_decimation * self.rows.stride),
            Resource::BandTaps => Table(bytemuck::cast_slice(&self.rows.taps)),
            Resource::WorkA | Resource::WorkB => {
                let beams = directions * plan.bin_count.max(plan.inverse_len);
                Zeros(8 * beams.max(channels * plan.forward_len))
            }
            Resource::Spectra => Zeros(8 * channels * plan.bin_count),
            Resource::Reference => Table(bytemuck::cast_slice(&plan.reference)),
            Resource::Gains => Zeros(4 * channels),
            Resource::Turns => Table(bytemuck::cast_slice(&self.steering.turns)),
            Resource::Beams => Table(bytemuck::cast_slice(&self.steering.beams)),
            Resource::Hidden => Zeros(4 * directions),
            Resource::Magnitudes => Zeros(if smooth { 4 * directions * plan.inverse_len } else { 4 }),
            Resource::Smoothing => Table(bytemuck::cast_slice(&plan.smoothing_taps)),
            Resource::Entries => Table(bytemuck::cast_slice(&self.masks.entries)),
            Resource::Rows => Table(bytemuck::cast_slice(&self.masks.rows)),
            Resource::Ranges => Table(bytemuck::cast_slice(&self.masks.ranges)),
            Resource::Result => Zeros(4 * self.layout.total),
        }
    }

    /// What a device must allow.
    pub(super) fn needs(&self) -> Needs {
        let bytes = |resource| match self.content(resource) {
            Content::Zeros(bytes) => bytes as u64,
            Content::Table(table) => table.len() as u64,
        };
        let largest = ALL.iter().map(|resource| bytes(*resource)).max().unwrap_or(0);
        let groups =
            self.params.row_count.max(self.steering.beams.len() as u32 / 4).max(self.direction_rows() as u32 / 8);
        Needs { buffer_bytes: largest, workgroups: groups + 1 }
    }
}

/// All resources, in order.
const ALL: [Resource; RESOURCE_COUNT] = [
    Resource::Raw,
    Resource::BitStreams,
    Resource::BitSums,
    Resource::Corrections,
    Resource::Pcm,
    Resource::BandTaps,
    Resource::WorkA,
    Resource::WorkB,
    Resource::Spectra,
    Resource::Reference,
    Resource::Gains,
    Resource::Turns,
    Resource::Beams,
    Resource::Hidden,
    Resource::Magnitudes,
    Resource::Smoothing,
    Resource::Entries,
    Resource::Rows,
    Resource::Ranges,
    Resource::Result,
];

impl Program {
    /// Makes every buffer and pipeline.
    ///
    /// # Errors
    /// Whatever the device recorded meanwhile.
    pub(super) fn new(gpu: &Gpu, blueprint: Blueprint<'_>) -> Result<Self, BackendError> {
        let device = &gpu.device;
        let buffers: Vec<_> =
            ALL.iter().map(|resource| make_buffer(gpu, *resource, blueprint.content(*resource))).collect();
        let params = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("params"),
            contents: bytemuck::bytes_of(&blueprint.params),
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        });
        let hidden: Vec<u32> = blueprint
            .plan
            .sensors
            .iter()
            .flat_map(|sensor| sensor.hidden.iter().map(|hidden| u32::from(*hidden)))
            .collect();
        gpu.queue.write_buffer(&buffers[Resource::Hidden as usize], 0, bytemuck::cast_slice(&hidden));
        let mut builder = Builder { gpu, params: &params, buffers: &buffers, modules: Vec::new(), steps: Vec::new() };
        builder.demodulate(&blueprint)?;
        let spectra = builder.matched_filter(&blueprint)?;
        debug_assert_eq!(spectra, Resource::Spectra);
        builder.delay_and_sum(&blueprint)?;
        builder.envelope(&blueprint)?;
        let rows = blueprint.params.row_count.max(1);
        let bindings = [Resource::Result, Resource::Entries, Resource::Rows, Resource::Ranges];
        builder.push("masked_energy", &[], &bindings, [rows * 128, 1, 1])?;
        let steps = builder.steps;
        gpu.faults.check()?;
        Ok(Self { steps, params, buffers, rows: blueprint.rows, raw_stride: blueprint.raw_stride })
    }

    pub(super) fn buffer(&self, resource: Resource) -> &wgpu::Buffer {
        &self.buffers[resource as usize]
    }
}

fn make_buffer(gpu: &Gpu, resource: Resource, content: Content<'_>) -> wgpu::Buffer {
    let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
    let label = format!("{resource:?}");
    match content {
        Content::Table(table) if !table.is_empty() => {
            let descriptor = wgpu::util::BufferInitDescriptor { label: Some(&label), contents: table, usage };
            gpu.device.create_buffer_init(&descriptor)
        }
        // A binding cannot be empty; sixteen bytes hold one element of any type.
        Content::Table(_) => gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(&label),
            size: 16,
            usage,
            mapped_at_creation: false,
        }),
        Content::Zeros(bytes) => gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(&label),
            size: (bytes as u64).max(16),
            usage,
            mapped_at_creation: false,
        }),
    }
}

/// Makes the steps one after another.
struct Builder<'a> {
    gpu: &'a Gpu,
    params: &'a wgpu::Buffer,
    buffers: &'a [wgpu::Buffer],
    modules: Vec<(Stage, wgpu::ShaderModule)>,
    steps: Vec<Step>,
}

impl Builder<'_> {
    fn demodulate(&mut self, blueprint: &Blueprint<'_>) -> Result<(), BackendError> {
        use Resource::{BitStreams, BitSums, Corrections, Pcm, Raw};
        let plan = blueprint.plan;
        let phases = [("PHASES", plan.band_decimation as f64)];
        let sensors = plan.sensors.len() as u32;
        let quads = [plan.sample_count.div_ceil(4) as u32, channel_stride(plan) as u32, sensors];
        match plan.format {
            SampleFormat::Pdm => {
                let blocks = [blueprint.params.bit_block_count, sensors, 1];
                self.push("transpose_words", &[], &[Raw, BitStreams], blocks)?;
                self.push("demodulate_pdm", &phases, &[BitStreams, BitSums, Corrections, Pcm], quads)
            }
            SampleFormat::PcmI16 => self.push("demodulate_i16", &phases, &[Raw, Pcm], quads),
            SampleFormat::PcmF32 => self.push("demodulate_f32", &phases, &[Raw, Pcm], quads),
        }
    }

    /// Returns where the spectra are.
    fn matched_filter(&mut self, blueprint: &Blueprint<'_>) -> Result<Resource, BackendError> {
        use Resource::{BandTaps, Gains, Pcm, Reference, Spectra, WorkA, WorkB};
        let plan = blueprint.plan;
        let phases = [("PHASES", plan.band_decimation as f64)];
        let outputs = [plan.forward_len.div_ceil(8) as u32, channel_stride(plan) as u32, plan.sensors.len() as u32];
        self.push("band_filter", &phases, &[Pcm, BandTaps, WorkA], outputs)?;
        let (mut from, mut to) = (WorkA, WorkB);
        let rows = blueprint.channel_rows() as u32;
        for (index, pass) in blueprint.forward.iter().enumerate() {
            let last = index + 1 == blueprint.forward.len();
            let constants = pass_constants(*pass, plan.forward_len);
            let threads = [plan.forward_len as u32 / pass.radix(), rows, 1];
            if last {
                self.push("forward_last", &constants, &[from, Spectra, Reference, Gains], threads)?;
            } else {
                self.push("forward_pass", &constants, &[from, to], threads)?;
                std::mem::swap(&mut from, &mut to);
            }
        }
        Ok(Spectra)
    }

    fn delay_and_sum(&mut self, blueprint: &Blueprint<'_>) -> Result<(), BackendError> {
        for group in &blueprint.steering.groups {
            let sensor = |index: usize| group.sensors.get(index).copied().unwrap_or(0) as f64;
            let constants = [
                ("SENSOR_A", sensor(0)),
                ("SENSOR_B", sensor(1)),
                ("SENSOR_C", sensor(2)),
                ("SENSORS", group.sensors.len() as f64),
                ("CHANNELS", group.channel_count as f64),
                ("QUAD_FIRST", group.quad_first as f64),
            ];
            let bindings = [Resource::Spectra, Resource::Turns, Resource::Beams, Resource::WorkA];
            let threads = [blueprint.plan.bin_count as u32, group.quad_count as u32, 1];
            self.push("delay_and_sum", &constants, &bindings, threads)?;
        }
        Ok(())
    }

    fn envelope(&mut self, blueprint: &Blueprint<'_>) -> Result<(), BackendError> {
        use Resource::{Hidden, Magnitudes, Result as Image, Smoothing, WorkA, WorkB};
        let plan = blueprint.plan;
        let smooth = !plan.smoothing_taps.is_empty();
        let (mut from, mut to) = (WorkA, WorkB);
        let rows = blueprint.direction_rows() as u32;
        for (index, pass) in blueprint.inverse.iter().enumerate() {
            let constants = pass_constants(*pass, plan.inverse_len);
            let threads = [plan.inverse_len as u32 / pass.radix(), rows, 1];
            if index + 1 < blueprint.inverse.len() {
                let name = if index == 0 { "inverse_first" } else { "inverse_pass" };
                self.push(name, &constants, &[from, to], threads)?;
                std::mem::swap(&mut from, &mut to);
            } else if smooth {
                self.push("inverse_last_whole", &constants, &[from, Magnitudes], threads)?;
            } else {
                self.push("inverse_last", &constants, &[from, Hidden, Image], threads)?;
            }
        }
        if smooth {
            let threads = [plan.grid.range_count() as u32, rows, 1];
            self.push("smooth_rows", &[], &[Hidden, Image, Magnitudes, Smoothing], threads)?;
        }
        Ok(())
    }

    fn module(&mut self, stage: Stage) -> wgpu::ShaderModule {
        if let Some((_, module)) = self.modules.iter().find(|(known, _)| *known == stage) {
            return module.clone();
        }
        let module = self.gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(stage.stem()),
            source: wgpu::ShaderSource::Wgsl(stage::source(stage).into()),
        });
        self.modules.push((stage, module.clone()));
        module
    }

    /// Adds a dispatch of at least `threads` threads. `resources` are in the order of the kernel's bindings.
    fn push(
        &mut self,
        entry_point: &'static str,
        constants: &[(&str, f64)],
        resources: &[Resource],
        threads: [u32; 3],
    ) -> Result<(), BackendError> {
        let kernel = stage::find(entry_point)
            .filter(|kernel| kernel.bindings.len() == resources.len())
            .ok_or_else(|| BackendError::Unavailable(format!("the kernel {entry_point} is not in the table")))?;
        let module = self.module(kernel.stage);
        let device = &self.gpu.device;
        let layout = bind_group_layout(device, kernel);
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry_point),
            layout: Some(&device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(entry_point),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            })),
            module: &module,
            entry_point: Some(entry_point),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants,
                // The kernels write workgroup memory before they read it.
                zero_initialize_workgroup_memory: false,
            },
            cache: None,
        });
        let entry = |(binding, resource): (u32, Resource)| wgpu::BindGroupEntry {
            binding,
            resource: self.buffers[resource as usize].as_entire_binding(),
        };
        let uniform = wgpu::BindGroupEntry { binding: 0, resource: self.params.as_entire_binding() };
        let storage = kernel.bindings.iter().map(|(binding, _)| *binding).zip(resources.iter().copied()).map(entry);
        let entries: Vec<_> = std::iter::once(uniform).chain(storage).collect();
        let bind_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(entry_point),
            layout: &layout,
            entries: &entries,
        });
        let groups = std::array::from_fn(|axis| threads[axis].div_ceil(kernel.workgroup[axis]));
        self.steps.push(Step { stage: kernel.stage, pipeline, bind_group, groups });
        Ok(())
    }
}

fn pass_constants(pass: Pass, len: usize) -> [(&'static str, f64); 4] {
    [
        ("RADIX_ROWS", f64::from(pass.rows)),
        ("RADIX_COLUMNS", f64::from(pass.columns)),
        ("LEN", len as f64),
        ("SPAN", f64::from(pass.span)),
    ]
}

fn bind_group_layout(device: &wgpu::Device, kernel: &Kernel) -> wgpu::BindGroupLayout {
    let entry = |binding: u32, ty: wgpu::BufferBindingType| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    };
    let storage = kernel.bindings.iter().map(|(binding, access)| {
        entry(*binding, wgpu::BufferBindingType::Storage { read_only: *access == Access::Read })
    });
    let entries: Vec<_> = std::iter::once(entry(0, wgpu::BufferBindingType::Uniform)).chain(storage).collect();
    let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some(kernel.entry_point), entries: &entries };
    device.create_bind_group_layout(&descriptor)
}
