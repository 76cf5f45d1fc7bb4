//! The emissions of all sensors: what each sends, and when in a ping set.
//!
//! Goes in: `[emission]`, each sensor's `emission`, the longest range and the ping period. Comes out: one [`Emission`] a sensor, the slot
//! of a turn, and the first key that does not fit. What a plan costs is said in the README. Never asks a clock.

use super::Config;
use crate::parameter::ParameterError;
use crate::sensor::{Emission, EmissionParams, EmissionPlan, RecordingFormat};
use std::sync::Arc;

/// Time for the work and the way of a command, beside the ping set's own length and a period.
const WORK_S: f64 = 0.02;

impl Config {
    /// What sensor `index` sends.
    #[must_use]
    pub fn emission_of(&self, index: usize) -> EmissionParams {
        let own = self.sensor.get(index).and_then(|sensor| sensor.emission.as_ref());
        self.emission.of_sensor(index, self.sensor.len(), own)
    }

    /// The emission of every sensor at the demodulated sample rate; equal ones are one.
    ///
    /// # Errors
    /// What is wrong with `[emission]`, a sensor's `emission`, its file or `[recording]`.
    pub fn emissions(&self) -> Result<Vec<Arc<Emission>>, ParameterError> {
        let rate_hz = self.recording()?.demodulated_rate_hz();
        let mut made: Vec<Arc<Emission>> = Vec::new();
        for index in 0..self.sensor.len() {
            let params = self.emission_of(index);
            let twin = (0..index).find(|earlier| self.emission_of(*earlier) == params);
            made.push(match twin {
                Some(twin) => Arc::clone(&made[twin]),
                None => {
                    let emission = Emission::new(&params, rate_hz, &self.base_dir);
                    Arc::new(emission.map_err(|error| self.at_emission(index, error))?)
                }
            });
        }
        Ok(made)
    }

    /// Where a person wrote what is wrong with the emission of sensor `index`.
    pub(super) fn at_emission(&self, index: usize, error: ParameterError) -> ParameterError {
        let own = self.sensor.get(index).and_then(|sensor| sensor.emission.as_ref());
        let spoken = own.is_some_and(|own| match error.key.as_str() {
            "shape" => own.shape.is_some(),
            "start_hz" => own.start_hz.is_some(),
            "end_hz" => own.end_hz.is_some(),
            "duration_s" => own.duration_s.is_some(),
            "taper" => own.taper.is_some(),
            "file" => own.file.is_some() || own.shape.is_some(),
            _ => false,
        });
        // A sweep that stands still may be told by either of its ends.
        let either = own.is_some_and(|own| error.key == "end_hz" && own.start_hz.is_some());
        if spoken {
            error.within(&format!("sensor[{index}].emission"))
        } else if either {
            ParameterError { key: format!("sensor[{index}].emission.start_hz"), ..error }
        } else {
            error.within("emission")
        }
    }

    /// From one sensor's emission to the next one's; zero when all fire together.
    #[must_use]
    pub fn slot_s(&self) -> f64 {
        match self.emission.plan {
            EmissionPlan::Together => 0.0,
            EmissionPlan::InTurn => self.emission.slot_s.unwrap_or_else(|| self.slot_min_s()),
        }
    }

    /// The same, in nanoseconds.
    #[must_use]
    pub fn slot_ns(&self) -> u64 {
        (1e9 * self.slot_s()).round() as u64
    }

    /// Shortest slot: until the last sample of an echo of the longest range, in whole tenths of a millisecond.
    fn slot_min_s(&self) -> f64 {
        let sent_s = (0..self.sensor.len()).map(|index| self.emission_of(index).duration_s).fold(0.0, f64::max);
        let heard_s = 2.0 * self.imaging.range_max_m / self.speed_of_sound_m_s() + sent_s;
        (heard_s * 1e4 - 1e-6).ceil() * 1e-4
    }

    /// From the first sensor's emission to the last sensor's last sample.
    #[must_use]
    pub fn set_duration_s(&self, recording: &RecordingFormat) -> f64 {
        recording.duration_s() + self.slot_s() * self.sensor.len().saturating_sub(1) as f64
    }
}

/// Turns that are long enough for the longest range, fit the ping period, and leave commands young enough to be obeyed.
pub(super) fn check(config: &Config, recording: &RecordingFormat) -> Result<(), ParameterError> {
    if config.emission.plan == EmissionPlan::Together {
        return Ok(());
    }
    let (slot_s, count, period_s) = (config.slot_s(), config.sensor.len(), 1.0 / config.control.rate_hz);
    let least_s = config.slot_min_s();
    // A written slot is refused where it stands; what follows from other keys, at the plan.
    let key = if config.emission.slot_s.is_some() { "emission.slot_s" } else { "emission.plan" };
    let found = || match config.emission.slot_s {
        Some(slot_s) => slot_s.to_string(),
        None => format!("\"in-turn\" with slots of {:.1} ms", 1e3 * slot_s),
    };
    if !(slot_s >= least_s - 1e-9) {
        let allowed = format!(
            "at least {least_s:.4}: until an echo of imaging.range_max_m = {} has been heard to its end",
            config.imaging.range_max_m
        );
        return Err(ParameterError::new(key, found(), allowed));
    }
    if !(slot_s * count as f64 <= period_s + 1e-9) {
        let allowed = format!(
            "at most {:.4}: {count} turns in a ping period of {:.1} ms (control.rate_hz = {}); lower imaging.range_max_m or \
             control.rate_hz",
            period_s / count as f64,
            1e3 * period_s,
            config.control.rate_hz
        );
        return Err(ParameterError::new(key, found(), allowed));
    }
    // A command is judged by the first emission of its set, and stands until the next one comes.
    let oldest_s = config.set_duration_s(recording) + config.safety.group_deadline_ms / 1e3 + period_s + WORK_S;
    if !(oldest_s <= config.safety.max_age_ms / 1e3) {
        let allowed = format!(
            "turns whose commands are no older than safety.max_age_ms = {} when the next is due, not {:.0} ms",
            config.safety.max_age_ms,
            1e3 * oldest_s
        );
        return Err(ParameterError::new(key, found(), allowed));
    }
    Ok(())
}

/// What turns cost beyond what the configuration reckons with.
pub(super) fn warnings(config: &Config, recording: &RecordingFormat) -> Vec<String> {
    if config.emission.plan == EmissionPlan::Together {
        return Vec::new();
    }
    let mut warnings = Vec::new();
    let (period_s, set_s) = (1.0 / config.control.rate_hz, config.set_duration_s(recording));
    // In the worst case an obstacle comes into view just after its sensor fired.
    let reaction_s = period_s + set_s + WORK_S;
    if !(reaction_s <= config.control.coverage.reaction_s) {
        warnings.push(format!(
            "control.coverage.reaction_s = {} and sensors that fire in turn take up to {reaction_s:.2} s from an obstacle's coming \
             into view to braking",
            config.control.coverage.reaction_s
        ));
    }
    if !(set_s <= period_s) {
        warnings.push(format!(
            "the last sensor's ping ends {:.1} ms after the first one's emission and control.rate_hz = {} asks for a set every \
             {:.1} ms: the simulated robot falls behind",
            1e3 * set_s,
            config.control.rate_hz,
            1e3 * period_s
        ));
    }
    warnings
}
