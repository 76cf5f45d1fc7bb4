//! CLEAN: the pattern of the strongest echoes taken out of the channel signals, and a main lobe alone put in its place (Högbom 1974,
//! "Aperture synthesis with a non-regular distribution of interferometer baselines"; here on the channel signals, so that the exact
//! near pattern and its phase go, and with a fitted wave front, so that walls, edges and points all do).
//!
//! The ranges are cut into windows. A round looks, in every window, for the loudest cell; where the neighbouring windows have nothing
//! louder, its echo is fitted: wave front (tilt in three coordinates and curvature), place within the cell, and amplitude with a
//! slope over frequency, as absorption in air gives it. What was fitted leaves the channel signals, which are imaged anew. After
//! the last round every echo is put back as the main lobe it would have with no side lobe. In: what the plan knows. Out:
//! [`CleanPlan`], which both twins follow. Never touches a sample.

use super::reference::spectrum_at;
use super::{Band, FocusPlan, ImagingPlan};
use crate::imaging::params::{CLEAN_ROUNDS_MAX, ImagingParams, Weighting};
use crate::parameter::ParameterError;
use crate::sensor::{Emission, SensorSetup, per_emission};
use nalgebra::{Complex, Matrix3, Vector3};
use std::f64::consts::TAU;
use std::sync::Arc;

type Complex64 = Complex<f64>;

/// Entries of the table of pulses for a sample: a straight line between them is right to 3e-4.
pub const PULSE_STEPS: usize = 32;
/// Coordinates of the wave front that are fitted beside its phase: x, y, z and the square of the distance from the origin.
pub const TERMS: usize = 4;
/// Times that a fit is improved: then it moves by less than a hundredth of a cell.
pub const IMPROVEMENTS: usize = 3;
/// Added to the diagonal of the fit, whose entries are at most one: a flat array says nothing of its own axis.
pub const RIDGE: f32 = 1e-4;
/// Amplitude at which the pulse is cut off.
const PULSE_END: f64 = 1e-3;
/// Longest pulse to either side of its peak.
const PULSE_SAMPLES_MAX: usize = 256;
/// Shortest window, in lengths of the pulse.
const WINDOW_PULSES: f64 = 4.0;

/// What CLEAN needs beside focus and plan.
#[derive(Debug, Clone)]
pub struct CleanPlan {
    /// How often echoes are taken out.
    pub rounds: usize,
    /// Ranges of a window; the last may be shorter.
    pub window_len: usize,
    /// How many there are.
    pub window_count: usize,
    /// First range, and distance of the next.
    pub range_first_m: f32,
    /// See `range_first_m`.
    pub range_step_m: f32,
    /// Samples of the pulse to either side of its peak.
    pub pulse_reach: usize,
    /// Radius of the arrays: the unit of the fitted coordinates.
    pub radius_m: f32,
    /// `[direction]`: unit vector.
    pub units: Vec<[f32; 3]>,
    /// What differs between sensors.
    pub sensors: Vec<SensorClean>,
}

/// What differs between sensors.
#[derive(Debug, Clone)]
pub struct SensorClean {
    /// `[channel]`: place.
    pub places_m: Vec<[f32; 3]>,
    /// Mean of the fitted coordinates, in radii of the array: about it a tilt makes nothing later.
    pub centre: [f32; TERMS],
    /// `[PULSE_STEPS * (sample + pulse_reach)]`: an echo of amplitude 1 in a channel signal, and what a slope over frequency adds
    /// to it, which is zero at the peak; real and imaginary part of both. The first entry stands `pulse_reach` samples before the peak.
    pub pulse: Arc<Vec<[f32; 4]>>,
    /// Half the squared phase of the main lobe for a change of direction: xx, yy, zz, xy, xz, yz.
    pub lobe: [f32; 6],
    /// Turn of the second part for each sample that an echo is late, radians.
    pub slope_per_sample: f32,
}

impl CleanPlan {
    /// First range of a window and the one behind its last.
    #[must_use]
    pub fn window(&self, index: usize, range_count: usize) -> std::ops::Range<usize> {
        index * self.window_len..range_count.min((index + 1) * self.window_len)
    }
}

/// What `params` ask for.
///
/// # Errors
/// If the rounds lie outside 1 to 16, or the image is no plain sum of what the microphones heard.
pub fn rounds(params: &ImagingParams, is_sum: bool) -> Result<usize, ParameterError> {
    let Some(rounds) = params.clean_rounds else { return Ok(0) };
    let refuse = |allowed: String| Err(ParameterError::new("imaging.clean_rounds", rounds, allowed));
    if !(1..=CLEAN_ROUNDS_MAX).contains(&rounds) {
        return refuse(format!("1 to {CLEAN_ROUNDS_MAX} rounds"));
    }
    if !is_sum || params.weighting == Weighting::Phat || params.smoothing_hz.is_some() || params.focus_to_m.is_some() {
        return refuse(
            "none together with beamformer, coherence, weighting, smoothing_hz or focus_to_m: only in a plain sum, focused at every \
             range, does an echo leave with its pattern"
                .to_owned(),
        );
    }
    Ok(rounds)
}

/// The tables of a plan that is otherwise made.
pub(super) fn clean(
    plan: &ImagingPlan,
    focus: &FocusPlan,
    sensors: &[SensorSetup],
    bands: &[Band],
    rounds: usize,
    speed_of_sound_m_s: f64,
) -> CleanPlan {
    let radius_m = sensors.iter().flat_map(|sensor| &sensor.array.positions_m).map(Vector3::norm).fold(1e-3, f64::max);
    let narrowest_hz = bands.iter().map(Band::width_hz).fold(f64::INFINITY, f64::min);
    let pulse_m = WINDOW_PULSES * speed_of_sound_m_s / (2.0 * narrowest_hz);
    let window_len = (radius_m.max(pulse_m) / plan.grid.range_step_m()).ceil().max(2.0) as usize;
    let pulses = per_emission(sensors, |index| Pulse::new(plan, focus, &sensors[index].emission, &bands[index]));
    let pulse_reach = pulses.iter().map(|pulse| pulse.reach()).max().unwrap_or(1);
    let tables = per_emission(sensors, |index| pulses[index].table(pulse_reach));
    let float = |vector: Vector3<f64>| [vector.x as f32, vector.y as f32, vector.z as f32];
    let one = |(index, sensor): (usize, &SensorSetup)| SensorClean {
        places_m: sensor.array.positions_m.iter().map(|place| float(*place)).collect(),
        centre: centre(sensor, radius_m),
        pulse: Arc::clone(&tables[index]),
        lobe: lobe(sensor, focus.turns_per_m),
        slope_per_sample: pulses[index].slope_per_sample() as f32,
    };
    CleanPlan {
        rounds,
        window_len,
        window_count: plan.grid.range_count().div_ceil(window_len),
        range_first_m: plan.grid.range_first_m() as f32,
        range_step_m: plan.grid.range_step_m() as f32,
        pulse_reach,
        radius_m: radius_m as f32,
        units: plan.grid.directions().iter().map(|direction| float(direction.unit())).collect(),
        sensors: sensors.iter().enumerate().map(one).collect(),
    }
}

/// Places of the microphones with their shares of the weights.
fn shares(sensor: &SensorSetup) -> Vec<(Vector3<f64>, f64)> {
    let array = &sensor.array;
    let used = array.positions_m.iter().zip(&array.weights).zip(&array.enabled).filter(|(_, enabled)| **enabled);
    let used: Vec<(Vector3<f64>, f64)> = used.map(|((place, weight), _)| (*place, f64::from(*weight))).collect();
    let whole: f64 = used.iter().map(|(_, weight)| weight).sum();
    used.into_iter().map(|(place, weight)| (place, if whole > 0.0 { weight / whole } else { 0.0 })).collect()
}

fn centre(sensor: &SensorSetup, radius_m: f64) -> [f32; TERMS] {
    let mut centre = [0.0; TERMS];
    for (place, share) in shares(sensor) {
        let place = place / radius_m;
        for (centre, term) in centre.iter_mut().zip([place.x, place.y, place.z, place.norm_squared()]) {
            *centre += (term * share) as f32;
        }
    }
    centre
}

/// Half the squared phases' scatter over the array: the main lobe is near exp(-d.L.d) for a change d of the direction.
fn lobe(sensor: &SensorSetup, turns_per_m: f64) -> [f32; 6] {
    let shares = shares(sensor);
    let mean: Vector3<f64> = shares.iter().map(|(place, share)| place * *share).sum();
    let scatter: Matrix3<f64> =
        shares.iter().map(|(place, share)| (place - mean) * (place - mean).transpose() * *share).sum();
    let half = scatter * (0.5 * (TAU * turns_per_m).powi(2));
    [half[(0, 0)], half[(1, 1)], half[(2, 2)], half[(0, 1)], half[(0, 2)], half[(1, 2)]].map(|value| value as f32)
}

/// An echo in a channel signal: the emission's own power within the passband, bin by bin about the centre frequency.
struct Pulse {
    /// Bins from the centre bin, and their shares of the peak.
    shares: Vec<(f64, f64)>,
    /// Mean of the bins, and their scatter about it.
    mean: f64,
    scatter: f64,
    len: f64,
}

impl Pulse {
    fn new(plan: &ImagingPlan, focus: &FocusPlan, emission: &Emission, band: &Band) -> Self {
        let power = |bin: usize| {
            let (re, im) = spectrum_at(plan, emission, bin);
            band.gain(bin as f64 * plan.bin_step_hz) * (re * re + im * im)
        };
        let bins = plan.first_bin..plan.first_bin + plan.bin_count;
        let powers: Vec<(f64, f64)> = bins.map(|bin| (bin as f64 - focus.centre_bin as f64, power(bin))).collect();
        let whole: f64 = powers.iter().map(|(_, power)| power).sum();
        let shares: Vec<(f64, f64)> = powers.into_iter().map(|(bin, power)| (bin, power / whole)).collect();
        let mean: f64 = shares.iter().map(|(bin, share)| bin * share).sum();
        let scatter = shares.iter().map(|(bin, share)| (bin - mean).powi(2) * share).sum::<f64>().sqrt();
        Self { shares, mean, scatter: scatter.max(1e-9), len: focus.signal_len as f64 }
    }

    fn slope_per_sample(&self) -> f64 {
        TAU * self.scatter / self.len
    }

    /// Pulse and its slope over frequency, so many samples after the peak.
    fn at(&self, samples: f64) -> [f64; 4] {
        let (mut pulse, mut slope) = (Complex64::default(), Complex64::default());
        for (bin, share) in &self.shares {
            let value = Complex64::from_polar(*share, TAU * bin * samples / self.len);
            pulse += value;
            slope += value * ((bin - self.mean) / self.scatter);
        }
        [pulse.re, pulse.im, slope.re, slope.im]
    }

    /// Samples from the peak beyond which nothing is louder than [`PULSE_END`].
    fn reach(&self) -> usize {
        let loud = |samples: &usize| {
            let [re, im, ..] = self.at(*samples as f64);
            re.hypot(im) > PULSE_END
        };
        let longest = PULSE_SAMPLES_MAX.min((self.len / 4.0) as usize);
        (1..longest).rev().find(loud).unwrap_or(1) + 1
    }

    fn table(&self, reach: usize) -> Vec<[f32; 4]> {
        let place = |entry: usize| entry as f64 / PULSE_STEPS as f64 - reach as f64;
        (0..=2 * reach * PULSE_STEPS).map(|entry| self.at(place(entry)).map(|value| value as f32)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_echo_is_the_pulse_and_its_slope() {
        // A band of 40 bins with a lopsided spectrum.
        let powers: Vec<(f64, f64)> = (-20..20).map(|bin| (f64::from(bin), 1.0 + 0.02 * f64::from(bin))).collect();
        let whole: f64 = powers.iter().map(|(_, power)| power).sum();
        let shares: Vec<(f64, f64)> = powers.into_iter().map(|(bin, power)| (bin, power / whole)).collect();
        let mean: f64 = shares.iter().map(|(bin, share)| bin * share).sum();
        let scatter = shares.iter().map(|(bin, share)| (bin - mean).powi(2) * share).sum::<f64>().sqrt();
        let pulse = Pulse { shares, mean, scatter, len: 128.0 };
        let complex = |at: f64| {
            let [re, im, slope_re, slope_im] = pulse.at(at);
            (Complex64::new(re, im), Complex64::new(slope_re, slope_im))
        };
        assert!((complex(0.0).0 - 1.0).norm() < 1e-12 && complex(0.0).1.norm() < 1e-12);
        // pulse(x - d) = pulse(x) - d pulse'(x), pulse' = j (mean pulse + scatter slope) 2 pi / len.
        let late = 1e-4;
        for at in [-3.0, 0.4, 5.2] {
            let (here, slope) = complex(at);
            let carried = Complex64::new(0.0, -TAU * mean / 128.0 * late);
            let sloped = Complex64::new(0.0, -pulse.slope_per_sample() * late);
            let expected = here * (1.0 + carried) + slope * sloped;
            assert!((complex(at - late).0 - expected).norm() < 1e-8, "{at}");
        }
    }
}
