//! `[safety]` of the configuration: the timeouts of the safe-state contract.
//!
//! Read by the daemon and by the controller process, each from its own configuration. No timeout can be switched off:
//! zero, negative, NaN and anything above one second are refused.

use crate::parameter::{ParameterError, check_range};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Shortest timeout that a person can mean; anything below is a misprint or an attempt to switch it off.
const TIMEOUT_MIN_MS: f64 = 1.0;
/// Longest timeout that the safe-state contract allows.
const TIMEOUT_MAX_MS: f64 = 1000.0;
/// Shortest time in HOLD before the controller latches: shorter would latch on any recoverable stop.
const HOLD_LATCH_MIN_S: f64 = 1.0;
/// Longest time in HOLD before the controller latches.
const HOLD_LATCH_MAX_S: f64 = 60.0;

/// `[safety]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SafetyParams {
    /// Oldest capture that may still move the robot (MAX_AGE).
    pub max_age_ms: f64,
    /// How long the controller may stay in HOLD before it latches.
    pub hold_latch_s: f64,
    /// How long a GPU may take for one ping set before the CPU redoes it.
    pub gpu_deadline_ms: f64,
    /// How long after the first sensor of an emission the daemon waits for the others.
    pub group_deadline_ms: f64,
    /// Oldest wanted velocity that is still obeyed; older counts as (0, 0).
    pub input_max_age_ms: f64,
}

impl Default for SafetyParams {
    fn default() -> Self {
        Self {
            max_age_ms: 300.0,
            hold_latch_s: 10.0,
            gpu_deadline_ms: 60.0,
            group_deadline_ms: 30.0,
            input_max_age_ms: 500.0,
        }
    }
}

impl SafetyParams {
    /// Checks every timeout against what the safe-state contract allows.
    ///
    /// # Errors
    /// [`ParameterError`] naming the first key out of range; NaN is out of range.
    pub fn validate(&self) -> Result<(), ParameterError> {
        for (key, value_ms) in [
            ("max_age_ms", self.max_age_ms),
            ("gpu_deadline_ms", self.gpu_deadline_ms),
            ("group_deadline_ms", self.group_deadline_ms),
            ("input_max_age_ms", self.input_max_age_ms),
        ] {
            check_range(key, value_ms, TIMEOUT_MIN_MS, TIMEOUT_MAX_MS)?;
        }
        check_range("hold_latch_s", self.hold_latch_s, HOLD_LATCH_MIN_S, HOLD_LATCH_MAX_S)
    }

    /// MAX_AGE in nanoseconds.
    #[must_use]
    pub fn max_age_ns(&self) -> u64 {
        nanoseconds_from_ms(self.max_age_ms)
    }

    /// Time in HOLD before latching, in nanoseconds.
    #[must_use]
    pub fn hold_latch_ns(&self) -> u64 {
        nanoseconds_from_ms(self.hold_latch_s * 1e3)
    }

    /// Age limit of the wanted velocity, in nanoseconds.
    #[must_use]
    pub fn input_max_age_ns(&self) -> u64 {
        nanoseconds_from_ms(self.input_max_age_ms)
    }

    /// Deadline of the GPU for one ping set.
    #[must_use]
    pub fn gpu_deadline(&self) -> Duration {
        Duration::from_nanos(nanoseconds_from_ms(self.gpu_deadline_ms))
    }

    /// Deadline of a partial ping set after its first ping.
    #[must_use]
    pub fn group_deadline(&self) -> Duration {
        Duration::from_nanos(nanoseconds_from_ms(self.group_deadline_ms))
    }
}

/// Whole nanoseconds; zero for NaN and negative values, so that an unchecked value means "nothing is young enough".
fn nanoseconds_from_ms(value_ms: f64) -> u64 {
    (value_ms * 1e6).round() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_those_of_the_specification_and_valid() {
        let params = SafetyParams::default();
        assert_eq!(params.validate(), Ok(()));
        assert_eq!(params.max_age_ns(), 300_000_000);
        assert_eq!(params.hold_latch_ns(), 10_000_000_000);
        assert_eq!(params.input_max_age_ns(), 500_000_000);
        assert_eq!(params.gpu_deadline(), Duration::from_millis(60));
        assert_eq!(params.group_deadline(), Duration::from_millis(30));
    }

    #[test]
    fn no_timeout_can_be_switched_off() {
        type Setter = fn(&mut SafetyParams, f64);
        let setters: [(&str, Setter); 5] = [
            ("max_age_ms", |params, value| params.max_age_ms = value),
            ("gpu_deadline_ms", |params, value| params.gpu_deadline_ms = value),
            ("group_deadline_ms", |params, value| params.group_deadline_ms = value),
            ("input_max_age_ms", |params, value| params.input_max_age_ms = value),
            ("hold_latch_s", |params, value| params.hold_latch_s = value),
        ];
        for (key, set) in setters {
            for value in [0.0, -1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1000.1, 1e300] {
                let mut params = SafetyParams::default();
                set(&mut params, value);
                let error = params.validate().expect_err("refused");
                assert_eq!(error.key, key, "{value}");
            }
        }
    }

    #[test]
    fn an_unchecked_nan_makes_every_age_too_old() {
        let params = SafetyParams { max_age_ms: f64::NAN, ..SafetyParams::default() };
        assert_eq!(params.max_age_ns(), 0);
    }

    #[test]
    fn unknown_keys_are_refused_and_whole_numbers_accepted() {
        let params: SafetyParams = toml::from_str("max_age_ms = 250").expect("whole number");
        assert_eq!(params.max_age_ms, 250.0);
        assert!(toml::from_str::<SafetyParams>("max_age = 250").is_err());
    }
}
