//! One TOML file to a validated [`Config`] (specification, section 7); unknown keys are refused.
//!
//! Goes in: a path, a text or nothing. Comes out: every parameter of the program, filled in with defaults and judged by the
//! one validator that serves every command, or a [`DocumentError`] that points at the line. Composes the parameter types of
//! the modules; no module imports this one. Exit code of its errors is 78.

mod layouts;
mod plan;
mod reference;
#[cfg(test)]
mod tests;
mod validate;
mod write;
mod zone;

pub use layouts::LAYOUT_NAMES;
pub use reference::reference;
pub use zone::StoppingDistance;

use crate::calibration::{Calibration, CalibrationParams};
use crate::control::{ControlParams, PlatformLimits};
use crate::detect::DetectParams;
use crate::document::{self, DocumentError};
use crate::geometry::shape::Shape;
use crate::imaging::params::ImagingParams;
use crate::imaging::steering;
use crate::io::IpcParams;
use crate::parameter::ParameterError;
use crate::safety::{GateParams, MotionLimits, SafetyParams};
use crate::sensor::{self, DeadZone, EmissionParams, RecordingFormat, RecordingParams, SensorParams, SensorSetup};
use crate::signal::Direction;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The version of the configuration that this program reads.
pub const CONFIG_VERSION: u32 = 1;
/// Speed of sound when neither it nor a temperature is configured: dry air at 20 degrees Celsius.
const SPEED_OF_SOUND_DEFAULT_M_S: f64 = 343.0;
/// Largest table of numbers read from a file.
const TABLE_SIZE_MAX_BYTES: u64 = 4 << 20;

/// The whole configuration. Fields are public so that a command line can override them; [`Config::validate`] judges the
/// result again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Version of the format.
    pub config_version: u32,
    /// Speed of sound, if it is given directly; see [`Config::speed_of_sound_m_s`].
    #[serde(default, rename = "speed_of_sound_m_s", skip_serializing_if = "Option::is_none")]
    pub speed_of_sound_given_m_s: Option<f64>,
    /// Temperature of the air, if the speed of sound follows from it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub air_temperature_c: Option<f64>,
    /// Raw data; see [`Config::recording`].
    pub recording: RecordingParams,
    /// Emitted sweep.
    pub emission: EmissionParams,
    /// Imaging.
    pub imaging: ImagingParams,
    /// Sensors, 1 to 3; see [`Config::sensor_setups`].
    pub sensor: Vec<SensorParams>,
    /// Shapes that hide what is behind them, robot frame.
    pub obstruction: Vec<Shape>,
    /// The robot.
    pub platform: PlatformLimits,
    /// The layered controller.
    pub control: ControlParams,
    /// Shared memory.
    pub ipc: IpcParams,
    /// Timeouts.
    pub safety: SafetyParams,
    /// Range-based detectors.
    pub detect: DetectParams,
    /// What was measured of the sensors, and what of it is applied.
    pub calibration: CalibrationParams,
    /// Directory that relative paths are relative to: that of the file.
    #[serde(skip)]
    pub base_dir: PathBuf,
}

impl Default for Config {
    /// The built-in robot: radius 0.20 m, three eRTIS at 0.15 m looking forward, left-back and right-back.
    fn default() -> Self {
        Self {
            config_version: CONFIG_VERSION,
            speed_of_sound_given_m_s: Some(SPEED_OF_SOUND_DEFAULT_M_S),
            air_temperature_c: None,
            recording: RecordingParams::default(),
            emission: EmissionParams::default(),
            imaging: ImagingParams::default(),
            sensor: vec![
                SensorParams::ertis("front", 0.15, 0.0, 0.0),
                SensorParams::ertis("left", 0.15, 120.0, 0.0),
                SensorParams::ertis("right", 0.15, -120.0, 0.0),
            ],
            obstruction: Vec::new(),
            platform: PlatformLimits::default(),
            control: ControlParams::default(),
            ipc: IpcParams::default(),
            safety: SafetyParams::default(),
            detect: DetectParams::default(),
            calibration: CalibrationParams::default(),
            base_dir: PathBuf::new(),
        }
    }
}

impl Config {
    /// Reads, completes and judges the file at `path`.
    ///
    /// # Errors
    /// [`DocumentError`]; its kind tells a missing file from a bad one.
    pub fn load(path: &Path) -> Result<Self, DocumentError> {
        Self::parse(&document::read(path)?, path)
    }

    /// Completes and judges `text`, the content of `path`.
    ///
    /// # Errors
    /// [`DocumentError`] naming file, line, key, what was found and what is allowed.
    pub fn parse(text: &str, path: &Path) -> Result<Self, DocumentError> {
        let mut config: Self = document::parse(path, text, |_| Ok(()))?;
        config.base_dir = path.parent().map(Path::to_owned).unwrap_or_default();
        if config.speed_of_sound_given_m_s.is_none() && config.air_temperature_c.is_none() {
            config.speed_of_sound_given_m_s = Some(SPEED_OF_SOUND_DEFAULT_M_S);
        }
        config.control.fit_default_regions(&config.platform);
        if let Some(root) = config.ipc.root.as_mut().filter(|root| root.is_relative()) {
            // Without a current directory a relative root stays relative and is refused below.
            let joined = config.base_dir.join(&*root);
            *root = std::path::absolute(&joined).unwrap_or(joined);
        }
        config.read_calibration().map_err(|error| document::refuse(path, text, &error))?;
        config.validate().map_err(|error| document::refuse(path, text, &error))?;
        Ok(config)
    }

    /// What the controller's gate judges by: the platform's limits and the timeouts.
    #[must_use]
    pub fn gate_params(&self) -> GateParams {
        let limits = MotionLimits {
            linear_m_s: self.platform.max_linear_m_s,
            angular_rad_s: self.platform.max_angular_rad_s,
            linear_m_s2: self.platform.max_linear_accel_m_s2,
            angular_rad_s2: self.platform.max_angular_accel_rad_s2,
        };
        GateParams::new(&self.safety, limits)
    }

    /// One of the sensor layouts of paper 000, by its name in [`LAYOUT_NAMES`]: `sim-1` to `sim-10` (table 1: radius 0.10 m,
    /// gains 1) and `real-1` to `real-6` (table 2: a Husky, radius 0.6 m, gains 0.1).
    ///
    /// # Errors
    /// For any other name, with the names there are.
    pub fn layout(name: &str) -> Result<Self, ParameterError> {
        layouts::layout(name)
    }

    /// Judges everything, files included: what [`Config::load`] accepts, this accepts.
    ///
    /// # Errors
    /// The first key that is not allowed, as a dotted path from the root of the file.
    pub fn validate(&self) -> Result<(), ParameterError> {
        validate::validate(self)
    }

    /// What is allowed and yet probably not meant, one sentence each.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        validate::warnings(self)
    }

    /// The configuration as a TOML file with a comment on every key; reads back as an equal [`Config`].
    #[must_use]
    pub fn to_toml(&self) -> String {
        write::to_toml(self)
    }

    /// Reads the file that `[calibration]` names, if it names one.
    ///
    /// # Errors
    /// What is wrong with it, at `calibration.file`.
    fn read_calibration(&mut self) -> Result<(), ParameterError> {
        let Some(file) = &self.calibration.file else { return Ok(()) };
        let path = self.base_dir.join(file);
        let read = document::load(&path, Calibration::validate).map_err(|error| {
            let line = error.line.map_or(String::new(), |line| format!(" line {line}"));
            let found = format!("{}{line}: {}", path.display(), error.summary);
            ParameterError::new("calibration.file", found, "a file written by noctule calibrate")
        })?;
        self.calibration.measured = Some(Arc::new(read));
        Ok(())
    }

    /// The same without any calibration applied: what a calibration is measured against.
    #[must_use]
    pub fn uncalibrated(&self) -> Self {
        let mut nominal = self.clone();
        nominal.calibration.apply.clear();
        nominal
    }

    /// Speed of sound: calibrated where that is applied, else given or from the temperature of the air.
    #[must_use]
    pub fn speed_of_sound_m_s(&self) -> f64 {
        if let Some(measured_m_s) = self.calibration.speed_of_sound_m_s() {
            return measured_m_s;
        }
        let from_temperature = || self.air_temperature_c.map(sensor::air::speed_of_sound_m_s);
        self.speed_of_sound_given_m_s.or_else(from_temperature).unwrap_or(SPEED_OF_SOUND_DEFAULT_M_S)
    }

    /// Format of the raw data, defaults of the format filled in.
    ///
    /// # Errors
    /// The first key of `[recording]` that is not allowed.
    pub fn recording(&self) -> Result<RecordingFormat, ParameterError> {
        self.recording.resolve().map_err(|error| error.within("recording"))
    }

    /// The sensors as they stand on the robot, with what `[calibration]` applies; those with equal emissions share one.
    ///
    /// # Errors
    /// What is wrong with a `[[sensor]]`, its array, or the emission.
    pub fn sensor_setups(&self) -> Result<Vec<SensorSetup>, ParameterError> {
        let emissions = self.emissions()?;
        let setup = |(index, params): (usize, &SensorParams)| {
            let setup = params.setup(Arc::clone(&emissions[index]), &self.base_dir);
            let mut setup = setup.map_err(|error| error.within(&format!("sensor[{index}]")))?;
            if let Some(measured) = self.calibration.measured.as_ref().and_then(|file| file.sensor(&setup.name)) {
                measured.check_fits(&setup).map_err(|error| error.within("calibration.file"))?;
                measured.apply(&self.calibration.apply, &mut setup);
            }
            Ok(setup)
        };
        self.sensor.iter().enumerate().map(setup).collect()
    }

    /// The directions of interest, from `[imaging] directions` or its file.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn directions(&self) -> Result<Vec<Direction>, ParameterError> {
        let directions = match &self.imaging.directions.file {
            None => steering::directions(&self.imaging.directions),
            Some(_)
                if self.imaging.directions.equal_area.is_some() || self.imaging.directions.elevation_deg.is_some() =>
            {
                let allowed = "a file, or equal_area with elevation_deg: not both";
                Err(ParameterError::new("directions.file", "a file beside equal_area or elevation_deg", allowed))
            }
            Some(file) => {
                let path = self.base_dir.join(file);
                let unread = |error: DocumentError| {
                    let what = error.summary.strip_prefix("found ").unwrap_or(&error.summary);
                    let found = format!("{}: {what}", path.display());
                    ParameterError::new("directions.file", found, "a CSV file of azimuth_deg,elevation_deg")
                };
                let text = document::read_at_most(&path, TABLE_SIZE_MAX_BYTES).map_err(unread)?;
                steering::directions_from_csv(&text).map_err(|error| {
                    let found = format!("{} {}", path.display(), error.found);
                    ParameterError { found, ..error }
                })
            }
        };
        directions.map_err(|error| error.within("imaging"))
    }

    /// What each sensor cannot see, in the order of `setups`.
    #[must_use]
    pub fn dead_zones(&self, setups: &[SensorSetup], directions: &[Direction]) -> Vec<DeadZone> {
        let zone = |index| sensor::hidden_directions(setups, index, &self.obstruction, directions);
        (0..setups.len()).map(zone).collect()
    }
}
