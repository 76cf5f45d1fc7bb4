//! Facts about the hardware, computed once: array, emission, mount, what the robot's own parts hide, and how the raw
//! data is delivered.

pub mod air;
pub mod array;
pub mod dead_zone;
pub mod emission;
pub mod emission_plan;
pub mod mount;
pub mod params;
pub mod recording;
mod table;

pub use array::MicrophoneArray;
pub use dead_zone::{DeadZone, hidden_directions};
pub use emission::{Emission, EmissionParams, EmissionShape};
pub use emission_plan::{EmissionPlan, SensorEmission, Sweeps};
pub use mount::Mount;
pub use params::{ERTIS_V3D1, MountParams, SensorParams};
pub use recording::{RecordingFormat, RecordingParams};

use nalgebra::Vector3;
use std::sync::Arc;

/// One sensor as it stands on the robot.
#[derive(Debug, Clone)]
pub struct SensorSetup {
    /// Name, part of the topic names.
    pub name: String,
    /// Where it stands and looks.
    pub mount: Mount,
    /// Its microphones.
    pub array: MicrophoneArray,
    /// What it sends out.
    pub emission: Arc<Emission>,
    /// Place of the emitter in the sensor frame.
    pub emitter_m: Vector3<f64>,
}

/// What `make` makes of the emission of each sensor, by the sensor's index; sensors with equal emissions share one.
pub fn per_emission<T>(sensors: &[SensorSetup], make: impl Fn(usize) -> T) -> Vec<Arc<T>> {
    let mut made: Vec<Arc<T>> = Vec::with_capacity(sensors.len());
    for (index, sensor) in sensors.iter().enumerate() {
        let twin = sensors[..index].iter().position(|other| other.emission == sensor.emission);
        made.push(twin.map_or_else(|| Arc::new(make(index)), |twin| Arc::clone(&made[twin])));
    }
    made
}
