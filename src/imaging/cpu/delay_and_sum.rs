//! Band spectra of the channels to band spectra of the beams (plan, step 4; specification, section 3).
//!
//! In: `[bin][channel]` of up to three sensors with the same array. Out: the buffers of the inverse transform, `[place][direction]`, one
//! vector of directions at a time. The phase exp(-j 2 pi f p.u / c) goes from bin to bin by one complex product and is set anew
//! from f64 at every block of bins. Two directions with opposite delays (a planar array, left and right) share all products. Twin of
//! `shaders/delay_and_sum.wgsl`.

use super::aligned::{rows, rows_mut};
use super::simd::Vector;
use crate::imaging::plan::SensorPlan;
use crate::signal::SENSORS_MAX;

/// Bins between two phases set from f64: 32 products leave an error below 2e-6.
const BLOCK: usize = 32;
/// Delays that differ by less are opposite: at 200 kHz a phase of 1e-8.
const SAME_DELAY_S: f64 = 1e-14;

/// The steering of one array, laid out for vectors.
#[derive(Debug)]
pub(super) struct Steering {
    /// Directions of each lane: the first, and the one with opposite delays if there is one.
    lanes: Vec<(usize, Option<usize>)>,
    channel_count: usize,
    /// `[lane block][channel][lane]`: delay times bin step, turns per bin.
    turns_per_bin: Vec<f64>,
    /// exp(-j 2 pi turns_per_bin) in the same order: real, imaginary.
    step: [Vec<f32>; 2],
}

impl Steering {
    /// Lays out the delays of a sensor for vectors of `lane_count` values.
    pub(super) fn new(sensor: &SensorPlan, bin_step_hz: f64, lane_count: usize) -> Self {
        let channel_count = sensor.channel_count;
        let lanes = mirror_pairs(&sensor.delays_s, channel_count);
        let blocks = lanes.len().div_ceil(lane_count);
        let mut turns_per_bin = vec![0.0; blocks * channel_count * lane_count];
        for (index, (direction, _)) in lanes.iter().enumerate() {
            for channel in 0..channel_count {
                let place = (index / lane_count * channel_count + channel) * lane_count + index % lane_count;
                turns_per_bin[place] = sensor.delays_s[direction * channel_count + channel] * bin_step_hz;
            }
        }
        let angle = |turns: &f64| -2.0 * std::f64::consts::PI * turns;
        let step = [
            turns_per_bin.iter().map(|turns| angle(turns).cos() as f32).collect(),
            turns_per_bin.iter().map(|turns| angle(turns).sin() as f32).collect(),
        ];
        Self { lanes, channel_count, turns_per_bin, step }
    }

    /// Channels of the array.
    pub(super) fn channel_count(&self) -> usize {
        self.channel_count
    }

    /// The direction and its mirror of each lane of a vector.
    pub(super) fn lanes(&self, lane_block: usize, lane_count: usize) -> &[(usize, Option<usize>)] {
        let first = lane_block * lane_count;
        &self.lanes[first..self.lanes.len().min(first + lane_count)]
    }

    /// Number of vectors that the lanes fill.
    pub(super) fn lane_blocks(&self, lane_count: usize) -> usize {
        self.lanes.len().div_ceil(lane_count)
    }
}

/// Pairs every direction with the one whose delays are opposite at every channel, where there is one.
fn mirror_pairs(delays_s: &[f64], channel_count: usize) -> Vec<(usize, Option<usize>)> {
    let row = |direction: usize| &delays_s[direction * channel_count..][..channel_count];
    let direction_count = delays_s.len() / channel_count;
    // One number a direction, which changes sign with all the delays, narrows the search; irregular weights keep apart what differs.
    let weight = |channel: usize| 1.0 + (channel as f64 * 0.754_877_666).fract();
    let key: Vec<f64> =
        (0..direction_count).map(|d| row(d).iter().enumerate().map(|(c, delay)| weight(c) * delay).sum()).collect();
    let mut order: Vec<usize> = (0..direction_count).collect();
    order.sort_by(|a, b| key[*a].total_cmp(&key[*b]));
    let tolerance = SAME_DELAY_S * 2.0 * channel_count as f64;
    let opposite = |a: usize, b: usize| row(a).iter().zip(row(b)).all(|(x, y)| (x + y).abs() <= SAME_DELAY_S);
    let mut taken = vec![false; direction_count];
    let mut lanes = Vec::with_capacity(direction_count);
    for direction in 0..direction_count {
        if std::mem::replace(&mut taken[direction], true) {
            continue;
        }
        let start = order.partition_point(|&other| key[other] < -key[direction] - tolerance);
        let near = order[start..].iter().take_while(|&&other| key[other] <= -key[direction] + tolerance);
        let mirror = near.copied().find(|&other| !taken[other] && opposite(direction, other));
        if let Some(other) = mirror {
            taken[other] = true;
        }
        lanes.push((direction, mirror));
    }
    lanes
}

/// One vector of directions of up to three sensors of one array.
pub(super) struct BeamTask<'a> {
    pub steering: &'a Steering,
    /// Which vector of lanes.
    pub lane_block: usize,
    /// Absolute index of the first bin.
    pub first_bin: usize,
    /// `[block of channels][sensor]` of `[bin][re, im][channel]`.
    pub spectra: &'a [&'a [f32]],
    /// 1 to [`SENSORS_MAX`].
    pub sensor_count: usize,
    /// Where the beams go.
    pub fold: &'a Fold,
    /// Scratch, of [`scratch_len`] values.
    pub phases: &'a mut [f32],
    /// `[sensor][direction, mirror][place][im, re][lane]`: parts exchanged, for the inverse transform.
    pub beams: &'a mut [f32],
}

/// Places of the bins in the inverse transform (plan, step 5): more bins than places are added up.
#[derive(Debug)]
pub(super) struct Fold {
    /// Place of each bin.
    pub places: Vec<u32>,
    /// Bins from this one on fall on a place that is taken.
    pub fresh: usize,
    /// Places without a bin.
    pub gaps: Vec<u32>,
    /// Number of places.
    pub len: usize,
}

/// Values of scratch: phase and step of all channels in one vector of lanes.
pub(super) fn scratch_len(channel_count: usize, lanes: usize) -> usize {
    4 * lanes * channel_count
}

/// Steers and sums.
#[inline(always)]
pub(super) fn delay_and_sum<V: Vector>(task: BeamTask<'_>) {
    match task.sensor_count {
        1 => beams_of::<V, 1>(task),
        2 => beams_of::<V, 2>(task),
        _ => beams_of::<V, { SENSORS_MAX }>(task),
    }
}

#[inline(always)]
fn beams_of<V: Vector, const SENSORS: usize>(task: BeamTask<'_>) {
    let BeamTask { steering, lane_block, first_bin, spectra, fold, phases, beams, .. } = task;
    let phases = rows_mut::<V>(phases).as_chunks_mut::<4>().0;
    let beams = rows_mut::<V>(beams);
    for buffer in beams.chunks_exact_mut(2 * fold.len) {
        for place in &fold.gaps {
            buffer[2 * *place as usize..][..2].fill(V::ROW_OF_ZEROS);
        }
    }
    for (bin, place) in fold.places.iter().enumerate() {
        if bin % BLOCK == 0 {
            seed::<V>(steering, lane_block, first_bin + bin, phases);
        }
        let products = sum_channels::<V, SENSORS>(phases, spectra, bin);
        for (sensor, [a, b, c, d]) in products.into_iter().enumerate() {
            for (side, parts) in [[c.add(d), a.sub(b)], [c.sub(d), a.add(b)]].into_iter().enumerate() {
                let first = 2 * ((2 * sensor + side) * fold.len + *place as usize);
                for (row, part) in beams[first..first + 2].iter_mut().zip(parts) {
                    let sum = if bin < fold.fresh { part } else { V::load(row).add(part) };
                    sum.store(row);
                }
            }
        }
    }
}

/// The four real sums over the channels that both directions of a lane are made of; the phases go one bin further.
#[inline(always)]
fn sum_channels<V: Vector, const SENSORS: usize>(
    phases: &mut [[V::Row; 4]],
    spectra: &[&[f32]],
    bin: usize,
) -> [[V; 4]; SENSORS] {
    let mut sums = [[V::splat(0.0); 4]; SENSORS];
    for (phases, spectra) in phases.chunks_mut(V::LANES).zip(spectra.as_chunks::<SENSORS>().0) {
        let zeros = V::ROW_OF_ZEROS;
        let mut values = [[&zeros; 2]; SENSORS];
        for (values, spectrum) in values.iter_mut().zip(spectra) {
            let pair = rows::<V>(&spectrum[2 * bin * V::LANES..][..2 * V::LANES]);
            *values = [&pair[0], &pair[1]];
        }
        for (lane, phase) in phases.iter_mut().enumerate().take(V::LANES) {
            let [re, im, step_re, step_im] = [&phase[0], &phase[1], &phase[2], &phase[3]].map(V::load);
            for sensor in 0..SENSORS {
                let (value_re, value_im) =
                    (V::splat(values[sensor][0].as_ref()[lane]), V::splat(values[sensor][1].as_ref()[lane]));
                sums[sensor][0] = value_re.mul_add(re, sums[sensor][0]);
                sums[sensor][1] = value_im.mul_add(im, sums[sensor][1]);
                sums[sensor][2] = value_im.mul_add(re, sums[sensor][2]);
                sums[sensor][3] = value_re.mul_add(im, sums[sensor][3]);
            }
            im.neg_mul_add(step_im, re.mul(step_re)).store(&mut phase[0]);
            re.mul_add(step_im, im.mul(step_re)).store(&mut phase[1]);
        }
    }
    sums
}

/// Sets the phases of a vector of lanes for a bin: `[channel][re, im, step re, step im]`.
#[inline(always)]
fn seed<V: Vector>(steering: &Steering, lane_block: usize, bin: usize, phases: &mut [[V::Row; 4]]) {
    for (channel, phase) in phases.iter_mut().enumerate() {
        let place = (lane_block * steering.channel_count + channel) * V::LANES;
        let turns = &steering.turns_per_bin[place..][..V::LANES];
        for (lane, turns) in turns.iter().enumerate() {
            let (sin, cos) = sin_cos_turns(-turns * bin as f64);
            (phase[0].as_mut()[lane], phase[1].as_mut()[lane]) = (cos, sin);
        }
        phase[2].as_mut().copy_from_slice(&steering.step[0][place..][..V::LANES]);
        phase[3].as_mut().copy_from_slice(&steering.step[1][place..][..V::LANES]);
    }
}

/// Adding and taking away 1.5 * 2^52 rounds an f64 below 2^51 to a whole number, in vector code on every processor.
const ROUNDER: f64 = 6_755_399_441_055_744.0;

/// Sine and cosine of an angle in turns, good to 2e-7. Whole and half turns are taken out in f64, the rest is a
/// Taylor series on a quarter turn.
#[inline(always)]
fn sin_cos_turns(turns: f64) -> (f32, f32) {
    let half_turns = (2.0 * turns + ROUNDER) - ROUNDER;
    let odd = half_turns - 2.0 * ((0.5 * half_turns + ROUNDER) - ROUNDER);
    let sign = (1.0 - 2.0 * odd.abs()) as f32;
    let angle = ((2.0 * turns - half_turns) * std::f64::consts::PI) as f32;
    let square = angle * angle;
    let mut sin = 1.605_904_4e-10_f32;
    for term in [-2.505_210_8e-8, 2.755_731_9e-6, -1.984_127e-4, 8.333_333e-3, -0.166_666_67, 1.0] {
        sin = sin * square + term;
    }
    let mut cos = 2.087_675_7e-9_f32;
    for term in [-2.755_732e-7, 2.480_158_7e-5, -1.388_888_9e-3, 4.166_666_7e-2, -0.5, 1.0] {
        cos = cos * square + term;
    }
    (sign * sin * angle, sign * cos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_are_good_to_2e_7_at_any_number_of_turns() {
        let mut worst = 0.0_f64;
        for step in -40_000..40_000 {
            let turns = f64::from(step) * 1.000_37e-3;
            let (sin, cos) = sin_cos_turns(turns);
            let (true_sin, true_cos) = (2.0 * std::f64::consts::PI * (turns - turns.round())).sin_cos();
            worst = worst.max((f64::from(sin) - true_sin).abs()).max((f64::from(cos) - true_cos).abs());
        }
        assert!(worst < 2e-7, "{worst:e}");
    }

    #[test]
    fn directions_are_paired_with_their_mirror_and_only_with_it() {
        // Four directions at two channels: 0 and 3 are opposite; 1 is opposite to 0 at one channel only; 2 stands alone.
        let delays = [1e-4, 2e-4, -1e-4, 1.9e-4, 3e-4, 0.0, -1e-4, -2e-4];
        assert_eq!(mirror_pairs(&delays, 2), vec![(0, Some(3)), (1, None), (2, None)]);
    }

    #[test]
    fn boresight_is_not_its_own_mirror() {
        assert_eq!(mirror_pairs(&[0.0, 0.0], 2), vec![(0, None)]);
    }
}
