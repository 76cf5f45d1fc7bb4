//! Our nouns as ROS 2 messages: structs, their schemas as recorders write them, and the encoding (CDR, little-endian, with
//! its four bytes of encapsulation in front), so that any ROS tool reads what we record or serve.
//!
//! Pure: bytes and structs only. Conventions of REP-103, 105 and 117: metres, radians, counter-clockwise; `base_link` and
//! `sonar_<name>`; +inf for nothing within range, NaN for what cannot be known. Stamps are wall-clock time of the emission.
//! Never opens a file and never links ROS.

mod convert;
mod standard;
mod step;
mod wire_message;

pub use convert::{
    command_twist, energyscape_image, health_diagnostics, laser_scan, mount_transforms, objects_frame, occupancy_grid,
    odometry_transform, platform_diagnostics, platform_twist, point_cloud, robot_laser_scan,
};
pub use standard::{
    DiagnosticArray, DiagnosticStatus, Header, Image, KeyValue, LaserScan, MapMetaData, OccupancyGrid, Octets,
    PointCloud2, PointField, Pose, Quaternion, TFMessage, Time, Transform, TransformStamped, Twist, TwistStamped,
    Vector3,
};
pub use step::{PipelineStep, StepKind};
pub use wire_message::{RawPingMessage, WireMessage};

use cdr_encoding::{CdrDeserializer, CdrSerializer};
use serde::{Deserialize, Serialize};

/// Frame of the robot.
pub const BASE_FRAME: &str = "base_link";
/// Frame that odometry is given in.
pub const ODOMETRY_FRAME: &str = "odom";
/// Encoding of schemas.
pub const SCHEMA_ENCODING: &str = "ros2msg";
/// Encoding of messages.
pub const MESSAGE_ENCODING: &str = "cdr";
/// CDR, little-endian, no options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Topic of commands as ROS knows velocities.
pub const COMMAND_TWIST_TOPIC: &str = "/noctule/cmd_vel";
/// Topic of what the controller really commands, as ROS knows velocities.
pub const PLATFORM_TWIST_TOPIC: &str = "/noctule/platform_vel";
/// Topic of the scan of the whole robot as ROS knows scans.
pub const LASER_SCAN_TOPIC: &str = "/noctule/laser_scan";
/// Topic of the points in space as ROS knows clouds.
pub const POINT_CLOUD_TOPIC: &str = "/noctule/point_cloud";
/// Topic of the occupancy map as ROS knows maps.
pub const MAP_TOPIC: &str = "/noctule/map";
/// Topic of diagnostics.
pub const DIAGNOSTICS_TOPIC: &str = "/diagnostics";
/// Topic of where the sensors stand.
pub const MOUNTS_TOPIC: &str = "/tf_static";
/// What the topics of all sensors begin with.
const SONAR_TOPICS: &str = "/noctule/sonar/";

/// Topic of a sensor's `leaf`: energyscape, scan, raw.
#[must_use]
pub fn sonar_topic(sensor: &str, leaf: &str) -> String {
    format!("{SONAR_TOPICS}{sensor}/{leaf}")
}

/// Sensor and leaf of a topic, if it is one of a sensor.
#[must_use]
pub fn sonar_of(topic: &str) -> Option<(&str, &str)> {
    topic.strip_prefix(SONAR_TOPICS)?.rsplit_once('/')
}

/// Frame of a sensor.
#[must_use]
pub fn sensor_frame(sensor: &str) -> String {
    format!("sonar_{sensor}")
}

/// A message with a name and a schema.
pub trait Message: Serialize {
    /// Package, `msg` and name: `sensor_msgs/msg/LaserScan`.
    fn type_name() -> String;
    /// Definition in ROS 2's language, followed by those of the messages within, each after a line of 80 `=`.
    fn schema() -> String;
}

/// Why bytes are no message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RosError {
    /// They do not begin as CDR in little-endian does.
    #[error("the message begins with {found:02x?}, allowed is CDR in little-endian: [00, 01, 00, 00]")]
    Encapsulation {
        /// What they begin with.
        found: Vec<u8>,
    },
    /// They end early, or a length or text in them cannot be.
    #[error("the message is no {expected}: {reason}")]
    Malformed {
        /// What was expected.
        expected: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// Another build wrote them, with other fields.
    #[error("{type_name} has layout {found:016x}, this build reads {allowed:016x}")]
    Layout {
        /// The type.
        type_name: &'static str,
        /// Schema hash found.
        found: u64,
        /// Schema hash of this build.
        allowed: u64,
    },
}

/// Writes `message` into `bytes`, in place of what was there.
///
/// # Errors
/// [`RosError::Malformed`] for what CDR cannot carry: more than 4 GiB.
pub fn encode_into<T: Serialize + ?Sized>(message: &T, bytes: &mut Vec<u8>) -> Result<(), RosError> {
    bytes.clear();
    bytes.extend_from_slice(&ENCAPSULATION);
    // Alignment counts from behind the encapsulation, as the serializer's own counter does.
    let mut serializer = CdrSerializer::<_, byteorder::LittleEndian>::new(&mut *bytes);
    message
        .serialize(&mut serializer)
        .map_err(|error| RosError::Malformed { expected: "message", reason: error.to_string() })
}

/// The message in `bytes`; what is borrowed points into them.
///
/// # Errors
/// [`RosError`].
pub fn decode<'de, T: Deserialize<'de>>(bytes: &'de [u8]) -> Result<T, RosError> {
    let Some(body) = bytes.strip_prefix(&ENCAPSULATION) else {
        return Err(RosError::Encapsulation { found: bytes.iter().copied().take(4).collect() });
    };
    let mut deserializer = CdrDeserializer::<byteorder::LittleEndian>::new(body);
    T::deserialize(&mut deserializer)
        .map_err(|error| RosError::Malformed { expected: std::any::type_name::<T>(), reason: error.to_string() })
}

#[cfg(test)]
mod tests;
