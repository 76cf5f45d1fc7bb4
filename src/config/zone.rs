//! Rule 27 of the safe-state contract: the CA zone is larger than the way the robot goes before it stands.
//!
//! Goes in: limits of the platform, MAX_AGE, the CA regions. Comes out: the way in its parts, and whether the zone covers
//! it. Decides nothing at run time.

use super::Config;
use crate::parameter::ParameterError;
use nalgebra::Vector2;

/// Controller tick and scheduling on top of MAX_AGE: together the time budget's Z2.
const SILENT_FAULT_EXTRA_S: f64 = 0.05;
/// Allowance for the error of a range and of the masks' edges.
const RANGE_ERROR_M: f64 = 0.05;
/// Distance between the points at which a zone is looked at.
const SAMPLE_M: f64 = 0.005;

/// How far the robot goes between the last good capture and standstill, at full speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StoppingDistance {
    /// Way within Z2 = MAX_AGE + 50 ms.
    pub travel_m: f64,
    /// Way while it brakes, v^2 / (2 a).
    pub braking_m: f64,
    /// Radius of the footprint.
    pub radius_m: f64,
    /// Allowance for the error of a range.
    pub range_error_m: f64,
}

impl StoppingDistance {
    /// For the platform and the timeouts of `config`.
    #[must_use]
    pub fn of(config: &Config) -> Self {
        let speed_m_s = config.platform.max_linear_m_s;
        Self {
            travel_m: speed_m_s * (config.safety.max_age_ms / 1e3 + SILENT_FAULT_EXTRA_S),
            braking_m: speed_m_s * speed_m_s / (2.0 * config.platform.max_linear_accel_m_s2),
            radius_m: config.platform.radius_m,
            range_error_m: RANGE_ERROR_M,
        }
    }

    /// Distance from the robot's centre that the zone must reach ahead.
    #[must_use]
    pub fn total_m(&self) -> f64 {
        self.radius_m + self.travel_m + self.braking_m + self.range_error_m
    }
}

impl std::fmt::Display for StoppingDistance {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            formatter,
            "{:.3} m = radius {:.3} + travel {:.3} + braking {:.3} + range error {:.3}",
            self.total_m(),
            self.radius_m,
            self.travel_m,
            self.braking_m,
            self.range_error_m
        )
    }
}

/// The first gap in the CA zone on the line at `lateral_m` beside the robot's x axis, between the footprint's edge and
/// where the robot must stand: x of a point in no region.
fn gap_m(config: &Config, way: &StoppingDistance, lateral_m: f64) -> Option<f64> {
    let front_m = (way.radius_m * way.radius_m - lateral_m * lateral_m).max(0.0).sqrt();
    let length_m = way.total_m() - way.radius_m;
    let count = (length_m / SAMPLE_M).ceil().clamp(1.0, 1e5) as usize;
    let regions = &config.control.collision_avoidance.regions;
    let x_m = |index: usize| front_m + length_m * index as f64 / count as f64;
    let inside = |x_m: f64| regions.iter().any(|region| region.contains(Vector2::new(x_m, lateral_m)));
    (0..=count).map(x_m).find(|x_m| !inside(*x_m))
}

/// Refuses a CA zone with a gap straight ahead of the robot.
pub(super) fn check(config: &Config) -> Result<(), ParameterError> {
    if !config.control.collision_avoidance.enabled {
        return Ok(());
    }
    let way = StoppingDistance::of(config);
    match gap_m(config, &way, 0.0) {
        None => Ok(()),
        Some(x_m) => Err(ParameterError::new(
            "control.collision_avoidance.regions",
            format!("a zone that leaves out the point {x_m:.3} m straight ahead"),
            format!("regions that hold everything ahead from the footprint to {way}"),
        )),
    }
}

/// What is odd about a zone that is allowed.
pub(super) fn warnings(config: &Config) -> Vec<String> {
    if !config.control.collision_avoidance.enabled {
        return vec!["control.collision_avoidance is off: nothing stops the robot before an obstacle".to_owned()];
    }
    let way = StoppingDistance::of(config);
    let gap = |share: i32| {
        let lateral_m = way.radius_m * f64::from(share) / 10.0;
        gap_m(config, &way, lateral_m).map(|x_m| (x_m, lateral_m))
    };
    let sentence = |(x_m, y_m): (f64, f64)| {
        format!(
            "control.collision_avoidance.regions leave out the point [{x_m:.2}, {y_m:.2}], which the robot's edge reaches \
             before it stands ({way})"
        )
    };
    // The corners, then inward: the widest gap is told, once.
    let mut shares: Vec<i32> = (-10..=10).collect();
    shares.sort_by_key(|share: &i32| -share.abs());
    shares.into_iter().find_map(gap).map(sentence).into_iter().collect()
}
