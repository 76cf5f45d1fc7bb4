//! Buffers, pipelines and bind groups of a blueprint, all made at open.
//!
//! In: a device and a [`Blueprint`]. Out: [`Program::steps`] in order, each ready to be encoded, and the buffers by name. Kernels with
//! the same constants share a pipeline. Never submits anything.

use super::device::Gpu;
use super::params::Params;
use super::resource::Resource;
use super::schedule::{Bank, Blueprint, Content, Dispatch, Tile};
use super::stage::{self, Access, Kernel};
use super::tables::PhaseRows;
use crate::imaging::backend::{BackendError, Stage};
use wgpu::util::DeviceExt;

/// Bytes from one uniform block to the next: where a binding may begin on every device.
const BLOCK_STRIDE: usize = 256;

/// One dispatch.
#[derive(Debug)]
pub(super) struct Step {
    pub stage: Stage,
    pub bank: usize,
    pub tile: Option<usize>,
    pub pipeline: wgpu::ComputePipeline,
    pub bind_group: wgpu::BindGroup,
    pub groups: [u32; 3],
}

impl Step {
    /// Whether both belong into one compute pass.
    pub(super) fn goes_with(&self, other: &Step) -> bool {
        (self.stage, self.bank, self.tile) == (other.stage, other.bank, other.tile)
    }
}

/// Everything that a ping set needs on the device.
#[derive(Debug)]
pub(super) struct Program {
    pub steps: Vec<Step>,
    pub rows: PhaseRows,
    /// 32-bit words of a sensor in the raw buffer.
    pub raw_stride: usize,
    pub banks: Vec<Bank>,
    pub tiles: Vec<Tile>,
    pub targets: Vec<[u32; 2]>,
    pub params: wgpu::Buffer,
    blocks: Vec<Params>,
    buffers: Vec<wgpu::Buffer>,
}

impl Program {
    /// Makes every buffer and pipeline.
    ///
    /// # Errors
    /// Whatever the device recorded meanwhile.
    pub(super) fn new(gpu: &Gpu, blueprint: Blueprint<'_>) -> Result<Self, BackendError> {
        let buffers = Resource::ALL.iter().map(|resource| make_buffer(gpu, *resource, &blueprint)).collect::<Vec<_>>();
        let params = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("params"),
            size: (BLOCK_STRIDE * blueprint.blocks.len()) as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut builder = Builder {
            gpu,
            blueprint: &blueprint,
            params: &params,
            buffers: &buffers,
            modules: Vec::new(),
            pipelines: Vec::new(),
        };
        let steps = blueprint.dispatches.iter().map(|dispatch| builder.step(dispatch)).collect();
        gpu.faults.check()?;
        let Blueprint { rows, raw_stride, banks, tiles, targets, blocks, .. } = blueprint;
        Ok(Self { steps, rows, raw_stride, banks, tiles, targets, params, blocks, buffers })
    }

    pub(super) fn buffer(&self, resource: Resource) -> &wgpu::Buffer {
        &self.buffers[resource as usize]
    }

    /// Bytes of all buffers.
    pub(super) fn bytes(&self) -> u64 {
        self.params.size() + self.buffers.iter().map(wgpu::Buffer::size).sum::<u64>()
    }

    /// Stage of every compute pass.
    pub(super) fn passes(&self) -> Vec<Stage> {
        self.steps.chunk_by(Step::goes_with).map(|steps| steps[0].stage).collect()
    }

    /// The bank that images a sensor.
    pub(super) fn bank_of(&self, sensor: usize) -> usize {
        self.banks.iter().position(|bank| bank.sensors.contains(&sensor)).unwrap_or(0)
    }

    /// Writes the uniform blocks with this nonce; `bytes` is room that is used again.
    pub(super) fn write_blocks(&mut self, queue: &wgpu::Queue, nonce: [u32; 4], bytes: &mut Vec<u8>) {
        bytes.clear();
        for block in &mut self.blocks {
            block.set_nonce(nonce);
            bytes.extend_from_slice(bytemuck::bytes_of(block));
            bytes.resize(bytes.len().next_multiple_of(BLOCK_STRIDE), 0);
        }
        queue.write_buffer(&self.params, 0, bytes);
    }
}

fn make_buffer(gpu: &Gpu, resource: Resource, blueprint: &Blueprint<'_>) -> wgpu::Buffer {
    let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
    let label = format!("{resource:?}");
    match blueprint.content(resource) {
        Content::Table(contents) if contents.len() >= 16 => {
            let descriptor = wgpu::util::BufferInitDescriptor { label: Some(&label), contents, usage };
            gpu.device.create_buffer_init(&descriptor)
        }
        content => {
            let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(&label),
                size: blueprint.bytes(resource),
                usage,
                mapped_at_creation: false,
            });
            if let Content::Table(table) = content {
                gpu.queue.write_buffer(&buffer, 0, table);
            }
            buffer
        }
    }
}

/// A kernel with its constants, and what was made of it.
struct Pipeline {
    kernel: &'static Kernel,
    constants: Vec<(&'static str, f64)>,
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::ComputePipeline,
}

/// Makes the steps one after another.
struct Builder<'a> {
    gpu: &'a Gpu,
    blueprint: &'a Blueprint<'a>,
    params: &'a wgpu::Buffer,
    buffers: &'a [wgpu::Buffer],
    modules: Vec<(Stage, wgpu::ShaderModule)>,
    pipelines: Vec<Pipeline>,
}

impl Builder<'_> {
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

    /// Index of the pipeline of a dispatch.
    fn pipeline(&mut self, dispatch: &Dispatch) -> usize {
        let same = |known: &Pipeline| *known.kernel == *dispatch.kernel && known.constants == dispatch.constants;
        if let Some(index) = self.pipelines.iter().position(same) {
            return index;
        }
        let kernel = dispatch.kernel;
        let module = self.module(kernel.stage);
        let device = &self.gpu.device;
        let layout = bind_group_layout(device, kernel);
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(kernel.entry_point),
            layout: Some(&device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(kernel.entry_point),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            })),
            module: &module,
            entry_point: Some(kernel.entry_point),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &dispatch.constants,
                // The kernels write workgroup memory before they read it.
                zero_initialize_workgroup_memory: false,
            },
            cache: None,
        });
        self.pipelines.push(Pipeline { kernel, constants: dispatch.constants.clone(), layout, pipeline });
        self.pipelines.len() - 1
    }

    fn step(&mut self, dispatch: &Dispatch) -> Step {
        let pipeline = self.pipeline(dispatch);
        let (kernel, pipeline) = (dispatch.kernel, &self.pipelines[pipeline]);
        let uniform = ((BLOCK_STRIDE * dispatch.block) as u64, size_of::<Params>() as u64);
        let storage = kernel.bindings.iter().zip(&dispatch.resources).map(|((binding, _), resource)| {
            let range = self.blueprint.binding(*resource, dispatch.bank);
            (*binding, &self.buffers[*resource as usize], range)
        });
        let all = std::iter::once((0, self.params, uniform)).chain(storage);
        let entry = |(binding, buffer, (offset, size))| wgpu::BindGroupEntry {
            binding,
            resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                buffer,
                offset,
                size: wgpu::BufferSize::new(size),
            }),
        };
        let entries: Vec<_> = all.map(entry).collect();
        let bind_group = self.gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(kernel.entry_point),
            layout: &pipeline.layout,
            entries: &entries,
        });
        let Dispatch { bank, tile, .. } = *dispatch;
        let groups = dispatch.groups();
        Step { stage: kernel.stage, bank, tile, pipeline: pipeline.pipeline.clone(), bind_group, groups }
    }
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
