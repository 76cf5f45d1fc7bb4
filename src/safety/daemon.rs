//! The daemon's state machine: what was found in each ping set, operator requests and time in; the state, and how fast a
//! command may be, out. Pure: `(daemon, event, now) -> (daemon, output)`.
//!
//! BOOT, SELFTEST, READY, ACTIVE, DEGRADED, STOPPED, FAULT, SHUTDOWN of the safe-state contract. STOPPED ends by itself,
//! FAULT only by an operator, motion begins only by an operator. Never looks at samples: [`super::plausibility`] does.

use super::{AgeError, GOOD_IN_A_ROW, OperatorEvent, Transition, arm_is_current, check_age};
use crate::signal::{DaemonState, Reason, SENSORS_MAX, Velocity};
use crate::time::Stamp;

/// Highest forward speed while something is lost.
pub const DEGRADED_SPEED_M_S: f64 = 0.1;
/// Channels left out without a consequence for the state.
pub const BAD_CHANNELS_GOOD_MAX: usize = 2;
/// Channels left out with which a ping is still usable.
pub const BAD_CHANNELS_USABLE_MAX: usize = 8;
/// Channels clipped after the direct path that are still a fault of channels, not a near obstacle.
pub const CLIPPED_CHANNELS_MAX: usize = 2;
/// Spread of the emission times of one set from which the state is DEGRADED.
pub const DESYNC_WARNING_NS: u64 = 2_000;
/// Spread of the emission times of one set from which the state is FAULT.
pub const DESYNC_FAULT_NS: u64 = 100_000;
/// Gaps in a sensor's sequence numbers, in a row, that make the state DEGRADED.
pub const SEQUENCE_GAPS_MAX: u32 = 3;
/// Ping sets missed in a row that stop the robot.
const MISSED_MAX: u32 = 2;
/// Unusable pings of one sensor in a row that are a dead array, not a disturbance.
const UNUSABLE_MAX: u32 = 5;
/// Stops within [`STOPS_WINDOW_NS`] that make a fault.
const STOPS_MAX: usize = 5;
const STOPS_WINDOW_NS: i64 = 60_000_000_000;
/// Hard limit from start to READY.
const START_LIMIT_NS: i64 = 10_000_000_000;
/// Exit code when the limit is passed: something that the daemon needs is not there.
const EXIT_UNAVAILABLE: u8 = 69;

/// What was found of one sensor's part of a ping set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SensorFindings {
    /// It delivered in time.
    pub present: bool,
    /// Its ping could not be decoded or does not fit the configuration. What follows is then not judged.
    pub rejected: bool,
    /// Channels left out for any reason but the configuration, clipped ones included.
    pub bad_channels: usize,
    /// Channels clipped later than the end of the emission + 2 ms.
    pub clipped_channels: usize,
    /// It hears its own emission.
    pub direct_path: bool,
    /// The delays of the direct path fit the array's geometry, or do not for too short a time to be sure.
    pub channel_map_fits: bool,
    /// They do not fit in this ping, or were never judged.
    pub channel_map_doubted: bool,
    /// Its samples repeat those of the ping before.
    pub frozen: bool,
    /// Sets in a row with missing sequence numbers, this one included.
    pub gaps_in_a_row: u32,
}

impl SensorFindings {
    /// Nothing wrong.
    pub const GOOD: SensorFindings = SensorFindings {
        present: true,
        rejected: false,
        bad_channels: 0,
        clipped_channels: 0,
        direct_path: true,
        channel_map_fits: true,
        channel_map_doubted: false,
        frozen: false,
        gaps_in_a_row: 0,
    };
    /// Did not deliver.
    pub const ABSENT: SensorFindings = SensorFindings { present: false, ..SensorFindings::GOOD };

    /// Whether its image may be relied on.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        self.present
            && !self.rejected
            && !self.channel_map_doubted
            && self.clipped_channels <= CLIPPED_CHANNELS_MAX
            && self.bad_channels <= BAD_CHANNELS_USABLE_MAX
    }
}

/// What was found of a ping set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GroupFindings {
    /// Oldest emission time in the set, CLOCK_BOOTTIME.
    pub captured_at_ns: u64,
    /// One entry a configured sensor; the rest is not read.
    pub sensors: [SensorFindings; SENSORS_MAX],
    /// Spread of the emission times.
    pub desync_ns: u64,
    /// The GPU failed and the CPU redid the set in time.
    pub backend_fallback: bool,
    /// A part of the way that the robot may take is seen by no healthy sensor.
    pub view_missing: bool,
}

/// What happens to the daemon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DaemonEvent {
    /// Configuration valid, lock taken, topics up, memory reserved.
    Started,
    /// The backend's image of a test ping equals the CPU reference.
    BackendVerified,
    /// It does not.
    BackendMismatch,
    /// A ping set was imaged.
    Group(GroupFindings),
    /// A ping set was not ready in time and was given up.
    DeadlineMissed,
    /// Time passed.
    Tick,
    /// An operator asked for something.
    Operator(OperatorEvent),
    /// The program found itself broken.
    InternalError,
    /// A signal asks to end.
    Terminate,
}

/// What the daemon may do after an event.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DaemonOutput {
    /// The state after the event.
    pub state: DaemonState,
    /// Why.
    pub reason: Reason,
    /// The change of state, if there was one.
    pub transition: Option<Transition<DaemonState>>,
    /// Why an operator's request was not obeyed.
    pub refusal: Option<Reason>,
    /// The process has to end with this code.
    pub exit_code: Option<u8>,
}

impl DaemonOutput {
    /// The velocity that may be published where `wanted` was decided: zero unless the state allows motion; slow and
    /// never backwards when DEGRADED; zero for anything not finite.
    #[must_use]
    pub fn limit(&self, wanted: Velocity) -> Velocity {
        match self.state {
            _ if !wanted.is_finite() => Velocity::ZERO,
            DaemonState::Active => wanted,
            DaemonState::Degraded => Velocity {
                linear_m_s: wanted.linear_m_s.clamp(0.0, DEGRADED_SPEED_M_S),
                angular_rad_s: wanted.angular_rad_s,
            },
            _ => Velocity::ZERO,
        }
    }
}

/// How bad a ping set is. The order is the order of importance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Severity {
    Good,
    Slow,
    Stop,
    Fault,
}

/// The daemon with everything it remembers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Daemon {
    sensor_count: usize,
    max_age_ns: u64,
    epoch: u64,
    state: DaemonState,
    reason: Reason,
    started_at: Stamp,
    was_ready: bool,
    disarmed_at_ns: u64,
    backend_verified: bool,
    captured_at_ns: Option<u64>,
    usable_in_a_row: [u32; SENSORS_MAX],
    unusable_in_a_row: [u32; SENSORS_MAX],
    good_in_a_row: u32,
    missed_in_a_row: u32,
    stopped_at: [Option<Stamp>; STOPS_MAX],
}

impl Daemon {
    /// A daemon in BOOT that has `sensor_count` sensors (at most [`SENSORS_MAX`] are looked at). `epoch` is random per start.
    #[must_use]
    pub fn new(sensor_count: usize, max_age_ns: u64, epoch: u64, now: Stamp) -> Self {
        Self {
            sensor_count: sensor_count.min(SENSORS_MAX),
            max_age_ns,
            epoch,
            state: DaemonState::Boot,
            reason: Reason::Starting,
            started_at: now,
            was_ready: false,
            disarmed_at_ns: now.boottime_ns,
            backend_verified: false,
            captured_at_ns: None,
            usable_in_a_row: [0; SENSORS_MAX],
            unusable_in_a_row: [0; SENSORS_MAX],
            good_in_a_row: 0,
            missed_in_a_row: 0,
            stopped_at: [None; STOPS_MAX],
        }
    }

    /// The present state.
    #[must_use]
    pub fn state(&self) -> DaemonState {
        self.state
    }

    /// Why the state is what it is.
    #[must_use]
    pub fn reason(&self) -> Reason {
        self.reason
    }

    /// Whether SELFTEST waits for [`DaemonEvent::BackendVerified`] or [`DaemonEvent::BackendMismatch`]; asked again after
    /// every operator reset.
    #[must_use]
    pub fn wants_backend_check(&self) -> bool {
        self.state == DaemonState::SelfTest && !self.backend_verified
    }

    /// The daemon after `event`, and what it may do.
    #[must_use]
    pub fn step(mut self, event: DaemonEvent, now: Stamp) -> (Self, DaemonOutput) {
        let before = self.state;
        let mut refusal = None;
        if before != DaemonState::Shutdown {
            match event {
                DaemonEvent::Started if before == DaemonState::Boot => self.begin_self_test(Reason::SelfTesting),
                DaemonEvent::Started => {}
                DaemonEvent::BackendVerified => self.backend_verified = true,
                DaemonEvent::BackendMismatch => self.fault(Reason::BackendMismatch, now),
                DaemonEvent::Group(group) => self.group(&group, now),
                DaemonEvent::DeadlineMissed => self.deadline_missed(now),
                DaemonEvent::Tick => self.tick(now),
                DaemonEvent::Operator(request) => refusal = self.operator(request, now).err(),
                DaemonEvent::InternalError => self.fault(Reason::InternalError, now),
                DaemonEvent::Terminate => self.enter(DaemonState::Shutdown, Reason::Terminated),
            }
        }
        let starting = matches!(self.state, DaemonState::Boot | DaemonState::SelfTest) && !self.was_ready;
        let late = starting && now.since_ns(self.started_at) > START_LIMIT_NS;
        if late {
            self.reason = Reason::StartTimeout;
        }
        let transition =
            (self.state != before).then_some(Transition { from: before, to: self.state, reason: self.reason });
        let output = DaemonOutput {
            state: self.state,
            reason: self.reason,
            transition,
            refusal,
            exit_code: late.then_some(EXIT_UNAVAILABLE),
        };
        (self, output)
    }

    fn enter(&mut self, state: DaemonState, reason: Reason) {
        self.state = state;
        self.reason = reason;
        self.good_in_a_row = 0;
    }

    fn begin_self_test(&mut self, reason: Reason) {
        self.enter(DaemonState::SelfTest, reason);
        self.usable_in_a_row = [0; SENSORS_MAX];
        self.unusable_in_a_row = [0; SENSORS_MAX];
        self.missed_in_a_row = 0;
    }

    fn fault(&mut self, reason: Reason, now: Stamp) {
        self.enter(DaemonState::Fault, reason);
        self.disarmed_at_ns = now.boottime_ns;
    }

    /// ACTIVE or DEGRADED to STOPPED, or to FAULT when that happens too often.
    fn stop(&mut self, reason: Reason, now: Stamp) {
        self.stopped_at.rotate_right(1);
        self.stopped_at[0] = Some(now);
        let recent =
            self.stopped_at.iter().flatten().filter(|&&stopped_at| now.since_ns(stopped_at) <= STOPS_WINDOW_NS).count();
        if recent >= STOPS_MAX {
            self.fault(Reason::TooManyStops, now);
        } else {
            self.enter(DaemonState::Stopped, reason);
        }
    }

    fn group(&mut self, group: &GroupFindings, now: Stamp) {
        if matches!(self.state, DaemonState::Boot | DaemonState::Fault) {
            return;
        }
        self.captured_at_ns = Some(group.captured_at_ns);
        self.missed_in_a_row = 0;
        self.count_usable(group);
        let (severity, reason) = self.judge(group, now);
        match (self.state, severity) {
            (_, Severity::Fault) => self.fault(reason, now),
            (DaemonState::SelfTest, _) => self.self_test(severity),
            (DaemonState::Active | DaemonState::Degraded, Severity::Stop) => self.stop(reason, now),
            (DaemonState::Active, Severity::Slow) => self.enter(DaemonState::Degraded, reason),
            (DaemonState::Degraded, Severity::Slow) => {
                self.good_in_a_row = 0;
                self.reason = reason;
            }
            (DaemonState::Degraded, Severity::Good) => {
                self.good_in_a_row += 1;
                if self.good_in_a_row >= GOOD_IN_A_ROW {
                    self.enter(DaemonState::Active, Reason::Recovered);
                }
            }
            (DaemonState::Stopped, Severity::Stop) => {
                self.good_in_a_row = 0;
                self.reason = reason;
            }
            (DaemonState::Stopped, Severity::Slow | Severity::Good) => {
                self.good_in_a_row += 1;
                if self.good_in_a_row >= GOOD_IN_A_ROW {
                    match severity {
                        Severity::Good => self.enter(DaemonState::Active, Reason::Recovered),
                        _ => self.enter(DaemonState::Degraded, reason),
                    }
                }
            }
            _ => {}
        }
    }

    fn count_usable(&mut self, group: &GroupFindings) {
        for (index, sensor) in group.sensors.iter().enumerate().take(self.sensor_count) {
            if sensor.is_usable() {
                self.usable_in_a_row[index] = self.usable_in_a_row[index].saturating_add(1);
                self.unusable_in_a_row[index] = 0;
            } else {
                self.usable_in_a_row[index] = 0;
                // Absence is a lost sensor and clipping a near obstacle; only dead channels are the array's own fault.
                let dead = sensor.present
                    && sensor.clipped_channels <= CLIPPED_CHANNELS_MAX
                    && sensor.bad_channels > BAD_CHANNELS_USABLE_MAX;
                self.unusable_in_a_row[index] = if dead { self.unusable_in_a_row[index].saturating_add(1) } else { 0 };
            }
        }
    }

    fn self_test(&mut self, severity: Severity) {
        if severity >= Severity::Stop {
            // An old stamp or a missing view spoils the set whatever its sensors say.
            self.usable_in_a_row = [0; SENSORS_MAX];
        }
        let sensors_good = self.usable_in_a_row[..self.sensor_count].iter().all(|&count| count >= GOOD_IN_A_ROW);
        if sensors_good && self.backend_verified {
            self.was_ready = true;
            self.enter(DaemonState::Ready, Reason::NotArmed);
        }
    }

    /// The worst of what was found, and its name.
    fn judge(&self, group: &GroupFindings, now: Stamp) -> (Severity, Reason) {
        let mut worst = (Severity::Good, Reason::None);
        let mut note = |found: bool, severity: Severity, reason: Reason| {
            if found && severity > worst.0 {
                worst = (severity, reason);
            }
        };
        let sensors = &group.sensors[..self.sensor_count];
        for (index, sensor) in sensors.iter().enumerate() {
            note(!sensor.present, Severity::Slow, Reason::SensorLost);
            if !sensor.present {
                continue;
            }
            note(sensor.rejected, Severity::Stop, Reason::PingRejected);
            if sensor.rejected {
                continue;
            }
            let clipped = sensor.clipped_channels > CLIPPED_CHANNELS_MAX;
            // Clipped all over it hears nothing but what is so loud: that stops the robot, and says nothing of emitter and array.
            note(!sensor.direct_path && !clipped, Severity::Fault, Reason::NoDirectPath);
            note(sensor.frozen, Severity::Fault, Reason::FrozenPing);
            note(!sensor.channel_map_fits && !clipped, Severity::Fault, Reason::ChannelMap);
            note(self.unusable_in_a_row[index] >= UNUSABLE_MAX, Severity::Fault, Reason::ChannelsDead);
            note(clipped, Severity::Stop, Reason::Clipped);
            note(sensor.channel_map_doubted && !clipped, Severity::Stop, Reason::ChannelMap);
            note(sensor.bad_channels > BAD_CHANNELS_USABLE_MAX, Severity::Stop, Reason::PingRejected);
            note(sensor.bad_channels > BAD_CHANNELS_GOOD_MAX, Severity::Slow, Reason::ChannelsLost);
            note(sensor.gaps_in_a_row >= SEQUENCE_GAPS_MAX, Severity::Slow, Reason::SequenceGaps);
        }
        note(group.desync_ns >= DESYNC_FAULT_NS, Severity::Fault, Reason::Desync);
        note(group.desync_ns >= DESYNC_WARNING_NS, Severity::Slow, Reason::DesyncWarning);
        let seen = sensors.iter().any(|sensor| sensor.present);
        note(group.view_missing || !seen, Severity::Stop, Reason::ViewMissing);
        match check_age(group.captured_at_ns, now, self.max_age_ns) {
            Ok(()) => {}
            Err(AgeError::TooOld) => note(true, Severity::Stop, Reason::PingTooOld),
            Err(AgeError::Future) => note(true, Severity::Stop, Reason::PingFromFuture),
        }
        note(group.backend_fallback, Severity::Slow, Reason::BackendFallback);
        worst
    }

    fn deadline_missed(&mut self, now: Stamp) {
        self.missed_in_a_row = self.missed_in_a_row.saturating_add(1);
        match self.state {
            DaemonState::Active | DaemonState::Degraded if self.missed_in_a_row >= MISSED_MAX => {
                self.stop(Reason::DeadlineMissed, now);
            }
            DaemonState::SelfTest => self.usable_in_a_row = [0; SENSORS_MAX],
            DaemonState::Stopped => self.good_in_a_row = 0,
            _ => {}
        }
    }

    fn tick(&mut self, now: Stamp) {
        let fresh =
            self.captured_at_ns.is_some_and(|captured_at_ns| check_age(captured_at_ns, now, self.max_age_ns).is_ok());
        match self.state {
            _ if fresh => {}
            DaemonState::Active | DaemonState::Degraded => self.stop(Reason::PingTooOld, now),
            DaemonState::Stopped => self.good_in_a_row = 0,
            DaemonState::SelfTest => self.usable_in_a_row = [0; SENSORS_MAX],
            _ => {}
        }
    }

    fn operator(&mut self, request: OperatorEvent, now: Stamp) -> Result<(), Reason> {
        match request {
            OperatorEvent::Stop => {
                self.disarmed_at_ns = now.boottime_ns;
                if matches!(self.state, DaemonState::Active | DaemonState::Degraded | DaemonState::Stopped) {
                    self.enter(DaemonState::Ready, Reason::OperatorStop);
                }
                Ok(())
            }
            OperatorEvent::Reset => {
                if self.state == DaemonState::Fault {
                    self.backend_verified = false;
                    self.stopped_at = [None; STOPS_MAX];
                    self.begin_self_test(Reason::OperatorReset);
                }
                Ok(())
            }
            OperatorEvent::Arm { epoch, requested_at_ns } => {
                if epoch != self.epoch {
                    return Err(Reason::ArmWrongEpoch);
                }
                if !arm_is_current(requested_at_ns, self.disarmed_at_ns, now) {
                    return Err(Reason::ArmOutdated);
                }
                match self.state {
                    DaemonState::Ready => self.enter(DaemonState::Active, Reason::Armed),
                    DaemonState::Active | DaemonState::Degraded | DaemonState::Stopped => {}
                    _ => return Err(Reason::ArmNotReady),
                }
                Ok(())
            }
        }
    }
}
