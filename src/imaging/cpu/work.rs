//! The buffers of the CPU backend and the share of every thread in every phase.
//!
//! In: a [`Job`] (which sensors, which gains) and raw samples, lent by the caller or copied for the other threads. Out: the
//! energyscapes and sums in this file's buffers. Every buffer that threads hand to each other is cut into pieces with a lock
//! each; a piece is written by one thread in one phase and read in later ones, so nobody ever waits at a lock. The arithmetic is
//! in the stages' files.

use super::delay_and_sum::{self, BLOCK, Steering};
use super::demodulate::{self, WORD_CHANNELS};
use super::envelope;
use super::masked_energy::RowWeights;
use super::matched_filter::BandPass;
use super::simd::InstructionSet;
use crate::imaging::plan::ImagingPlan;
use crate::signal::{MaskTable, RowSums, SENSORS_MAX, SampleFormat, Samples};
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

/// Outputs of one piece of PDM demodulation.
const PDM_PIECE: usize = 512;
/// Directions of one piece of an image.
pub(super) const IMAGE_PIECE: usize = 6;
/// Cells of one piece of the masked sums, about.
const ROWS_PIECE: usize = 8192;

/// The phases of a ping, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(usize)]
pub(super) enum Phase {
    Demodulate,
    MatchedFilter,
    DelayAndSum,
    Envelope,
    Gain,
    Rows,
}

impl Phase {
    pub(super) const ALL: [Phase; 6] =
        [Phase::Demodulate, Phase::MatchedFilter, Phase::DelayAndSum, Phase::Envelope, Phase::Gain, Phase::Rows];
}

/// A piece of the raw data: one channel (PCM) or some outputs of all channels (PDM).
#[derive(Debug, Clone)]
pub(super) struct RawPiece {
    pub sensor: usize,
    /// Values of the raw ping.
    pub values: Range<usize>,
    /// PDM: outputs.
    pub samples: Range<usize>,
}

/// Sensors with the same steering.
#[derive(Debug)]
pub(super) struct Group {
    pub sensors: Vec<usize>,
    pub steering: Steering,
}

/// What is to be done with the current ping set.
#[derive(Debug)]
pub(super) struct Job {
    /// Sensors to image.
    pub active: [bool; SENSORS_MAX],
    /// `[sensor][channel]`.
    pub gains: Vec<Vec<f32>>,
    pub groups: Vec<GroupJob>,
    /// Group of each active sensor, and its place among the group's active ones.
    pub place: [(usize, usize); SENSORS_MAX],
}

/// What is to be done for one array.
#[derive(Debug)]
pub(super) struct GroupJob {
    /// Its active sensors, in order.
    pub sensors: Vec<usize>,
    /// The channels that any of them uses.
    pub channels: Vec<usize>,
}

/// Scratch of one thread.
#[derive(Debug)]
pub(super) struct Scratch {
    pub samples: Vec<f32>,
    pub window: Vec<f32>,
    pub forward: Vec<Complex<f32>>,
    pub inverse: Vec<Complex<f32>>,
    pub transform: Vec<Complex<f32>>,
    pub magnitudes: Vec<f32>,
    pub spectra: Vec<Complex<f32>>,
    pub phases: Vec<f32>,
}

impl Job {
    fn new(plan: &ImagingPlan, groups: usize) -> Self {
        let (sensors, channels) = (plan.sensors.len(), channels_max(plan));
        let group =
            |_: usize| GroupJob { sensors: Vec::with_capacity(sensors), channels: Vec::with_capacity(channels) };
        Self {
            active: [false; SENSORS_MAX],
            gains: plan.sensors.iter().map(|sensor| vec![0.0; sensor.channel_count]).collect(),
            groups: (0..groups).map(group).collect(),
            place: [(0, 0); SENSORS_MAX],
        }
    }
}

impl Scratch {
    fn new(plan: &ImagingPlan, band_pass: &BandPass, forward: &dyn Fft<f32>, inverse: &dyn Fft<f32>) -> Self {
        let zeros = |count: usize| vec![Complex::default(); count];
        Self {
            samples: vec![0.0; plan.sample_count],
            window: vec![0.0; band_pass.window_len()],
            forward: zeros(forward.get_inplace_scratch_len()),
            inverse: zeros(inverse.get_inplace_scratch_len()),
            transform: zeros(plan.forward_len.max(IMAGE_PIECE * plan.inverse_len)),
            magnitudes: vec![0.0; plan.inverse_len],
            spectra: zeros(BLOCK * channels_max(plan) * SENSORS_MAX),
            phases: vec![0.0; delay_and_sum::scratch_len(channels_max(plan))],
        }
    }
}

fn channels_max(plan: &ImagingPlan) -> usize {
    plan.sensors.iter().map(|sensor| sensor.channel_count).max().unwrap_or(0)
}

/// Everything that the threads share.
pub(super) struct Work {
    pub plan: Arc<ImagingPlan>,
    pub masks: Arc<MaskTable>,
    pub set: InstructionSet,
    pub threads: usize,
    pub band_pass: BandPass,
    pub forward: Arc<dyn Fft<f32>>,
    pub inverse: Arc<dyn Fft<f32>>,
    pub groups: Vec<Group>,
    pub weights: RowWeights,
    pub gains: Vec<Vec<f32>>,
    pub floors: Vec<Vec<f32>>,
    /// First channel of each sensor among all channels, and their number at the end.
    pub first_channel: Vec<usize>,
    pub row_pieces: Vec<Range<usize>>,
    pub raw_pieces: Vec<RawPiece>,
    pub next: AtomicUsize,
    pub job: RwLock<Job>,
    pub scratch: Vec<Mutex<Scratch>>,
    /// Copies of the raw pieces that other threads than the caller work on.
    pub copies: Vec<Mutex<Samples>>,
    /// `[raw piece]` of `[channel][sample]`, PDM only.
    pub demodulated: Vec<RwLock<Vec<f32>>>,
    /// `[channel of all sensors]` of `[bin]`.
    pub spectra: Vec<RwLock<Vec<Complex<f32>>>>,
    /// `[group][block]` of `[active sensor][direction][bin]`.
    pub beams: Vec<Vec<RwLock<Vec<Complex<f32>>>>>,
    /// `[sensor][piece]` of `[direction][range]`.
    pub pieces: Vec<Vec<Mutex<Vec<f32>>>>,
    /// `[sensor]` of `[direction][range]`.
    pub images: Vec<RwLock<Vec<f32>>>,
    pub energies: Vec<RwLock<Vec<f32>>>,
    /// `[row piece]` of `[row]`.
    pub sums: Vec<Mutex<Vec<RowSums>>>,
}

pub(super) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

pub(super) fn reading<T>(lock: &RwLock<T>) -> RwLockReadGuard<'_, T> {
    lock.read().unwrap_or_else(PoisonError::into_inner)
}

pub(super) fn writing<T>(lock: &RwLock<T>) -> RwLockWriteGuard<'_, T> {
    lock.write().unwrap_or_else(PoisonError::into_inner)
}

/// Values per sensor and range from the mask table, `default` where it has none.
fn range_table(table: &[Vec<f32>], plan: &ImagingPlan, default: f32) -> Vec<Vec<f32>> {
    let ranges = plan.grid.range_count();
    (0..plan.sensors.len())
        .map(|sensor| {
            table.get(sensor).filter(|row| row.len() == ranges).cloned().unwrap_or_else(|| vec![default; ranges])
        })
        .collect()
}

fn raw_pieces(plan: &ImagingPlan) -> Vec<RawPiece> {
    let of_sensor = |sensor: usize| -> Vec<RawPiece> {
        if plan.format == SampleFormat::Pdm {
            let pieces = (0..plan.sample_count).step_by(PDM_PIECE);
            let piece = |first: usize| {
                let count = PDM_PIECE.min(plan.sample_count - first);
                let taps = plan.demodulation_taps.len();
                let values = demodulate::words_needed(first, count, plan.decimation, taps, plan.raw_count);
                RawPiece { sensor, values, samples: first..first + count }
            };
            pieces.map(piece).collect()
        } else {
            let channels = 0..plan.sensors[sensor].channel_count;
            let row = |channel: usize| channel * plan.raw_count..(channel + 1) * plan.raw_count;
            channels.map(|channel| RawPiece { sensor, values: row(channel), samples: 0..plan.sample_count }).collect()
        }
    };
    (0..plan.sensors.len()).flat_map(of_sensor).collect()
}

/// Rows in order, cut where about [`ROWS_PIECE`] cells are together.
fn row_pieces(masks: &MaskTable) -> Vec<Range<usize>> {
    let mut pieces = Vec::new();
    let (mut first, mut cells) = (0, 0);
    for (index, row) in masks.rows.iter().enumerate() {
        cells += row.count;
        if cells >= ROWS_PIECE || index + 1 == masks.rows.len() {
            pieces.push(first..index + 1);
            (first, cells) = (index + 1, 0);
        }
    }
    pieces
}

/// Sensors with the same delays together, with their steering.
fn groups(plan: &ImagingPlan, set: InstructionSet) -> Vec<Group> {
    let sensors = || 0..plan.sensors.len();
    let group = |first: usize| Group {
        sensors: sensors().filter(|&sensor| plan.sensors[sensor].steering_of == first).collect(),
        steering: Steering::new(&plan.sensors[first], plan.bin_step_hz, set.lanes()),
    };
    sensors().filter(|&sensor| plan.sensors[sensor].steering_of == sensor).map(group).collect()
}

/// First channel of each sensor among the channels of all, and their number at the end.
fn first_channels(plan: &ImagingPlan) -> Vec<usize> {
    let mut first = vec![0];
    first.extend(plan.sensors.iter().scan(0, |sum, sensor| {
        *sum += sensor.channel_count;
        Some(*sum)
    }));
    first
}

impl Work {
    /// Makes all buffers.
    pub(super) fn new(plan: Arc<ImagingPlan>, masks: Arc<MaskTable>, set: InstructionSet, threads: usize) -> Self {
        let mut planner = FftPlanner::new();
        let forward = planner.plan_fft_forward(plan.forward_len);
        let inverse = planner.plan_fft_inverse(plan.inverse_len);
        let sensors = plan.sensors.len();
        let (directions, ranges) = (plan.grid.direction_count(), plan.grid.range_count());
        let groups = groups(&plan, set);
        let first_channel = first_channels(&plan);
        let zeros = |count: usize| vec![Complex::default(); count];
        let band_pass = BandPass::new(&plan);
        let raw_pieces = raw_pieces(&plan);
        let row_pieces = row_pieces(&masks);
        let blocks = envelope::block_count(plan.bin_count);
        let demodulated = |piece: &RawPiece| {
            let pdm = if plan.format == SampleFormat::Pdm { WORD_CHANNELS * piece.samples.len() } else { 0 };
            RwLock::new(vec![0.0; pdm])
        };
        let copied = |(index, piece): (usize, &RawPiece)| {
            let len = if index % threads == 0 { 0 } else { piece.values.len() };
            Mutex::new(Samples::zeros(plan.format, len))
        };
        let group_beams = |group: &Group| {
            (0..blocks).map(|_| RwLock::new(zeros(group.sensors.len() * directions * BLOCK))).collect::<Vec<_>>()
        };
        let image_pieces = |_: usize| {
            let count = |first: usize| IMAGE_PIECE.min(directions - first);
            (0..directions).step_by(IMAGE_PIECE).map(|first| Mutex::new(vec![0.0; count(first) * ranges])).collect()
        };
        let image = |_: usize| RwLock::new(vec![0.0; directions * ranges]);
        Self {
            set,
            threads,
            weights: RowWeights::new(&masks, &plan.grid),
            gains: range_table(&masks.gains, &plan, 1.0),
            floors: range_table(&masks.floors, &plan, 0.0),
            next: AtomicUsize::new(0),
            job: RwLock::new(Job::new(&plan, groups.len())),
            scratch: (0..threads).map(|_| Mutex::new(Scratch::new(&plan, &band_pass, &*forward, &*inverse))).collect(),
            copies: raw_pieces.iter().enumerate().map(copied).collect(),
            demodulated: raw_pieces.iter().map(demodulated).collect(),
            spectra: (0..first_channel[sensors]).map(|_| RwLock::new(zeros(plan.bin_count))).collect(),
            beams: groups.iter().map(group_beams).collect(),
            pieces: (0..sensors).map(image_pieces).collect(),
            images: (0..sensors).map(image).collect(),
            energies: (0..sensors).map(image).collect(),
            sums: row_pieces.iter().map(|piece| Mutex::new(vec![RowSums::SILENT; piece.len()])).collect(),
            band_pass,
            forward,
            inverse,
            groups,
            first_channel,
            row_pieces,
            raw_pieces,
            plan,
            masks,
        }
    }

    /// Sets what is to be done: the sensors, and `gains[sensor][channel]`.
    pub(super) fn begin<'a>(&self, active: [bool; SENSORS_MAX], gains: impl Iterator<Item = &'a [f32]>) {
        let mut job = writing(&self.job);
        let job = &mut *job;
        job.active = active;
        for (own, gains) in job.gains.iter_mut().zip(gains) {
            own.copy_from_slice(gains);
        }
        for (index, (group, GroupJob { sensors, channels })) in self.groups.iter().zip(&mut job.groups).enumerate() {
            sensors.clear();
            sensors.extend(group.sensors.iter().filter(|&&sensor| active[sensor]));
            for (place, sensor) in sensors.iter().enumerate() {
                job.place[*sensor] = (index, place);
            }
            channels.clear();
            let used = |channel: &usize| sensors.iter().any(|&sensor| job.gains[sensor][*channel] != 0.0);
            channels.extend((0..group.steering.channel_count()).filter(used));
        }
    }

    /// Makes the tasks of the next phase available.
    pub(super) fn rewind(&self) {
        self.next.store(0, Ordering::Release);
    }

    /// Calls `task` for task numbers up to `count` that nobody has taken yet.
    pub(super) fn take_tasks(&self, count: usize, mut task: impl FnMut(usize)) {
        loop {
            let index = self.next.fetch_add(1, Ordering::AcqRel);
            if index >= count {
                return;
            }
            task(index);
        }
    }
}
