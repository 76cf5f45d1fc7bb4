//! What one thread does in each phase: which pieces it takes, from which buffer to which.
//!
//! In and out: the buffers of [`Work`]. The pieces of the two phases that read raw samples are dealt out by number, so
//! that only the other threads' pieces have to be copied; the later ones are taken as they come. Either way each piece is
//! computed alone, and the result does not depend on who computes it.

use super::delay_and_sum::{BLOCK, BeamTask};
use super::demodulate::{self, DemodulateTask};
use super::envelope::{self, EnvelopeTask};
use super::masked_energy::{self, GainTask};
use super::matched_filter::{self, BandPassTask};
use super::work::{GroupJob, IMAGE_PIECE, Phase, Scratch, Work, locked, reading, writing};
use super::{pool, simd};
use crate::signal::{RowSums, SampleFormat, Samples};
use rustfft::num_complex::Complex;
use std::ops::Range;

/// Lends the raw samples of a sensor.
pub(super) type Lend<'a> = &'a dyn Fn(usize) -> &'a Samples;

/// Part of some samples.
enum Part<'a> {
    Pdm(&'a [u32]),
    PcmI16(&'a [i16]),
    PcmF32(&'a [f32]),
}

fn part(samples: &Samples, range: Range<usize>) -> Part<'_> {
    match samples {
        Samples::Pdm(words) => Part::Pdm(&words[range]),
        Samples::PcmI16(values) => Part::PcmI16(&values[range]),
        Samples::PcmF32(values) => Part::PcmF32(&values[range]),
    }
}

impl Work {
    /// Copies the pieces that other threads will work on.
    pub(super) fn copy_raw(&self, lend: Lend<'_>) {
        let active = reading(&self.job).active;
        let foreign = |index: &usize| !index.is_multiple_of(self.threads) && active[self.raw_pieces[*index].sensor];
        for index in (0..self.raw_pieces.len()).filter(foreign) {
            let piece = &self.raw_pieces[index];
            match (part(lend(piece.sensor), piece.values.clone()), &mut *locked(&self.copies[index])) {
                (Part::Pdm(from), Samples::Pdm(to)) => to.copy_from_slice(from),
                (Part::PcmI16(from), Samples::PcmI16(to)) => to.copy_from_slice(from),
                (Part::PcmF32(from), Samples::PcmF32(to)) => to.copy_from_slice(from),
                _ => {}
            }
        }
    }

    /// The caller's share of a phase.
    pub(super) fn run_own(&self, phase: Phase, lend: Lend<'_>) {
        self.share(phase, 0, Some(lend));
    }

    fn share(&self, phase: Phase, thread: usize, lend: Option<Lend<'_>>) {
        let scratch = &mut *locked(&self.scratch[thread]);
        match phase {
            Phase::Demodulate => self.demodulate_share(thread, lend),
            Phase::MatchedFilter => self.matched_filter_share(thread, lend, scratch),
            Phase::DelayAndSum => self.delay_and_sum_share(scratch),
            Phase::Envelope => self.envelope_share(scratch),
            Phase::Gain => self.gain_share(),
            Phase::Rows => self.rows_share(),
        }
    }

    /// Calls `task` with a raw piece: the caller's own samples, or the copy made for this thread.
    fn with_raw(&self, index: usize, lend: Option<Lend<'_>>, task: impl FnOnce(Part<'_>)) {
        let piece = &self.raw_pieces[index];
        match lend {
            Some(lend) => task(part(lend(piece.sensor), piece.values.clone())),
            None => task(part(&locked(&self.copies[index]), 0..piece.values.len())),
        }
    }

    fn demodulate_share(&self, thread: usize, lend: Option<Lend<'_>>) {
        let active = reading(&self.job).active;
        if self.plan.format != SampleFormat::Pdm {
            return;
        }
        for index in (thread..self.raw_pieces.len()).step_by(self.threads) {
            let piece = &self.raw_pieces[index];
            if !active[piece.sensor] {
                continue;
            }
            let channel_count = self.plan.sensors[piece.sensor].channel_count;
            let output = &mut *writing(&self.demodulated[index]);
            self.with_raw(index, lend, |raw| {
                let Part::Pdm(words) = raw else { return };
                let task = DemodulateTask {
                    taps: &self.plan.demodulation_taps,
                    decimation: self.plan.decimation,
                    words,
                    first_word: piece.values.start,
                    first_sample: piece.samples.start,
                    sample_count: piece.samples.len(),
                    channel_count,
                    output: &mut output[..channel_count * piece.samples.len()],
                };
                simd::demodulate(self.set, task);
            });
        }
    }

    /// PCM of one channel in `samples`; of a PDM channel from the demodulated pieces.
    fn gather_pdm(&self, sensor: usize, channel: usize, samples: &mut [f32]) {
        for (piece, demodulated) in
            self.raw_pieces.iter().zip(&self.demodulated).filter(|(piece, _)| piece.sensor == sensor)
        {
            let count = piece.samples.len();
            samples[piece.samples.clone()].copy_from_slice(&reading(demodulated)[channel * count..][..count]);
        }
    }

    fn matched_filter_share(&self, thread: usize, lend: Option<Lend<'_>>, scratch: &mut Scratch) {
        let job = reading(&self.job);
        for sensor in (0..self.plan.sensors.len()).filter(|&sensor| job.active[sensor]) {
            for (channel, &gain) in job.gains[sensor].iter().enumerate() {
                let index = self.first_channel[sensor] + channel;
                if index % self.threads != thread {
                    continue;
                }
                let spectrum = &mut *writing(&self.spectra[index]);
                if gain == 0.0 {
                    spectrum.fill(Complex::default());
                } else if self.plan.format == SampleFormat::Pdm {
                    let mut samples = std::mem::take(&mut scratch.samples);
                    self.gather_pdm(sensor, channel, &mut samples);
                    self.filter_channel(&samples, gain, scratch, spectrum);
                    scratch.samples = samples;
                } else {
                    self.with_raw(index, lend, |raw| match raw {
                        Part::PcmF32(samples) => self.filter_channel(samples, gain, scratch, spectrum),
                        Part::PcmI16(values) => {
                            let mut samples = std::mem::take(&mut scratch.samples);
                            demodulate::full_scale(values, &mut samples);
                            self.filter_channel(&samples, gain, scratch, spectrum);
                            scratch.samples = samples;
                        }
                        Part::Pdm(_) => {}
                    });
                }
            }
        }
    }

    fn filter_channel(&self, samples: &[f32], gain: f32, scratch: &mut Scratch, spectrum: &mut [Complex<f32>]) {
        let transform = &mut scratch.transform[..self.plan.forward_len];
        let task = BandPassTask { filter: &self.band_pass, samples, window: &mut scratch.window, output: transform };
        simd::band_pass(self.set, task);
        self.forward.process_with_scratch(transform, &mut scratch.forward);
        matched_filter::apply_reference(&self.plan, gain, transform, spectrum);
    }

    fn delay_and_sum_share(&self, scratch: &mut Scratch) {
        let job = reading(&self.job);
        let blocks = envelope::block_count(self.plan.bin_count);
        self.take_tasks(self.groups.len() * blocks, |index| {
            let (group, block) = (index / blocks, index % blocks);
            let GroupJob { sensors, channels } = &job.groups[group];
            if sensors.is_empty() {
                return;
            }
            let tile = &mut *writing(&self.beams[group][block]);
            let beams = &mut tile[..sensors.len() * self.plan.grid.direction_count() * BLOCK];
            if channels.is_empty() {
                beams.fill(Complex::default());
                return;
            }
            let first = block * BLOCK;
            let bins = first..self.plan.bin_count.min(first + BLOCK);
            let stride = channels.len() * sensors.len();
            for (place, sensor) in sensors.iter().enumerate() {
                for (column, channel) in channels.iter().enumerate() {
                    let spectrum = reading(&self.spectra[self.first_channel[*sensor] + channel]);
                    for (row, bin) in spectrum[bins.clone()].iter().enumerate() {
                        scratch.spectra[row * stride + column * sensors.len() + place] = *bin;
                    }
                }
            }
            let task = BeamTask {
                steering: &self.groups[group].steering,
                first_bin: self.plan.first_bin + first,
                bin_count: bins.len(),
                channels,
                spectra: &scratch.spectra,
                sensor_count: sensors.len(),
                scratch: &mut scratch.phases,
                beams,
            };
            simd::delay_and_sum(self.set, task);
        });
    }

    fn envelope_share(&self, scratch: &mut Scratch) {
        let job = reading(&self.job);
        let pieces = self.pieces[0].len();
        let (directions, ranges) = (self.plan.grid.direction_count(), self.plan.grid.range_count());
        let length = self.plan.inverse_len;
        self.take_tasks(self.plan.sensors.len() * pieces, |index| {
            let (sensor, piece) = (index / pieces, index % pieces);
            if !job.active[sensor] {
                return;
            }
            let output = &mut *locked(&self.pieces[sensor][piece]);
            let rows = output.len() / ranges;
            let (group, place) = job.place[sensor];
            let first_row = place * directions + piece * IMAGE_PIECE;
            let transforms = &mut scratch.transform[..rows * length];
            transforms.fill(Complex::default());
            for (block, beams) in self.beams[group].iter().enumerate() {
                let beams = reading(beams);
                let bins = BLOCK.min(self.plan.bin_count - block * BLOCK);
                for (row, transform) in transforms.chunks_exact_mut(length).enumerate() {
                    let beam = &beams[(first_row + row) * BLOCK..][..bins];
                    envelope::fold(self.plan.first_bin + block * BLOCK, beam, transform);
                }
            }
            let hidden = &self.plan.sensors[sensor].hidden[piece * IMAGE_PIECE..];
            let rows = transforms.chunks_exact_mut(length).zip(output.chunks_exact_mut(ranges)).zip(hidden);
            for ((signal, output), hidden) in rows {
                if *hidden {
                    output.fill(0.0);
                    continue;
                }
                self.inverse.process_with_scratch(signal, &mut scratch.inverse);
                let taps = &self.plan.smoothing_taps;
                let magnitudes = &mut scratch.magnitudes;
                simd::magnitude(self.set, EnvelopeTask { signal, taps, magnitudes, output });
            }
        });
    }

    /// Puts the pieces of the images together; the caller does it alone.
    pub(super) fn join_images(&self) {
        let active = reading(&self.job).active;
        for (sensor, (image, pieces)) in self.images.iter().zip(&self.pieces).enumerate() {
            if active[sensor] {
                let mut rest = &mut writing(image)[..];
                for piece in pieces.iter().map(locked) {
                    let (now, later) = rest.split_at_mut(piece.len());
                    now.copy_from_slice(&piece);
                    rest = later;
                }
            }
        }
    }

    fn gain_share(&self) {
        let active = reading(&self.job).active;
        self.take_tasks(self.images.len(), |sensor| {
            if active[sensor] && !self.masks.rows.is_empty() {
                let image = &reading(&self.images[sensor]);
                let energies = &mut writing(&self.energies[sensor]);
                let (gains, floors) = (&self.gains[sensor], &self.floors[sensor]);
                simd::gained(self.set, GainTask { image, gains, floors, energies });
            }
        });
    }

    fn rows_share(&self) {
        let active = reading(&self.job).active;
        self.take_tasks(self.row_pieces.len(), |piece| {
            let rows = &self.masks.rows[self.row_pieces[piece].clone()];
            for (row, sums) in rows.iter().zip(locked(&self.sums[piece]).iter_mut()) {
                *sums = if active[row.sensor_index] {
                    let energies = reading(&self.energies[row.sensor_index]);
                    masked_energy::masked_energy(&self.masks, &self.weights, row, &energies)
                } else {
                    RowSums::SILENT
                };
            }
        });
    }

    /// Copies the sums of all rows to `sums`.
    pub(super) fn copy_sums(&self, sums: &mut [RowSums]) {
        for (rows, piece) in self.row_pieces.iter().zip(&self.sums) {
            sums[rows.clone()].copy_from_slice(&locked(piece));
        }
    }

    /// Demodulated samples of a sensor, `[channel][sample]`, zeros for a channel without gain: for tests.
    pub(super) fn demodulated_of(&self, sensor: usize, lend: Lend<'_>) -> Vec<f32> {
        let job = reading(&self.job);
        let mut output = vec![0.0; job.gains[sensor].len() * self.plan.sample_count];
        for (channel, samples) in output.chunks_exact_mut(self.plan.sample_count).enumerate() {
            let row = channel * self.plan.raw_count..(channel + 1) * self.plan.raw_count;
            if job.gains[sensor][channel] == 0.0 {
                continue;
            }
            match lend(sensor) {
                Samples::Pdm(_) => self.gather_pdm(sensor, channel, samples),
                Samples::PcmI16(values) => demodulate::full_scale(&values[row], samples),
                Samples::PcmF32(values) => samples.copy_from_slice(&values[row]),
            }
        }
        output
    }

    /// Band spectra of a sensor's channels, `[channel][bin]`: for tests.
    pub(super) fn spectra_of(&self, sensor: usize) -> Vec<[f32; 2]> {
        let channels = self.first_channel[sensor]..self.first_channel[sensor + 1];
        let rows = self.spectra[channels].iter().map(reading);
        rows.flat_map(|row| row.iter().map(|bin| [bin.re, bin.im]).collect::<Vec<_>>()).collect()
    }

    /// Band spectra of a sensor's beams, `[direction][bin]`: for tests.
    pub(super) fn beams_of(&self, sensor: usize) -> Vec<[f32; 2]> {
        let (group, place) = reading(&self.job).place[sensor];
        let directions = self.plan.grid.direction_count();
        let bin = |direction: usize, bin: usize| {
            let value =
                reading(&self.beams[group][bin / BLOCK])[(place * directions + direction) * BLOCK + bin % BLOCK];
            [value.re, value.im]
        };
        (0..directions).flat_map(|d| (0..self.plan.bin_count).map(move |k| (d, k))).map(|(d, k)| bin(d, k)).collect()
    }
}

impl pool::Work for Work {
    fn run(&self, phase: usize, thread: usize) {
        self.share(Phase::ALL[phase], thread, None);
    }
}
