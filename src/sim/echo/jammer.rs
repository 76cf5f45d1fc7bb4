//! Narrow-band sources that are no sonar, as every microphone hears them.
//!
//! A jammer, the sensor and its clock in; a tone added to the microphones' samples, at each one's exact distance, spread
//! and absorbed. Its phase, and that of its bursts, is drawn anew for every ping and is the same for all microphones. Only
//! the direct way is made, no echo of it. Knows no emission.

use super::air::absorption_np_m;
use super::directivity::view;
use super::noise::Noise;
use super::path::{LENGTH_MIN_M, Station};
use super::sight::Sight;
use crate::sim::params::{Bursts, Jammer, SimParams};
use nalgebra::Vector2;
use std::f64::consts::{PI, TAU};

/// Share of a burst in which it comes, and again in which it goes.
const RAMP_SHARE: f64 = 0.1;

/// A jammer made ready.
#[derive(Debug, Clone)]
pub(super) struct Jamming {
    jammer: Jammer,
    absorption_np_m: f64,
    /// Sine and cosine of its phase at every sample.
    carrier: Vec<[f32; 2]>,
}

/// Where and when a sensor hears.
pub(super) struct Listening<'a> {
    pub(super) sight: &'a Sight<'a>,
    pub(super) sensor: usize,
    /// How late this sensor's sample 0 is.
    pub(super) clock_s: f64,
    pub(super) rate_hz: f64,
    pub(super) speed_of_sound_m_s: f64,
    /// Bearings of full and of no view.
    pub(super) view_rad: (f64, f64),
}

impl Jamming {
    pub(super) fn new(jammer: Jammer, params: &SimParams, rate_hz: f64, samples: usize) -> Self {
        let phase_rad = |sample: usize| TAU * jammer.frequency_hz * (sample as f64 / rate_hz);
        Self {
            jammer,
            absorption_np_m: params.air.map_or(0.0, |air| absorption_np_m(jammer.frequency_hz, &air)),
            carrier: (0..samples)
                .map(|sample| [phase_rad(sample).sin() as f32, phase_rad(sample).cos() as f32])
                .collect(),
        }
    }

    /// Adds what the microphones of a sensor hear of it to `pcm`, `[microphones][samples]`; `draw` belongs to the ping.
    pub(super) fn add_to(&self, pcm: &mut [f32], listening: &Listening, mut draw: Noise) {
        let start_rad = TAU * f64::from(draw.uniform());
        let start_share = f64::from(draw.uniform()) + 0.5;
        let station: &Station = &listening.sight.stations[listening.sensor];
        let [x_m, y_m, height_m] = self.jammer.position_m;
        let place_m = Vector2::new(x_m, y_m);
        let (full_rad, zero_rad) = listening.view_rad;
        let gain = view(station.bearing_rad(station.ear_m, place_m), full_rad, zero_rad);
        let hidden = || listening.sight.hidden(&[(place_m, station.ear_m)], 0, station.looks_through);
        if gain == 0.0 || hidden() {
            return;
        }
        let rows = pcm.chunks_mut(self.carrier.len());
        for ((microphone_m, microphone_height_m), row) in station.microphones_m.iter().zip(rows) {
            let distance_m = (microphone_m - place_m).norm().hypot(microphone_height_m - height_m).max(LENGTH_MIN_M);
            let loss = (-self.absorption_np_m * distance_m).exp();
            let amplitude = self.jammer.amplitude_at_1_m * gain * loss / distance_m;
            let offset_s = listening.clock_s - distance_m / listening.speed_of_sound_m_s;
            let (sin, cos) = (start_rad + TAU * self.jammer.frequency_hz * offset_s).sin_cos();
            let weights = [(amplitude * cos) as f32, (amplitude * sin) as f32];
            match self.jammer.bursts {
                None => {
                    for (value, carrier) in row.iter_mut().zip(&self.carrier) {
                        *value += weights[0] * carrier[0] + weights[1] * carrier[1];
                    }
                }
                Some(bursts) => {
                    for (sample, (value, carrier)) in row.iter_mut().zip(&self.carrier).enumerate() {
                        let time_s = sample as f64 / listening.rate_hz + offset_s + start_share * bursts.period_s;
                        let gate = gate(&bursts, time_s) as f32;
                        *value += gate * (weights[0] * carrier[0] + weights[1] * carrier[1]);
                    }
                }
            }
        }
    }
}

/// Envelope of bursts, the first of which begins at 0.
fn gate(bursts: &Bursts, time_s: f64) -> f64 {
    let since_s = time_s.rem_euclid(bursts.period_s);
    let from_end_s = since_s.min(bursts.duration_s - since_s);
    let ramp = (from_end_s / (RAMP_SHARE * bursts.duration_s)).clamp(0.0, 1.0);
    0.5 - 0.5 * (PI * ramp).cos()
}
