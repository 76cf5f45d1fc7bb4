//! The file of a calibration: TOML that people can read, judged like every other document.
//!
//! In: what was measured, or the text of a file. Out: the text, or a [`Calibration`] whose every number is plausible, and sensors
//! corrected by it. Bounds are here and nowhere else: a speed of sound of no air, an emitter or microphone that moved by millimetres
//! is an error that names it, never applied. Measures nothing.

use super::params::Applied;
use crate::parameter::{ParameterError, check_range};
use crate::sensor::SensorSetup;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Version of the format.
pub const CALIBRATION_VERSION: u32 = 1;
/// Speeds of sound of air that a robot works in: -50 to 86 degrees Celsius.
pub const SPEED_M_S: (f64, f64) = (300.0, 380.0);
/// Farthest that an emitter may lie from where the configuration says.
pub const EMITTER_MAX_M: f64 = 10e-3;
/// Largest change of a microphone's way: more than half of it is a third of a period, and the period may be mistaken.
pub const PATH_MAX_M: f64 = 4e-3;
/// Largest difference of a gain from the array's median that is corrected.
pub const GAIN_MAX_DB: f64 = 12.0;
/// Latest beginning of an emission.
const LATE_MAX_US: f64 = 50.0;
/// Most microphones and names in a list.
const LIST_MAX: usize = crate::sensor::array::MICROPHONES_MAX;

/// What was measured of a robot's sensors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Version of the format.
    pub calibration_version: u32,
    /// When the recording was made, UTC.
    pub recorded: String,
    /// One table a sensor.
    #[serde(default)]
    pub sensor: Vec<SensorCalibration>,
    /// One table a pair of sensors of which one hears the other.
    #[serde(default)]
    pub cross: Vec<CrossCalibration>,
}

/// What the emission of one sensor, heard by another, tells of the air.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CrossCalibration {
    /// Who emitted.
    pub from: String,
    /// Who heard it.
    pub to: String,
    /// Pings that it rests on.
    pub pings: u64,
    /// Microphones that heard it.
    pub microphones: usize,
    /// Rms of their deviations from the array.
    pub residual_m: f64,
    /// Speed of sound.
    pub speed_of_sound_m_s: f64,
    /// Its standard deviation, mounts included.
    pub speed_of_sound_sd_m_s: f64,
}

/// What was measured of one sensor. Lists have one entry a microphone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorCalibration {
    /// The sensor's name.
    pub name: String,
    /// Microphones of its array.
    pub microphones: usize,
    /// Checksum of the array and emitter that it was measured against.
    pub geometry: String,
    /// Pings that it rests on.
    pub pings: u64,
    /// Speed of sound that was configured then.
    pub configured_m_s: f64,
    /// Speed of sound.
    pub speed_of_sound_m_s: f64,
    /// Its standard deviation.
    pub speed_of_sound_sd_m_s: f64,
    /// Temperature of dry air with that speed of sound.
    pub air_temperature_c: f64,
    /// Its standard deviation.
    pub air_temperature_sd_c: f64,
    /// How much later than sample 0 the emission begins, microseconds.
    pub late_us: f64,
    /// Its standard deviation.
    pub late_sd_us: f64,
    /// Phase that the transducers turn the sweep by.
    pub phase_rad: f64,
    /// Emitter in the sensor's frame.
    pub emitter_m: [f64; 3],
    /// Standard deviation of each coordinate.
    pub emitter_sd_m: [f64; 3],
    /// Rms of the microphones' deviations from the array.
    pub residual_m: f64,
    /// Level of the emitter: decibels of full scale of the median microphone, at 1 m.
    pub level_db: f64,
    /// Of speed of sound, lateness, emitter x, y, z: of so many independent combinations the data told something.
    pub directions_told: usize,
    /// Those that stayed as they were known.
    #[serde(default)]
    pub not_observable: Vec<String>,
    /// Microphones that were not heard.
    #[serde(default)]
    pub unheard: Vec<usize>,
    /// Microphones whose way does not fit the others.
    #[serde(default)]
    pub misplaced: Vec<usize>,
    /// Microphones cut off at full scale: their gains are not known.
    #[serde(default)]
    pub clipped: Vec<usize>,
    /// By how much farther from the emitter each microphone is than its place says.
    pub path_m: Vec<f64>,
    /// Standard deviations of these.
    pub path_sd_m: Vec<f64>,
    /// Gain of each microphone against the array's median.
    pub gain_db: Vec<f64>,
    /// Standard deviations of these.
    pub gain_sd_db: Vec<f64>,
}

impl Calibration {
    /// Judges every number.
    ///
    /// # Errors
    /// The first key that is not plausible.
    pub fn validate(&self) -> Result<(), ParameterError> {
        if self.calibration_version != CALIBRATION_VERSION {
            let allowed = format!("{CALIBRATION_VERSION}: the only version that this program reads");
            return Err(ParameterError::new("calibration_version", self.calibration_version, allowed));
        }
        for (index, sensor) in self.sensor.iter().enumerate() {
            sensor.validate().map_err(|error| error.within(&format!("sensor[{index}]")))?;
        }
        for (index, pair) in self.cross.iter().enumerate() {
            let key = format!("cross[{index}].speed_of_sound_m_s");
            check_range(&key, pair.speed_of_sound_m_s, SPEED_M_S.0, SPEED_M_S.1)?;
        }
        Ok(())
    }

    /// The sensor of that name.
    #[must_use]
    pub fn sensor(&self, name: &str) -> Option<&SensorCalibration> {
        self.sensor.iter().find(|sensor| sensor.name == name)
    }

    /// Speed of sound of all sensors, weighted by how sure each is.
    #[must_use]
    pub fn speed_of_sound_m_s(&self) -> Option<f64> {
        let weight = |sensor: &SensorCalibration| sensor.speed_of_sound_sd_m_s.max(1e-3).powi(-2);
        let weights: f64 = self.sensor.iter().map(weight).sum();
        let sum: f64 = self.sensor.iter().map(|sensor| weight(sensor) * sensor.speed_of_sound_m_s).sum();
        (weights > 0.0).then(|| sum / weights)
    }

    /// The file's text.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let body = toml::to_string(self).unwrap_or_default();
        format!(
            "# Written by `noctule calibrate`; named by [calibration] file. Metres, microseconds and decibels as the names say;\n\
             # `_sd` is a standard deviation. Speed of sound and size of the array are told apart by prior knowledge only:\n\
             # what `not_observable` lists stayed as configured.\n{body}"
        )
    }
}

impl SensorCalibration {
    fn validate(&self) -> Result<(), ParameterError> {
        check_range("speed_of_sound_m_s", self.speed_of_sound_m_s, SPEED_M_S.0, SPEED_M_S.1)?;
        check_range("speed_of_sound_sd_m_s", self.speed_of_sound_sd_m_s, 0.0, SPEED_M_S.1)?;
        check_range("configured_m_s", self.configured_m_s, 200.0, 1600.0)?;
        check_range("late_us", self.late_us, -LATE_MAX_US, LATE_MAX_US)?;
        check_range("phase_rad", self.phase_rad, -4.0, 4.0)?;
        for (key, values, (least, most)) in
            [("emitter_m", &self.emitter_m, (-1.0, 1.0)), ("emitter_sd_m", &self.emitter_sd_m, (0.0, 1.0))]
        {
            for (axis, value) in values.iter().enumerate() {
                check_range(&format!("{key}[{axis}]"), *value, least, most)?;
            }
        }
        check_range("level_db", self.level_db, -300.0, 100.0)?;
        if !(1..=LIST_MAX).contains(&self.microphones) {
            return Err(ParameterError::new("microphones", self.microphones, format!("1 to {LIST_MAX}")));
        }
        let lists = [
            ("path_m", &self.path_m, (-PATH_MAX_M, PATH_MAX_M), "path"),
            ("path_sd_m", &self.path_sd_m, (0.0, 1.0), "standard deviation"),
            ("gain_db", &self.gain_db, (-60.0, 60.0), "gain"),
            ("gain_sd_db", &self.gain_sd_db, (0.0, 60.0), "standard deviation"),
        ];
        for (key, values, (least, most), what) in lists {
            if values.len() != self.microphones {
                let found = format!("{} numbers", values.len());
                return Err(ParameterError::new(key, found, format!("{}, one a microphone", self.microphones)));
            }
            for (microphone, value) in values.iter().enumerate() {
                if !(*value >= least && *value <= most) {
                    let found = format!("{value}, the {what} of microphone {microphone} of sensor {:?}", self.name);
                    return Err(ParameterError::new(key, found, format!("numbers from {least} to {most}")));
                }
            }
        }
        for (key, list) in [("unheard", &self.unheard), ("misplaced", &self.misplaced), ("clipped", &self.clipped)] {
            if let Some(mic) = list.iter().find(|mic| **mic >= self.microphones) {
                return Err(ParameterError::new(key, mic, format!("microphones, 0 to {}", self.microphones - 1)));
            }
        }
        Ok(())
    }

    /// Whether it may be applied to `sensor`.
    ///
    /// # Errors
    /// When it was measured against another geometry, or says that something lies where it cannot; the key is empty.
    pub fn check_fits(&self, sensor: &SensorSetup) -> Result<(), ParameterError> {
        let refuse = |found: String, allowed: &str| Err(ParameterError::new("", found, allowed));
        if self.microphones != sensor.array.channel_count() || self.geometry != geometry_of(sensor) {
            return refuse(
                format!("a calibration of another array or emitter than sensor {:?} has", self.name),
                "one made with this configuration: run noctule calibrate again",
            );
        }
        let moved_m = (Vector3::from(self.emitter_m) - sensor.emitter_m).norm();
        if !(moved_m <= EMITTER_MAX_M) {
            return refuse(
                format!("the emitter of sensor {:?} {:.1} mm from where it is configured", self.name, 1e3 * moved_m),
                "at most 10 mm: measure it, and correct emitter_m",
            );
        }
        Ok(())
    }

    /// Corrects what `applied` lists. A microphone is moved along the line from the emitter, the only part of a move that shows.
    pub fn apply(&self, applied: &[Applied], sensor: &mut SensorSetup) {
        let emitter_m = Vector3::from(self.emitter_m);
        if applied.contains(&Applied::Microphones) {
            for (place_m, longer_m) in sensor.array.positions_m.iter_mut().zip(&self.path_m) {
                *place_m = farther(place_m, &emitter_m, *longer_m);
            }
        }
        if applied.contains(&Applied::Emitter) {
            sensor.emitter_m = emitter_m;
        }
        if applied.contains(&Applied::Gains) {
            for (weight, gain_db) in sensor.array.weights.iter_mut().zip(&self.gain_db) {
                *weight *= 10f64.powf(-gain_db.clamp(-GAIN_MAX_DB, GAIN_MAX_DB) / 20.0) as f32;
            }
        }
    }

    /// The sensor as it was measured, for comparing with it later: emitter and microphones moved, nothing else.
    #[must_use]
    pub fn reference(&self, sensor: &SensorSetup) -> SensorSetup {
        let mut moved = sensor.clone();
        self.apply(&[Applied::Microphones, Applied::Emitter], &mut moved);
        moved
    }
}

/// The place `longer_m` farther from the emitter.
fn farther(place_m: &Vector3<f64>, emitter_m: &Vector3<f64>, longer_m: f64) -> Vector3<f64> {
    let apart_m = place_m - emitter_m;
    let distance_m = apart_m.norm();
    if distance_m > 1e-6 { place_m + apart_m * (longer_m / distance_m) } else { *place_m }
}

/// Checksum of places of microphones and emitter, to a hundredth of a millimetre.
#[must_use]
pub fn geometry_of(sensor: &SensorSetup) -> String {
    let mut hasher = crc32fast::Hasher::new();
    for place_m in sensor.array.positions_m.iter().chain([&sensor.emitter_m]) {
        for coordinate_m in place_m {
            hasher.update(&((coordinate_m * 1e5).round() as i64).to_le_bytes());
        }
    }
    format!("{:08x}", hasher.finalize())
}

/// Date and time of seconds since 1970, UTC, as TOML and people write it.
#[must_use]
pub fn utc(seconds: u64) -> String {
    let (day, second) = (seconds / 86_400, seconds % 86_400);
    // Days counted from 1 March of year 0, in eras of 400 years, so that leap days come last.
    let day = day + 719_468;
    let (era, day) = (day / 146_097, day % 146_097);
    let year = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let (day, month) = (day - (153 * month + 2) / 5 + 1, if month < 10 { month + 3 } else { month - 9 });
    let year = era * 400 + year + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}Z", second / 3_600, second / 60 % 60, second % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        assert_eq!(utc(0), "1970-01-01T00:00:00Z");
        assert_eq!(utc(951_827_696), "2000-02-29T12:34:56Z");
        assert_eq!(utc(1_709_251_199), "2024-02-29T23:59:59Z");
        assert_eq!(utc(1_709_251_200), "2024-03-01T00:00:00Z");
        assert_eq!(utc(4_107_542_400), "2100-03-01T00:00:00Z");
    }
}
