//! Self-calibration: what the direct path from the emitter to each microphone tells, over many pings, of the air and the sensor.
//!
//! In: raw pings and the sensors as configured. Out: speed of sound and the air's temperature, the emitter's place, of each microphone by
//! how much its way is longer and how loud it is ([`SensorCalibration`], kept in a file), what of this nobody can tell, and alarms
//! when it drifts ([`drift`]). Applies what the configuration says is to be applied, within bounds. Never stops a robot: that is for
//! [`crate::safety`] alone.
//!
//! ```text
//! RawPing ─► arrival (matched filter, one channel) ─► running (robust mean) ─► solve (most probable values) ─► file, drift
//! ```

pub mod arrival;
pub mod cross;
pub mod drift;
pub mod file;
pub mod measure;
pub mod observe;
pub mod params;
pub mod running;
pub mod solve;

pub use drift::{Alarms, Drift, DriftMonitor};
pub use file::{Calibration, CrossCalibration, SensorCalibration};
pub use measure::{Tolerances, measure};
pub use observe::Observer;
pub use params::{Applied, CalibrationParams};
