//! The range scan of the whole robot: the nearest echo around it, fused from the scans of all sensors.
//!
//! Rays go out from the robot's origin, one a degree. Peaks are the reflectors behind the rays: an array hears one reflector in
//! many directions, and only the loudest of them says where it is. Data only; who makes it is [`crate::detect::ScanFuser`].

use super::Reading;
use crate::time::Stamp;
use nalgebra::Vector2;

/// Rays of a scan: one a degree.
pub const RAYS: usize = 360;
/// Most reflectors told in a scan; the nearest are kept.
pub const PEAKS_MAX: usize = 64;

/// What one bearing around the robot has to say.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Ray {
    /// The nearest echo, nothing within range, or unseen. Its range is measured from the robot's origin.
    pub reading: Reading,
    /// Standard deviation of the range of an echo.
    pub range_sigma_m: f64,
    /// Standard deviation of its bearing: small at a peak, the distance to the peak beside it.
    pub bearing_sigma_rad: f64,
    /// Distance from the origin up to which the bearing is known to be free of echoes, beyond what no sensor ever sees; 0 where
    /// nothing is known.
    pub free_m: f64,
}

/// One reflector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// Place in the robot frame.
    pub position_m: Vector2<f64>,
    /// Place of the sensor that heard it, in the robot frame.
    pub sensor_m: Vector2<f64>,
    /// Standard deviation along the line of sight from that sensor.
    pub range_sigma_m: f64,
    /// Standard deviation of the bearing from that sensor.
    pub bearing_sigma_rad: f64,
    /// Envelope, linear amplitude in units of full scale.
    pub energy: f32,
    /// Index of the sensor.
    pub sensor_index: usize,
}

/// One scan of the whole robot.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotScan {
    /// Sequence of the ping set.
    pub sequence: u64,
    /// Oldest emission of the set.
    pub emitted_at: Stamp,
    /// Bit k is set when sensor k went in.
    pub sensors_used: u32,
    /// Ranges from the robot's origin within which any sensor sees anything.
    pub range_m: [f64; 2],
    /// One a degree; see [`RobotScan::bearing_rad`].
    pub rays: Box<[Ray; RAYS]>,
    /// Reflectors, nearest to the robot's origin first; at most [`PEAKS_MAX`].
    pub peaks: Vec<Peak>,
}

impl RobotScan {
    /// A scan that knows nothing. Filling it allocates nothing.
    #[must_use]
    pub fn unseen() -> Self {
        Self {
            sequence: 0,
            emitted_at: Stamp::default(),
            sensors_used: 0,
            range_m: [0.0, 0.0],
            rays: Box::new([Ray::default(); RAYS]),
            peaks: Vec::with_capacity(PEAKS_MAX),
        }
    }

    /// Bearing of a ray in the robot frame, from -180 degrees up, positive to the left.
    #[must_use]
    pub fn bearing_rad(ray: usize) -> f64 {
        (ray as f64 - 0.5 * RAYS as f64) * std::f64::consts::TAU / RAYS as f64
    }

    /// The ray nearest to a bearing.
    #[must_use]
    pub fn ray_at(bearing_rad: f64) -> usize {
        let step = bearing_rad * RAYS as f64 / std::f64::consts::TAU;
        (step.round() as i64 + RAYS as i64 / 2).rem_euclid(RAYS as i64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_ray_is_found_by_its_bearing_and_straight_behind_is_one_ray() {
        for ray in 0..RAYS {
            assert_eq!(RobotScan::ray_at(RobotScan::bearing_rad(ray)), ray);
        }
        let behind = std::f64::consts::PI;
        assert_eq!(RobotScan::ray_at(behind), RobotScan::ray_at(-behind));
        assert_eq!(RobotScan::ray_at(0.0), RAYS / 2, "straight ahead");
        assert_eq!(RobotScan::bearing_rad(RAYS / 2 + 90), 0.5 * behind, "left is positive");
    }
}
