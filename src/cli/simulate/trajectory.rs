//! A drive as a CSV file: a row a ping set, units in the names of the columns.

use crate::cli::Failure;
use crate::cli::output::NewFile;
use crate::sensor::SensorSetup;
use crate::service::trial::{TrackPoint, Trial};
use serde::Serialize;
use std::path::Path;

/// One row; the fields are the header.
#[derive(Serialize)]
struct Row<'a> {
    time_s: f64,
    x_m: f64,
    y_m: f64,
    heading_deg: f64,
    linear_m_s: f64,
    angular_rad_s: f64,
    wanted_linear_m_s: f64,
    wanted_angular_rad_s: f64,
    decided_linear_m_s: f64,
    decided_angular_rad_s: f64,
    layer: &'static str,
    state: &'static str,
    gate: &'static str,
    stuck: bool,
    clearance_m: f64,
    /// Empty without a mover.
    mover_clearance_m: Option<f64>,
    /// Empty, as range and bearing are, when no sensor is behind the decision.
    cause_sensor: Option<&'a str>,
    cause_range_m: Option<f64>,
    cause_bearing_deg: Option<f64>,
    cause_energy: f64,
    cause_threshold: f64,
}

impl<'a> Row<'a> {
    fn new(point: &TrackPoint, sensors: &'a [SensorSetup]) -> Self {
        let cause = &point.cause;
        let sensor = cause.sensor_index.and_then(|index| sensors.get(index));
        Self {
            time_s: point.time_s,
            x_m: point.pose.x_m,
            y_m: point.pose.y_m,
            heading_deg: point.pose.heading_rad.to_degrees(),
            linear_m_s: point.velocity.linear_m_s,
            angular_rad_s: point.velocity.angular_rad_s,
            wanted_linear_m_s: point.wanted.linear_m_s,
            wanted_angular_rad_s: point.wanted.angular_rad_s,
            decided_linear_m_s: point.decided.linear_m_s,
            decided_angular_rad_s: point.decided.angular_rad_s,
            layer: point.layer.as_str(),
            state: point.state.as_str(),
            gate: point.gate.as_str(),
            stuck: point.stuck,
            clearance_m: point.clearance_m,
            mover_clearance_m: Some(point.mover_clearance_m).filter(|clearance_m| clearance_m.is_finite()),
            cause_sensor: sensor.map(|sensor| sensor.name.as_str()),
            cause_range_m: sensor.map(|_| cause.range_m),
            cause_bearing_deg: sensor.map(|_| cause.bearing_rad.to_degrees()),
            cause_energy: cause.energy,
            cause_threshold: cause.threshold,
        }
    }
}

/// Writes the drive.
///
/// # Errors
/// Exit 73, 74 or 77.
pub fn write(path: &Path, trial: &Trial, sensors: &[SensorSetup]) -> Result<(), Failure> {
    let mut file = NewFile::create(path)?;
    let mut writer = csv::Writer::from_writer(&mut file);
    let rows = trial.track.iter().try_for_each(|point| writer.serialize(Row::new(point, sensors)));
    let written = rows.map_err(std::io::Error::from).and_then(|()| writer.flush());
    drop(writer);
    written.map_err(|error| file.failure(&error))?;
    file.finish()
}
