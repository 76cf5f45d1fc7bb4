//! The buffers of the CPU backend, made once and shared by all threads.
//!
//! In: a plan, a mask table, an instruction set. Out: buffers cut into pieces with a lock each; a piece is written by one thread in one
//! phase and read in later ones, so nobody ever waits at a lock. What is done with them is in [`super::shares`], the arithmetic in
//! the stages' files.

use super::aligned::Aligned;
use super::channel_signal::signals_len;
use super::cleaning::Cleaning;
use super::delay_and_sum::{self, Fold, Steering};
use super::demodulate::{BitFilter, WORD_CHANNELS};
use super::focus;
use super::masked_energy::RowRuns;
use super::shared_image::SharedImage;
use super::simd::InstructionSet;
use super::transform::Transform;
use crate::imaging::channels::{ChannelFinding, WORDS_OVERLAP, WordFindings};
use crate::imaging::plan::combine::Scale;
use crate::imaging::plan::{FocusPlan, ImagingPlan};
use crate::signal::{MaskTable, RowSums, SENSORS_MAX, SampleFormat, Samples};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard, TryLockError};

/// Outputs of one piece of PDM demodulation.
const PDM_PIECE: usize = 512;
/// Outputs of one piece of the band-pass.
const BAND_PIECE: usize = 256;
/// PDM words of one piece of the judging.
const JUDGE_PIECE: usize = 16_384;
/// Runs of one piece of the masked sums, about.
const RUNS_PIECE: usize = 1024;
/// Most blocks of channels of all sensors: 256 channels, four lanes.
pub(super) const BLOCKS_MAX: usize = SENSORS_MAX * 64;

/// A part of one sensor's data: values, outputs or bins, whatever the phase cuts.
#[derive(Debug, Clone)]
pub(super) struct Piece {
    pub sensor: usize,
    /// Block of channels, where the phase has such.
    pub block: usize,
    pub range: Range<usize>,
}

/// Sensors with the same steering.
#[derive(Debug)]
pub(super) struct Group {
    pub sensors: Vec<usize>,
    pub steering: Steering,
    pub lane_blocks: usize,
    /// Whether each sensor is a task of its own: where there are few vectors of directions for many threads.
    pub split: bool,
}

/// What is to be done with the current ping set.
#[derive(Debug)]
pub(super) struct Job {
    /// Sensors to image.
    pub active: [bool; SENSORS_MAX],
    /// Their samples, lent for the time of the job.
    pub samples: [Option<Arc<Samples>>; SENSORS_MAX],
    /// `[sensor][channel]`, zeros up to whole blocks.
    pub gains: Vec<Aligned>,
    /// What goes with them where cells are combined one by one.
    pub scales: [Scale; SENSORS_MAX],
}

/// Scratch of one thread.
pub(super) struct Scratch {
    pub tile: Aligned,
    pub windows: Vec<[u32; WORD_CHANNELS]>,
    /// A transform of a block of channels, or those of the beams.
    pub transforms: Aligned,
    pub phases: Aligned,
    /// Where focusing reads the channels.
    pub readings: Aligned,
    pub square: Aligned,
    pub energies: Aligned,
}

/// Everything that the threads share.
pub(super) struct Work {
    pub plan: Arc<ImagingPlan>,
    pub masks: Arc<MaskTable>,
    pub set: InstructionSet,
    pub lanes: usize,
    pub bit_filter: BitFilter,
    pub forward: Transform,
    pub inverse: Transform,
    pub fold: Fold,
    pub groups: Vec<Group>,
    pub row_runs: RowRuns,
    next: AtomicUsize,
    /// A row of an image was held twice: a fault of this program.
    pub conflict: AtomicBool,
    /// Time spent in delay_and_sum and in envelope by all threads, nanoseconds: they share a phase.
    pub beam_times_ns: [AtomicU64; 2],
    pub job: RwLock<Job>,
    pub scratch: Vec<Mutex<Scratch>>,
    pub judged: Vec<Piece>,
    /// `[piece of judged]`: PCM has a finding a channel, PDM some for all.
    pub findings: Vec<Mutex<ChannelFinding>>,
    pub word_findings: Vec<Mutex<WordFindings>>,
    pub demodulated: Vec<Piece>,
    /// `[piece of demodulated]` of `[block][sample, padded][lane]`.
    pub pcm: Vec<RwLock<Aligned>>,
    pub filtered: Vec<Piece>,
    /// `[piece of filtered]` of `[output][re, im][lane]`.
    pub band: Vec<RwLock<Aligned>>,
    pub transformed: Vec<Piece>,
    /// `[piece of transformed]` of `[bin][re, im][lane]`.
    pub spectra: Vec<RwLock<Aligned>>,
    /// `[piece of transformed]` of `[lane][row][re, im][sample]`; the transform that makes them. Nothing where no range is focused.
    pub signals: Vec<RwLock<Aligned>>,
    pub to_signal: Option<Transform>,
    /// Sensors of one geometry together.
    pub focus_groups: Vec<Vec<usize>>,
    pub cleaning: Cleaning,
    /// `[sensor]` of `[direction][range]`: being written, and finished.
    pub drafts: Vec<SharedImage>,
    pub images: Vec<RwLock<Vec<f32>>>,
    pub row_pieces: Vec<Range<usize>>,
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

fn channels_max(plan: &ImagingPlan) -> usize {
    plan.sensors.iter().map(|sensor| sensor.channel_count).max().unwrap_or(0)
}

/// `0..count` in pieces of `piece`, for every block of every sensor.
fn pieces(plan: &ImagingPlan, blocks: impl Fn(usize) -> usize, count: usize, piece: usize) -> Vec<Piece> {
    let of_block = |sensor: usize, block: usize| {
        let range = move |first: usize| first..count.min(first + piece);
        (0..count).step_by(piece).map(move |first| Piece { sensor, block, range: range(first) })
    };
    (0..plan.sensors.len())
        .flat_map(|sensor| (0..blocks(sensor)).map(move |block| (sensor, block)))
        .flat_map(|(sensor, block)| of_block(sensor, block))
        .collect()
}

/// PCM: a channel each; PDM: stretches of words that overlap by what a run may straddle.
fn judged(plan: &ImagingPlan) -> Vec<Piece> {
    if plan.format != SampleFormat::Pdm {
        return pieces(plan, |sensor| plan.sensors[sensor].channel_count, plan.raw_count, plan.raw_count);
    }
    let mut pieces = pieces(plan, |_| 1, plan.raw_count, JUDGE_PIECE);
    for piece in &mut pieces {
        piece.range.end = plan.raw_count.min(piece.range.end + WORDS_OVERLAP);
    }
    pieces
}

/// Sensors with the same delays together, with their steering.
fn groups(plan: &ImagingPlan, lanes: usize, threads: usize) -> Vec<Group> {
    let sensors = || 0..plan.sensors.len();
    let group = |first: usize| {
        let steering = Steering::new(&plan.sensors[first], plan.bin_step_hz, lanes);
        let lane_blocks = steering.lane_blocks(lanes);
        Group {
            sensors: sensors().filter(|&sensor| plan.sensors[sensor].steering_of == first).collect(),
            steering,
            lane_blocks,
            split: lane_blocks < 3 * threads,
        }
    };
    sensors().filter(|&sensor| plan.sensors[sensor].steering_of == sensor).map(group).collect()
}

/// Sensors that are focused alike.
fn focus_groups(plan: &ImagingPlan) -> Vec<Vec<usize>> {
    let Some(focus) = &plan.focus else { return Vec::new() };
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (sensor, geometry) in focus.sensors.iter().enumerate() {
        match groups.iter_mut().find(|group| focus.sensors[group[0]] == *geometry) {
            Some(group) => group.push(sensor),
            None => groups.push(vec![sensor]),
        }
    }
    groups
}

fn fold(plan: &ImagingPlan, inverse: &Transform) -> Fold {
    let len = plan.inverse_len;
    let place = |index: usize| inverse.place((plan.first_bin + index) % len) as u32;
    Fold {
        places: (0..plan.bin_count).map(place).collect(),
        fresh: len,
        gaps: (plan.bin_count..len.max(plan.bin_count)).map(place).collect(),
        len,
    }
}

fn scratch(
    plan: &ImagingPlan,
    lanes: usize,
    transform_len: usize,
    bit_filter: &BitFilter,
    row_runs: &RowRuns,
) -> Scratch {
    let samples = (BAND_PIECE - 1) * plan.band_decimation + plan.band_taps.len();
    let pdm = plan.format == SampleFormat::Pdm;
    Scratch {
        tile: Aligned::zeros(samples * lanes),
        windows: vec![[0; WORD_CHANNELS]; if pdm { bit_filter.window_count(PDM_PIECE) } else { 0 }],
        transforms: Aligned::zeros(transform_len),
        phases: Aligned::zeros(delay_and_sum::scratch_len(channels_max(plan), lanes)),
        readings: Aligned::zeros(focus::scratch_len(channels_max(plan), lanes)),
        square: Aligned::zeros(lanes * lanes),
        energies: Aligned::zeros(row_runs.scratch_len()),
    }
}

impl Work {
    /// Makes all buffers.
    pub(super) fn new(plan: Arc<ImagingPlan>, masks: Arc<MaskTable>, set: InstructionSet, threads: usize) -> Self {
        let lanes = set.lanes();
        let (directions, ranges) = (plan.grid.direction_count(), plan.grid.range_count());
        let sensors = plan.sensors.len();
        let blocks = |sensor: usize| plan.sensors[sensor].channel_count.div_ceil(lanes);
        let bit_filter = BitFilter::new(&plan.demodulation_taps, plan.decimation, set.lookup_bits());
        let (forward, inverse) = (Transform::new(plan.forward_len), Transform::new(plan.inverse_len));
        let row_runs = RowRuns::new(&masks, &plan, lanes);
        let row_pieces = row_runs.pieces(RUNS_PIECE);
        let pdm = plan.format == SampleFormat::Pdm;
        let judged = judged(&plan);
        let demodulated = if pdm { pieces(&plan, |_| 1, plan.sample_count, PDM_PIECE) } else { Vec::new() };
        let filtered = pieces(&plan, blocks, plan.forward_len, BAND_PIECE);
        let transformed = pieces(&plan, blocks, plan.bin_count, plan.bin_count);
        let zeros = |len: usize| RwLock::new(Aligned::zeros(len));
        let pcm = |piece: &Piece| zeros(bit_filter.padded(piece.range.len()) * blocks(piece.sensor) * lanes);
        let to_signal = plan.focus.as_ref().map(|focus| Transform::new(focus.signal_len));
        let signals = |focus: &FocusPlan| transformed.iter().map(|_| zeros(signals_len(focus, lanes))).collect();
        let longest = to_signal.as_ref().map_or(0, |transform| transform.buffer_len(lanes));
        let beams = 2 * sensors * inverse.buffer_len(lanes);
        let transform_len = beams.max(forward.buffer_len(lanes)).max(longest);
        let gains = |sensor: usize| Aligned::zeros(blocks(sensor) * lanes);
        Self {
            lanes,
            set,
            fold: fold(&plan, &inverse),
            groups: groups(&plan, lanes, threads),
            next: AtomicUsize::new(0),
            conflict: AtomicBool::new(false),
            beam_times_ns: [AtomicU64::new(0), AtomicU64::new(0)],
            job: RwLock::new(Job {
                active: [false; SENSORS_MAX],
                samples: [const { None }; SENSORS_MAX],
                gains: (0..sensors).map(gains).collect(),
                scales: [Scale::default(); SENSORS_MAX],
            }),
            findings: judged.iter().map(|_| Mutex::new(ChannelFinding::Good)).collect(),
            word_findings: judged.iter().map(|_| Mutex::new(WordFindings::NONE)).collect(),
            pcm: demodulated.iter().map(pcm).collect(),
            band: filtered.iter().map(|piece| zeros(2 * piece.range.len() * lanes)).collect(),
            spectra: transformed.iter().map(|piece| zeros(2 * piece.range.len() * lanes)).collect(),
            signals: plan.focus.as_ref().map_or_else(Vec::new, signals),
            drafts: (0..sensors).map(|_| SharedImage::zeros(directions, ranges)).collect(),
            images: (0..sensors).map(|_| RwLock::new(vec![0.0; directions * ranges])).collect(),
            sums: row_pieces.iter().map(|piece| Mutex::new(vec![RowSums::SILENT; piece.len()])).collect(),
            scratch: (0..threads)
                .map(|_| Mutex::new(scratch(&plan, lanes, transform_len, &bit_filter, &row_runs)))
                .collect(),
            to_signal,
            focus_groups: focus_groups(&plan),
            cleaning: Cleaning::new(&plan),
            bit_filter,
            forward,
            inverse,
            row_runs,
            row_pieces,
            judged,
            demodulated,
            filtered,
            transformed,
            plan,
            masks,
        }
    }

    /// The job, to be changed between phases; `None` while a thread still works on it, which only one that hangs does.
    fn change_job(&self) -> Option<RwLockWriteGuard<'_, Job>> {
        match self.job.try_write() {
            Ok(job) => Some(job),
            Err(TryLockError::Poisoned(poisoned)) => Some(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// Lends the samples of the active sensors to the threads. False when one of them hangs.
    pub(super) fn lend<'a>(
        &self,
        active: [bool; SENSORS_MAX],
        samples: impl Iterator<Item = &'a Arc<Samples>>,
    ) -> bool {
        let Some(mut job) = self.change_job() else { return false };
        job.active = active;
        for ((own, samples), active) in job.samples.iter_mut().zip(samples).zip(active) {
            *own = active.then(|| Arc::clone(samples));
        }
        true
    }

    /// Ends the loan; a thread that hangs keeps its own, and whoever fills the buffer next gets a new one.
    pub(super) fn give_back(&self) {
        if let Some(mut job) = self.change_job() {
            job.samples = [const { None }; SENSORS_MAX];
        }
    }

    /// Sets `gains[sensor][channel]`. False when a thread hangs.
    pub(super) fn set_gains<'a>(&self, gains: impl Iterator<Item = &'a [f32]>) -> bool {
        let Some(mut job) = self.change_job() else { return false };
        let combine = self.plan.focus.as_ref().map(|focus| focus.combine).filter(|combine| !combine.is_sum());
        let job = &mut *job;
        for ((kept, scale), gains) in job.gains.iter_mut().zip(&mut job.scales).zip(gains) {
            kept[..gains.len()].copy_from_slice(gains);
            if let Some(combine) = combine {
                *scale = combine.scale(gains);
            }
        }
        true
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

    /// Finished drafts become images, by exchange. False when a thread still holds a row.
    pub(super) fn finish_images(&self) -> bool {
        let active = reading(&self.job).active;
        let pairs = self.drafts.iter().zip(&self.images).zip(active).filter(|(_, active)| *active);
        pairs.fold(true, |all, ((draft, image), _)| draft.exchange(&mut writing(image)) && all)
            && !self.conflict.load(Ordering::Acquire)
    }

    /// Copies the sums of all rows to `sums`.
    pub(super) fn copy_sums(&self, sums: &mut [RowSums]) {
        for (rows, piece) in self.row_pieces.iter().zip(&self.sums) {
            sums[rows.clone()].copy_from_slice(&locked(piece));
        }
    }
}
