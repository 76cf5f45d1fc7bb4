//! Each stage of the imaging as the textbook formula in f64, slow and plain. Shares no code with `src`.
//!
//! Full sample rate, one long zero-padded transform, exact phases, and the analytic signal summed at each bin's own time. From
//! the plan it takes only what defines the task: filter taps of the PDM decimation and of the smoothing, and the
//! frequencies at which the stages in between hand over.

use super::scenes::{Case, EMITTER_M, SPEED_OF_SOUND_M_S, unit};
use noctule::imaging::params::Weighting;
use noctule::imaging::plan::ImagingPlan;
use noctule::signal::{MaskTable, NO_CELL, RowSums, Samples};
use std::f64::consts::PI;

/// A complex number.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Complex {
    pub re: f64,
    pub im: f64,
}

impl Complex {
    pub fn turn(angle_rad: f64) -> Self {
        Self { re: angle_rad.cos(), im: angle_rad.sin() }
    }

    pub fn times(self, other: Self) -> Self {
        Self { re: self.re * other.re - self.im * other.im, im: self.re * other.im + self.im * other.re }
    }

    pub fn plus(self, other: Self) -> Self {
        Self { re: self.re + other.re, im: self.im + other.im }
    }

    pub fn scaled(self, factor: f64) -> Self {
        Self { re: self.re * factor, im: self.im * factor }
    }

    pub fn conjugate(self) -> Self {
        Self { re: self.re, im: -self.im }
    }

    pub fn magnitude(self) -> f64 {
        self.re.hypot(self.im)
    }
}

/// Stage 1: samples of every channel, full scale 1.
pub fn demodulate(plan: &ImagingPlan, channel_count: usize, samples: &Samples) -> Vec<Vec<f64>> {
    let rows = |values: Vec<f64>| values.chunks(plan.raw_count).map(<[f64]>::to_vec).collect();
    match samples {
        Samples::PcmF32(values) => rows(values.iter().map(|value| f64::from(*value)).collect()),
        Samples::PcmI16(values) => rows(values.iter().map(|value| f64::from(*value) / 32768.0).collect()),
        Samples::Pdm(words) => (0..channel_count).map(|channel| decimate(plan, words, channel)).collect(),
    }
}

fn decimate(plan: &ImagingPlan, words: &[u32], channel: usize) -> Vec<f64> {
    let half = plan.demodulation_taps.len() as i64 / 2;
    let bits: Vec<f64> = words.iter().map(|word| if word >> channel & 1 == 1 { 1.0 } else { -1.0 }).collect();
    let output = |j: usize| {
        let place = |i: usize| (j * plan.decimation) as i64 + i as i64 - half;
        let bit = |i: usize| usize::try_from(place(i)).ok().and_then(|place| bits.get(place)).copied().unwrap_or(0.0);
        plan.demodulation_taps.iter().enumerate().map(|(i, tap)| f64::from(*tap) * bit(i)).sum()
    };
    (0..words.len() / plan.decimation).map(output).collect()
}

/// P(f): 1 in the sweep's band, raised-cosine edges of a tenth of its width, 0 beyond.
pub fn passband(case: &Case, frequency_hz: f64) -> f64 {
    let low_hz = case.sweep.start_hz.min(case.sweep.end_hz);
    let high_hz = case.sweep.start_hz.max(case.sweep.end_hz);
    let edge_hz = 0.1 * (high_hz - low_hz);
    let ramp = |share: f64| if share <= 0.0 { 0.0 } else { 0.5 - 0.5 * (PI * share).cos() };
    if frequency_hz < low_hz {
        ramp((frequency_hz - (low_hz - edge_hz)) / edge_hz)
    } else if frequency_hz <= high_hz {
        1.0
    } else {
        ramp(((high_hz + edge_hz) - frequency_hz) / edge_hz)
    }
}

/// Spectrum of real samples at one frequency, by its definition.
pub fn spectrum_at(samples: &[f64], rate_hz: f64, frequency_hz: f64) -> Complex {
    let step = Complex::turn(-2.0 * PI * frequency_hz / rate_hz);
    let mut sum = Complex::default();
    for (block, values) in samples.chunks(1024).enumerate() {
        let mut phase = Complex::turn(-2.0 * PI * (frequency_hz / rate_hz * (block * 1024) as f64).fract());
        for value in values {
            sum = sum.plus(phase.scaled(*value));
            phase = phase.times(step);
        }
    }
    sum
}

/// Sum of squares of the emission.
pub fn emission_energy(case: &Case) -> f64 {
    case.sweep.emission().samples.iter().map(|s| s * s).sum()
}

/// Stage 2 at bin `bin` of the plan: what one channel of weight 1 hands to the beamformer. N is the transform's whole length.
pub fn matched_filter(case: &Case, plan: &ImagingPlan, samples: &[f64], bin: usize) -> Complex {
    let rate_hz = case.demodulated().0;
    let frequency_hz = bin as f64 * plan.bin_step_hz;
    let heard = spectrum_at(samples, rate_hz, frequency_hz);
    let sent = spectrum_at(&case.sweep.emission().samples, rate_hz, frequency_hz);
    let first = Complex::turn(2.0 * PI * frequency_hz * 2.0 * case.params.range_min_m / SPEED_OF_SOUND_M_S);
    let product = heard.times(sent.conjugate()).times(first);
    if case.params.weighting == Weighting::Phat {
        let passed: f64 =
            (0..plan.bin_count).map(|k| passband(case, (plan.first_bin + k) as f64 * plan.bin_step_hz)).sum();
        return product.scaled(passband(case, frequency_hz) / (passed * product.magnitude()));
    }
    let length = rate_hz / plan.bin_step_hz;
    product.scaled(2.0 * passband(case, frequency_hz) / (emission_energy(case) * length))
}

/// Delay of a microphone for a direction: by how much it hears earlier.
pub fn earlier_s(case: &Case, sensor: usize, channel: usize, direction: usize) -> f64 {
    case.arrays[sensor][channel].dot(&unit(&case.directions[direction])) / SPEED_OF_SOUND_M_S
}

/// Stage 3 at one bin of one direction from stage 2 of all channels, with their gains.
pub fn delay_and_sum(
    case: &Case,
    plan: &ImagingPlan,
    sensor: usize,
    direction: usize,
    bin: usize,
    matched: &[Complex],
) -> Complex {
    let frequency_hz = bin as f64 * plan.bin_step_hz;
    let aligned = |(channel, value): (usize, &Complex)| {
        value.times(Complex::turn(-2.0 * PI * frequency_hz * plane_wave_s(case, sensor, channel, direction)))
    };
    matched.iter().enumerate().map(aligned).fold(Complex::default(), Complex::plus)
}

/// By how much sooner than 2 r / c a microphone hears a point at r in a direction: the exact path, in metres.
pub fn sooner_m(case: &Case, sensor: usize, channel: usize, direction: usize, range_m: f64, fault: Fault) -> f64 {
    let point_m = unit(&case.directions[direction]) * range_m;
    let emitter_m = if fault == Fault::NoEmitter { nalgebra::Vector3::zeros() } else { EMITTER_M };
    2.0 * range_m - (point_m - emitter_m).norm() - (point_m - case.arrays[sensor][channel]).norm()
}

/// A fault planted into the oracle, which a comparison must notice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    None,
    /// One microphone's samples come one sample late.
    LateMicrophone(usize),
    /// Two channels are exchanged.
    SwappedChannels(usize, usize),
    /// Delays have the wrong sign.
    DelaySign,
    /// The result is one percent too large.
    Scale,
    /// One direction takes its neighbour's place.
    ShiftedDirection(usize),
    /// A direction and its mirror are exchanged.
    LostMirror(usize),
    /// Ranges are off by a tenth of a bin.
    RangeOffset,
    /// The envelope is of the beam's real part only.
    NoQuadrature,
    /// Focused as if the emitter stood in the origin.
    NoEmitter,
    /// Not focused at all.
    PlaneWave,
}

/// Stages 2 to 4 as a whole: the energyscape rows of `directions`, `[direction][range]`.
///
/// `gains` are weights over their sum. With PHAT the spectra stand on the plan's bins, since whitening depends on them;
/// otherwise on those of a transform of at least twice the recording, whatever the plan uses.
pub fn energyscape(
    case: &Case,
    plan: &ImagingPlan,
    sensor: usize,
    samples: &[Vec<f64>],
    gains: &[f32],
    directions: &[usize],
    fault: Fault,
) -> Vec<f64> {
    let mut samples = samples.to_vec();
    match fault {
        Fault::LateMicrophone(channel) => samples[channel].rotate_right(1),
        Fault::SwappedChannels(a, b) => samples.swap(a, b),
        _ => {}
    }
    let (spectra, bin_hz, first_bin) = band_spectra(case, plan, &samples, gains);
    let rows = directions.iter().map(|&direction| {
        let direction = match fault {
            Fault::ShiftedDirection(shifted) if shifted == direction => direction + 1,
            Fault::LostMirror(lost) if lost == direction => case.directions.len() - 1 - direction,
            _ => direction,
        };
        let ranges = plan.grid.range_count();
        if plan.sensors[sensor].hidden[direction] {
            return vec![0.0; ranges];
        }
        let beam = |earlier_s: &dyn Fn(usize) -> f64| {
            let used = spectra.iter().enumerate().filter(|(channel, _)| gains[*channel] != 0.0);
            let mut beam = vec![Complex::default(); spectra.first().map_or(0, Vec::len)];
            let sign = if fault == Fault::DelaySign { 1.0 } else { -1.0 };
            for (channel, spectrum) in used {
                steer(&mut beam, spectrum, first_bin, bin_hz, sign * earlier_s(channel));
            }
            beam
        };
        let mut row = Vec::new();
        for (range_m, focused) in focused_blocks(plan).into_iter().filter(|_| fault != Fault::PlaneWave) {
            let sooner_s = |channel| sooner_m(case, sensor, channel, direction, range_m, fault) / SPEED_OF_SOUND_M_S;
            row.extend(envelope(plan, &beam(&sooner_s), first_bin, bin_hz, focused, fault));
        }
        let rest = row.len()..ranges;
        row.extend(envelope(
            plan,
            &beam(&|channel| plane_wave_s(case, sensor, channel, direction)),
            first_bin,
            bin_hz,
            rest,
            fault,
        ));
        row
    });
    rows.flatten().collect()
}

/// By how much earlier than 2 r / c a plane wave is heard: by the emitter's place, too, unless focusing is off altogether.
fn plane_wave_s(case: &Case, sensor: usize, channel: usize, direction: usize) -> f64 {
    let emitter_m =
        if case.params.focus_to_m == Some(0.0) { 0.0 } else { EMITTER_M.dot(&unit(&case.directions[direction])) };
    earlier_s(case, sensor, channel, direction) + emitter_m / SPEED_OF_SOUND_M_S
}

/// The blocks of ranges that share a focus, each with the harmonic mean of its first and last range.
pub fn focused_blocks(plan: &ImagingPlan) -> Vec<(f64, std::ops::Range<usize>)> {
    let Some(focus) = &plan.focus else { return Vec::new() };
    let range_m = |index: usize| plan.grid.range_first_m() + index as f64 * plan.grid.range_step_m();
    let block = |block: &noctule::imaging::plan::focus::FocusBlock| {
        let (near_m, far_m) = (range_m(block.first), range_m(block.first + block.len - 1));
        (2.0 / (1.0 / near_m + 1.0 / far_m), block.first..block.first + block.len)
    };
    focus.blocks.iter().map(block).collect()
}

/// Adds a spectrum, delayed.
fn steer(beam: &mut [Complex], spectrum: &[Complex], first_bin: usize, bin_hz: f64, delay_s: f64) {
    let step = Complex::turn(2.0 * PI * bin_hz * delay_s);
    for (block, (sums, values)) in beam.chunks_mut(64).zip(spectrum.chunks(64)).enumerate() {
        let mut phase = Complex::turn(2.0 * PI * (first_bin + 64 * block) as f64 * bin_hz * delay_s);
        for (sum, value) in sums.iter_mut().zip(values) {
            *sum = sum.plus(value.times(phase));
            phase = phase.times(step);
        }
    }
}

/// Band spectra of all channels, `[channel][bin]`, scaled so that the sum over bins is the analytic signal; their bin step
/// and first bin.
pub fn band_spectra(
    case: &Case,
    plan: &ImagingPlan,
    samples: &[Vec<f64>],
    gains: &[f32],
) -> (Vec<Vec<Complex>>, f64, usize) {
    if case.params.weighting == Weighting::Phat {
        let bins = plan.first_bin..plan.first_bin + plan.bin_count;
        // `matched_filter` carries the phase of the first range, which the sum over bins below brings itself.
        let first_s = 2.0 * case.params.range_min_m / SPEED_OF_SOUND_M_S;
        let bin_of = |row: &[f64], bin: usize, gain: f32| {
            let back = Complex::turn(-2.0 * PI * bin as f64 * plan.bin_step_hz * first_s);
            matched_filter(case, plan, row, bin).times(back).scaled(f64::from(gain))
        };
        let spectra =
            samples.iter().zip(gains).map(|(row, gain)| bins.clone().map(|bin| bin_of(row, bin, *gain)).collect());
        return (spectra.collect(), plan.bin_step_hz, plan.first_bin);
    }
    let (rate_hz, count) = case.demodulated();
    let emission = case.sweep.emission().samples;
    let length = (2 * (count + emission.len())).next_power_of_two();
    let bin_hz = rate_hz / length as f64;
    let low_hz = 0.5 * case.sweep.start_hz.min(case.sweep.end_hz);
    let high_hz = 1.5 * case.sweep.start_hz.max(case.sweep.end_hz);
    let inside: Vec<usize> = (1..length / 2)
        .filter(|&k| (low_hz..high_hz).contains(&(k as f64 * bin_hz)) && passband(case, k as f64 * bin_hz) > 0.0)
        .collect();
    let (first, last) = (inside[0], inside[inside.len() - 1]);
    let sent = transform(&emission, length);
    let energy: f64 = emission.iter().map(|s| s * s).sum();
    let spectrum = |(row, gain): (&Vec<f64>, &f32)| {
        let heard = if *gain == 0.0 { vec![Complex::default(); length] } else { transform(row, length) };
        let scale = |k: usize| 2.0 * passband(case, k as f64 * bin_hz) * f64::from(*gain) / (energy * length as f64);
        (first..=last).map(|k| heard[k].times(sent[k].conjugate()).scaled(scale(k))).collect()
    };
    (samples.iter().zip(gains).map(spectrum).collect(), bin_hz, first)
}

/// Stage 4: magnitude of the analytic signal at the time of each range bin, smoothed with the plan's taps.
fn envelope(
    plan: &ImagingPlan,
    beam: &[Complex],
    first_bin: usize,
    bin_hz: f64,
    ranges: std::ops::Range<usize>,
    fault: Fault,
) -> Vec<f64> {
    let half = plan.smoothing_taps.len() as i64 / 2;
    let (first, end) = (ranges.start as i64, ranges.end as i64);
    let magnitude = |index: i64| {
        let offset = if fault == Fault::RangeOffset { 0.1 } else { 0.0 };
        let range_m = plan.grid.range_first_m() + (index as f64 + offset) * plan.grid.range_step_m();
        let time_s = 2.0 * range_m / SPEED_OF_SOUND_M_S;
        let step = Complex::turn(2.0 * PI * bin_hz * time_s);
        let mut sum = Complex::default();
        for (block, bins) in beam.chunks(256).enumerate() {
            let mut phase = Complex::turn(2.0 * PI * ((first_bin + block * 256) as f64 * bin_hz * time_s).fract());
            for bin in bins {
                sum = sum.plus(bin.times(phase));
                phase = phase.times(step);
            }
        }
        let scale = if fault == Fault::Scale { 1.01 } else { 1.0 };
        scale * if fault == Fault::NoQuadrature { sum.re.abs() } else { sum.magnitude() }
    };
    if plan.smoothing_taps.is_empty() {
        return (first..end).map(magnitude).collect();
    }
    let values: Vec<f64> = (first - half..end + half).map(magnitude).collect();
    let smooth = |window: &[f64]| plan.smoothing_taps.iter().zip(window).map(|(tap, x)| f64::from(*tap) * x).sum();
    values.windows(plan.smoothing_taps.len()).map(smooth).collect()
}

/// Stage 5: the sums of one row over an image, by their definition at `RowSums`.
pub fn masked_energy(masks: &MaskTable, row: usize, plan: &ImagingPlan, image: &[f64]) -> [f64; 5] {
    let row = &masks.rows[row];
    let mut sums = [0.0; 5];
    for entry in row.first..row.first + row.count {
        let cell = masks.cells[entry] as usize;
        let range = cell % plan.grid.range_count();
        let range_m = plan.grid.range_first_m() + range as f64 * plan.grid.range_step_m();
        let gained = image[cell] * f64::from(masks.gains[row.sensor_index][range]);
        if gained < f64::from(masks.floors[row.sensor_index][range]) {
            continue;
        }
        sums[0] += gained;
        // At range zero there is no side.
        let near = if range_m > 0.0 { 1.0 / (range_m * range_m) } else { 0.0 };
        sums[1] += gained * f64::from(masks.sides[entry]) * near;
        sums[2] += gained * range_m.sqrt();
        sums[3] = f64::max(sums[3], gained);
        sums[4] += gained * near;
    }
    sums
}

/// Says what in `found` contradicts the image it was made from; values near a threshold may fall on either side.
pub fn entries_contradict(
    masks: &MaskTable,
    row: usize,
    plan: &ImagingPlan,
    image: &[f64],
    found: &RowSums,
) -> Option<String> {
    let row = &masks.rows[row];
    let energy = |entry: usize| {
        let cell = masks.cells[row.first + entry] as usize;
        let range = cell % plan.grid.range_count();
        let gained = image[cell] * f64::from(masks.gains[row.sensor_index][range]);
        if gained < f64::from(masks.floors[row.sensor_index][range]) { 0.0 } else { gained }
    };
    let energies: Vec<f64> = (0..row.count).map(energy).collect();
    let peak = energies.iter().copied().fold(0.0, f64::max);
    if peak == 0.0 {
        return (*found != RowSums::SILENT).then(|| format!("{found:?} for silence"));
    }
    let at = |entry: u32| (entry != NO_CELL).then(|| energies.get(entry as usize).copied()).flatten();
    let Some(peak_found) = at(found.peak_entry) else { return Some("no peak entry".into()) };
    if peak_found < peak * (1.0 - 1e-4) {
        return Some(format!("peak entry holds {peak_found}, not {peak}"));
    }
    let Some(nearest) = at(found.nearest_entry) else { return Some("no nearest entry".into()) };
    let distance_m = |entry: usize| masks.distances_m[row.first + entry];
    if nearest < 0.5 * peak * (1.0 - 1e-4) || distance_m(found.nearest_entry as usize) != found.nearest_distance_m {
        return Some(format!("nearest entry holds {nearest} of {peak}, at another distance than it says"));
    }
    let surely_nearer =
        (0..row.count).any(|e| energies[e] > 0.5 * peak * (1.0 + 1e-4) && distance_m(e) < found.nearest_distance_m);
    surely_nearer.then(|| "a nearer entry is strong enough".into())
}

/// Transform of real samples, zero-padded to `length`, a power of two: split into even and odd.
pub fn transform(samples: &[f64], length: usize) -> Vec<Complex> {
    let mut values = vec![Complex::default(); length];
    for (index, value) in samples.iter().enumerate() {
        values[index.reverse_bits() >> (usize::BITS - length.trailing_zeros())] = Complex { re: *value, im: 0.0 };
    }
    let mut half = 1;
    while half < length {
        let twiddles: Vec<Complex> = (0..half).map(|k| Complex::turn(-PI * k as f64 / half as f64)).collect();
        for block in values.chunks_mut(2 * half) {
            let (even, odd) = block.split_at_mut(half);
            for ((even, odd), twiddle) in even.iter_mut().zip(odd).zip(&twiddles) {
                let turned = odd.times(*twiddle);
                (*even, *odd) = (even.plus(turned), even.plus(turned.scaled(-1.0)));
            }
        }
        half *= 2;
    }
    values
}
