//! One channel's direct path: where it should be heard, and what it told when it was heard last.
//!
//! In: the thinned start of the channel. Out: phase, strength and lateness of the emission in it. Knows nothing of other channels
//! and judges nothing.

use super::template::{Correlation, Template, peak_in_flanks};
use nalgebra::{Complex, Vector3};

/// Samples of the quiet stretch that are needed, and those left out at its ends: the filter's way in and the taper's beginning.
const QUIET_MIN: usize = 16;
pub(super) const QUIET_MARGIN: usize = 6;

/// What a channel told when it was heard last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Told {
    Nothing,
    /// Heard where it should be; the unit phasor of what is left.
    InPlace {
        phasor: Complex<f32>,
        strength: f32,
    },
    /// Heard elsewhere, by so many samples.
    Elsewhere {
        late: f64,
    },
    Deaf,
}

/// One microphone's channel.
#[derive(Debug, Clone)]
pub(super) struct Channel {
    pub(super) index: usize,
    pub(super) place_m: Vector3<f64>,
    pub(super) distance_m: f64,
    /// By the geometry, in samples.
    pub(super) delay: f64,
    /// Length of the quiet stretch; zero where there is none.
    pub(super) quiet_len: usize,
    pub(super) told: Told,
    /// What it would tell if it is in place.
    pub(super) candidate: Told,
    /// Where it should be.
    pub(super) coefficient: f32,
    /// Where it is.
    pub(super) clarity: f32,
    /// Of the emission beside its place, in samples.
    pub(super) late: Option<f64>,
    pub(super) noise: f32,
    /// Sum of its deviations, and how many.
    pub(super) deviations_m: f64,
}

impl Channel {
    /// Channel `index` of the raw data, heard `delay` samples after the emission; nothing told yet.
    pub(super) fn new(index: usize, place_m: Vector3<f64>, distance_m: f64, delay: f64) -> Self {
        let quiet_len = (delay as usize).saturating_sub(2 * QUIET_MARGIN);
        Self {
            index,
            place_m,
            distance_m,
            delay,
            quiet_len: if quiet_len >= QUIET_MIN { quiet_len } else { 0 },
            told: Told::Nothing,
            candidate: Told::Nothing,
            coefficient: 0.0,
            clarity: 0.0,
            late: None,
            noise: 0.0,
            deviations_m: 0.0,
        }
    }

    /// Hears it where it should be, `shift` samples later, and notes what it would tell; compares the envelope with its flanks if
    /// asked to.
    pub(super) fn hear(&mut self, template: &Template, start: &[f32], shift: i64, flanked: bool) -> Correlation {
        let expected = self.delay + shift as f64;
        let lag = expected.round() as i64;
        let found = template.correlate(start, lag);
        if !(found.coefficient > 0.0) {
            return found;
        }
        let turn = ((expected - lag as f64) * template.mean_rad) as f32;
        let phasor = Complex::from_polar(1.0, found.product.arg() + turn);
        self.candidate = Told::InPlace { phasor, strength: found.amplitude * self.distance_m as f32 };
        if flanked {
            let side = |sign: i64| f64::from(template.correlate(start, lag + sign * template.flank).product.norm());
            let sizes = [side(-1), f64::from(found.product.norm()), side(1)];
            let late = peak_in_flanks(sizes) * template.flank as f64;
            self.late = Some(late + lag as f64 - expected);
        }
        found
    }
}

/// Finite and not silent.
pub(super) fn is_alive(start: &[f32]) -> bool {
    let power: f32 = start.iter().map(|sample| sample * sample).sum();
    power > 0.0 && power.is_finite()
}

/// All samples equal, but for what a filter begins with.
pub(super) fn is_flat(start: &[f32]) -> bool {
    start.get(2..).is_none_or(|rest| rest.iter().all(|sample| *sample == rest[0]))
}
