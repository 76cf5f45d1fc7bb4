//! What is sensed, decided and asked for, as it lies in shared memory: raw pings, energyscapes, commands, wanted
//! velocities, operator requests, odometry; with the conversions to and from the nouns of [`crate::signal`].
//!
//! Layouts only; who may send what is told by [`crate::io::topics`]. Times are `t_monotonic_ns` (CLOCK_BOOTTIME).

use super::{Checked, HEADER_VERSION, NO_SENSOR, WireType, wire_type};
use crate::geometry::Pose2;
use crate::safety::check_age;
use crate::signal::{Cause, DaemonState, Decision, LayerName, PolarGrid, Reason, SampleFormat, Velocity};
use crate::time::Stamp;
use iceoryx2::prelude::ZeroCopySend;

/// Set in [`EnergyscapeHeader::flags`] when the directions are equally spaced in the horizontal plane, so that first
/// direction and step tell them all.
pub const FLAG_EQUAL_DIRECTIONS: u32 = 1;
/// Set in [`EnergyscapeHeader::flags`] when channels were left out of the image.
pub const FLAG_CHANNELS_LEFT_OUT: u32 = 2;
/// Set in [`EnergyscapeHeader::flags`] when the CPU redid what the GPU failed to do.
pub const FLAG_BACKEND_FALLBACK: u32 = 4;
/// Set in [`EnergyscapeHeader::flags`] when the sensor is no witness of free space: it did not hear its own emission, or too few of its
/// channels are sound. Echoes in the image may be real; silence in it means nothing.
pub const FLAG_NO_WITNESS: u32 = 8;

wire_type! {
    /// Header of a raw ping; the payload is `[u32]` PDM words, or `[i16]` or `[f32]` PCM as `[channel][sample]`.
    RawHeader = "noctule.RawHeader.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// The sensor's own running number.
        sequence: u64,
        /// Emission: time of sample 0, CLOCK_BOOTTIME.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// Rate of PDM words or PCM samples.
        sample_rate_hz: f64,
        /// Version of the header: 1.
        version: u32,
        /// Index of the sensor in the configuration.
        sensor_index: u32,
        /// Microphones.
        channel_count: u32,
        /// PDM words, or PCM samples of one microphone.
        sample_count: u32,
        /// 0 PDM words, 1 PCM i16, 2 PCM f32.
        format: u32 as format_name,
        /// None yet: 0.
        flags: u32,
    }
}

wire_type! {
    /// Header of an energyscape; the payload is `[f32]`, row-major `[direction][range]`.
    EnergyscapeHeader = "noctule.EnergyscapeHeader.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// Sequence of the raw ping.
        sequence: u64,
        /// Emission: time of sample 0 of the raw ping, CLOCK_BOOTTIME.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// When the image was complete, CLOCK_BOOTTIME.
        t_completed_ns: u64,
        /// First direction, 0 on boresight, positive to the left (flag 1).
        direction_first_rad: f64,
        /// Step between directions (flag 1).
        direction_step_rad: f64,
        /// Range of the first bin.
        range_first_m: f64,
        /// Step between bins.
        range_step_m: f64,
        /// Speed of sound that the ranges were computed with.
        speed_of_sound_m_s: f64,
        /// Version of the header: 1.
        version: u32,
        /// Index of the sensor in the configuration.
        sensor_index: u32,
        /// Rows.
        direction_count: u32,
        /// Columns.
        range_count: u32,
        /// 0 CPU, 1 GPU.
        backend: u32 as backend_name,
        /// 1 equally spaced directions, 2 channels left out, 4 the CPU redid what the GPU failed to do, 8 silence here is no free space.
        flags: u32,
    }
}

wire_type! {
    /// A velocity for the controller process, after every ping set, in every state of the daemon.
    VelocityCommand = "noctule.VelocityCommand.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// Random number of this start of the daemon.
        epoch: u64,
        /// Random number of this publisher.
        publisher_id: u64,
        /// Running number within the epoch.
        sequence: u64,
        /// Oldest emission that it was made from, CLOCK_BOOTTIME: what its age is judged by.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// When it was published, CLOCK_BOOTTIME.
        t_published_ns: u64,
        /// Not to be followed later than this, CLOCK_BOOTTIME; MAX_AGE holds besides.
        valid_until_ns: u64,
        /// Forward speed V.
        linear_m_s: f64,
        /// Turn rate omega, counter-clockwise.
        angular_rad_s: f64,
        /// Highest forward speed that the seen way allows.
        speed_limit_m_s: f64,
        /// Range of the reflection behind the decision.
        cause_range_m: f64,
        /// Its bearing from the sensor.
        cause_bearing_rad: f64,
        /// What was compared with the threshold.
        cause_energy: f64,
        /// The threshold.
        cause_threshold: f64,
        /// Sensor that heard it; 4294967295 for none.
        cause_sensor: u32,
        /// Layer that decided.
        layer: u32 as layer_name,
        /// State of the daemon.
        state: u32 as daemon_state_name,
        /// Why it is in that state.
        reason: u32 as reason_name,
        /// 1 when there is no progress although motion is asked for.
        stuck: u32,
        /// CRC-32 (IEEE) of all bytes before it.
        checksum: u32,
    }
}

wire_type! {
    /// The velocity that a planner or an operator wants.
    VelocityInput = "noctule.VelocityInput.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// Running number of the sender.
        sequence: u64,
        /// When it was wanted, CLOCK_BOOTTIME.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// Forward speed.
        linear_m_s: f64,
        /// Turn rate, counter-clockwise.
        angular_rad_s: f64,
    }
}

wire_type! {
    /// What an operator asks daemon and controller for.
    OperatorRequest = "noctule.OperatorRequest.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// Epoch of the daemon to be armed; read for arm only.
        epoch: u64,
        /// Running number of the sender.
        sequence: u64,
        /// When it was asked for, CLOCK_BOOTTIME; an arm request is obeyed for one second.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// 1 arm, 2 stop, 3 reset.
        request: u32 as request_name,
        /// CRC-32 (IEEE) of all bytes before it.
        checksum: u32,
    }
}

wire_type! {
    /// Pose and twist of the robot.
    Odometry = "noctule.Odometry.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// Running number of the sender.
        sequence: u64,
        /// When it was measured, CLOCK_BOOTTIME.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// Position in the odometry frame.
        x_m: f64,
        /// Position in the odometry frame.
        y_m: f64,
        /// Heading, counter-clockwise.
        heading_rad: f64,
        /// Forward speed.
        linear_m_s: f64,
        /// Turn rate, counter-clockwise.
        angular_rad_s: f64,
    }
}

impl Checked for VelocityCommand {
    const CHECKSUM_OFFSET: usize = std::mem::offset_of!(VelocityCommand, checksum);

    fn checksum_field(&self) -> u32 {
        self.checksum
    }
}

impl Checked for OperatorRequest {
    const CHECKSUM_OFFSET: usize = std::mem::offset_of!(OperatorRequest, checksum);

    fn checksum_field(&self) -> u32 {
        self.checksum
    }
}

pub(crate) fn format_name(number: u32) -> Option<&'static str> {
    ["pdm", "pcm-i16", "pcm-f32"].get(number as usize).copied()
}

pub(crate) fn backend_name(number: u32) -> Option<&'static str> {
    ["cpu", "gpu"].get(number as usize).copied()
}

pub(crate) fn daemon_state_name(number: u32) -> Option<&'static str> {
    DaemonState::from_number(number).map(DaemonState::as_str)
}

pub(crate) fn reason_name(number: u32) -> Option<&'static str> {
    Reason::from_number(number).map(Reason::as_str)
}

pub(crate) fn layer_name(number: u32) -> Option<&'static str> {
    LayerName::from_number(number).map(LayerName::as_str)
}

pub(crate) fn request_name(number: u32) -> Option<&'static str> {
    Request::from_number(number).map(Request::as_str)
}

/// What an operator can ask for. The numbers are on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Request {
    /// Move.
    Arm = 1,
    /// Stand still until armed again.
    Stop = 2,
    /// Leave FAULT.
    Reset = 3,
}

impl Request {
    /// `arm`, `stop` or `reset`.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Request::Arm => "arm",
            Request::Stop => "stop",
            Request::Reset => "reset",
        }
    }

    fn from_number(number: u32) -> Option<Self> {
        [Request::Arm, Request::Stop, Request::Reset].into_iter().find(|&request| request as u32 == number)
    }
}

/// The number of a raw format on the wire.
#[must_use]
pub fn format_number(format: SampleFormat) -> u32 {
    match format {
        SampleFormat::Pdm => 0,
        SampleFormat::PcmI16 => 1,
        SampleFormat::PcmF32 => 2,
    }
}

/// The raw format of this number on the wire, if there is one.
#[must_use]
pub fn format_of(number: u32) -> Option<SampleFormat> {
    [SampleFormat::Pdm, SampleFormat::PcmI16, SampleFormat::PcmF32]
        .into_iter()
        .find(|&format| format_number(format) == number)
}

impl EnergyscapeHeader {
    /// Whether the writer's layout was ours and `len` values are the image that it describes.
    #[must_use]
    pub fn describes(&self, len: usize) -> bool {
        let cells = u64::from(self.direction_count) * u64::from(self.range_count);
        self.schema_matches() && cells == len as u64 && cells > 0
    }

    /// A header that describes `grid`; sequence, times and backend are left at zero.
    #[must_use]
    pub fn for_grid(grid: &PolarGrid, sensor_index: usize, speed_of_sound_m_s: f64) -> Self {
        let directions = grid.directions();
        let first_rad = directions.first().map_or(0.0, |direction| direction.azimuth_rad);
        let last_rad = directions.last().map_or(0.0, |direction| direction.azimuth_rad);
        let step_rad = (last_rad - first_rad) / (directions.len().max(2) - 1) as f64;
        let equal = grid.is_horizontal()
            && directions
                .iter()
                .enumerate()
                .all(|(index, direction)| (direction.azimuth_rad - first_rad - index as f64 * step_rad).abs() <= 1e-9);
        Self {
            version: HEADER_VERSION,
            sensor_index: sensor_index as u32,
            direction_count: grid.direction_count() as u32,
            range_count: grid.range_count() as u32,
            direction_first_rad: if equal { first_rad } else { 0.0 },
            direction_step_rad: if equal { step_rad } else { 0.0 },
            range_first_m: grid.range_first_m(),
            range_step_m: grid.range_step_m(),
            speed_of_sound_m_s,
            flags: if equal { FLAG_EQUAL_DIRECTIONS } else { 0 },
            ..Self::blank()
        }
    }
}

impl VelocityCommand {
    /// A command that carries `decision`, limited to `velocity` by the daemon's state; epoch, publisher, sequence, time of
    /// publishing and checksum are filled in by the publisher.
    #[must_use]
    pub fn from_decision(decision: &Decision, velocity: Velocity, state: DaemonState, reason: Reason) -> Self {
        Self {
            t_monotonic_ns: decision.emitted_at.boottime_ns,
            t_wall_ns: decision.emitted_at.wall_ns,
            valid_until_ns: u64::MAX,
            linear_m_s: velocity.linear_m_s,
            angular_rad_s: velocity.angular_rad_s,
            speed_limit_m_s: decision.speed_limit_m_s,
            cause_range_m: decision.cause.range_m,
            cause_bearing_rad: decision.cause.bearing_rad,
            cause_energy: decision.cause.energy,
            cause_threshold: decision.cause.threshold,
            cause_sensor: decision.cause.sensor_index.map_or(NO_SENSOR, |index| index as u32),
            layer: decision.layer as u32,
            state: state.number(),
            reason: reason.number(),
            stuck: u32::from(decision.stuck),
            ..Self::blank()
        }
    }

    /// A command to stand still, made without a decision. `emitted_at` is the newest capture known.
    #[must_use]
    pub fn standstill(emitted_at: Stamp, state: DaemonState, reason: Reason) -> Self {
        let decision = Decision {
            emitted_at,
            velocity: Velocity::ZERO,
            layer: LayerName::Stopped,
            cause: Cause::default(),
            speed_limit_m_s: 0.0,
            stuck: false,
        };
        Self::from_decision(&decision, Velocity::ZERO, state, reason)
    }

    /// The commanded velocity.
    #[must_use]
    pub fn velocity(&self) -> Velocity {
        Velocity { linear_m_s: self.linear_m_s, angular_rad_s: self.angular_rad_s }
    }

    /// The daemon's state, `None` if the number is unknown.
    #[must_use]
    pub fn daemon_state(&self) -> Option<DaemonState> {
        DaemonState::from_number(self.state)
    }

    /// The same command with its checksum.
    #[must_use]
    pub fn sealed(mut self) -> Self {
        self.checksum = self.compute_checksum();
        self
    }
}

impl VelocityInput {
    /// A wanted velocity at `now`.
    #[must_use]
    pub fn new(sequence: u64, now: Stamp, velocity: Velocity) -> Self {
        Self {
            sequence,
            t_monotonic_ns: now.boottime_ns,
            t_wall_ns: now.wall_ns,
            linear_m_s: velocity.linear_m_s,
            angular_rad_s: velocity.angular_rad_s,
            ..Self::blank()
        }
    }

    /// The wanted velocity at `now`: (0, 0) when older than `max_age_ns`, from more than 50 ms ahead, or not finite.
    #[must_use]
    pub fn wanted(&self, now: Stamp, max_age_ns: u64) -> Velocity {
        let velocity = Velocity { linear_m_s: self.linear_m_s, angular_rad_s: self.angular_rad_s };
        let fresh = check_age(self.t_monotonic_ns, now, max_age_ns).is_ok();
        if fresh && velocity.is_finite() && self.schema_matches() { velocity } else { Velocity::ZERO }
    }
}

impl OperatorRequest {
    /// A sealed request made at `now`.
    #[must_use]
    pub fn new(request: Request, epoch: u64, sequence: u64, now: Stamp) -> Self {
        let mut made = Self {
            epoch,
            sequence,
            t_monotonic_ns: now.boottime_ns,
            t_wall_ns: now.wall_ns,
            request: request as u32,
            ..Self::blank()
        };
        made.checksum = made.compute_checksum();
        made
    }

    /// What is asked for. A stop is believed even when the rest is spoilt; arm and reset only when nothing is.
    #[must_use]
    pub fn request(&self) -> Option<Request> {
        let sound = self.schema_matches() && self.checksum_matches();
        Request::from_number(self.request).filter(|&request| sound || request == Request::Stop)
    }
}

impl Odometry {
    /// A measured pose and twist.
    #[must_use]
    pub fn new(sequence: u64, at: Stamp, pose: Pose2, twist: Velocity) -> Self {
        Self {
            sequence,
            t_monotonic_ns: at.boottime_ns,
            t_wall_ns: at.wall_ns,
            x_m: pose.x_m,
            y_m: pose.y_m,
            heading_rad: pose.heading_rad,
            linear_m_s: twist.linear_m_s,
            angular_rad_s: twist.angular_rad_s,
            ..Self::blank()
        }
    }

    /// The pose.
    #[must_use]
    pub fn pose(&self) -> Pose2 {
        Pose2 { x_m: self.x_m, y_m: self.y_m, heading_rad: self.heading_rad }
    }

    /// Pose and time, if the pose is made of numbers.
    #[must_use]
    pub fn dated_pose(&self) -> Option<(Pose2, Stamp)> {
        let at = Stamp { boottime_ns: self.t_monotonic_ns, wall_ns: self.t_wall_ns };
        let finite = self.x_m.is_finite() && self.y_m.is_finite() && self.heading_rad.is_finite();
        finite.then_some((self.pose(), at))
    }

    /// The twist.
    #[must_use]
    pub fn twist(&self) -> Velocity {
        Velocity { linear_m_s: self.linear_m_s, angular_rad_s: self.angular_rad_s }
    }
}
