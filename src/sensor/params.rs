//! `[[sensor]]` of the configuration.
//!
//! Goes in: name, mount, array, emitter and disabled microphones as a person writes them, degrees and metres. Comes out: a
//! [`SensorSetup`]. Whether several sensors go together is judged by the configuration.

use super::{Emission, MicrophoneArray, Mount, SensorEmission, SensorSetup, table};
use crate::parameter::{ParameterError, check_range};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

/// Name of the built-in array.
pub const ERTIS_V3D1: &str = "ertis-v3d1";
/// Longest name of a sensor: it is part of topic names.
const NAME_LEN_MAX: usize = 32;

/// `[[sensor]]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorParams {
    /// Name, part of the topic names.
    pub name: String,
    /// Where it stands and looks; the robot's centre, forward, by default.
    #[serde(default)]
    pub mount: MountParams,
    /// `ertis-v3d1`, or a CSV file of microphone positions.
    #[serde(default = "default_array")]
    pub array: String,
    /// Microphones that are not used.
    #[serde(default)]
    pub disabled_mics: Vec<usize>,
    /// Place of the emitter in the sensor frame.
    #[serde(default = "default_emitter_m")]
    pub emitter_m: [f64; 3],
    /// What it sends other than `[emission]` says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub emission: Option<SensorEmission>,
}

fn default_array() -> String {
    ERTIS_V3D1.to_owned()
}

fn default_emitter_m() -> [f64; 3] {
    [0.0, 0.0, 0.06]
}

/// `mount = { distance_m, bearing_deg, yaw_deg }`, each 0 by default.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MountParams {
    /// Distance l from the robot's centre of rotation.
    pub distance_m: f64,
    /// Bearing alpha of the sensor's position.
    pub bearing_deg: f64,
    /// Yaw beta of the sensor against that bearing.
    pub yaw_deg: f64,
}

impl SensorParams {
    /// An eRTIS of that name and place.
    #[must_use]
    pub fn ertis(name: &str, distance_m: f64, bearing_deg: f64, yaw_deg: f64) -> Self {
        Self {
            name: name.to_owned(),
            mount: MountParams { distance_m, bearing_deg, yaw_deg },
            array: default_array(),
            disabled_mics: Vec::new(),
            emitter_m: default_emitter_m(),
            emission: None,
        }
    }

    /// Judges the values that need no file.
    ///
    /// # Errors
    /// The first key that is not allowed, relative to the sensor's table.
    pub fn validate(&self) -> Result<(), ParameterError> {
        let spelt_well = self.name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-');
        if self.name.is_empty() || self.name.len() > NAME_LEN_MAX || !spelt_well {
            let allowed = format!("1 to {NAME_LEN_MAX} letters, digits, `_` or `-`: it becomes part of topic names");
            return Err(ParameterError::new("name", format!("{:?}", self.name), allowed));
        }
        check_range("mount.distance_m", self.mount.distance_m, 0.0, 5.0)?;
        check_range("mount.bearing_deg", self.mount.bearing_deg, -360.0, 360.0)?;
        check_range("mount.yaw_deg", self.mount.yaw_deg, -360.0, 360.0)?;
        for (index, coordinate_m) in self.emitter_m.iter().enumerate() {
            check_range(&format!("emitter_m[{index}]"), *coordinate_m, -1.0, 1.0)?;
        }
        Ok(())
    }

    /// The sensor as it stands on the robot; a relative array file is looked for in `base_dir`.
    ///
    /// # Errors
    /// As [`SensorParams::validate`], and what is wrong with the array or the list of disabled microphones.
    pub fn setup(&self, emission: Arc<Emission>, base_dir: &Path) -> Result<SensorSetup, ParameterError> {
        self.validate()?;
        let mut array = match self.array.as_str() {
            ERTIS_V3D1 => MicrophoneArray::ertis_v3d1(),
            file => Self::array_from(&base_dir.join(file)).map_err(|error| error.within("array"))?,
        };
        array.disable(&self.disabled_mics)?;
        let mount = Mount {
            distance_m: self.mount.distance_m,
            bearing_rad: self.mount.bearing_deg.to_radians(),
            yaw_rad: self.mount.yaw_deg.to_radians(),
        };
        let emitter_m = Vector3::from(self.emitter_m);
        Ok(SensorSetup { name: self.name.clone(), mount, array, emission, emitter_m })
    }

    fn array_from(path: &Path) -> Result<MicrophoneArray, ParameterError> {
        let text = table::read(path).map_err(|error| {
            let allowed = format!("\"{ERTIS_V3D1}\" or a CSV file of microphones");
            ParameterError { allowed, ..error }
        })?;
        MicrophoneArray::from_csv(&text).map_err(|error| table::in_file(path, error))
    }
}
