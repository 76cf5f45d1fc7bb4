//! CLEAN on the channel signals (plan, `clean`): the loudest cells, their echoes fitted and taken out, and main lobes put back.
//!
//! In: the channel signals of a sensor and the image made from them. Out: an [`Echo`] a window and round, the same signals with
//! those echoes taken out, and the last image with their main lobes. An echo is fitted alone, one channel after another: it is no
//! hundredth of what imaging costs. Twin of `shaders/clean.wgsl`.

use crate::imaging::plan::FocusPlan;
use crate::imaging::plan::clean::{CleanPlan, IMPROVEMENTS, PULSE_STEPS, RIDGE, SensorClean, TERMS};
use crate::imaging::plan::focus::{FRACTIONS, TAPS, TAPS_BEFORE};
use nalgebra::Complex;
use std::f32::consts::TAU;

/// A cell and what it reads.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Cell {
    pub value: f32,
    pub direction: usize,
    pub range: usize,
}

/// An echo that was taken out; of amplitude zero where there was none.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Echo {
    /// The cell and what it read.
    pub cell: Cell,
    /// Samples of a channel signal by which it is later than its cell.
    pub late_samples: f32,
    /// Wave front against that of the cell: metres at the array's radius, in x, y, z and the squared distance.
    pub tilt_m: [f32; TERMS],
    /// Complex amplitude, and that of its slope over frequency.
    pub amplitude: Complex<f32>,
    pub slope: Complex<f32>,
}

/// Where an echo stands in a channel signal.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Arrival {
    /// Samples behind that of the cell's range.
    pub offset_samples: f32,
    /// Phase that brings the channel into line.
    pub turn: Complex<f32>,
}

/// The signals of one sensor.
pub(super) struct Channels<'a> {
    pub focus: &'a FocusPlan,
    /// `[block of channels]` of `[lane][row][re, im][sample]`.
    pub blocks: &'a [&'a [f32]],
    pub lanes: usize,
    /// `[channel]`.
    pub gains: &'a [f32],
}

impl Channels<'_> {
    /// Three samples about a place of a channel: a sample before, there, and a sample behind.
    fn around(&self, channel: usize, range: usize, offset_samples: f32) -> [Complex<f32>; 3] {
        let focus = self.focus;
        let whole = offset_samples.floor();
        let step = (offset_samples - whole) * FRACTIONS as f32;
        let entry = (step as usize).min(FRACTIONS - 1);
        let share = step - entry as f32;
        let (here, next) = (&focus.taps[entry], &focus.taps[entry + 1]);
        let base = (whole as isize + ((focus.lead + range) * focus.oversampling) as isize) - TAPS_BEFORE as isize - 1;
        let signals = self.blocks[channel / self.lanes];
        let mut found = [Complex::default(); 3];
        for place in 0..TAPS + 2 {
            let sample = base + place as isize;
            let Ok(sample) = usize::try_from(sample) else { continue };
            let (row, column) = (sample % focus.oversampling, sample / focus.oversampling);
            if column >= focus.row_len {
                continue;
            }
            let at = (channel % self.lanes * focus.oversampling + row) * 2 * focus.row_len + column;
            let value = Complex::new(signals[at], signals[at + focus.row_len]);
            for (shift, found) in found.iter_mut().enumerate() {
                let Some(tap) = place.checked_sub(shift).filter(|tap| *tap < TAPS) else { continue };
                let weight = here[tap] + share * (next[tap] - here[tap]);
                *found += value * weight;
            }
        }
        found
    }
}

fn over(a: f32, b: f32) -> f32 {
    if b > 0.0 { a / b } else { 0.0 }
}

/// Phase of so many turns.
fn turn(turns: f32) -> Complex<f32> {
    let (sin, cos) = (TAU * (turns - turns.round())).sin_cos();
    Complex::new(cos, sin)
}

/// What a fit works with.
pub(super) struct Fit<'a> {
    pub clean: &'a CleanPlan,
    pub sensor: usize,
    pub channels: Channels<'a>,
}

impl Fit<'_> {
    /// Fits the echo of a cell, and says where it stands in every channel; `values` is room for a value a channel.
    pub(super) fn fit(&self, cell: Cell, arrivals: &mut [Arrival], values: &mut [Complex<f32>]) -> Echo {
        let focus = self.channels.focus;
        let mut echo = Echo { cell, ..Echo::default() };
        for step in 0..=IMPROVEMENTS {
            self.arrive(&echo, arrivals);
            let mut beam = [Complex::default(); 3];
            for (channel, arrival) in arrivals.iter().enumerate().filter(|(channel, _)| self.is_used(*channel)) {
                let around = self.channels.around(channel, cell.range, arrival.offset_samples);
                for (beam, value) in beam.iter_mut().zip(around) {
                    *beam += value * arrival.turn;
                }
                values[channel] = around[1] * arrival.turn;
            }
            (echo.amplitude, echo.slope) = self.amplitudes(&beam);
            if step == IMPROVEMENTS {
                break;
            }
            let mut system = System::default();
            for (channel, value) in values.iter().enumerate().filter(|(channel, _)| self.is_used(*channel)) {
                let ahead = value * beam[1].conj();
                let sine = over(ahead.im, (value.norm_sqr() * beam[1].norm_sqr()).sqrt());
                system.add(self.terms(channel), sine, self.channels.gains[channel]);
            }
            let ahead = echo.slope * echo.amplitude.conj();
            let late = -over(ahead.im, echo.amplitude.norm_sqr() * self.sensor().slope_per_sample);
            let most = focus.oversampling as f32;
            echo.late_samples = (echo.late_samples + late.clamp(-most, most)).clamp(-1.5 * most, 1.5 * most);
            // A phase ahead of the others' is a path that is shorter than was taken.
            let metres = 1.0 / (TAU * focus.turns_per_m as f32);
            for (tilt_m, ahead) in echo.tilt_m.iter_mut().zip(system.solved()) {
                *tilt_m -= ahead * metres;
            }
        }
        echo
    }

    fn sensor(&self) -> &SensorClean {
        &self.clean.sensors[self.sensor]
    }

    fn is_used(&self, channel: usize) -> bool {
        self.channels.gains[channel] > 0.0
    }

    /// Coordinates of a channel for the wave front, in radii of the array.
    fn terms(&self, channel: usize) -> [f32; TERMS] {
        let [x, y, z] = self.sensor().places_m[channel].map(|metres| metres / self.clean.radius_m);
        let terms = [x, y, z, x * x + y * y + z * z];
        std::array::from_fn(|index| terms[index] - self.sensor().centre[index])
    }

    fn arrive(&self, echo: &Echo, arrivals: &mut [Arrival]) {
        let focus = self.channels.focus;
        let geometry = &focus.sensors[self.sensor];
        let range_m = self.clean.range_first_m + echo.cell.range as f32 * self.clean.range_step_m;
        let emitter_along_m = geometry.emitter_along_m[echo.cell.direction];
        let emitter_m = FocusPlan::excess_m(range_m, emitter_along_m, geometry.emitter_square_m2);
        let unit = self.clean.units[echo.cell.direction];
        for (channel, arrival) in arrivals.iter_mut().enumerate() {
            let [x, y, z] = self.sensor().places_m[channel];
            let along_m = x * unit[0] + y * unit[1] + z * unit[2];
            let tilt_m: f32 = self.terms(channel).iter().zip(&echo.tilt_m).map(|(term, tilt_m)| term * tilt_m).sum();
            let path_m = FocusPlan::excess_m(range_m, along_m, geometry.square_m2[channel]) + emitter_m + tilt_m;
            let offset_samples = path_m * focus.samples_per_m as f32 + echo.late_samples;
            *arrival = Arrival { offset_samples, turn: turn(path_m * focus.turns_per_m as f32) };
        }
    }

    /// Amplitudes of the pulse and of its slope that the beam shows at its peak and a sample to either side.
    fn amplitudes(&self, beam: &[Complex<f32>; 3]) -> (Complex<f32>, Complex<f32>) {
        let whole: f32 = self.channels.gains.iter().sum();
        let beam = beam.map(|value| value * over(1.0, whole));
        let peak = self.clean.pulse_reach * PULSE_STEPS;
        let (mut slope, mut norm) = (Complex::default(), 0.0);
        for (entry, value) in [(peak - PULSE_STEPS, beam[0]), (peak + PULSE_STEPS, beam[2])] {
            let [re, im, slope_re, slope_im] = self.sensor().pulse[entry];
            let by_slope = Complex::new(slope_re, slope_im);
            slope += by_slope.conj() * (value - beam[1] * Complex::new(re, im));
            norm += by_slope.norm_sqr();
        }
        slope *= over(1.0, norm);
        // More slope than echo is another echo.
        let least = over(beam[1].norm_sqr(), slope.norm_sqr()).sqrt().min(1.0);
        (beam[1], slope * least)
    }
}

/// Normal equations of the wave front: a phase and its change with the coordinates.
#[derive(Default)]
struct System {
    matrix: [[f32; TERMS + 1]; TERMS + 1],
    sides: [f32; TERMS + 1],
}

impl System {
    fn add(&mut self, terms: [f32; TERMS], phase: f32, weight: f32) {
        let terms: [f32; TERMS + 1] = std::array::from_fn(|index| if index == 0 { 1.0 } else { terms[index - 1] });
        for (i, row) in self.matrix.iter_mut().enumerate() {
            for (k, entry) in row.iter_mut().enumerate() {
                *entry += weight * terms[i] * terms[k];
            }
            self.sides[i] += weight * terms[i] * phase;
        }
    }

    /// How the phase changes with the coordinates: Gauss's elimination, which needs no pivot with a ridge.
    fn solved(mut self) -> [f32; TERMS] {
        for (i, row) in self.matrix.iter_mut().enumerate() {
            row[i] += RIDGE;
        }
        for pivot in 0..=TERMS {
            for i in pivot + 1..=TERMS {
                let factor = self.matrix[i][pivot] / self.matrix[pivot][pivot];
                for k in pivot..=TERMS {
                    self.matrix[i][k] -= factor * self.matrix[pivot][k];
                }
                self.sides[i] -= factor * self.sides[pivot];
            }
        }
        for i in (0..=TERMS).rev() {
            for k in i + 1..=TERMS {
                self.sides[i] -= self.matrix[i][k] * self.sides[k];
            }
            self.sides[i] /= self.matrix[i][i];
        }
        std::array::from_fn(|index| self.sides[index + 1])
    }
}

/// Takes an echo out of the signals of one channel, `[row][re, im][sample]`.
pub(super) fn take_out(
    focus: &FocusPlan,
    clean: &CleanPlan,
    pulse: &[[f32; 4]],
    echo: &Echo,
    arrival: &Arrival,
    gain: f32,
    signals: &mut [f32],
) {
    let reach = clean.pulse_reach as f32;
    let base = ((focus.lead + echo.cell.range) * focus.oversampling) as isize;
    let first = (arrival.offset_samples - reach).ceil();
    let last = (arrival.offset_samples + reach).floor();
    let back = arrival.turn.conj() * gain;
    let (amplitude, slope) = (echo.amplitude * back, echo.slope * back);
    let step = (first - arrival.offset_samples + reach) * PULSE_STEPS as f32;
    let entry = (step.max(0.0) as usize).min(PULSE_STEPS);
    let share = step - entry as f32;
    let count = (last - first).max(-1.0) as isize + 1;
    // Neighbouring samples of a row are `oversampling` samples apart, and as far in the table.
    for start in 0..focus.oversampling as isize {
        let sample = base + first as isize + start;
        let row = sample.rem_euclid(focus.oversampling as isize) as usize;
        let column = sample.div_euclid(focus.oversampling as isize);
        // What lies before the first sample that is kept is nowhere.
        let before = usize::try_from(-column).unwrap_or(0);
        let column = usize::try_from(column).unwrap_or(0).min(focus.row_len);
        let [re, im] = rows_of(signals, row, focus.row_len);
        let (columns, others) = (&mut re[column..], &mut im[column..]);
        let entries = pulse[(entry + start as usize * PULSE_STEPS).min(pulse.len())..].windows(2);
        let entries = entries.step_by(focus.oversampling * PULSE_STEPS).skip(before);
        let wanted = (count - start + focus.oversampling as isize - 1) / focus.oversampling as isize - before as isize;
        for ((re, im), pair) in columns.iter_mut().zip(others).zip(entries).take(wanted.max(0) as usize) {
            let read: [f32; 4] = std::array::from_fn(|part| pair[0][part] + share * (pair[1][part] - pair[0][part]));
            let value = amplitude * Complex::new(read[0], read[1]) + slope * Complex::new(read[2], read[3]);
            *re -= value.re;
            *im -= value.im;
        }
    }
}

/// Real and imaginary part of a row of a channel.
fn rows_of(signals: &mut [f32], row: usize, row_len: usize) -> [&mut [f32]; 2] {
    let (re, im) = signals[row * 2 * row_len..][..2 * row_len].split_at_mut(row_len);
    [re, im]
}

/// Puts the main lobe of an echo back into a row, where it is louder than what is there.
pub(super) fn put_back(
    focus: &FocusPlan,
    clean: &CleanPlan,
    sensor: usize,
    echo: &Echo,
    direction: usize,
    row: &mut [f32],
) {
    let (here, cell) = (clean.units[direction], clean.units[echo.cell.direction]);
    let sensor = &clean.sensors[sensor];
    let bent = |from: [f32; 3]| -> f32 {
        let change = |axis: usize| from[axis] - cell[axis] + echo.tilt_m[axis] / clean.radius_m;
        let [x, y, z] = [change(0), change(1), change(2)];
        let [xx, yy, zz, xy, xz, yz] = sensor.lobe;
        xx * x * x + yy * y * y + zz * z * z + 2.0 * (xy * x * y + xz * x * z + yz * y * z)
    };
    // The cell itself is to read what it read.
    let across = bent(cell) - bent(here);
    if across < -LOBE_END * LOBE_END {
        return;
    }
    let narrow = 0.5 * sensor.slope_per_sample * sensor.slope_per_sample;
    let late = echo.late_samples;
    let reach = (LOBE_END / narrow.sqrt()) as usize / focus.oversampling + 2;
    let first = echo.cell.range.saturating_sub(reach);
    let last = row.len().min(echo.cell.range + reach + 1);
    for (range, value) in row.iter_mut().enumerate().take(last).skip(first) {
        let samples = (range as f32 - echo.cell.range as f32) * focus.oversampling as f32 - late;
        let along = narrow * (late * late - samples * samples);
        *value = value.max(echo.cell.value * (across + along).exp());
    }
}

/// A lobe ends where its exponent has this root: at -55 dB.
const LOBE_END: f32 = 2.5;
