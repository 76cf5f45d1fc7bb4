//! What stands where in space: points of a robot with their uncertainties, and the slice of them that the robot drives in.
//!
//! Data only. Heights are those above the plane of the sensors' origins. Who makes it is [`crate::detect::SpaceDetector`].

use crate::time::Stamp;
use nalgebra::{Matrix3, Vector3};

/// Most points of a cloud.
pub const POINTS_MAX: usize = 192;
/// Bearings of the slice: two degrees each, from straight behind counter-clockwise.
pub const SLICE_BEARINGS: usize = 180;

/// What a point is to a robot of a certain height.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(u32)]
pub enum SpaceClass {
    /// Below the lowest part of the robot.
    Floor = 0,
    /// At the robot's height: it is in the way.
    #[default]
    Obstacle = 1,
    /// Above the robot, which passes under it.
    Overhang = 2,
    /// As high as what echoes from straight above.
    Ceiling = 3,
}

impl SpaceClass {
    /// All of them, by number.
    pub const ALL: [Self; 4] = [Self::Floor, Self::Obstacle, Self::Overhang, Self::Ceiling];

    /// Its name.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Floor => "floor",
            Self::Obstacle => "obstacle",
            Self::Overhang => "overhang",
            Self::Ceiling => "ceiling",
        }
    }
}

/// One reflecting point, in the robot frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SpacePoint {
    /// Forward, left, above the plane of the sensors' origins.
    pub position_m: Vector3<f64>,
    /// Its covariance.
    pub covariance_m2: Matrix3<f64>,
    /// Envelope, linear amplitude in units of full scale.
    pub energy: f32,
    /// Index of the sensor that heard it.
    pub sensor_index: usize,
    /// What it is.
    pub class: SpaceClass,
}

/// The points of one ping set.
#[derive(Debug, Clone, PartialEq)]
pub struct PointCloud {
    /// Sequence of the ping set.
    pub sequence: u64,
    /// Its oldest emission.
    pub emitted_at: Stamp,
    /// The points, sensor by sensor; never more than [`POINTS_MAX`].
    pub points: Vec<SpacePoint>,
    /// Nearest obstacle of each bearing, from the robot's centre; infinite without one.
    pub slice_m: [f64; SLICE_BEARINGS],
    /// Height of the floor as heard from straight above it, once that was heard often enough.
    pub floor_m: Option<f64>,
    /// Height of the ceiling.
    pub ceiling_m: Option<f64>,
}

impl PointCloud {
    /// An empty cloud with room for all points.
    #[must_use]
    pub fn empty() -> Self {
        Self {
            sequence: 0,
            emitted_at: Stamp::default(),
            points: Vec::with_capacity(POINTS_MAX),
            slice_m: [f64::INFINITY; SLICE_BEARINGS],
            floor_m: None,
            ceiling_m: None,
        }
    }
}
