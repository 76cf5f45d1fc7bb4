//! GPU twin: the five stages as WGSL kernels through wgpu, one submission a ping set.
//!
//! In: raw pings and the channels' gains. Out: energyscapes and masked sums. `schedule.rs` lists the dispatches and cuts them so that no
//! binding grows too large, `program.rs` makes every buffer and pipeline at open; here is the order of a ping set: upload, poison,
//! dispatch, read back, check. Every wait ends, every error comes back as a [`BackendError`], nothing panics. Never judges channels
//! and never chooses between backends.
//!
//! Counted for the default plan, three sensors of 32 channels, PDM, 180 directions, 941 ranges: 15 dispatches, 2.0 MB up, 2.0 MB down,
//! 27 MB of buffers. `noctule bench --backend gpu` prints the count of every stage (`work.rs`), what cards of known peaks should
//! make of it, and what this one does.
//!
//! Nothing here overlaps one ping set with the next: the path to a command waits for each result at once, so that a second set in
//! flight could only make it later. Who has recordings to get through opens two backends, one on each of two threads: one is
//! computed while the other is uploaded and read back.

mod device;
mod focusing;
mod inspect;
mod params;
mod program;
mod readback;
mod resource;
mod schedule;
pub mod stage;
mod tables;
mod timing;
mod transform;
mod work;

pub use device::{AdapterDescription, AdapterKind, adapters, compiled_backends};
pub use params::{PARAMS_LAYOUT, Params};
pub use readback::panic_is_a_lost_device;
pub use work::{DispatchWork, Memory, PipelineUse, memory, pipelines, transfer_bytes, workload};

use super::backend::{Backend, BackendError, BackendKind, BackendReport, Image, Stage, StageOutput, StageTimes};
use super::plan::ImagingPlan;
use crate::signal::{MaskTable, PingSet, RowSums, SENSORS_MAX, Samples};
use device::Gpu;
use params::{NONCE_WORDS, ResultLayout, channel_stride};
use program::{Program, Step};
use readback::{Staging, check_cells, check_nonce, checked_sums, poison_buffer};
use resource::Resource;
use schedule::{BINDING_BYTES_MAX, Blueprint};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use timing::Timing;

/// Limit of the first ping set, at open, in which drivers compile, and of reading a stage's output back.
const SLOW_LIMIT: Duration = Duration::from_secs(8);

/// Counts devices: the result of one can never pass for that of another.
static EPOCH: AtomicU32 = AtomicU32::new(1);

/// The GPU backend.
#[derive(Debug)]
pub struct GpuBackend {
    plan: Arc<ImagingPlan>,
    masks: Arc<MaskTable>,
    layout: ResultLayout,
    /// Sequence of the ping set (low, high), epoch of the device, sensors present.
    nonce: [u32; NONCE_WORDS],
    gpu: Gpu,
    program: Program,
    poison: wgpu::Buffer,
    staging: Staging,
    timing: Option<Timing>,
    limit: Duration,
    report: BackendReport,
    stage_times_ns: StageTimes,
    /// Gains of all channels, and packed 16-bit samples of one sensor.
    gains: Vec<f32>,
    packed: Vec<u32>,
    /// One channel of nothing.
    silence: Vec<f32>,
    /// The uniform blocks as bytes.
    blocks: Vec<u8>,
}

impl GpuBackend {
    /// Opens the best adapter that fits, makes every buffer and pipeline, and images one silent ping set, so that the first real
    /// one is not late. A software adapter is taken only if `allow_software`. A ping set is given up after `deadline_ms`.
    ///
    /// # Errors
    /// [`BackendError::Unavailable`] with the reason of every adapter; the others as [`Backend::image`].
    pub fn open(
        plan: Arc<ImagingPlan>,
        masks: Arc<MaskTable>,
        allow_software: bool,
        deadline_ms: u64,
    ) -> Result<GpuBackend, BackendError> {
        Self::open_within(plan, masks, allow_software, deadline_ms, BINDING_BYTES_MAX)
    }

    /// As [`GpuBackend::open`]; a driver that panics while it opens a device has lost it.
    ///
    /// # Errors
    /// As [`GpuBackend::open`].
    pub fn open_caught(
        plan: Arc<ImagingPlan>,
        masks: Arc<MaskTable>,
        allow_software: bool,
        deadline_ms: u64,
    ) -> Result<GpuBackend, BackendError> {
        readback::catching(|| Self::open(plan, masks, allow_software, deadline_ms))
            .unwrap_or_else(|message| Err(BackendError::Lost(message)))
    }

    /// As [`GpuBackend::open`], with no binding larger than `binding_bytes`: tests cut small work as large work is cut.
    ///
    /// # Errors
    /// As [`GpuBackend::open`].
    pub fn open_within(
        plan: Arc<ImagingPlan>,
        masks: Arc<MaskTable>,
        allow_software: bool,
        deadline_ms: u64,
        binding_bytes: u64,
    ) -> Result<GpuBackend, BackendError> {
        let blueprint = Blueprint::new(&plan, &masks, binding_bytes.min(BINDING_BYTES_MAX))?;
        let gpu = device::open(allow_software, blueprint.needs())?;
        let layout = blueprint.layout;
        let program = Program::new(&gpu, blueprint)?;
        let timing = Timing::new(&gpu, program.passes());
        let staging_bytes = layout.bytes() + timing.as_ref().map_or(0, Timing::bytes);
        let mut backend = Self {
            poison: poison_buffer(&gpu, layout.bytes()),
            staging: Staging::new(&gpu, staging_bytes),
            timing,
            limit: Duration::from_millis(deadline_ms),
            report: BackendReport {
                kind: BackendKind::Gpu,
                adapter: gpu.description.to_string(),
                reason: "the GPU backend was asked for".to_owned(),
                threads: 1,
            },
            stage_times_ns: StageTimes::default(),
            gains: vec![0.0; plan.sensors.len() * (channel_stride(&plan) + 2)],
            packed: Vec::new(),
            silence: vec![0.0; plan.raw_count],
            blocks: Vec::new(),
            nonce: [0, 0, EPOCH.fetch_add(1, Ordering::Relaxed), 0],
            plan,
            masks,
            layout,
            gpu,
            program,
        };
        backend.gpu.faults.check()?;
        backend.warm_up()?;
        Ok(backend)
    }

    /// Replaces the sentence that says why this backend is used.
    pub(crate) fn set_reason(&mut self, reason: String) {
        self.report.reason = reason;
    }

    /// The adapter in use.
    #[must_use]
    pub fn adapter(&self) -> &AdapterDescription {
        &self.gpu.description
    }

    /// Dispatches of one ping set.
    #[must_use]
    pub fn dispatch_count(&self) -> usize {
        self.program.steps.len()
    }

    /// Bytes of all buffers on the device and of those that the processor reads, as asked for at open: none is made later.
    #[must_use]
    pub fn buffer_bytes(&self) -> u64 {
        self.program.bytes() + self.poison.size() + self.staging.buffer.size()
    }

    /// Into how many parts the directions were cut, so that each part's spectra fit their buffers.
    #[must_use]
    pub fn tile_count(&self) -> usize {
        self.program.tiles.len()
    }

    /// Into how many parts the sensors were cut: 1, or as many as there are.
    #[must_use]
    pub fn bank_count(&self) -> usize {
        self.program.banks.len()
    }

    /// Destroys the device, as a driver that fails would: every later call returns [`BackendError::Lost`]. For tests and drills.
    pub fn destroy_device(&self) {
        self.gpu.device.destroy();
    }

    /// What destroys the device at any moment, from any thread, as [`GpuBackend::destroy_device`] does.
    #[must_use]
    pub fn destroyer(&self) -> Box<dyn Fn() + Send> {
        let device = self.gpu.device.clone();
        Box::new(move || device.destroy())
    }

    fn warm_up(&mut self) -> Result<(), BackendError> {
        let lens: Vec<usize> = (0..self.plan.sensors.len()).map(|sensor| self.plan.raw_len(sensor)).collect();
        let mut pings = PingSet::empty(self.plan.sensors.len(), self.plan.format, &lens);
        pings.present[..lens.len()].fill(true);
        let mut image = Image::empty(&self.plan, &self.masks);
        self.submit_and_wait(&pings, pings.present, &image, SLOW_LIMIT)?;
        self.take_result(&pings, pings.present, &mut image)
    }

    /// Uploads, dispatches and waits; the result then stands in the staging buffer, mapped.
    fn submit_and_wait(
        &mut self,
        pings: &PingSet,
        active: [bool; SENSORS_MAX],
        image: &Image,
        limit: Duration,
    ) -> Result<(), BackendError> {
        let start = Instant::now();
        self.drain(start, limit)?;
        self.upload(pings, active, image);
        let mut encoder = self.encode(self.timing.as_ref(), |_| true);
        let (image, sums) = (4 * self.layout.image as u64, 4 * self.layout.sums as u64);
        let staging = &self.staging.buffer;
        encoder.copy_buffer_to_buffer(self.program.buffer(Resource::Image), 0, staging, 0, image);
        encoder.copy_buffer_to_buffer(self.program.buffer(Resource::Sums), 0, staging, image, sums);
        if let Some(timing) = &self.timing {
            timing.resolve(&mut encoder, staging, self.layout.bytes());
        }
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu.faults.check()?;
        self.staging.request();
        self.staging.wait(&self.gpu, start, limit)
    }

    /// Waits for a ping set that was given up earlier, if there is one: its buffers are still in use.
    fn drain(&mut self, start: Instant, limit: Duration) -> Result<(), BackendError> {
        self.gpu.faults.check()?;
        if self.staging.is_pending() {
            self.staging.wait(&self.gpu, start, limit)?;
            self.staging.release();
        }
        Ok(())
    }

    /// Writes samples, gains and the words that change with every ping set.
    fn upload(&mut self, pings: &PingSet, active: [bool; SENSORS_MAX], image: &Image) {
        let stride = channel_stride(&self.plan);
        self.gains.fill(0.0);
        let mut present = 0;
        let queue = &self.gpu.queue;
        for (sensor, ping) in pings.pings.iter().enumerate().filter(|(sensor, _)| active[*sensor]) {
            present |= 1 << sensor;
            let gains = &image.channels[sensor].gains;
            self.gains[sensor * stride..][..gains.len()].copy_from_slice(gains);
            if let Some(focus) = self.plan.focus.as_ref().filter(|focus| !focus.combine.is_sum()) {
                let scale = focus.combine.scale(gains);
                let at = self.plan.sensors.len() * stride + 2 * sensor;
                self.gains[at..at + 2].copy_from_slice(&[scale.count, scale.products]);
            }
            let offset = 4 * (sensor * self.program.raw_stride) as u64;
            let raw = self.program.buffer(Resource::Raw);
            match &*ping.samples {
                Samples::Pdm(words) => queue.write_buffer(raw, offset, bytemuck::cast_slice(words)),
                Samples::PcmF32(values) if !gains.contains(&0.0) => {
                    queue.write_buffer(raw, offset, bytemuck::cast_slice(values));
                }
                Samples::PcmF32(values) => {
                    for (channel, (row, gain)) in values.chunks_exact(self.plan.raw_count).zip(gains).enumerate() {
                        // What is not finite stays here: a kernel may be compiled as if there were no NaN.
                        let row = if *gain == 0.0 { &self.silence } else { row };
                        let offset = offset + 4 * (channel * self.plan.raw_count) as u64;
                        queue.write_buffer(raw, offset, bytemuck::cast_slice(row));
                    }
                }
                Samples::PcmI16(values) => {
                    let pairs = values.chunks_exact(2);
                    let odd = pairs.remainder().first().map(|value| u32::from(value.cast_unsigned()));
                    self.packed.clear();
                    let word =
                        |pair: &[i16]| u32::from(pair[0].cast_unsigned()) | u32::from(pair[1].cast_unsigned()) << 16;
                    self.packed.extend(pairs.map(word).chain(odd));
                    queue.write_buffer(raw, offset, bytemuck::cast_slice(&self.packed));
                }
            }
        }
        queue.write_buffer(self.program.buffer(Resource::Gains), 0, bytemuck::cast_slice(&self.gains));
        self.nonce = [pings.sequence as u32, (pings.sequence >> 32) as u32, self.nonce[2], present];
        self.program.write_blocks(queue, self.nonce, &mut self.blocks);
    }

    /// Poisons the result and records the dispatches that are wanted, those of a stage, bank and tile in one compute pass.
    fn encode(&self, timing: Option<&Timing>, wanted: impl Fn(&Step) -> bool) -> wgpu::CommandEncoder {
        let mut encoder =
            self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("ping set") });
        for resource in [Resource::Image, Resource::Sums] {
            let target = self.program.buffer(resource);
            let mut at = 0;
            while at < target.size() {
                let bytes = self.poison.size().min(target.size() - at);
                encoder.copy_buffer_to_buffer(&self.poison, 0, target, at, bytes);
                at += bytes;
            }
        }
        let steps: Vec<&Step> = self.program.steps.iter().filter(|step| wanted(step)).collect();
        for (index, steps) in steps.chunk_by(|a, b| a.goes_with(b)).enumerate() {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some(steps[0].stage.stem()),
                timestamp_writes: timing.map(|timing| timing.writes(index)),
            });
            for step in steps {
                pass.set_pipeline(&step.pipeline);
                pass.set_bind_group(0, &step.bind_group, &[]);
                pass.dispatch_workgroups(step.groups[0], step.groups[1], step.groups[2]);
            }
        }
        encoder
    }

    /// Checks the result in the staging buffer and copies it into `image`.
    fn take_result(
        &mut self,
        pings: &PingSet,
        active: [bool; SENSORS_MAX],
        image: &mut Image,
    ) -> Result<(), BackendError> {
        let (layout, nonce, masks) = (self.layout, self.nonce, Arc::clone(&self.masks));
        let timing = self.timing.as_ref();
        self.stage_times_ns = self.staging.read(|bytes| {
            let (result, times) = bytes.split_at(layout.bytes() as usize);
            let words: &[u32] =
                bytemuck::try_cast_slice(result).map_err(|error| BackendError::Invalid(error.to_string()))?;
            let (words, sums) = words.split_at(layout.image);
            check_nonce(&sums[layout.nonce..][..NONCE_WORDS], nonce)?;
            for (sensor, energyscape) in image.energyscapes.iter_mut().enumerate() {
                if active[sensor] {
                    let cells = &words[sensor * layout.stride..][..layout.cells];
                    check_cells(sensor, cells)?;
                    energyscape.values.copy_from_slice(bytemuck::cast_slice(cells));
                } else {
                    energyscape.values.fill(0.0);
                }
            }
            let sums = sums[..layout.nonce].chunks_exact(8);
            for ((sums, row), words) in image.sums.iter_mut().zip(&masks.rows).zip(sums) {
                *sums = if active[row.sensor_index] { checked_sums(words)? } else { RowSums::SILENT };
            }
            Ok(timing.map_or(StageTimes::default(), |timing| timing.stage_times_ns(times)))
        })?;
        for (sensor, (energyscape, ping)) in image.energyscapes.iter_mut().zip(&pings.pings).enumerate() {
            if active[sensor] {
                energyscape.sequence = ping.sequence;
                energyscape.emitted_at = ping.emitted_at;
            }
        }
        Ok(())
    }

    /// Refuses pings or an image that do not fit the plan.
    fn check(&self, pings: &PingSet, image: &Image) -> Result<(), BackendError> {
        super::cpu::check_pings(&self.plan, pings)?;
        let sensors = &self.plan.sensors;
        let fits = image.energyscapes.len() == sensors.len()
            && image.energyscapes.iter().all(|energyscape| energyscape.values.len() == self.layout.cells)
            && image.channels.len() == sensors.len()
            && image.channels.iter().zip(sensors).all(|(report, sensor)| report.gains.len() == sensor.channel_count)
            && image.sums.len() == self.masks.rows.len();
        if fits { Ok(()) } else { Err(BackendError::Invalid("the image was made for another plan".to_owned())) }
    }
}

impl Backend for GpuBackend {
    fn image(&mut self, pings: &PingSet, image: &mut Image) -> Result<(), BackendError> {
        self.check(pings, image)?;
        self.submit_and_wait(pings, pings.present, image, self.limit)?;
        self.take_result(pings, pings.present, image)?;
        image.stamp(pings, BackendKind::Gpu);
        Ok(())
    }

    fn image_up_to(
        &mut self,
        stage: Stage,
        pings: &PingSet,
        sensor_index: usize,
        image: &mut Image,
    ) -> Result<StageOutput, BackendError> {
        self.check(pings, image)?;
        if sensor_index >= self.plan.sensors.len() {
            return Err(BackendError::PingShape {
                sensor_index,
                found: "no such sensor".to_owned(),
                allowed: format!("{} sensors", self.plan.sensors.len()),
            });
        }
        let mut active = [false; SENSORS_MAX];
        active[sensor_index] = pings.present[sensor_index];
        if stage >= Stage::Focus {
            self.submit_and_wait(pings, active, image, SLOW_LIMIT)?;
            self.take_result(pings, active, image)?;
            return Ok(match stage {
                Stage::Focus => StageOutput::Real(image.energyscapes[sensor_index].values.clone()),
                _ => StageOutput::Sums(image.sums.clone()),
            });
        }
        self.drain(Instant::now(), SLOW_LIMIT)?;
        self.upload(pings, active, image);
        match stage {
            Stage::Demodulate => Ok(StageOutput::Real(self.demodulated(sensor_index)?)),
            Stage::MatchedFilter => Ok(StageOutput::Complex(self.matched(sensor_index)?)),
            Stage::Envelope => Ok(StageOutput::Real(self.plane_waves(sensor_index)?)),
            _ => Ok(StageOutput::Complex(self.summed(sensor_index)?)),
        }
    }

    fn stage_times_ns(&self) -> StageTimes {
        self.stage_times_ns
    }

    fn report(&self) -> &BackendReport {
        &self.report
    }
}

impl Drop for GpuBackend {
    fn drop(&mut self) {
        // Dropping the queue waits for the device without a limit. Where it hangs or is lost, its handles are given up instead.
        if self.staging.is_pending() || self.gpu.faults.is_lost() {
            std::mem::forget((self.gpu.device.clone(), self.gpu.queue.clone()));
        }
    }
}

#[cfg(test)]
mod tests;
