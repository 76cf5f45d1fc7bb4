//! `[platform]` of the configuration: what the robot is and can do.

use crate::parameter::{ParameterError, check_positive, check_range};
use serde::{Deserialize, Serialize};

/// `[platform]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlatformLimits {
    /// Radius of the footprint, a disc about the centre of rotation.
    pub radius_m: f64,
    /// Largest speed, either way.
    pub max_linear_m_s: f64,
    /// Largest turn rate, either way.
    pub max_angular_rad_s: f64,
    /// Largest change of speed.
    pub max_linear_accel_m_s2: f64,
    /// Largest change of turn rate.
    pub max_angular_accel_rad_s2: f64,
    /// Lowest and highest part of the robot above the plane of the sensors' origins: what is lower is floor, what is higher it passes
    /// under. Without it everything that is heard may be in the way.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub z_m: Option<[f64; 2]>,
}

impl Default for PlatformLimits {
    fn default() -> Self {
        Self {
            radius_m: 0.20,
            max_linear_m_s: 0.3,
            max_angular_rad_s: 1.0,
            max_linear_accel_m_s2: 1.0,
            max_angular_accel_rad_s2: 3.0,
            z_m: None,
        }
    }
}

impl PlatformLimits {
    /// Refuses what no robot is.
    ///
    /// # Errors
    /// The first key that is not allowed, relative to `[platform]`.
    pub fn validate(&self) -> Result<(), ParameterError> {
        check_positive("radius_m", self.radius_m, 5.0)?;
        check_positive("max_linear_m_s", self.max_linear_m_s, 5.0)?;
        check_positive("max_angular_rad_s", self.max_angular_rad_s, 10.0)?;
        check_positive("max_linear_accel_m_s2", self.max_linear_accel_m_s2, 50.0)?;
        check_positive("max_angular_accel_rad_s2", self.max_angular_accel_rad_s2, 100.0)?;
        if let Some([low_m, high_m]) = self.z_m {
            // The sensors are part of the robot: what is level with them is always in the way.
            check_range("z_m[0]", low_m, -10.0, -0.01)?;
            check_range("z_m[1]", high_m, 0.01, 10.0)?;
        }
        Ok(())
    }
}
