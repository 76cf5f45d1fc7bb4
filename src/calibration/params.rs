//! `[calibration]` of the configuration.
//!
//! Goes in: the keys that a person wrote. Comes out: the file to use, what of it is applied, and from which change on an alarm is due.
//! Reading the file is the configuration's; nothing is applied that is not listed.

use super::file::{Calibration, SPEED_M_S};
use crate::parameter::{ParameterError, check_positive};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// What of a calibration is applied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Applied {
    /// The speed of sound, instead of the configured one.
    SpeedOfSound,
    /// The emitter's place.
    Emitter,
    /// The microphones' ways, as places along the line from the emitter.
    Microphones,
    /// The microphones' gains, as weights.
    Gains,
}

/// `[calibration]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CalibrationParams {
    /// What `noctule calibrate` wrote.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// What of it is applied.
    pub apply: Vec<Applied>,
    /// Whether the daemon watches for drift.
    pub watch: bool,
    /// Relative error of the speed of sound that is an alarm.
    pub speed_tolerance: f64,
    /// Change of a microphone's way.
    pub path_tolerance_m: f64,
    /// Change of a microphone's gain against the others.
    pub gain_tolerance_db: f64,
    /// Loss of the emitter's level.
    pub level_tolerance_db: f64,
    /// What was read from the file.
    #[serde(skip)]
    pub measured: Option<Arc<Calibration>>,
}

impl Default for CalibrationParams {
    fn default() -> Self {
        Self {
            file: None,
            apply: Vec::new(),
            watch: true,
            speed_tolerance: 0.01,
            path_tolerance_m: 1e-3,
            gain_tolerance_db: 3.0,
            level_tolerance_db: 3.0,
            measured: None,
        }
    }
}

impl CalibrationParams {
    /// Judges the values that need no file.
    ///
    /// # Errors
    /// The first key that is not allowed, relative to `[calibration]`.
    pub fn validate(&self) -> Result<(), ParameterError> {
        check_positive("speed_tolerance", self.speed_tolerance, 0.2)?;
        check_positive("path_tolerance_m", self.path_tolerance_m, 0.1)?;
        check_positive("gain_tolerance_db", self.gain_tolerance_db, 60.0)?;
        check_positive("level_tolerance_db", self.level_tolerance_db, 60.0)?;
        if self.file.is_none() && !self.apply.is_empty() {
            let allowed = "nothing without `file`: what noctule calibrate wrote";
            return Err(ParameterError::new("apply", format!("{} entries", self.apply.len()), allowed));
        }
        for (index, applied) in self.apply.iter().enumerate() {
            if self.apply[..index].contains(applied) {
                return Err(ParameterError::new(format!("apply[{index}]"), "an entry again", "each entry once"));
            }
        }
        Ok(())
    }

    /// The speed of sound that is to be used instead of the configured one.
    #[must_use]
    pub fn speed_of_sound_m_s(&self) -> Option<f64> {
        let measured = self.measured.as_ref().filter(|_| self.apply.contains(&Applied::SpeedOfSound))?;
        measured.speed_of_sound_m_s().map(|speed_m_s| speed_m_s.clamp(SPEED_M_S.0, SPEED_M_S.1))
    }
}
