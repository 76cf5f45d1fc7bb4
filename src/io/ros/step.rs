//! What the pipeline was told, call by call: enough, with the raw pings beside it, to repeat a run bit for bit.
//!
//! A layout only. Times are those that the pipeline was handed as "now"; whoever replays hands it the same.

use crate::geometry::Pose2;
use crate::io::wire::wire_type;
use crate::signal::{SENSORS_MAX, Velocity};
use crate::time::Stamp;
use iceoryx2::prelude::ZeroCopySend;

/// What a step is. The numbers are in recordings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum StepKind {
    /// The pipeline was made: epoch and time of the start.
    Begin = 0,
    /// A ping set was processed.
    PingSet = 1,
    /// The daemon had started.
    Started = 2,
    /// Time passed.
    Tick = 3,
    /// A set was not ready in time.
    DeadlineMissed = 4,
    /// An operator armed.
    Arm = 5,
    /// An operator stopped.
    Stop = 6,
    /// An operator reset.
    Reset = 7,
    /// The program found itself broken.
    InternalError = 8,
    /// A signal asked to end.
    Terminate = 9,
}

impl StepKind {
    const ALL: [StepKind; 10] = [
        StepKind::Begin,
        StepKind::PingSet,
        StepKind::Started,
        StepKind::Tick,
        StepKind::DeadlineMissed,
        StepKind::Arm,
        StepKind::Stop,
        StepKind::Reset,
        StepKind::InternalError,
        StepKind::Terminate,
    ];

    /// The kind with this number, if there is one.
    #[must_use]
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.get(number as usize).copied()
    }
}

pub(crate) fn step_name(number: u32) -> Option<&'static str> {
    const NAMES: [&str; 10] = [
        "begin",
        "ping_set",
        "started",
        "tick",
        "deadline_missed",
        "arm",
        "stop",
        "reset",
        "internal_error",
        "terminate",
    ];
    NAMES.get(number as usize).copied()
}

wire_type! {
    /// One call of the pipeline: what it was told, and when.
    PipelineStep = "noctule.PipelineStep.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// Running number within the recording.
        sequence: u64,
        /// The "now" that the pipeline was handed, CLOCK_BOOTTIME.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// Epoch: the daemon's own for begin, the request's for arm.
        epoch: u64,
        /// When an operator asked, CLOCK_BOOTTIME; arm only.
        requested_at_ns: u64,
        /// Running number of the ping set.
        set_sequence: u64,
        /// Oldest emission of the set, CLOCK_BOOTTIME.
        set_t_monotonic_ns: u64,
        /// The same on the wall clock.
        set_t_wall_ns: u64,
        /// Sequence of each sensor's ping.
        ping_sequence: [u64; SENSORS_MAX],
        /// Forward speed that was wanted.
        wanted_linear_m_s: f64,
        /// Turn rate that was wanted.
        wanted_angular_rad_s: f64,
        /// Position that odometry gave.
        x_m: f64,
        /// Position that odometry gave.
        y_m: f64,
        /// Heading that odometry gave.
        heading_rad: f64,
        /// What the step is.
        kind: u32 as step_name,
        /// Bit k is set when sensor k delivered.
        sensors_present: u32,
        /// 1 when there was a fresh pose.
        has_pose: u32,
        /// 1 when the raw pings of the set are in the recording.
        has_pings: u32,
    }
}

impl PipelineStep {
    /// What the pipeline was handed as "now".
    #[must_use]
    pub fn now(&self) -> Stamp {
        Stamp { boottime_ns: self.t_monotonic_ns, wall_ns: self.t_wall_ns }
    }

    /// Emission of the ping set.
    #[must_use]
    pub fn set_emitted_at(&self) -> Stamp {
        Stamp { boottime_ns: self.set_t_monotonic_ns, wall_ns: self.set_t_wall_ns }
    }

    /// What was wanted.
    #[must_use]
    pub fn wanted(&self) -> Velocity {
        Velocity { linear_m_s: self.wanted_linear_m_s, angular_rad_s: self.wanted_angular_rad_s }
    }

    /// Where the robot was, if that was known.
    #[must_use]
    pub fn pose(&self) -> Option<Pose2> {
        (self.has_pose != 0).then_some(Pose2 { x_m: self.x_m, y_m: self.y_m, heading_rad: self.heading_rad })
    }
}
