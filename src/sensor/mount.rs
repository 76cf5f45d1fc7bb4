//! Where a sensor stands on the robot, and how it moves when the robot moves (paper 000, figure 3 and eq. 3).

use crate::geometry::{Pose2, wrap_angle_rad};
use crate::signal::Velocity;
use nalgebra::Vector2;

/// Place and heading of a sensor on the robot: distance l, bearing alpha of its position, yaw beta.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mount {
    /// Distance l from the robot's centre of rotation.
    pub distance_m: f64,
    /// Bearing alpha of the sensor's position.
    pub bearing_rad: f64,
    /// Yaw beta of the sensor against that bearing.
    pub yaw_rad: f64,
}

impl Mount {
    /// Heading delta = alpha + beta of the sensor's boresight in the robot frame, in (-pi, pi].
    #[must_use]
    pub fn heading_rad(&self) -> f64 {
        wrap_angle_rad(self.bearing_rad + self.yaw_rad)
    }

    /// Position of the sensor in the robot frame.
    #[must_use]
    pub fn position_m(&self) -> Vector2<f64> {
        Vector2::new(self.distance_m * self.bearing_rad.cos(), self.distance_m * self.bearing_rad.sin())
    }

    /// Pose of the sensor frame in the robot frame.
    #[must_use]
    pub fn pose(&self) -> Pose2 {
        let position = self.position_m();
        Pose2 { x_m: position.x, y_m: position.y, heading_rad: self.heading_rad() }
    }

    /// Velocity of the sensor itself in its own frame, m/s, while the robot moves with `robot`.
    ///
    /// The paper's eq. 3 prints `+V sin(alpha + beta)` in row 2; a sensor that looks to the left (delta = 90 deg) of a robot
    /// driving forward moves to its own right, so the sign is minus.
    #[must_use]
    pub fn sensor_velocity_m_s(&self, robot: Velocity) -> Vector2<f64> {
        let (sin_heading, cos_heading) = (self.bearing_rad + self.yaw_rad).sin_cos();
        let (sin_yaw, cos_yaw) = self.yaw_rad.sin_cos();
        let swing_m_s = self.distance_m * robot.angular_rad_s;
        Vector2::new(
            robot.linear_m_s * cos_heading + swing_m_s * sin_yaw,
            -robot.linear_m_s * sin_heading + swing_m_s * cos_yaw,
        )
    }
}
