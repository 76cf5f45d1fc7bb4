//! GPU twin: the five stages as WGSL kernels through wgpu, one submission a ping set.
//!
//! In: raw pings and the channels' gains. Out: energyscapes and masked sums. `program.rs` makes every buffer and pipeline at open;
//! here is the order of a ping set: upload, poison, dispatch, read back, check. Every wait ends, every error comes back as a
//! [`BackendError`], nothing panics. Never judges channels and never chooses between backends.
//!
//! Counted for the default plan, three sensors of 32 channels, PDM, 180 directions, 941 ranges: 11 dispatches, 2.0 MB up,
//! 2.0 MB down. Through the device's memory, caches left aside:
//!
//! | stage | dispatches | MB | why |
//! |---|---|---|---|
//! | demodulate | 2 | 12 | words, bit streams there and back, PCM |
//! | matched_filter | 4 | 16 | PCM once, N1 = 2048 complex values a channel there and back three times |
//! | delay_and_sum | 1 | 6 | 0.8 of spectra (again from the cache for every four beams), spectra of 540 directions |
//! | envelope | 3 | 28 | M = 1250 complex values a direction there and back twice, energyscapes |
//! | masked_energy | 1 | 2 + 32 bytes an entry | energyscapes, the table twice |
//!
//! Poisoning moves 4 MB more. Arithmetic: 0.1 G additions of table values, 0.05 G multiply-adds of the band filter, 0.1 G of
//! delay-and-sum with its sines, 0.1 G of the transforms.

mod device;
mod params;
mod program;
mod readback;
pub mod stage;
mod tables;
mod timing;
mod transform;

pub use device::{AdapterDescription, AdapterKind, adapters};
pub use params::{PARAMS_LAYOUT, Params};
pub use readback::panic_is_a_lost_device;

use super::backend::{Backend, BackendError, BackendKind, BackendReport, Image, Stage, StageOutput};
use super::plan::ImagingPlan;
use crate::signal::{MaskTable, PingSet, RowSums, SENSORS_MAX, Samples};
use device::Gpu;
use params::{NONCE_WORDS, ResultLayout, channel_stride};
use program::{Blueprint, Program, Resource};
use readback::{POISON, Staging, check_cells, check_nonce, checked_sums};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use timing::{TIMESTAMP_BYTES, Timing};

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
    params: Params,
    gpu: Gpu,
    program: Program,
    poison: wgpu::Buffer,
    staging: Staging,
    timing: Option<Timing>,
    limit: Duration,
    report: BackendReport,
    stage_times_ns: [u64; 5],
    /// Gains of all channels, and packed 16-bit samples of one sensor.
    gains: Vec<f32>,
    packed: Vec<u32>,
    /// One channel of nothing.
    silence: Vec<f32>,
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
        let blueprint = Blueprint::new(&plan, &masks)?;
        let gpu = device::open(allow_software, blueprint.needs())?;
        let mut params = blueprint.params;
        params.nonce_epoch = EPOCH.fetch_add(1, Ordering::Relaxed);
        let program = Program::new(&gpu, blueprint)?;
        let layout = ResultLayout::new(&plan, &masks);
        let mut backend = Self {
            poison: poison_buffer(&gpu, layout.total),
            staging: Staging::new(&gpu, (4 * layout.total as u64).next_multiple_of(8) + TIMESTAMP_BYTES),
            timing: Timing::new(&gpu),
            limit: Duration::from_millis(deadline_ms),
            report: BackendReport {
                kind: BackendKind::Gpu,
                adapter: gpu.description.to_string(),
                reason: "the GPU backend was asked for".to_owned(),
                threads: 1,
            },
            stage_times_ns: [0; 5],
            gains: vec![0.0; plan.sensors.len() * channel_stride(&plan)],
            packed: Vec::new(),
            silence: vec![0.0; plan.raw_count],
            plan,
            masks,
            layout,
            params,
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

    /// Destroys the device, as a driver that fails would: every later call returns [`BackendError::Lost`]. For tests and drills.
    pub fn destroy_device(&self) {
        self.gpu.device.destroy();
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
        let mut encoder = self.encode(Stage::MaskedEnergy);
        let bytes = 4 * self.layout.total as u64;
        let result = self.program.buffer(Resource::Result);
        encoder.copy_buffer_to_buffer(result, 0, &self.staging.buffer, 0, bytes);
        if let Some(timing) = &self.timing {
            timing.resolve(&mut encoder, &self.staging.buffer, bytes.next_multiple_of(8));
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
        self.params.present = 0;
        let queue = &self.gpu.queue;
        for (sensor, ping) in pings.pings.iter().enumerate().filter(|(sensor, _)| active[*sensor]) {
            self.params.present |= 1 << sensor;
            let gains = &image.channels[sensor].gains;
            self.gains[sensor * stride..][..gains.len()].copy_from_slice(gains);
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
        self.params.nonce_low = pings.sequence as u32;
        self.params.nonce_high = (pings.sequence >> 32) as u32;
        queue.write_buffer(self.program.buffer(Resource::Gains), 0, bytemuck::cast_slice(&self.gains));
        queue.write_buffer(&self.program.params, 0, bytemuck::bytes_of(&self.params));
    }

    /// Poisons the result and records every dispatch up to a stage, a compute pass a stage.
    fn encode(&self, last: Stage) -> wgpu::CommandEncoder {
        let mut encoder =
            self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("ping set") });
        let result = self.program.buffer(Resource::Result);
        encoder.copy_buffer_to_buffer(&self.poison, 0, result, 0, 4 * self.layout.total as u64);
        for stage in Stage::ALL.into_iter().filter(|stage| *stage <= last) {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some(stage.stem()),
                timestamp_writes: self.timing.as_ref().map(|timing| timing.writes(stage)),
            });
            for step in self.program.steps.iter().filter(|step| step.stage == stage) {
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
        let (layout, nonce, masks) = (self.layout, self.params.nonce(), Arc::clone(&self.masks));
        let timing = self.timing.as_ref();
        self.stage_times_ns = self.staging.read(|bytes| {
            let (result, times) = bytes.split_at((4 * layout.total).next_multiple_of(8));
            let words: &[u32] = bytemuck::try_cast_slice(&result[..4 * layout.total])
                .map_err(|error| BackendError::Invalid(error.to_string()))?;
            check_nonce(&words[layout.nonce..][..NONCE_WORDS], nonce)?;
            for (sensor, energyscape) in image.energyscapes.iter_mut().enumerate() {
                if active[sensor] {
                    let cells = &words[sensor * layout.cells..][..layout.cells];
                    check_cells(sensor, cells)?;
                    energyscape.values.copy_from_slice(bytemuck::cast_slice(cells));
                } else {
                    energyscape.values.fill(0.0);
                }
            }
            let sums = words[layout.sums..layout.nonce].chunks_exact(8);
            for ((sums, row), words) in image.sums.iter_mut().zip(&masks.rows).zip(sums) {
                *sums = if active[row.sensor_index] { checked_sums(words)? } else { RowSums::SILENT };
            }
            Ok(timing.map_or([0; 5], |timing| timing.stage_times_ns(times)))
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

    /// Bytes of a buffer after the stages up to `last`, as words.
    fn words_after(
        &mut self,
        last: Stage,
        resource: Resource,
        first: usize,
        count: usize,
    ) -> Result<Vec<u32>, BackendError> {
        let start = Instant::now();
        let bytes = 4 * count.max(1) as u64;
        let mut staging = Staging::new(&self.gpu, bytes);
        let mut encoder = self.encode(last);
        encoder.copy_buffer_to_buffer(self.program.buffer(resource), 4 * first as u64, &staging.buffer, 0, bytes);
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu.faults.check()?;
        staging.request();
        staging.wait(&self.gpu, start, SLOW_LIMIT)?;
        staging.read(|bytes| Ok(bytemuck::pod_collect_to_vec(bytes)))
    }

    /// Rows of bins after a stage.
    fn bins_after(
        &mut self,
        stage: Stage,
        resource: Resource,
        row: usize,
        rows: usize,
    ) -> Result<StageOutput, BackendError> {
        let bins = self.plan.bin_count;
        let words = self.words_after(stage, resource, 2 * bins * row, 2 * bins * rows)?;
        let pair = |pair: &[u32]| [f32::from_bits(pair[0]), f32::from_bits(pair[1])];
        Ok(StageOutput::Complex(words.chunks_exact(2).map(pair).collect()))
    }

    /// PCM of a sensor, put back from phase rows into `[channel][sample]`.
    fn demodulated(&mut self, sensor: usize) -> Result<Vec<f32>, BackendError> {
        let (phases, row_len, lead) = (self.plan.band_decimation, self.program.rows.stride, self.program.rows.lead);
        let rows = channel_stride(&self.plan) * phases;
        let words = self.words_after(Stage::Demodulate, Resource::Pcm, sensor * rows * row_len, rows * row_len)?;
        let channels = self.plan.sensors[sensor].channel_count;
        let value = |channel: usize, n: usize| words[(channel * phases + n % phases) * row_len + lead + n / phases];
        let samples = self.plan.sample_count;
        Ok((0..channels)
            .flat_map(|channel| (0..samples).map(move |n| (channel, n)))
            .map(|(channel, n)| f32::from_bits(value(channel, n)))
            .collect())
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
        if stage >= Stage::Envelope {
            self.submit_and_wait(pings, active, image, SLOW_LIMIT)?;
            self.take_result(pings, active, image)?;
            return Ok(match stage {
                Stage::Envelope => StageOutput::Real(image.energyscapes[sensor_index].values.clone()),
                _ => StageOutput::Sums(image.sums.clone()),
            });
        }
        self.drain(Instant::now(), SLOW_LIMIT)?;
        self.upload(pings, active, image);
        match stage {
            Stage::Demodulate => Ok(StageOutput::Real(self.demodulated(sensor_index)?)),
            Stage::MatchedFilter => {
                let row = sensor_index * channel_stride(&self.plan);
                self.bins_after(stage, Resource::Spectra, row, self.plan.sensors[sensor_index].channel_count)
            }
            _ => {
                let rows = self.plan.grid.direction_count();
                self.bins_after(stage, Resource::WorkA, sensor_index * rows, rows)
            }
        }
    }

    fn stage_times_ns(&self) -> [u64; 5] {
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

fn poison_buffer(gpu: &Gpu, words: usize) -> wgpu::Buffer {
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("poison"),
        size: 4 * words as u64,
        usage: wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    gpu.queue.write_buffer(&buffer, 0, bytemuck::cast_slice(&vec![POISON; words]));
    buffer
}

#[cfg(test)]
mod tests;
