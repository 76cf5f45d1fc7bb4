//! The messages of ROS 2's own packages that we write, field by field, and their definitions.
//!
//! Only those fields and their order matter to a reader; the comments of the originals are left out. Computes nothing.

use super::Message;
use serde::de::{Deserializer, Error as _, Visitor};
use serde::ser::Serializer;
use serde::{Deserialize, Serialize};

/// The line between a definition and those of the messages within.
macro_rules! rule {
    () => {
        "================================================================================\n"
    };
}

/// Definition of what every header holds.
macro_rules! time_definition {
    () => {
        concat!(rule!(), "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n")
    };
}

/// Definition of a header, with what it holds.
macro_rules! header_definition {
    () => {
        concat!(rule!(), "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n", time_definition!())
    };
}

macro_rules! vector_definition {
    () => {
        concat!(rule!(), "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n")
    };
}

/// What follows every definition that begins with a header.
pub(super) const HEADER_DEFINITION: &str = header_definition!();

macro_rules! message {
    ($type:ty, $name:literal, $definition:expr) => {
        impl Message for $type {
            fn type_name() -> String {
                $name.to_owned()
            }

            fn schema() -> String {
                $definition.to_owned()
            }
        }
    };
}

/// builtin_interfaces/Time: wall-clock time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Time {
    /// Seconds since 1970.
    pub sec: i32,
    /// Nanoseconds within the second.
    pub nanosec: u32,
}

impl Time {
    /// From nanoseconds since 1970; what the format cannot hold, from 2038 on, stays at its end.
    #[must_use]
    pub fn from_wall_ns(wall_ns: u64) -> Self {
        match i32::try_from(wall_ns / 1_000_000_000) {
            Ok(sec) => Self { sec, nanosec: (wall_ns % 1_000_000_000) as u32 },
            Err(_) => Self { sec: i32::MAX, nanosec: 999_999_999 },
        }
    }
}

/// std_msgs/Header.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Header {
    /// When.
    pub stamp: Time,
    /// In which frame.
    pub frame_id: String,
}

impl Header {
    /// A header at `wall_ns` nanoseconds since 1970.
    #[must_use]
    pub fn new(wall_ns: u64, frame_id: impl Into<String>) -> Self {
        Self { stamp: Time::from_wall_ns(wall_ns), frame_id: frame_id.into() }
    }
}

/// `uint8[]`, copied in one go and borrowed when read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Octets<'a>(pub &'a [u8]);

impl Serialize for Octets<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(self.0)
    }
}

impl<'de: 'a, 'a> Deserialize<'de> for Octets<'a> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Borrow;
        impl<'de> Visitor<'de> for Borrow {
            type Value = &'de [u8];

            fn expecting(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                formatter.write_str("bytes")
            }

            fn visit_borrowed_bytes<E: serde::de::Error>(self, bytes: &'de [u8]) -> Result<Self::Value, E> {
                Ok(bytes)
            }
        }
        deserializer.deserialize_bytes(Borrow).map(Octets).map_err(D::Error::custom)
    }
}

/// sensor_msgs/LaserScan, REP-117: +inf nothing within range, NaN unknown.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct LaserScan {
    /// Emission time, frame of the sensor.
    pub header: Header,
    /// Bearing of the first reading, the rightmost.
    pub angle_min: f32,
    /// Bearing of the last.
    pub angle_max: f32,
    /// Step, above zero.
    pub angle_increment: f32,
    /// Zero: all directions are heard at once.
    pub time_increment: f32,
    /// From one scan to the next, seconds.
    pub scan_time: f32,
    /// Nearest range that is imaged.
    pub range_min: f32,
    /// Farthest range that is imaged.
    pub range_max: f32,
    /// Readings, right to left.
    pub ranges: Vec<f32>,
    /// Energy of each echo; zero without one.
    pub intensities: Vec<f32>,
}
message!(
    LaserScan,
    "sensor_msgs/msg/LaserScan",
    concat!(
        "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\nfloat32 time_increment\n",
        "float32 scan_time\nfloat32 range_min\nfloat32 range_max\nfloat32[] ranges\nfloat32[] intensities\n",
        header_definition!()
    )
);

/// sensor_msgs/Image.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Image<'a> {
    /// Emission time, frame of the sensor.
    pub header: Header,
    /// Rows: directions.
    pub height: u32,
    /// Columns: ranges.
    pub width: u32,
    /// `32FC1`.
    pub encoding: String,
    /// Zero.
    pub is_bigendian: u8,
    /// Bytes of a row.
    pub step: u32,
    /// The rows.
    #[serde(borrow)]
    pub data: Octets<'a>,
}
message!(
    Image<'_>,
    "sensor_msgs/msg/Image",
    concat!(
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n",
        header_definition!()
    )
);

/// sensor_msgs/PointField.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct PointField {
    /// Name.
    pub name: String,
    /// Bytes from the beginning of the point.
    pub offset: u32,
    /// 6: uint32, 7: float32.
    pub datatype: u8,
    /// Number of elements.
    pub count: u32,
}

/// sensor_msgs/PointCloud2.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PointCloud2 {
    /// Emission time, frame of the robot.
    pub header: Header,
    /// 1: the points have no order.
    pub height: u32,
    /// Number of points.
    pub width: u32,
    /// What a point is made of.
    pub fields: Vec<PointField>,
    /// False.
    pub is_bigendian: bool,
    /// Bytes of a point.
    pub point_step: u32,
    /// Bytes of all.
    pub row_step: u32,
    /// The points.
    pub data: Vec<u8>,
    /// True: no point is without a place.
    pub is_dense: bool,
}
message!(
    PointCloud2,
    "sensor_msgs/msg/PointCloud2",
    concat!(
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n",
        "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n",
        rule!(),
        "MSG: sensor_msgs/PointField\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n",
        header_definition!()
    )
);

/// geometry_msgs/Vector3.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Vector3 {
    /// Forward.
    pub x: f64,
    /// Left.
    pub y: f64,
    /// Up.
    pub z: f64,
}

/// geometry_msgs/Quaternion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// Of the axis.
    pub x: f64,
    /// Of the axis.
    pub y: f64,
    /// Of the axis.
    pub z: f64,
    /// Cosine of half the angle.
    pub w: f64,
}

impl Quaternion {
    /// A turn about the vertical axis, counter-clockwise.
    #[must_use]
    pub fn from_yaw_rad(yaw_rad: f64) -> Self {
        let (z, w) = (0.5 * yaw_rad).sin_cos();
        Self { x: 0.0, y: 0.0, z, w }
    }
}

/// geometry_msgs/Twist.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Twist {
    /// Metres a second.
    pub linear: Vector3,
    /// Radians a second.
    pub angular: Vector3,
}

/// geometry_msgs/TwistStamped.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct TwistStamped {
    /// Time and frame.
    pub header: Header,
    /// Velocity.
    pub twist: Twist,
}
message!(
    TwistStamped,
    "geometry_msgs/msg/TwistStamped",
    concat!(
        "std_msgs/Header header\ngeometry_msgs/Twist twist\n",
        rule!(),
        "MSG: geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
        vector_definition!(),
        header_definition!()
    )
);

/// geometry_msgs/Transform.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// Place of the child frame's origin.
    pub translation: Vector3,
    /// How it is turned.
    pub rotation: Quaternion,
}

/// geometry_msgs/TransformStamped.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TransformStamped {
    /// Time and parent frame.
    pub header: Header,
    /// Child frame.
    pub child_frame_id: String,
    /// From child to parent.
    pub transform: Transform,
}

/// tf2_msgs/TFMessage.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct TFMessage {
    /// The transforms.
    pub transforms: Vec<TransformStamped>,
}
message!(
    TFMessage,
    "tf2_msgs/msg/TFMessage",
    concat!(
        "geometry_msgs/TransformStamped[] transforms\n",
        rule!(),
        "MSG: geometry_msgs/TransformStamped\nstd_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
        rule!(),
        "MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
        vector_definition!(),
        rule!(),
        "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
        header_definition!()
    )
);

/// diagnostic_msgs/KeyValue.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct KeyValue {
    /// Name.
    pub key: String,
    /// Value.
    pub value: String,
}

/// diagnostic_msgs/DiagnosticStatus.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// 0 ok, 1 warning, 2 error, 3 stale.
    pub level: u8,
    /// What it is about.
    pub name: String,
    /// State and reason.
    pub message: String,
    /// Whose.
    pub hardware_id: String,
    /// Details.
    pub values: Vec<KeyValue>,
}

/// diagnostic_msgs/DiagnosticArray.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// Time.
    pub header: Header,
    /// What there is to say.
    pub status: Vec<DiagnosticStatus>,
}
message!(
    DiagnosticArray,
    "diagnostic_msgs/msg/DiagnosticArray",
    concat!(
        "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
        rule!(),
        "MSG: diagnostic_msgs/DiagnosticStatus\nbyte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\n",
        "string message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values\n",
        rule!(),
        "MSG: diagnostic_msgs/KeyValue\nstring key\nstring value\n",
        header_definition!()
    )
);

/// geometry_msgs/Pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Place.
    pub position: Vector3,
    /// Heading.
    pub orientation: Quaternion,
}

/// nav_msgs/MapMetaData.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MapMetaData {
    /// When the map was made.
    pub map_load_time: Time,
    /// Edge of a cell, metres.
    pub resolution: f32,
    /// Cells along x.
    pub width: u32,
    /// Cells along y.
    pub height: u32,
    /// Corner of the first cell.
    pub origin: Pose,
}

/// nav_msgs/OccupancyGrid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OccupancyGrid {
    /// Time and frame.
    pub header: Header,
    /// Size and place.
    pub info: MapMetaData,
    /// Row by row from the origin: 0 to 100 per cent, -1 unknown.
    pub data: Vec<i8>,
}
message!(
    OccupancyGrid,
    "nav_msgs/msg/OccupancyGrid",
    concat!(
        "std_msgs/Header header\nnav_msgs/MapMetaData info\nint8[] data\n",
        rule!(),
        "MSG: nav_msgs/MapMetaData\nbuiltin_interfaces/Time map_load_time\nfloat32 resolution\nuint32 width\nuint32 height\n",
        "geometry_msgs/Pose origin\n",
        rule!(),
        "MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
        rule!(),
        "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n",
        rule!(),
        "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
        header_definition!()
    )
);
