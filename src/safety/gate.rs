//! The controller's gate: commands, operator requests and ticks in; the velocity that may be sent to the platform out.
//!
//! States WAIT, TRACK, HOLD, LATCHED of the safe-state contract. Pure: `(gate, event, now) -> (gate, output)`. It trusts
//! nothing that it is told: it judges age by the capture time inside the command, pins epoch and publisher, and clamps
//! to its own limits. Zero is immediate; only TRACK is anything else. Never ramps down outside TRACK, never falls silent.

use super::{AgeError, GOOD_IN_A_ROW, OperatorEvent, SafetyParams, Transition, arm_is_current, check_age};
use crate::signal::{DaemonState, GateState, Reason, Velocity};
use crate::time::Stamp;

/// A command may exceed a limit by this factor (rounding, other limits in the daemon's configuration) and is clamped;
/// above it the daemon is broken.
const LIMIT_TOLERANCE: f64 = 1.1;
/// Longest time that one tick may use for a change of velocity: twice the tick, so that a late tick is no big step.
const TICK_MAX_NS: i64 = 40_000_000;

/// What the platform can do, from the controller's own configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionLimits {
    /// Highest |V|.
    pub linear_m_s: f64,
    /// Highest |omega|.
    pub angular_rad_s: f64,
    /// Highest |dV/dt|.
    pub linear_m_s2: f64,
    /// Highest |d omega/dt|.
    pub angular_rad_s2: f64,
}

/// What the gate judges by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GateParams {
    /// MAX_AGE: oldest capture that may move the robot, and longest time without a new sequence number.
    pub max_age_ns: u64,
    /// Longest HOLD before LATCHED.
    pub hold_latch_ns: u64,
    /// Limits of the platform.
    pub limits: MotionLimits,
}

impl GateParams {
    /// The timeouts of `safety` with the platform's `limits`.
    #[must_use]
    pub fn new(safety: &SafetyParams, limits: MotionLimits) -> Self {
        Self { max_age_ns: safety.max_age_ns(), hold_latch_ns: safety.hold_latch_ns(), limits }
    }
}

/// A command as it was received, its own claims not yet believed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommandSample {
    /// Whether its layout is ours.
    pub schema_matches: bool,
    /// Whether its checksum is right.
    pub checksum_matches: bool,
    /// Start of the daemon that made it.
    pub epoch: u64,
    /// Publisher, as the command and as the transport say.
    pub publisher: (u64, u128),
    /// Running number within the epoch.
    pub sequence: u64,
    /// Oldest capture that it was made from, CLOCK_BOOTTIME.
    pub captured_at_ns: u64,
    /// Not to be used later than this, CLOCK_BOOTTIME.
    pub valid_until_ns: u64,
    /// The commanded velocity.
    pub velocity: Velocity,
    /// The daemon's state, `None` if the number is unknown.
    pub daemon_state: Option<DaemonState>,
}

/// What happens to the gate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GateEvent {
    /// 20 ms have passed: the velocity of this tick is asked for.
    Tick,
    /// A command arrived.
    Command(CommandSample),
    /// An operator asked for something.
    Operator(OperatorEvent),
}

/// What became of the event's command or request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The event was a tick, or needed no judgement.
    Nothing,
    /// Will be followed from the next tick on (command), or was obeyed (request).
    Accepted,
    /// Good, but not followed: not armed, or not yet five in a row.
    Counted,
    /// Not used.
    Refused(Reason),
}

/// What the gate says after an event.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GateOutput {
    /// What the platform is to do. Exactly zero unless `state` is TRACK.
    pub velocity: Velocity,
    /// The state after the event.
    pub state: GateState,
    /// Why.
    pub reason: Reason,
    /// The change of state, if there was one.
    pub transition: Option<Transition<GateState>>,
    /// What became of the event.
    pub verdict: Verdict,
}

/// The last command that passed every test.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Believed {
    sequence: u64,
    captured_at_ns: u64,
    valid_until_ns: u64,
    velocity: Velocity,
    received_at: Stamp,
}

/// The gate with everything it remembers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gate {
    params: GateParams,
    state: GateState,
    reason: Reason,
    entered_at: Stamp,
    disarmed_at_ns: u64,
    epoch: Option<u64>,
    publisher: Option<(u64, u128)>,
    believed: Option<Believed>,
    fresh_in_a_row: u32,
    velocity: Velocity,
    ticked_at: Stamp,
    accepted_count: u64,
    refused_count: u64,
}

impl Gate {
    /// A gate in WAIT, not armed. Requests made before `now` are refused: nobody can have armed this gate yet.
    #[must_use]
    pub fn new(params: GateParams, now: Stamp) -> Self {
        Self {
            params,
            state: GateState::Wait,
            reason: Reason::NotArmed,
            entered_at: now,
            disarmed_at_ns: now.boottime_ns,
            epoch: None,
            publisher: None,
            believed: None,
            fresh_in_a_row: 0,
            velocity: Velocity::ZERO,
            ticked_at: now,
            accepted_count: 0,
            refused_count: 0,
        }
    }

    /// The present state.
    #[must_use]
    pub fn state(&self) -> GateState {
        self.state
    }

    /// The epoch that an operator armed, if one did.
    #[must_use]
    pub fn armed_epoch(&self) -> Option<u64> {
        self.epoch
    }

    /// Commands followed and commands refused since the start.
    #[must_use]
    pub fn counts(&self) -> (u64, u64) {
        (self.accepted_count, self.refused_count)
    }

    /// Whether it drives by a command that has meanwhile become too old: whoever looks between two ticks need not wait for the next.
    #[must_use]
    pub fn is_overdue(&self, now: Stamp) -> bool {
        self.state == GateState::Track && self.stale(now).is_some()
    }

    /// The gate after `event`, and what it says.
    #[must_use]
    pub fn step(mut self, event: GateEvent, now: Stamp) -> (Self, GateOutput) {
        let before = self.state;
        let verdict = match event {
            GateEvent::Tick => {
                self.tick(now);
                Verdict::Nothing
            }
            GateEvent::Command(command) => self.command(&command, now),
            GateEvent::Operator(request) => self.operator(request, now),
        };
        if self.state != GateState::Track {
            self.velocity = Velocity::ZERO;
        }
        match verdict {
            Verdict::Accepted if matches!(event, GateEvent::Command(_)) => self.accepted_count += 1,
            Verdict::Refused(_) if matches!(event, GateEvent::Command(_)) => self.refused_count += 1,
            _ => {}
        }
        let transition =
            (self.state != before).then_some(Transition { from: before, to: self.state, reason: self.reason });
        let output =
            GateOutput { velocity: self.velocity, state: self.state, reason: self.reason, transition, verdict };
        (self, output)
    }

    fn enter(&mut self, state: GateState, reason: Reason, now: Stamp) {
        self.state = state;
        self.reason = reason;
        self.entered_at = now;
        self.fresh_in_a_row = 0;
        if state == GateState::Latched {
            self.disarmed_at_ns = now.boottime_ns;
            self.epoch = None;
            self.publisher = None;
            self.believed = None;
        }
    }

    fn tick(&mut self, now: Stamp) {
        let elapsed_ns = now.since_ns(self.ticked_at).clamp(0, TICK_MAX_NS);
        self.ticked_at = now;
        match self.state {
            GateState::Track => match self.stale(now) {
                Some(reason) => self.enter(GateState::Hold, reason, now),
                None => self.follow(elapsed_ns as f64 * 1e-9),
            },
            GateState::Hold => {
                if self.stale(now).is_some() {
                    self.fresh_in_a_row = 0;
                }
                let held_ns = now.since_ns(self.entered_at);
                if held_ns > i64::try_from(self.params.hold_latch_ns).unwrap_or(i64::MAX) {
                    self.enter(GateState::Latched, Reason::HoldTooLong, now);
                }
            }
            GateState::Wait => {
                if self.stale(now).is_some() {
                    self.fresh_in_a_row = 0;
                }
            }
            GateState::Latched => {}
        }
    }

    /// Why the believed command may not be followed now, if so.
    fn stale(&self, now: Stamp) -> Option<Reason> {
        let Some(believed) = &self.believed else { return Some(Reason::NoCommand) };
        if let Err(error) = check_age(believed.captured_at_ns, now, self.params.max_age_ns) {
            return Some(error.into());
        }
        if now.boottime_ns > believed.valid_until_ns {
            return Some(Reason::CommandTooOld);
        }
        let silent_ns = now.since_ns(believed.received_at);
        (silent_ns > i64::try_from(self.params.max_age_ns).unwrap_or(i64::MAX)).then_some(Reason::SequenceStalled)
    }

    /// Moves the velocity towards the believed command, within all limits.
    fn follow(&mut self, elapsed_s: f64) {
        let Some(believed) = &self.believed else { return };
        let limits = &self.params.limits;
        let approach = |from: f64, wanted: f64, limit: f64, rate: f64| {
            let step = (wanted - from).clamp_to(rate * elapsed_s);
            (from + step).clamp_to(limit)
        };
        self.velocity = Velocity {
            linear_m_s: approach(
                self.velocity.linear_m_s,
                believed.velocity.linear_m_s.clamp_to(limits.linear_m_s),
                limits.linear_m_s,
                limits.linear_m_s2,
            ),
            angular_rad_s: approach(
                self.velocity.angular_rad_s,
                believed.velocity.angular_rad_s.clamp_to(limits.angular_rad_s),
                limits.angular_rad_s,
                limits.angular_rad_s2,
            ),
        };
    }

    fn command(&mut self, command: &CommandSample, now: Stamp) -> Verdict {
        if self.state == GateState::Latched {
            return Verdict::Refused(self.reason);
        }
        if let Err(reason) = self.judge(command) {
            if self.state == GateState::Wait {
                self.fresh_in_a_row = 0;
            } else {
                self.enter(GateState::Latched, reason, now);
            }
            return Verdict::Refused(reason);
        }
        if self.epoch.is_none() {
            return Verdict::Counted;
        }
        if let Err(reason) = self.judge_freshness(command, now) {
            // A repeated number is a repeated delivery, not a failure; if nothing newer follows, the next ticks see it.
            if self.state == GateState::Track && reason != Reason::SequenceStalled {
                self.enter(GateState::Hold, reason, now);
            } else if self.state != GateState::Track {
                self.fresh_in_a_row = 0;
            }
            return Verdict::Refused(reason);
        }
        self.believe(command, now)
    }

    /// Takes over a command that passed every test.
    fn believe(&mut self, command: &CommandSample, now: Stamp) -> Verdict {
        self.publisher = Some(command.publisher);
        self.believed = Some(Believed {
            sequence: command.sequence,
            captured_at_ns: command.captured_at_ns,
            valid_until_ns: command.valid_until_ns,
            velocity: command.velocity,
            received_at: now,
        });
        let may_move = command.daemon_state.is_some_and(DaemonState::allows_motion);
        if self.state == GateState::Track {
            if may_move {
                return Verdict::Accepted;
            }
            self.enter(GateState::Hold, Reason::DaemonNotActive, now);
            return Verdict::Counted;
        }
        self.fresh_in_a_row = self.fresh_in_a_row.saturating_add(1);
        if self.fresh_in_a_row < GOOD_IN_A_ROW || !may_move {
            if !may_move {
                self.reason = Reason::DaemonNotActive;
            }
            return Verdict::Counted;
        }
        self.enter(
            GateState::Track,
            if self.state == GateState::Hold { Reason::Recovered } else { Reason::Armed },
            now,
        );
        Verdict::Accepted
    }

    /// What a sound daemon never sends, whatever the time.
    fn judge(&self, command: &CommandSample) -> Result<(), Reason> {
        let limits = &self.params.limits;
        let velocity = &command.velocity;
        if !command.schema_matches {
            Err(Reason::BadSchema)
        } else if !command.checksum_matches {
            Err(Reason::BadChecksum)
        } else if self.epoch.is_some_and(|epoch| epoch != command.epoch) {
            Err(Reason::EpochChanged)
        } else if self.publisher.is_some_and(|publisher| publisher != command.publisher) {
            Err(Reason::PublisherChanged)
        } else if !velocity.is_finite() {
            Err(Reason::NotFinite)
        } else if !(velocity.linear_m_s.abs() <= limits.linear_m_s * LIMIT_TOLERANCE)
            || !(velocity.angular_rad_s.abs() <= limits.angular_rad_s * LIMIT_TOLERANCE)
        {
            Err(Reason::LimitExceeded)
        } else {
            Ok(())
        }
    }

    /// What makes a sound command unusable now.
    fn judge_freshness(&self, command: &CommandSample, now: Stamp) -> Result<(), Reason> {
        if self.believed.is_some_and(|believed| command.sequence <= believed.sequence) {
            return Err(Reason::SequenceStalled);
        }
        check_age(command.captured_at_ns, now, self.params.max_age_ns)?;
        if now.boottime_ns > command.valid_until_ns {
            return Err(Reason::CommandTooOld);
        }
        Ok(())
    }

    fn operator(&mut self, request: OperatorEvent, now: Stamp) -> Verdict {
        match request {
            OperatorEvent::Stop => {
                self.enter(GateState::Latched, Reason::OperatorStop, now);
                Verdict::Accepted
            }
            OperatorEvent::Reset => Verdict::Nothing,
            OperatorEvent::Arm { epoch, requested_at_ns } => {
                if !arm_is_current(requested_at_ns, self.disarmed_at_ns, now) {
                    return Verdict::Refused(Reason::ArmOutdated);
                }
                if self.epoch == Some(epoch) {
                    return Verdict::Nothing;
                }
                self.enter(GateState::Wait, Reason::NoCommand, now);
                self.epoch = Some(epoch);
                self.publisher = None;
                self.believed = None;
                Verdict::Accepted
            }
        }
    }
}

impl From<AgeError> for Reason {
    fn from(error: AgeError) -> Self {
        match error {
            AgeError::TooOld => Reason::CommandTooOld,
            AgeError::Future => Reason::CommandFromFuture,
        }
    }
}

/// Symmetric clamp that cannot panic: a limit that is NaN or not above zero means standing still.
trait ClampTo {
    fn clamp_to(self, limit: f64) -> f64;
}

impl ClampTo for f64 {
    fn clamp_to(self, limit: f64) -> f64 {
        if limit > 0.0 && !self.is_nan() { self.clamp(-limit, limit) } else { 0.0 }
    }
}
