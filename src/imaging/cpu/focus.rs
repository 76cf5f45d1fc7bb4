//! Channel signals to focused rows of the energyscape (plan, `focus`).
//!
//! In: the signals of all channels of a sensor. Out: the near cells of one direction. For every block of ranges and every channel the
//! excess of the exact path over twice the range says which samples to read, between which to interpolate and by how much to
//! turn the phase; a vector holds neighbouring ranges. Twin of `focus` in `shaders/focus.wgsl`.

use super::aligned::{rows, rows_mut};
use super::combine::combine;
use super::minimum_variance::Snapshots;
use super::shared_image::RowGuard;
use super::simd::Vector;
use crate::imaging::plan::FocusPlan;
use crate::imaging::plan::combine::{SNAPSHOTS, Scale};
use crate::imaging::plan::focus::{FRACTIONS, TAP_ROW, TAPS, TAPS_BEFORE};
use crate::signal::SENSORS_MAX;

/// The focused cells of one direction of up to three sensors of one geometry.
pub(super) struct FocusTask<'a, 'b> {
    pub focus: &'a FocusPlan,
    /// The first sensor of this geometry.
    pub sensor: usize,
    pub direction: usize,
    /// `[block of channels][sensor]` of `[channel][row][re, im][sample]`, zeros for a channel that is left out.
    pub signals: &'a [&'a [f32]],
    /// `[sensor]`: gains of the channels, and what goes with them.
    pub gains: &'a [(&'a [f32], Scale)],
    /// Scratch of [`scratch_len`] values.
    pub scratch: &'a mut [f32],
    /// `[sensor]`: the direction's row of the image.
    pub rows: &'a mut [Option<RowGuard<'b>>],
}

/// Values of scratch for so many channels: where and how each is read.
pub(super) fn scratch_len(channel_count: usize, lanes: usize) -> usize {
    // Readings in vectors of channels; then aligned samples, a vector of ranges each.
    READINGS * channel_count.next_multiple_of(lanes) + 2 * channel_count * lanes
}

/// What is known of how a channel is read: whole samples, fraction of a sample, cosine and sine.
const READINGS: usize = 4;

/// Focuses.
#[inline(always)]
pub(super) fn focus<V: Vector>(task: FocusTask<'_, '_>) {
    if !task.focus.combine.is_sum() {
        return combine_cells::<V>(task);
    }
    match task.rows.len() {
        1 => focus_of::<V, 1>(task),
        2 => focus_of::<V, 2>(task),
        _ => focus_of::<V, SENSORS_MAX>(task),
    }
}

#[inline(always)]
fn focus_of<V: Vector, const SENSORS: usize>(task: FocusTask<'_, '_>) {
    let FocusTask { focus, sensor, direction, signals, scratch, rows: image, .. } = task;
    let channel_count = focus.sensors[sensor].square_m2.len();
    let readings = &mut rows_mut::<V>(scratch)[..READINGS * channel_count.div_ceil(V::LANES)];
    for block in &focus.blocks {
        read_where::<V>(focus, sensor, direction, block.range_m as f32, readings);
        let (mut first, end) = (block.first, block.first + block.len);
        while first < end {
            let stretch = Stretch { focus, readings, signals, channel_count, first, end };
            if end - first > V::LANES {
                stretch.beams::<V, SENSORS, 2>(image);
                first += 2 * V::LANES;
            } else {
                stretch.beams::<V, SENSORS, 1>(image);
                first += V::LANES;
            }
        }
    }
}

/// As [`focus_of`], cell by cell with another rule than the sum, one sensor after another.
#[inline(always)]
fn combine_cells<V: Vector>(task: FocusTask<'_, '_>) {
    let FocusTask { focus, sensor, direction, signals, gains, scratch, rows: image } = task;
    let channel_count = focus.sensors[sensor].square_m2.len();
    let (readings, aligned) = rows_mut::<V>(scratch).split_at_mut(READINGS * channel_count.div_ceil(V::LANES));
    let aligned = &mut aligned.as_chunks_mut::<2>().0[..channel_count];
    let sensors = image.len();
    for block in &focus.blocks {
        read_where::<V>(focus, sensor, direction, block.range_m as f32, readings);
        let end = block.first + block.len;
        for (index, (row, (gains, scale))) in image.iter_mut().zip(gains).enumerate() {
            let Some(row) = row else { continue };
            for first in (block.first..end).step_by(V::LANES) {
                let cells = Cells { focus, readings, signals, sensors, index, first };
                let found = if focus.combine.sub_bands > 1 {
                    cells.least_variance::<V>(gains, scale)
                } else {
                    for (channel, aligned) in aligned.iter_mut().enumerate() {
                        let [re, im] = cells.aligned::<V>(channel, 0, 0);
                        re.store(&mut aligned[0]);
                        im.store(&mut aligned[1]);
                    }
                    combine::<V>(&focus.combine, scale, aligned, gains)
                };
                let mut amplitudes = V::ROW_OF_ZEROS;
                found.store(&mut amplitudes);
                let count = V::LANES.min(end - first);
                row[first..first + count].copy_from_slice(&amplitudes.as_ref()[..count]);
            }
        }
    }
}

/// A vector of cells of one sensor.
struct Cells<'a, R> {
    focus: &'a FocusPlan,
    readings: &'a [R],
    signals: &'a [&'a [f32]],
    /// Sensors of `signals`, and which of them.
    sensors: usize,
    index: usize,
    first: usize,
}

impl<R: AsRef<[f32]>> Cells<'_, R> {
    /// What a channel adds to them, `offset` ranges farther, of a sub-band.
    #[inline(always)]
    fn aligned<V: Vector>(&self, channel: usize, sub_band: usize, offset: isize) -> [V; 2] {
        let (channel_block, lane) = (channel / V::LANES, channel % V::LANES);
        let of_block = &self.readings[READINGS * channel_block..];
        let reading = [0, 1, 2, 3].map(|part| of_block[part].as_ref()[lane]);
        let mut reading = Reading::new(self.focus, reading, self.first);
        // Never negative: `lead` has room for the snapshots, too.
        reading.column = reading.column.saturating_add_signed(offset);
        let signals = &self.signals[channel_block * self.sensors + self.index..][..1];
        let mut sums = [[[V::splat(0.0); 2]; 1]; 1];
        add_channel::<V, 1, 1>(self.focus, &reading, signals, sub_band * V::LANES + lane, &mut sums);
        sums[0][0]
    }

    /// Magnitude of the sum of the sub-bands' outputs of least variance.
    #[inline(always)]
    fn least_variance<V: Vector>(&self, gains: &[f32], scale: &Scale) -> V {
        let mut sum = [V::splat(0.0); 2];
        let step = self.focus.combine.sub_bands as isize;
        for sub_band in 0..self.focus.combine.sub_bands {
            let mut snapshots = Snapshots::<V>::new();
            for (channel, gain) in gains.iter().enumerate().filter(|(_, gain)| **gain > 0.0) {
                let mut values = [[V::splat(0.0); 2]; SNAPSHOTS];
                for (snapshot, value) in values.iter_mut().enumerate() {
                    let offset = (snapshot as isize - SNAPSHOTS as isize / 2) * step;
                    *value = self.aligned::<V>(channel, sub_band, offset).map(|part| part.mul(V::splat(1.0 / gain)));
                }
                snapshots.add(&values);
            }
            let [re, im] = snapshots.output(scale.count);
            sum = [sum[0].add(re), sum[1].add(im)];
        }
        sum[0].mul_add(sum[0], sum[1].mul(sum[1])).sqrt()
    }
}

/// Ranges of one block that are focused together.
struct Stretch<'a, R> {
    focus: &'a FocusPlan,
    readings: &'a [R],
    signals: &'a [&'a [f32]],
    channel_count: usize,
    first: usize,
    end: usize,
}

impl<R: AsRef<[f32]>> Stretch<'_, R> {
    /// Sums over the channels, a vector after another, and their magnitudes.
    #[inline(always)]
    fn beams<V: Vector, const SENSORS: usize, const VECTORS: usize>(&self, image: &mut [Option<RowGuard<'_>>]) {
        let mut sums = [[[V::splat(0.0); 2]; VECTORS]; SENSORS];
        for (channel_block, readings) in self.readings.chunks(READINGS).enumerate() {
            let signals = &self.signals[channel_block * SENSORS..][..SENSORS];
            for lane in 0..V::LANES.min(self.channel_count - channel_block * V::LANES) {
                let [whole, fraction, cos, sin] = [0, 1, 2, 3].map(|part| readings[part].as_ref()[lane]);
                let reading = Reading::new(self.focus, [whole, fraction, cos, sin], self.first);
                add_channel::<V, SENSORS, VECTORS>(self.focus, &reading, signals, lane, &mut sums);
            }
        }
        for (row, sums) in image.iter_mut().zip(&sums) {
            let Some(row) = row else { continue };
            for (sum, start) in sums.iter().zip((self.first..self.end).step_by(V::LANES)) {
                let mut magnitudes = V::ROW_OF_ZEROS;
                sum[0].mul_add(sum[0], sum[1].mul(sum[1])).sqrt().store(&mut magnitudes);
                let count = V::LANES.min(self.end - start);
                row[start..start + count].copy_from_slice(&magnitudes.as_ref()[..count]);
            }
        }
    }
}

/// How a channel is read for a block of ranges.
struct Reading {
    taps: [f32; TAP_ROW],
    /// Sample of the first tap for the block's first range.
    row: usize,
    column: usize,
    cos: f32,
    sin: f32,
}

impl Reading {
    #[inline(always)]
    fn new(focus: &FocusPlan, [whole, fraction, cos, sin]: [f32; READINGS], first: usize) -> Self {
        let step = fraction.clamp(0.0, 1.0) * FRACTIONS as f32;
        let entry = (step as usize).min(FRACTIONS - 1);
        let share = step - entry as f32;
        let (here, next) = (&focus.taps[entry], &focus.taps[entry + 1]);
        let mut taps = [0.0; TAP_ROW];
        for tap in 0..TAP_ROW {
            taps[tap] = here[tap] + share * (next[tap] - here[tap]);
        }
        // Never negative: `lead` samples stand in every row before the first range.
        let start =
            (whole as isize + (focus.lead * focus.oversampling) as isize - TAPS_BEFORE as isize).max(0) as usize;
        let (row, column) = (start % focus.oversampling, first + start / focus.oversampling);
        Self { taps, row, column, cos, sin }
    }
}

/// Adds a channel of every sensor, read between its samples and turned.
#[inline(always)]
fn add_channel<V: Vector, const SENSORS: usize, const VECTORS: usize>(
    focus: &FocusPlan,
    reading: &Reading,
    signals: &[&[f32]],
    lane: usize,
    sums: &mut [[[V; 2]; VECTORS]; SENSORS],
) {
    let (oversampling, row_len) = (focus.oversampling, focus.row_len);
    let mut read = [[[V::splat(0.0); 2]; VECTORS]; SENSORS];
    for first_tap in 0..oversampling.min(TAPS) {
        let place = reading.row + first_tap;
        let (row, column) = (place % oversampling, reading.column + place / oversampling);
        let at = (lane * oversampling + row) * 2 * row_len + column;
        let tap_count = (TAPS - first_tap).div_ceil(oversampling);
        let len = tap_count - 1 + VECTORS * V::LANES;
        let mut stretches = [[&[][..]; 2]; SENSORS];
        for (stretch, signals) in stretches.iter_mut().zip(signals) {
            *stretch = [&signals[at..][..len], &signals[at + row_len..][..len]];
        }
        for tap in 0..tap_count {
            let value = V::splat(reading.taps[first_tap + tap * oversampling]);
            for (read, stretch) in read.iter_mut().zip(&stretches) {
                for (vector, read) in read.iter_mut().enumerate() {
                    for (read, part) in read.iter_mut().zip(stretch) {
                        let samples = rows::<V>(&part[tap + vector * V::LANES..][..V::LANES]);
                        *read = V::load(&samples[0]).mul_add(value, *read);
                    }
                }
            }
        }
    }
    let (cos, sin) = (V::splat(reading.cos), V::splat(reading.sin));
    for (sums, read) in sums.iter_mut().zip(&read) {
        for (sum, [re, im]) in sums.iter_mut().zip(read) {
            sum[0] = im.neg_mul_add(sin, re.mul_add(cos, sum[0]));
            sum[1] = re.mul_add(sin, im.mul_add(cos, sum[1]));
        }
    }
}

/// `[block of channels][whole, fraction, cos, sin][lane]` at a range.
#[inline(always)]
fn read_where<V: Vector>(focus: &FocusPlan, sensor: usize, direction: usize, range_m: f32, readings: &mut [V::Row]) {
    let geometry = &focus.sensors[sensor];
    let emitter_m = FocusPlan::excess_m(range_m, geometry.emitter_along_m[direction], geometry.emitter_square_m2);
    let channel_count = geometry.square_m2.len();
    let along_m = &geometry.along_m[direction * channel_count..][..channel_count];
    for (block, readings) in readings.chunks_mut(READINGS).enumerate() {
        let at = |values: &[f32]| {
            let mut row = V::ROW_OF_ZEROS;
            let values = &values[(block * V::LANES).min(channel_count)..channel_count];
            let count = values.len().min(V::LANES);
            row.as_mut()[..count].copy_from_slice(&values[..count]);
            V::load(&row)
        };
        let range = V::splat(range_m);
        // |p|^2 - 2 r p.u, over |r u - p| + r: see FocusPlan::excess_m.
        let bend = at(along_m).neg_mul_add(V::splat(2.0 * range_m), at(&geometry.square_m2));
        let square = range.mul_add(range, bend);
        let zero = V::splat(0.0);
        let path = square.where_less(zero, zero, square).sqrt().add(range);
        let least = V::splat(f32::MIN_POSITIVE);
        let excess = bend.div(path.where_less(least, least, path)).add(V::splat(emitter_m));
        let samples = excess.mul(V::splat(focus.samples_per_m as f32));
        let whole = rounded(samples.sub(V::splat(0.5)));
        let (cos, sin) = cos_sin(excess.mul(V::splat(focus.turns_per_m as f32)));
        for (reading, value) in readings.iter_mut().zip([whole, samples.sub(whole), cos, sin]) {
            value.store(reading);
        }
    }
}

/// Adding and taking away 1.5 * 2^23 rounds an f32 below 2^22 to a whole number, in vector code on every processor.
const ROUNDER: f32 = 12_582_912.0;

#[inline(always)]
fn rounded<V: Vector>(value: V) -> V {
    value.add(V::splat(ROUNDER)).sub(V::splat(ROUNDER))
}

/// Taylor series of the cosine and of the sine of a quarter turn's angle, over it.
const COS: [f32; 6] = [2.087_675_7e-9, -2.755_732e-7, 2.480_158_7e-5, -1.388_888_9e-3, 4.166_666_7e-2, -0.5];
const SIN: [f32; 6] = [1.605_904_4e-10, -2.505_210_8e-8, 2.755_731_9e-6, -1.984_127e-4, 8.333_333e-3, -0.166_666_67];

/// Cosine and sine of 2 pi turns, good to 3e-7 below a hundred turns beside the turns' own rounding.
#[inline(always)]
fn cos_sin<V: Vector>(turns: V) -> (V, V) {
    let half_turns = rounded(turns.add(turns));
    let halves = half_turns.mul(V::splat(0.5));
    let odd = halves.sub(rounded(halves)).abs();
    // 1 for even half turns, -1 for odd ones, whose remainder is a half.
    let sign = odd.neg_mul_add(V::splat(4.0), V::splat(1.0));
    let angle = turns.add(turns).sub(half_turns).mul(V::splat(std::f32::consts::PI));
    let square = angle.mul(angle);
    let (mut cos, mut sin) = (V::splat(COS[0]), V::splat(SIN[0]));
    for term in 1..6 {
        cos = cos.mul_add(square, V::splat(COS[term]));
        sin = sin.mul_add(square, V::splat(SIN[term]));
    }
    let one = V::splat(1.0);
    (cos.mul_add(square, one).mul(sign), sin.mul_add(square, one).mul(angle).mul(sign))
}

#[cfg(test)]
mod tests {
    use super::super::simd::Plain;
    use super::*;

    #[test]
    fn cosine_and_sine_of_turns_are_good_to_3e_7() {
        for step in -4000..4000 {
            let turns = step as f32 * 0.012_207_031;
            let (cos, sin) = cos_sin::<Plain>(Plain::splat(turns));
            let mut row = [[0.0; 4]; 2];
            cos.store(&mut row[0]);
            sin.store(&mut row[1]);
            let (true_sin, true_cos) = (2.0 * std::f64::consts::PI * f64::from(turns)).sin_cos();
            let error = (f64::from(row[0][0]) - true_cos).abs().max((f64::from(row[1][0]) - true_sin).abs());
            assert!(error < 3e-7, "{turns}: {error:e}");
        }
    }
}
