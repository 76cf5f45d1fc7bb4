//! Velocities and decisions.

use crate::time::Stamp;

/// Velocity of the robot in its own plane.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Velocity {
    /// Forward speed V.
    pub linear_m_s: f64,
    /// Turn rate omega, counter-clockwise.
    pub angular_rad_s: f64,
}

impl Velocity {
    /// Standing still.
    pub const ZERO: Velocity = Velocity { linear_m_s: 0.0, angular_rad_s: 0.0 };

    /// Straight ahead.
    #[must_use]
    pub fn forward_m_s(linear_m_s: f64) -> Self {
        Self { linear_m_s, angular_rad_s: 0.0 }
    }

    /// Whether both components are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.linear_m_s.is_finite() && self.angular_rad_s.is_finite()
    }
}

/// The behaviour layers in order of priority, and what else a decision can come from. The numbers are on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u8)]
pub enum LayerName {
    /// No layer is triggered: the wanted velocity passes through, within the limits.
    PassThrough = 0,
    /// CA.
    CollisionAvoidance = 1,
    /// OA.
    ObstacleAvoidance = 2,
    /// AFF.
    FlowFollowing = 3,
    /// RCF.
    CorridorFollowing = 4,
    /// Nothing was decided: the daemon's state forbids motion.
    Stopped = 5,
}

impl LayerName {
    /// The four layers, highest priority first.
    pub const LAYERS: [LayerName; 4] = [
        LayerName::CollisionAvoidance,
        LayerName::ObstacleAvoidance,
        LayerName::FlowFollowing,
        LayerName::CorridorFollowing,
    ];

    /// Everything that a decision can come from, in the order of the numbers.
    pub const ALL: [LayerName; 6] = [
        LayerName::PassThrough,
        LayerName::CollisionAvoidance,
        LayerName::ObstacleAvoidance,
        LayerName::FlowFollowing,
        LayerName::CorridorFollowing,
        LayerName::Stopped,
    ];

    /// The one with this number, if there is one.
    #[must_use]
    pub fn from_number(number: u32) -> Option<Self> {
        LayerName::ALL.get(number as usize).copied()
    }

    /// The name as configuration, JSON and file names write it.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            LayerName::PassThrough => "pass_through",
            LayerName::CollisionAvoidance => "collision_avoidance",
            LayerName::ObstacleAvoidance => "obstacle_avoidance",
            LayerName::FlowFollowing => "flow_following",
            LayerName::CorridorFollowing => "corridor_following",
            LayerName::Stopped => "stopped",
        }
    }
}

/// Why a decision is what it is: the reflection that mattered most, and its energy against the threshold.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Cause {
    /// Sensor that heard it, if one did.
    pub sensor_index: Option<usize>,
    /// Range from that sensor; zero without a sensor.
    pub range_m: f64,
    /// Bearing from that sensor; zero without a sensor.
    pub bearing_rad: f64,
    /// What was compared with the threshold.
    pub energy: f64,
    /// The threshold.
    pub threshold: f64,
}

/// What the controller wants the robot to do, and why.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decision {
    /// Emission time of the cues it was made from, unchanged.
    pub emitted_at: Stamp,
    /// The commanded velocity, within all limits.
    pub velocity: Velocity,
    /// The layer that made it.
    pub layer: LayerName,
    /// The reflection behind it.
    pub cause: Cause,
    /// Highest forward speed that the seen way allows now.
    pub speed_limit_m_s: f64,
    /// No progress for the configured time while motion was asked for.
    pub stuck: bool,
}
