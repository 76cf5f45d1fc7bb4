//! What a ping set is on a device, before there is one: tables, sizes of buffers, and the list of dispatches.
//!
//! In: plan, mask table and the largest binding. Out: [`Blueprint`], which `program.rs` turns into buffers and pipelines. Two cuts
//! keep every binding within its limit: *banks*, all sensors together or one at a time; and *tiles*, the directions whose spectra
//! stand in memory together. The buffers between the stages are used again from bank to bank and from tile to tile, so that
//! memory grows with the raw data and the energyscapes only. Never touches a device.

use super::device::Needs;
use super::params::{BINDING_WORDS, Params, ResultLayout, channel_stride};
use super::resource::Resource;
use super::stage::{self, Kernel};
use super::tables::{self, BitWindow, Geometry, MaskEntries, PhaseRows, Steering, SteeringGroup};
use super::transform::{self, Pass};
use crate::imaging::backend::BackendError;
use crate::imaging::plan::{FocusPlan, ImagingPlan};
use crate::signal::{MaskTable, SampleFormat};
use std::ops::Range;

/// The largest binding that every WebGPU device allows.
pub(super) const BINDING_BYTES_MAX: u64 = 128 << 20;
/// Most bytes of each of the two buffers of spectra, unless one channel set needs more: enough rows to fill any GPU, and little
/// enough for a small one.
const WORK_BYTES_MAX: u64 = 32 << 20;

/// What a buffer begins with.
pub(super) enum Content<'a> {
    /// Zeros; so many bytes.
    Zeros(usize),
    /// A table.
    Table(&'a [u8]),
}

/// Sensors that are imaged together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Bank {
    pub sensors: Range<usize>,
}

/// Directions whose spectra stand in memory together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Tile {
    pub bank: usize,
    /// First row in the table of targets, and how many.
    pub target_first: usize,
    pub row_count: usize,
}

/// One dispatch.
#[derive(Debug, Clone)]
pub(super) struct Dispatch {
    pub kernel: &'static Kernel,
    pub constants: Vec<(&'static str, f64)>,
    /// In the order of the kernel's bindings.
    pub resources: Vec<Resource>,
    /// Which uniform block.
    pub block: usize,
    /// Least threads asked for.
    pub threads: [u32; 3],
    pub bank: usize,
    pub tile: Option<usize>,
}

impl Dispatch {
    pub(super) fn groups(&self) -> [u32; 3] {
        std::array::from_fn(|axis| self.threads[axis].div_ceil(self.kernel.workgroup[axis]))
    }
}

/// The tables, the sizes and the dispatches: whether a plan can be done at all is known without a device.
#[derive(Debug)]
pub(super) struct Blueprint<'a> {
    pub plan: &'a ImagingPlan,
    pub rows: PhaseRows,
    pub layout: ResultLayout,
    /// 32-bit words of a sensor in the raw buffer.
    pub raw_stride: usize,
    pub banks: Vec<Bank>,
    pub tiles: Vec<Tile>,
    /// First cell within the bank, and sensor of the bank with the hidden flag: `HIDDEN_BIT` of the shader.
    pub targets: Vec<[u32; 2]>,
    pub blocks: Vec<Params>,
    pub dispatches: Vec<Dispatch>,
    pub bits: BitWindow,
    pub masks: MaskEntries,
    geometry: Geometry,
    references: Vec<[f32; 2]>,
    steering: Steering,
    forward: Vec<Pass>,
    inverse: Vec<Pass>,
    pub(super) to_signal: Vec<Pass>,
    work_bytes: usize,
}

/// Marks a row whose direction is hidden, in the sensor of its target.
const HIDDEN_BIT: u32 = 1 << 31;

impl<'a> Blueprint<'a> {
    /// Cuts the work so that no binding is larger than `binding_bytes`.
    ///
    /// # Errors
    /// [`BackendError::Unavailable`] where a length has no transform, the mask table does not fit the plan, or a buffer that cannot
    /// be cut is too large.
    pub(super) fn new(plan: &'a ImagingPlan, masks: &MaskTable, binding_bytes: u64) -> Result<Self, BackendError> {
        let passes = |len: usize| {
            transform::passes(len).ok_or_else(|| {
                BackendError::Unavailable(format!(
                    "a transform of {len} has a prime factor above 7, the largest allowed"
                ))
            })
        };
        let (forward, inverse) = (passes(plan.forward_len)?, passes(plan.inverse_len)?);
        let to_signal = plan.focus.as_ref().map_or(Ok(Vec::new()), |focus| passes(focus.signal_len))?;
        let raw_len = |sensor| match plan.format {
            SampleFormat::Pdm | SampleFormat::PcmF32 => plan.raw_len(sensor),
            SampleFormat::PcmI16 => plan.raw_len(sensor).div_ceil(2),
        };
        let raw_stride = (0..plan.sensors.len()).map(raw_len).max().unwrap_or(1).next_multiple_of(BINDING_WORDS);
        let mut blueprint = Self {
            plan,
            rows: PhaseRows::new(plan),
            layout: ResultLayout::new(plan, masks),
            raw_stride,
            banks: vec![Bank { sensors: 0..plan.sensors.len() }],
            tiles: Vec::new(),
            targets: Vec::new(),
            blocks: Vec::new(),
            dispatches: Vec::new(),
            bits: BitWindow::new(plan),
            masks: MaskEntries::new(plan, masks).map_err(BackendError::Unavailable)?,
            geometry: Geometry::new(plan),
            references: tables::references(plan),
            steering: Steering::new(plan),
            forward,
            inverse,
            to_signal,
            work_bytes: WORK_BYTES_MAX.min(binding_bytes) as usize,
        };
        if blueprint.too_large(binding_bytes).is_some() {
            blueprint.banks = (0..plan.sensors.len()).map(|sensor| Bank { sensors: sensor..sensor + 1 }).collect();
        }
        for bank in 0..blueprint.banks.len() {
            blueprint.schedule_bank(bank, masks)?;
        }
        match blueprint.too_large(binding_bytes) {
            None => Ok(blueprint),
            Some((resource, bytes)) => Err(BackendError::Unavailable(format!(
                "{resource:?} needs {bytes} bytes in one binding, {binding_bytes} are allowed; fewer samples, microphones, \
                 directions, ranges or mask cells would do"
            ))),
        }
    }

    /// A resource that is bound with more than `binding_bytes`.
    fn too_large(&self, binding_bytes: u64) -> Option<(Resource, u64)> {
        let largest = |resource: &Resource| {
            let banks = 0..self.banks.len();
            (*resource, banks.map(|bank| self.binding(*resource, bank).1).max().unwrap_or(0))
        };
        Resource::ALL.iter().map(largest).find(|(_, bytes)| *bytes > binding_bytes)
    }

    /// Sensors of the largest bank.
    pub(super) fn bank_sensors(&self) -> usize {
        self.banks.iter().map(|bank| bank.sensors.len()).max().unwrap_or(1)
    }

    /// Channels of a bank, gaps included.
    pub(super) fn channel_rows(&self) -> usize {
        self.bank_sensors() * channel_stride(self.plan)
    }

    /// Complex values of a row of a direction between the stages, at most.
    fn row_len(&self) -> usize {
        self.plan.bin_count.max(self.plan.inverse_len)
    }

    /// Rows that a tile may have.
    fn tile_rows_max(&self) -> usize {
        self.work_bytes / (8 * self.row_len())
    }

    /// What a buffer begins with, and so its size.
    pub(super) fn content(&self, resource: Resource) -> Content<'_> {
        use Content::{Table, Zeros};
        let plan = self.plan;
        let channels = self.channel_rows();
        let tile_rows = self.tiles.iter().map(|tile| tile.row_count).max().unwrap_or(0);
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
                let signals = |focus: &FocusPlan| focus.combine.sub_bands * focus.signal_len;
                let longest = plan.focus.as_ref().map_or(0, signals).max(plan.forward_len);
                Zeros(8 * (tile_rows * self.row_len()).max(channels * longest))
            }
            Resource::Spectra => Zeros(8 * channels * plan.bin_count),
            Resource::Reference => Table(bytemuck::cast_slice(&self.references)),
            // Behind the gains two scales a sensor.
            Resource::Gains => Zeros(4 * plan.sensors.len() * (channel_stride(plan) + 2)),
            Resource::Turns => Table(bytemuck::cast_slice(&self.steering.turns)),
            Resource::Beams => Table(bytemuck::cast_slice(&self.steering.beams)),
            Resource::Targets => Table(bytemuck::cast_slice(&self.targets)),
            Resource::Magnitudes => Zeros(if smooth { 4 * tile_rows * plan.inverse_len } else { 4 }),
            Resource::Smoothing => Table(bytemuck::cast_slice(&plan.smoothing_taps)),
            Resource::Signals => {
                let focus = plan.focus.as_ref();
                let samples = |focus: &FocusPlan| focus.combine.sub_bands * focus.oversampling * focus.row_len;
                Zeros(focus.map_or(4, |focus| 8 * channels * samples(focus)))
            }
            Resource::Along => Table(bytemuck::cast_slice(&self.geometry.along_m)),
            Resource::Squares => Table(bytemuck::cast_slice(&self.geometry.square_m2)),
            Resource::Emitters => Table(bytemuck::cast_slice(&self.geometry.emitters)),
            Resource::FocusRanges => Table(bytemuck::cast_slice(&self.geometry.focus_range_m)),
            Resource::Interpolator => Table(plan.focus.as_ref().map_or(&[], |focus| bytemuck::cast_slice(&focus.taps))),
            Resource::Picks | Resource::Echoes | Resource::Arrivals => Zeros(self.clean_bytes(resource)),
            Resource::CleanTable => Table(bytemuck::cast_slice(&self.geometry.clean)),
            Resource::Pulse => Table(bytemuck::cast_slice(&self.geometry.pulse)),
            Resource::Entries => Table(bytemuck::cast_slice(&self.masks.entries)),
            Resource::Rows => Table(bytemuck::cast_slice(&self.masks.rows)),
            Resource::Ranges => Table(bytemuck::cast_slice(&self.masks.ranges)),
            Resource::Image => Zeros(4 * self.layout.image),
            Resource::Sums => Zeros(4 * self.layout.sums),
        }
    }

    /// Bytes of a buffer. A binding cannot be empty; sixteen bytes hold one element of any type.
    pub(super) fn bytes(&self, resource: Resource) -> u64 {
        let bytes = match self.content(resource) {
            Content::Zeros(bytes) => bytes,
            Content::Table(table) => table.len(),
        };
        bytes.max(16) as u64
    }

    /// What a device must allow.
    pub(super) fn needs(&self) -> Needs {
        let bytes = Resource::ALL.iter().map(|resource| self.bytes(*resource));
        let bindings = Resource::ALL.iter().flat_map(|resource| (0..self.banks.len()).map(|bank| (*resource, bank)));
        Needs {
            buffer_bytes: bytes.max().unwrap_or(0),
            binding_bytes: bindings.map(|(resource, bank)| self.binding(resource, bank).1).max().unwrap_or(0),
            workgroups: self.dispatches.iter().flat_map(Dispatch::groups).max().unwrap_or(0),
        }
    }

    /// Offset and size of what a bank sees of a buffer.
    pub(super) fn binding(&self, resource: Resource, bank: usize) -> (u64, u64) {
        let words = match resource {
            Resource::Raw => self.raw_stride,
            Resource::Image => self.layout.stride,
            _ => return (0, self.bytes(resource)),
        };
        let sensors = &self.banks[bank].sensors;
        (4 * (words * sensors.start) as u64, 4 * (words * sensors.len()) as u64)
    }

    /// Adds the tiles, blocks and dispatches of a bank.
    fn schedule_bank(&mut self, bank: usize, masks: &MaskTable) -> Result<(), BackendError> {
        let sensors = self.banks[bank].sensors.clone();
        let params = Params {
            sensor_count: sensors.len() as u32,
            sensor_first: sensors.start as u32,
            ..Params::new(self.plan, masks, &self.bits, &self.rows, self.raw_stride, &self.layout)
        };
        let block = self.blocks.len();
        self.blocks.push(params);
        let mut list = List { bank, tile: None, block, dispatches: Vec::new() };
        self.demodulate(&mut list)?;
        self.matched_filter(&mut list)?;
        let parts = if self.plan.has_plane_waves() { self.cut(bank) } else { Vec::new() };
        for parts in parts {
            let row_count = parts.iter().map(|part| part.sensors.len() * part.slots().len()).sum();
            let tile = Tile { bank, target_first: self.targets.len(), row_count };
            (list.tile, list.block) = (Some(self.tiles.len()), self.blocks.len());
            let mut row_base = 0;
            for part in &parts {
                let params = Params {
                    tile_row_count: row_count as u32,
                    tile_target_first: tile.target_first as u32,
                    quad_first: (part.group.quad_first + part.quads.start) as u32,
                    slot_first: part.slots().start as u32,
                    row_base,
                    row_step: part.slots().len() as u32,
                    ..params
                };
                let (block, first) = (self.blocks.len(), list.block);
                self.blocks.push(params);
                list.block = block;
                delay_and_sum(self.plan, &mut list, part)?;
                list.block = first;
                row_base += (part.sensors.len() * part.slots().len()) as u32;
            }
            let targets: Vec<_> = parts.iter().flat_map(|part| self.targets_of(part, sensors.start)).collect();
            self.targets.extend(targets);
            self.envelope(&mut list, row_count as u32)?;
            self.tiles.push(tile);
        }
        (list.tile, list.block) = (None, block);
        self.focus(&mut list)?;
        let bindings = [Resource::Image, Resource::Entries, Resource::Rows, Resource::Ranges, Resource::Sums];
        list.push("masked_energy", &[], &bindings, [params.row_count.max(1) * 128, 1, 1])?;
        self.dispatches.append(&mut list.dispatches);
        Ok(())
    }

    /// The parts of every tile of a bank: one tile where all its directions fit, else tiles of one group of sensors each.
    fn cut(&self, bank: usize) -> Vec<Vec<Part>> {
        let bank = &self.banks[bank].sensors;
        let whole = |group: &SteeringGroup| {
            let ours = group.sensors.iter().filter(|sensor| bank.contains(sensor));
            let sensors: Vec<usize> = ours.map(|sensor| sensor - bank.start).collect();
            let quads = 0..group.quad_count;
            (!sensors.is_empty()).then(|| Part { group: group.clone(), sensors, quads })
        };
        let parts: Vec<Part> = self.steering.groups.iter().filter_map(whole).collect();
        let rows: usize = parts.iter().map(|part| part.sensors.len() * part.slots().len()).sum();
        let rows_max = self.tile_rows_max();
        if rows <= rows_max {
            return vec![parts];
        }
        let cut = |part: Part| {
            let quads_max = (rows_max / (8 * part.sensors.len())).max(1);
            let (quads, count) = (part.group.quad_count, part.group.quad_count.div_ceil(quads_max));
            let edge = move |index: usize| index * quads / count;
            (0..count).map(move |index| vec![Part { quads: edge(index)..edge(index + 1), ..part.clone() }])
        };
        parts.into_iter().flat_map(cut).collect()
    }

    fn targets_of(&self, part: &Part, sensor_first: usize) -> Vec<[u32; 2]> {
        let ranges = self.plan.grid.range_count();
        let target = |sensor: usize, direction: u32| {
            let hidden = self.plan.sensors[sensor_first + sensor].hidden[direction as usize];
            let cell = sensor * self.layout.stride + direction as usize * ranges;
            [cell as u32, sensor as u32 | if hidden { HIDDEN_BIT } else { 0 }]
        };
        let directions = &part.group.directions[part.slots()];
        let row = |sensor: &usize| directions.iter().map(move |direction| (*sensor, *direction)).collect::<Vec<_>>();
        part.sensors.iter().flat_map(row).map(|(sensor, direction)| target(sensor, direction)).collect()
    }

    fn demodulate(&self, list: &mut List) -> Result<(), BackendError> {
        use Resource::{BitStreams, BitSums, Corrections, Pcm, Raw};
        let plan = self.plan;
        let phases = [("PHASES", plan.band_decimation as f64)];
        let sensors = self.banks[list.bank].sensors.len() as u32;
        let quads = [plan.sample_count.div_ceil(4) as u32, channel_stride(plan) as u32, sensors];
        match plan.format {
            SampleFormat::Pdm => {
                list.push("transpose_words", &[], &[Raw, BitStreams], [self.bits.block_count as u32, sensors, 1])?;
                list.push("demodulate_pdm", &phases, &[BitStreams, BitSums, Corrections, Pcm], quads)
            }
            SampleFormat::PcmI16 => list.push("demodulate_i16", &phases, &[Raw, Pcm], quads),
            SampleFormat::PcmF32 => list.push("demodulate_f32", &phases, &[Raw, Pcm], quads),
        }
    }

    fn matched_filter(&self, list: &mut List) -> Result<(), BackendError> {
        use Resource::{BandTaps, Gains, Pcm, Reference, Spectra, WorkA, WorkB};
        let plan = self.plan;
        let phases = [("PHASES", plan.band_decimation as f64)];
        let (channels, sensors) = (channel_stride(plan), self.banks[list.bank].sensors.len());
        let outputs = [plan.forward_len.div_ceil(8) as u32, channels as u32, sensors as u32];
        list.push("band_filter", &phases, &[Pcm, BandTaps, WorkA], outputs)?;
        let (mut from, mut to) = (WorkA, WorkB);
        for (index, pass) in self.forward.iter().enumerate() {
            let constants = pass.constants(plan.forward_len);
            let threads = [plan.forward_len as u32 / pass.radix(), (sensors * channels) as u32, 1];
            if index + 1 == self.forward.len() {
                list.push("forward_last", &constants, &[from, Spectra, Reference, Gains], threads)?;
            } else {
                list.push("forward_pass", &constants, &[from, to], threads)?;
                std::mem::swap(&mut from, &mut to);
            }
        }
        Ok(())
    }

    fn envelope(&self, list: &mut List, rows: u32) -> Result<(), BackendError> {
        use Resource::{Image, Magnitudes, Smoothing, Targets, WorkA, WorkB};
        let plan = self.plan;
        let smooth = !plan.smoothing_taps.is_empty();
        let (mut from, mut to) = (WorkA, WorkB);
        for (index, pass) in self.inverse.iter().enumerate() {
            let constants = pass.constants(plan.inverse_len);
            let threads = [plan.inverse_len as u32 / pass.radix(), rows, 1];
            if index + 1 < self.inverse.len() {
                let name = if index == 0 { "inverse_first" } else { "inverse_pass" };
                list.push(name, &constants, &[from, to, Targets], threads)?;
                std::mem::swap(&mut from, &mut to);
            } else if smooth {
                list.push("inverse_last_whole", &constants, &[from, Targets, Magnitudes], threads)?;
            } else {
                list.push("inverse_last", &constants, &[from, Targets, Image], threads)?;
            }
        }
        if smooth {
            let threads = [plan.grid.range_count() as u32, rows, 1];
            list.push("smooth_rows", &[], &[Targets, Image, Magnitudes, Smoothing], threads)?;
        }
        Ok(())
    }
}

/// What one group of sensors has in a tile.
#[derive(Debug, Clone)]
struct Part {
    group: SteeringGroup,
    /// Its sensors, counted from the bank's first.
    sensors: Vec<usize>,
    quads: Range<usize>,
}

impl Part {
    fn slots(&self) -> Range<usize> {
        self.group.slots_before[self.quads.start]..self.group.slots_before[self.quads.end]
    }
}

/// The dispatches of a bank while they are listed.
pub(super) struct List {
    pub bank: usize,
    tile: Option<usize>,
    block: usize,
    dispatches: Vec<Dispatch>,
}

impl List {
    /// Adds a dispatch of at least `threads` threads. `resources` are in the order of the kernel's bindings.
    pub(super) fn push(
        &mut self,
        entry_point: &'static str,
        constants: &[(&'static str, f64)],
        resources: &[Resource],
        threads: [u32; 3],
    ) -> Result<(), BackendError> {
        let kernel = stage::find(entry_point)
            .filter(|kernel| kernel.bindings.len() == resources.len())
            .ok_or_else(|| BackendError::Unavailable(format!("the kernel {entry_point} is not in the table")))?;
        let (constants, resources) = (constants.to_vec(), resources.to_vec());
        let Self { bank, tile, block, .. } = *self;
        self.dispatches.push(Dispatch { kernel, constants, resources, block, threads, bank, tile });
        Ok(())
    }
}

fn delay_and_sum(plan: &ImagingPlan, list: &mut List, part: &Part) -> Result<(), BackendError> {
    let sensor = |index: usize| part.sensors.get(index).copied().unwrap_or(0) as f64;
    let constants = [
        ("SENSOR_A", sensor(0)),
        ("SENSOR_B", sensor(1)),
        ("SENSOR_C", sensor(2)),
        ("SENSORS", part.sensors.len() as f64),
        ("CHANNELS", part.group.channel_count as f64),
    ];
    let bindings = [Resource::Spectra, Resource::Turns, Resource::Beams, Resource::WorkA];
    list.push("delay_and_sum", &constants, &bindings, [plan.bin_count as u32, part.quads.len() as u32, 1])
}
