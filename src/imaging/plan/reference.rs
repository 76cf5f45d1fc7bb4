//! What each sensor's spectra are multiplied with: its band, its emission, the band-pass divided out again.
//!
//! In: the sensors' emissions and a plan whose sizes and band-pass are made. Out: the [`Band`]s, the one band around them that the
//! band-pass and the bins cover, and the reference of every sensor (step 3 of [`super`]). Never touches a sample of a ping.

use super::{EDGE_SHARE, ImagingPlan};
use crate::parameter::ParameterError;
use crate::sensor::{Emission, SensorSetup, per_emission};
use std::f64::consts::PI;

/// The numbers that the parts of the plan are made from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Band {
    pub low_hz: f64,
    pub high_hz: f64,
    pub edge_hz: f64,
}

impl Band {
    /// P(f): 1 inside, raised-cosine edges outside, 0 beyond.
    pub(super) fn gain(&self, frequency_hz: f64) -> f64 {
        let outside_hz = (self.low_hz - frequency_hz).max(frequency_hz - self.high_hz).max(0.0);
        if outside_hz < self.edge_hz { 0.5 * (1.0 + (PI * outside_hz / self.edge_hz).cos()) } else { 0.0 }
    }

    pub(super) fn width_hz(&self) -> f64 {
        self.high_hz - self.low_hz + 2.0 * self.edge_hz
    }

    pub(super) fn centre_hz(&self) -> f64 {
        0.5 * (self.low_hz + self.high_hz)
    }

    /// The checked bands of all sensors.
    pub(super) fn of(sensors: &[SensorSetup], rate_hz: f64) -> Result<Vec<Self>, ParameterError> {
        sensors.iter().map(|sensor| Self::checked(&sensor.emission, rate_hz)).collect()
    }

    /// The band that holds all of `bands`, edges included.
    pub(super) fn around(bands: &[Self]) -> Self {
        let first = bands[0];
        if bands.iter().all(|band| *band == first) {
            return first;
        }
        let least = |of: fn(&Self) -> f64| bands.iter().map(of).fold(f64::INFINITY, f64::min);
        let (low_hz, high_hz) = (least(|band| band.low_hz), -least(|band| -band.high_hz));
        let (first_hz, last_hz) =
            (least(|band| band.low_hz - band.edge_hz), -least(|band| -band.high_hz - band.edge_hz));
        Self { low_hz, high_hz, edge_hz: (low_hz - first_hz).max(last_hz - high_hz) }
    }

    /// Width of the narrowest and of the widest sweep, without edges.
    pub(super) fn widths_hz(bands: &[Self]) -> (f64, f64) {
        let widths = bands.iter().map(|band| band.high_hz - band.low_hz);
        widths.fold((f64::INFINITY, 0.0), |(least, most), width| (least.min(width), most.max(width)))
    }

    fn checked(emission: &Emission, rate_hz: f64) -> Result<Self, ParameterError> {
        let (low_hz, high_hz) = emission.band_hz;
        let edge_hz = EDGE_SHARE * (high_hz - low_hz);
        if !((emission.sample_rate_hz / rate_hz - 1.0).abs() < 1e-9) {
            let allowed = format!("{rate_hz} Hz, the demodulated sample rate");
            return Err(ParameterError::new("emission.file", format!("{} Hz", emission.sample_rate_hz), allowed));
        }
        if !(low_hz > 0.0 && edge_hz > 0.0 && high_hz + edge_hz < 0.5 * rate_hz) {
            let allowed = format!(
                "a band above 0 Hz that ends, with its edge of a tenth, below half the sample rate of {rate_hz} Hz"
            );
            return Err(ParameterError::new(
                "emission.start_hz",
                format!("a band of {low_hz} to {high_hz} Hz"),
                allowed,
            ));
        }
        if !(emission.samples.iter().map(|s| s * s).sum::<f64>() > 0.0) {
            return Err(ParameterError::new("emission", "silence", "finite samples, not all zero"));
        }
        Ok(Self { low_hz, high_hz, edge_hz })
    }
}

/// Response of the band-pass at bin k of N, from the rounded taps themselves.
fn band_response(taps: &[[f32; 2]], turns_per_sample: f64) -> (f64, f64) {
    let half = (taps.len() / 2) as f64;
    taps.iter().enumerate().fold((0.0, 0.0), |(re, im), (index, tap)| {
        let (sin, cos) = (2.0 * PI * turns_per_sample * (index as f64 - half)).sin_cos();
        let (tap_re, tap_im) = (f64::from(tap[0]), f64::from(tap[1]));
        (re + tap_re * cos - tap_im * sin, im + tap_re * sin + tap_im * cos)
    })
}

/// Gives every sensor of a plan that is otherwise made its reference.
pub(super) fn fill(plan: &mut ImagingPlan, bands: &[Band], sensors: &[SensorSetup], first_s: f64) {
    let references = per_emission(sensors, |index| reference(plan, &bands[index], &sensors[index].emission, first_s));
    for (sensor, reference) in plan.sensors.iter_mut().zip(references) {
        sensor.reference = reference;
    }
}

/// Spectrum of an emission at bin k of N.
pub(super) fn spectrum_at(plan: &ImagingPlan, emission: &Emission, bin: usize) -> (f64, f64) {
    let span = plan.forward_len * plan.band_decimation;
    emission.samples.iter().enumerate().fold((0.0, 0.0), |(re, im), (n, sample)| {
        // Whole turns are taken out in integers: the phase of late samples stays exact.
        let (sin, cos) = (2.0 * PI * ((n * bin) % span) as f64 / span as f64).sin_cos();
        (re + sample * cos, im - sample * sin)
    })
}

/// One sensor's reference: see the header of [`super`].
fn reference(plan: &ImagingPlan, band: &Band, emission: &Emission, first_s: f64) -> Vec<[f32; 2]> {
    let span = plan.forward_len * plan.band_decimation;
    let energy: f64 = emission.samples.iter().map(|s| s * s).sum();
    let bins = plan.first_bin..plan.first_bin + plan.bin_count;
    let passed: f64 = bins.clone().map(|bin| band.gain(bin as f64 * plan.bin_step_hz)).sum();
    let complex = |bin: usize| {
        let frequency_hz = bin as f64 * plan.bin_step_hz;
        let turns = bin as f64 / span as f64;
        let (s_re, s_im) = spectrum_at(plan, emission, bin);
        let (g_re, g_im) = band_response(&plan.band_taps, turns);
        // conj(S) / G = conj(S) conj(G) / |G|^2, and the phase of the first range.
        let (q_re, q_im) = (s_re * g_re - s_im * g_im, -(s_re * g_im + s_im * g_re));
        let (sin, cos) = (2.0 * PI * (frequency_hz * first_s).fract()).sin_cos();
        let magnitude = if plan.phat {
            band.gain(frequency_hz) / (passed * (q_re * q_re + q_im * q_im).sqrt())
        } else {
            2.0 * band.gain(frequency_hz) / ((g_re * g_re + g_im * g_im) * energy * plan.forward_len as f64)
        };
        let magnitude = if magnitude.is_finite() { magnitude } else { 0.0 };
        [(magnitude * (q_re * cos - q_im * sin)) as f32, (magnitude * (q_re * sin + q_im * cos)) as f32]
    };
    bins.map(complex).collect()
}
