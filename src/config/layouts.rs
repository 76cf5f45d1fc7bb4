//! The sensor layouts of paper 000, tables 1 and 2, as complete configurations.
//!
//! Goes in: a name. Comes out: the built-in configuration with the table's mounts, the platform of the experiments and
//! its gains. The tables print degrees and centimetres; so does this file.

use super::Config;
use crate::control::{ControlParams, PlatformLimits};
use crate::parameter::ParameterError;
use crate::sensor::SensorParams;

/// Names of the layouts.
pub const LAYOUT_NAMES: [&str; 16] = [
    "sim-1", "sim-2", "sim-3", "sim-4", "sim-5", "sim-6", "sim-7", "sim-8", "sim-9", "sim-10", "real-1", "real-2",
    "real-3", "real-4", "real-5", "real-6",
];

/// (alpha in degrees, beta in degrees, l in centimetres) of each sensor.
type Row = &'static [(f64, f64, f64)];

/// Table 1, simulation.
const SIMULATED: [Row; 10] = [
    &[(0.0, 0.0, 18.0)],
    &[(0.0, -20.0, 14.0), (90.0, -10.0, 10.0), (-90.0, -5.0, 8.0)],
    &[(90.0, -20.0, 10.0), (-90.0, 20.0, 10.0)],
    &[(0.0, 0.0, 12.0), (90.0, 0.0, 12.0), (-90.0, 0.0, 12.0)],
    &[(45.0, 0.0, 4.0), (-135.0, 0.0, 4.0)],
    &[(0.0, 0.0, 10.0), (-180.0, 0.0, 0.0)],
    &[(0.0, 20.0, 6.0), (90.0, 10.0, 0.0), (-90.0, 20.0, 14.0)],
    &[(0.0, 0.0, 0.0), (120.0, -120.0, 14.0), (-120.0, 120.0, 14.0)],
    &[(180.0, -180.0, 6.0)],
    &[(45.0, -10.0, 6.0), (-45.0, 10.0, 6.0), (-180.0, 0.0, 0.0)],
];

/// Table 2, the real robot.
const REAL: [Row; 6] = [
    &[(0.0, 0.0, 41.0), (30.0, 60.0, 40.0), (-30.0, -60.0, 40.0)],
    &[(0.0, 0.0, 41.0), (180.0, 0.0, 27.0), (58.0, 32.0, 31.0)],
    &[(0.0, -12.0, 41.0), (180.0, 35.0, 27.0), (58.0, 2.0, 31.0)],
    &[(0.0, 0.0, 41.0)],
    &[(140.0, 80.0, 25.0), (-20.0, -30.0, 30.0), (30.0, -30.0, 39.0)],
    &[(140.0, 11.0, 25.0), (-20.0, 0.0, 30.0)],
];

/// Radius of the simulated robot and of a Clearpath Husky, and the gains lambda and mu used with each.
const SIMULATED_ROBOT: (f64, f64) = (0.10, 1.0);
const HUSKY: (f64, f64) = (0.60, 0.1);

pub(super) fn layout(name: &str) -> Result<Config, ParameterError> {
    let index = LAYOUT_NAMES.iter().position(|known| *known == name);
    let (row, (radius_m, gain)) = match index {
        Some(index) if index < SIMULATED.len() => (SIMULATED[index], SIMULATED_ROBOT),
        Some(index) => (REAL[index - SIMULATED.len()], HUSKY),
        None => return Err(ParameterError::new("layout", format!("{name:?}"), LAYOUT_NAMES.join(", "))),
    };
    let platform = PlatformLimits { radius_m, max_linear_m_s: 0.3, ..PlatformLimits::default() };
    let mut control = ControlParams::for_platform(&platform);
    control.obstacle_avoidance.lambda = gain;
    control.obstacle_avoidance.mu = gain;
    control.flow_following.lambda = gain;
    control.corridor_following.lambda = gain;
    let sensor = |(index, (bearing_deg, yaw_deg, distance_cm)): (usize, &(f64, f64, f64))| {
        SensorParams::ertis(&format!("sonar{}", index + 1), distance_cm / 100.0, *bearing_deg, *yaw_deg)
    };
    Ok(Config { sensor: row.iter().enumerate().map(sensor).collect(), platform, control, ..Config::default() })
}
