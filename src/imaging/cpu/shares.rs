//! What a thread does in each phase: which pieces it takes, from which buffer to which.
//!
//! In and out: the buffers of [`Work`]. Pieces are taken as they come; each is computed alone, so the result does not depend on who
//! computes it. The arithmetic is in the stages' files.

use super::channel_signal::SignalTask;
use super::delay_and_sum::BeamTask;
use super::demodulate::DemodulateTask;
use super::envelope::EnvelopeTask;
use super::focus::FocusTask;
use super::judge::JudgeTask;
use super::masked_energy::RowTask;
use super::matched_filter::{BandPassTask, SpectrumTask};
use super::tile::{Pcm, TileTask};
use super::work::{BLOCKS_MAX, Group, Job, Piece, Scratch, Work, locked, reading, writing};
use super::{pool, simd};
use crate::imaging::channels;
use crate::imaging::plan::combine::Scale;
use crate::signal::{RowSums, SENSORS_MAX, Samples};
use std::ops::Range;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// The phases of a ping, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(usize)]
pub(super) enum Phase {
    Judge,
    Demodulate,
    BandPass,
    Spectrum,
    Beams,
    Signals,
    Focus,
    Pick,
    Fit,
    TakeOut,
    PutBack,
    Rows,
}

impl Phase {
    const ALL: [Phase; 12] = [
        Phase::Judge,
        Phase::Demodulate,
        Phase::BandPass,
        Phase::Spectrum,
        Phase::Beams,
        Phase::Signals,
        Phase::Focus,
        Phase::Pick,
        Phase::Fit,
        Phase::TakeOut,
        Phase::PutBack,
        Phase::Rows,
    ];
}

/// Most lanes of a vector.
const LANES_MAX: usize = 16;

impl Work {
    /// A thread's share of a phase.
    pub(super) fn share(&self, phase: Phase, thread: usize) {
        let job = reading(&self.job);
        let scratch = &mut *locked(&self.scratch[thread]);
        match phase {
            Phase::Judge => self.take_tasks(self.judged.len(), |index| self.judge(&job, index)),
            Phase::Demodulate => self.take_tasks(self.demodulated.len(), |index| self.demodulate(&job, index, scratch)),
            Phase::BandPass => self.take_tasks(self.filtered.len(), |index| self.band_pass(&job, index, scratch)),
            Phase::Spectrum => self.take_tasks(self.transformed.len(), |index| self.spectrum(&job, index, scratch)),
            Phase::Beams => self.beams_share(&job, scratch),
            Phase::Signals => self.take_tasks(self.signals.len(), |index| self.channel_signal(&job, index, scratch)),
            Phase::Focus => {
                let directions = self.plan.grid.direction_count();
                let groups = &self.focus_groups;
                self.take_tasks(groups.len() * directions, |index| {
                    self.focus(&job, &groups[index / directions], index % directions, scratch);
                });
            }
            Phase::Pick | Phase::Fit | Phase::TakeOut | Phase::PutBack => self.clean_share(&job, phase),
            Phase::Rows => self.take_tasks(self.row_pieces.len(), |index| self.sum_rows(&job, index, scratch)),
        }
    }

    fn judge(&self, job: &Job, index: usize) {
        let Piece { sensor, block: channel, range } = &self.judged[index];
        let Some(samples) = &job.samples[*sensor] else { return };
        let clip_from = channels::clip_from(&self.plan, *sensor);
        let row = channel * self.plan.raw_count..(channel + 1) * self.plan.raw_count;
        match &**samples {
            Samples::PcmF32(values) => {
                let (row, found) = (&values[row], &mut *locked(&self.findings[index]));
                simd::judge(self.set, JudgeTask::F32 { row, clip_from, found });
            }
            Samples::PcmI16(values) => {
                let (row, found) = (&values[row], &mut *locked(&self.findings[index]));
                simd::judge(self.set, JudgeTask::I16 { row, clip_from, found });
            }
            Samples::Pdm(words) => {
                let (words, found) = (&words[range.clone()], &mut *locked(&self.word_findings[index]));
                let clip_from = clip_from.saturating_sub(range.start);
                simd::judge(self.set, JudgeTask::Pdm { words, clip_from, found });
            }
        }
    }

    fn demodulate(&self, job: &Job, index: usize, scratch: &mut Scratch) {
        let piece = &self.demodulated[index];
        let Some(Samples::Pdm(words)) = job.samples[piece.sensor].as_deref() else { return };
        let task = DemodulateTask {
            filter: &self.bit_filter,
            words,
            first_sample: piece.range.start,
            sample_count: piece.range.len(),
            windows: &mut scratch.windows,
            output: &mut writing(&self.pcm[index]),
        };
        simd::demodulate(self.set, task);
    }

    fn band_pass(&self, job: &Job, index: usize, scratch: &mut Scratch) {
        let piece = &self.filtered[index];
        let Some(samples) = job.samples[piece.sensor].as_deref() else { return };
        let (taps, step) = (&self.plan.band_taps, self.plan.band_decimation);
        let span = self.plan.forward_len * step;
        let count = (piece.range.len() - 1) * step + taps.len();
        let tile = &mut scratch.tile[..count * self.lanes];
        // The ping lies on a circle of `span` samples, of which those behind its end are zero.
        let start = (piece.range.start * step + span - taps.len() / 2) % span;
        let mut done = 0;
        while done < count {
            let place = (start + done) % span;
            let existing = self.plan.sample_count.saturating_sub(place);
            let stretch = (count - done).min(if existing > 0 { existing } else { span - place });
            let part = &mut tile[done * self.lanes..(done + stretch) * self.lanes];
            if existing > 0 {
                self.fill_tile(samples, piece, place, part);
            } else {
                part.fill(0.0);
            }
            done += stretch;
        }
        simd::band_pass(self.set, BandPassTask { taps, step, tile, output: &mut writing(&self.band[index]) });
    }

    /// Samples of a block of channels from `first` on, side by side.
    fn fill_tile(&self, samples: &Samples, piece: &Piece, first: usize, tile: &mut [f32]) {
        let pcm = match samples {
            Samples::PcmF32(values) => Pcm::F32(values),
            Samples::PcmI16(values) => Pcm::I16(values),
            Samples::Pdm(_) => return self.fill_demodulated(piece, first, tile),
        };
        let task = TileTask {
            pcm,
            sample_count: self.plan.raw_count,
            first_channel: piece.block * self.lanes,
            channel_count: self.plan.sensors[piece.sensor].channel_count,
            first,
            tile,
        };
        simd::fill(self.set, task);
    }

    fn fill_demodulated(&self, piece: &Piece, first: usize, tile: &mut [f32]) {
        let end = first + tile.len() / self.lanes;
        for (from, pcm) in self.demodulated.iter().zip(&self.pcm).filter(|(from, _)| from.sensor == piece.sensor) {
            let shared = from.range.start.max(first)..from.range.end.min(end);
            if !shared.is_empty() {
                let block = piece.block * self.bit_filter.padded(from.range.len());
                let rows = |first: usize| (first * self.lanes)..(first + shared.len()) * self.lanes;
                tile[rows(shared.start - first)]
                    .copy_from_slice(&reading(pcm)[rows(block + shared.start - from.range.start)]);
            }
        }
    }

    fn spectrum(&self, job: &Job, index: usize, scratch: &mut Scratch) {
        let piece = &self.transformed[index];
        if !job.active[piece.sensor] {
            return;
        }
        let transform = &self.forward;
        let values = &mut scratch.transforms[..transform.buffer_len(self.lanes)];
        let of_block = |from: &Piece| from.sensor == piece.sensor && from.block == piece.block;
        for (from, band) in self.filtered.iter().zip(&self.band).filter(|(from, _)| of_block(from)) {
            let (first, outputs) = (from.range.start, &reading(band)[..]);
            simd::spectrum(self.set, SpectrumTask::Place { transform, first, outputs, values });
        }
        let gains = &job.gains[piece.sensor][piece.block * self.lanes..][..self.lanes];
        let spectrum = &mut writing(&self.spectra[index])[..];
        let (plan, reference) = (&self.plan, &self.plan.sensors[piece.sensor].reference[..]);
        simd::spectrum(self.set, SpectrumTask::Apply { transform, plan, reference, gains, values, spectrum });
    }

    fn beams_share(&self, job: &Job, scratch: &mut Scratch) {
        let parts = |group: &Group| if group.split { group.sensors.len() } else { 1 };
        let count = self.groups.iter().map(|group| group.lane_blocks * parts(group)).sum();
        self.take_tasks(count, |index| {
            let mut rest = index;
            for group in &self.groups {
                let tasks = group.lane_blocks * parts(group);
                if rest < tasks {
                    let (part, lane_block) = (rest / group.lane_blocks, rest % group.lane_blocks);
                    let sensors = if group.split { &group.sensors[part..=part] } else { &group.sensors[..] };
                    self.beams(job, group, lane_block, sensors, scratch);
                    return;
                }
                rest -= tasks;
            }
        });
    }

    /// Beams and envelopes of one vector of directions, for some sensors of a group.
    fn beams(&self, job: &Job, group: &Group, lane_block: usize, sensors: &[usize], scratch: &mut Scratch) {
        let start = Instant::now();
        let mut active = [0; SENSORS_MAX];
        let mut sensor_count = 0;
        for sensor in sensors.iter().filter(|sensor| job.active[**sensor]) {
            active[sensor_count] = *sensor;
            sensor_count += 1;
        }
        let active = &active[..sensor_count];
        if active.is_empty() {
            return;
        }
        let buffer_len = self.inverse.buffer_len(self.lanes);
        let beams = &mut scratch.transforms[..2 * sensor_count * buffer_len];
        self.steer(group, lane_block, active, &self.fold, &mut scratch.phases, beams);
        let steered = Instant::now();
        for (sensor, beams) in active.iter().zip(beams.chunks_exact_mut(2 * buffer_len)) {
            let (direct, mirrored) = beams.split_at_mut(buffer_len);
            self.envelope(*sensor, group, lane_block, false, direct, &mut scratch.square);
            self.envelope(*sensor, group, lane_block, true, mirrored, &mut scratch.square);
        }
        for (total, time) in self.beam_times_ns.iter().zip([steered - start, steered.elapsed()]) {
            total.fetch_add(time.as_nanos() as u64, Ordering::Relaxed);
        }
    }

    /// Beams of the `active` sensors into the places of `fold`.
    pub(super) fn steer(
        &self,
        group: &Group,
        lane_block: usize,
        active: &[usize],
        fold: &super::delay_and_sum::Fold,
        phases: &mut [f32],
        beams: &mut [f32],
    ) {
        let channel_count = group.steering.channel_count();
        let blocks = channel_count.div_ceil(self.lanes);
        let of =
            |block: usize, sensor: usize| self.signals_of(sensor, block).map(|index| reading(&self.spectra[index]));
        let mut guards = [const { None }; BLOCKS_MAX];
        for (index, guard) in guards[..blocks * active.len()].iter_mut().enumerate() {
            *guard = of(index / active.len(), active[index % active.len()]);
        }
        let mut spectra: [&[f32]; BLOCKS_MAX] = [&[]; BLOCKS_MAX];
        for (spectrum, guard) in spectra.iter_mut().zip(&guards) {
            *spectrum = guard.as_ref().map_or(&[], |guard| &guard[..]);
        }
        let task = BeamTask {
            steering: &group.steering,
            lane_block,
            first_bin: self.plan.first_bin,
            spectra: &spectra[..blocks * active.len()],
            sensor_count: active.len(),
            fold,
            phases: &mut phases[..super::delay_and_sum::scratch_len(channel_count, self.lanes)],
            beams,
        };
        simd::delay_and_sum(self.set, task);
    }

    /// Rows of the image of one vector of directions, or of their mirrors.
    fn envelope(
        &self,
        sensor: usize,
        group: &Group,
        lane_block: usize,
        mirror: bool,
        values: &mut [f32],
        square: &mut [f32],
    ) {
        let mut rows = [const { None }; LANES_MAX];
        let mut any = false;
        for (row, lane) in rows.iter_mut().zip(group.steering.lanes(lane_block, self.lanes)) {
            let Some(direction) = (if mirror { lane.1 } else { Some(lane.0) }) else { continue };
            let Some(mut guard) = self.drafts[sensor].row(direction) else {
                self.conflict.store(true, Ordering::Release);
                continue;
            };
            if self.plan.sensors[sensor].hidden[direction] {
                guard.fill(0.0);
            } else {
                *row = Some(guard);
                any = true;
            }
        }
        if any {
            let (taps, range_count) = (&self.plan.smoothing_taps, self.plan.grid.range_count());
            let rows = &mut rows[..];
            simd::envelope(
                self.set,
                EnvelopeTask { transform: &self.inverse, taps, values, square, rows, range_count },
            );
        }
    }

    fn channel_signal(&self, job: &Job, index: usize, scratch: &mut Scratch) {
        let (Some(focus), Some(transform)) = (&self.plan.focus, &self.to_signal) else { return };
        if !job.active[self.transformed[index].sensor] {
            return;
        }
        let task = SignalTask {
            focus,
            transform,
            first_bin: self.plan.first_bin,
            spectrum: &reading(&self.spectra[index]),
            values: &mut scratch.transforms[..transform.buffer_len(self.lanes)],
            square: &mut scratch.square,
            signals: &mut writing(&self.signals[index]),
        };
        simd::channel_signal(self.set, task);
    }

    /// Which spectra and signals are those of a block of channels.
    pub(super) fn signals_of(&self, sensor: usize, block: usize) -> Option<usize> {
        self.transformed.iter().position(|piece| piece.sensor == sensor && piece.block == block)
    }

    /// The focused cells of one direction of the sensors of a group.
    fn focus(&self, job: &Job, group: &[usize], direction: usize, scratch: &mut Scratch) {
        let Some(focus) = &self.plan.focus else { return };
        let mut rows = [const { None }; SENSORS_MAX];
        let mut guards = [const { None }; BLOCKS_MAX];
        let mut active = 0;
        for sensor in group.iter().filter(|sensor| job.active[**sensor]) {
            let Some(mut row) = self.drafts[*sensor].row(direction) else {
                self.conflict.store(true, Ordering::Release);
                continue;
            };
            if self.plan.sensors[*sensor].hidden[direction] {
                row[..focus.range_count].fill(0.0);
                continue;
            }
            rows[active] = Some((*sensor, row));
            active += 1;
        }
        if active == 0 {
            return;
        }
        let channel_count = self.plan.sensors[group[0]].channel_count;
        let blocks = channel_count.div_ceil(self.lanes);
        for (index, guard) in guards[..blocks * active].iter_mut().enumerate() {
            let Some((sensor, _)) = &rows[index % active] else { continue };
            *guard = self.signals_of(*sensor, index / active).map(|index| reading(&self.signals[index]));
        }
        let mut signals: [&[f32]; BLOCKS_MAX] = [&[]; BLOCKS_MAX];
        for (signal, guard) in signals.iter_mut().zip(&guards) {
            *signal = guard.as_ref().map_or(&[], |guard| &guard[..]);
        }
        let mut gains: [(&[f32], Scale); SENSORS_MAX] = [(&[], Scale::default()); SENSORS_MAX];
        for (gains, row) in gains.iter_mut().zip(&rows) {
            if let Some((sensor, _)) = row {
                *gains = (&job.gains[*sensor][..channel_count], job.scales[*sensor]);
            }
        }
        let mut rows = rows.map(|row| row.map(|(_, row)| row));
        let task = FocusTask {
            focus,
            sensor: group[0],
            direction,
            signals: &signals[..blocks * active],
            gains: &gains[..active],
            scratch: &mut scratch.readings,
            rows: &mut rows[..active],
        };
        simd::focus(self.set, task);
    }

    fn sum_rows(&self, job: &Job, index: usize, scratch: &mut Scratch) {
        let rows: Range<usize> = self.row_pieces[index].clone();
        for (index, sums) in rows.zip(locked(&self.sums[index]).iter_mut()) {
            let row = &self.masks.rows[index];
            *sums = RowSums::SILENT;
            if job.active[row.sensor_index] {
                let task = RowTask {
                    runs: &self.row_runs,
                    row: index,
                    sensor: row.sensor_index,
                    image: &reading(&self.images[row.sensor_index]),
                    distances_m: &self.masks.distances_m[row.first..row.first + row.count],
                    scratch: &mut scratch.energies,
                    sums,
                };
                simd::masked_energy(self.set, task);
            }
        }
    }
}

impl pool::Work for Work {
    fn run(&self, phase: usize, thread: usize) {
        self.share(Phase::ALL[phase], thread);
    }
}
