//! The acoustic flow field: how an echo moves through a sensor's image when the robot moves (paper 000, eq. 6).
//!
//! Goes in: mount, robot velocity, range and bearing of a static reflector. Comes out: their rates. The paper's eq. 3 has
//! a wrong sign in its second row (the sensor sits at yaw beta against its bearing, so the rotation carries it along
//! +l omega cos(beta), seen from a frame turned by delta), and eq. 6 and 10 inherit it; this file follows the
//! specification, section 4. It never looks at an image.

use crate::sensor::Mount;
use crate::signal::Velocity;

/// Rates of the polar coordinates of a static reflector in a moving sensor's frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FlowRate {
    /// Rate of the range.
    pub range_m_s: f64,
    /// Rate of the bearing.
    pub bearing_rad_s: f64,
}

/// Flow of a static reflector at (`range_m`, `bearing_rad`) of a sensor on a robot that moves with `velocity`.
///
/// The bearing's rate is infinite or NaN at range zero, where a bearing has no meaning. A robot driving at 0.3 m/s towards
/// a reflector on the boresight of a sensor at its nose sees (-0.3 m/s, 0 rad/s).
#[must_use]
pub fn flow_rate(mount: &Mount, velocity: Velocity, range_m: f64, bearing_rad: f64) -> FlowRate {
    let Velocity { linear_m_s, angular_rad_s } = velocity;
    let (sin_robot, cos_robot) = (bearing_rad + mount.bearing_rad + mount.yaw_rad).sin_cos();
    let (sin_mount, cos_mount) = (bearing_rad + mount.yaw_rad).sin_cos();
    let tangential_m_s = mount.distance_m * angular_rad_s;
    FlowRate {
        range_m_s: -linear_m_s * cos_robot - tangential_m_s * sin_mount,
        bearing_rad_s: (linear_m_s * sin_robot - tangential_m_s * cos_mount) / range_m - angular_rad_s,
    }
}
