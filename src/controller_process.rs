//! The controller process: commands and operator requests in, what the platform is to do out, 50 times a second, for ever.
//!
//! The loop around [`crate::safety::gate`]: it reads the clock, polls the topics every millisecond, ticks the gate at
//! absolute times, publishes what it says, and zero at once when it stops. Serves `noctule-controller` and `noctule controller`.
//! No science, no files but its configuration, no allocation after start; nothing blocks it, not even its log.

mod reporter;

use crate::config::Config;
use crate::io::wire::message::{OperatorRequest, Request, VelocityCommand};
use crate::io::wire::telemetry::PlatformVelocity;
use crate::io::wire::{Checked, WireType};
use crate::io::{ControllerTopics, Ipc, IpcError, IpcParams};
use crate::life::panic::{EXIT_INTERNAL, end_on_panic, is_dying};
use crate::life::{Notifier, Stop};
use crate::safety::{
    CommandSample, DaemonState, Gate, GateEvent, GateOutput, GateParams, GateState, OperatorEvent, Reason, Verdict,
};
use crate::signal::Velocity;
use crate::time::{Clock, Stamp, SystemClock};
use reporter::{Report, Reporter};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Period of the platform's commands.
pub const TICK: Duration = Duration::from_millis(20);
/// Pause between two looks at the topics.
const LOOK_PAUSE: Duration = Duration::from_millis(1);
/// Samples taken in one look: a flood must not keep the tick waiting.
const LOOK_SAMPLES_MAX: usize = 32;
/// Pause between two looks whether the topics' files are still there.
const PROBE_PAUSE: Duration = Duration::from_secs(1);
/// Zeros sent at the end, in case one is lost.
const LAST_ZEROS: usize = 3;
/// Ticks between two words to the service manager: half a second.
const TICKS_PER_WORD: u64 = 25;

/// What the controller process works by.
#[derive(Debug, Clone, PartialEq)]
pub struct ControllerParams {
    /// Where the topics are.
    pub ipc: IpcParams,
    /// Limits and timeouts.
    pub gate: GateParams,
}

impl ControllerParams {
    /// The parts of a validated configuration that the controller reads.
    #[must_use]
    pub fn from_config(config: &Config) -> Self {
        Self { ipc: config.ipc.clone(), gate: config.gate_params() }
    }
}

/// Runs until SIGTERM or SIGINT and returns the exit code; says on the log why it did not start.
#[must_use]
pub fn serve(config: &Config, arm: bool) -> u8 {
    let stop = match Stop::on_signals() {
        Ok(stop) => stop,
        Err(error) => {
            log::error!("cannot watch for signals: {error}");
            return EXIT_INTERNAL;
        }
    };
    end_on_panic(stop.flag());
    stop.hold();
    match run(&ControllerParams::from_config(config), arm, stop.flag()) {
        Ok(()) if is_dying() => EXIT_INTERNAL,
        Ok(()) => 0,
        Err(error) => {
            log::error!("{error}");
            error.exit_code()
        }
    }
}

/// Runs until `stop`; with `arm`, arms once, for the first live daemon, and never after a latch.
///
/// # Errors
/// [`IpcError`] when the topics cannot be opened. Once they are, only `stop` ends it, or that somebody deletes their files.
pub fn run(params: &ControllerParams, arm: bool, stop: &AtomicBool) -> Result<(), IpcError> {
    let ipc = Ipc::open(&params.ipc)?;
    let topics = ControllerTopics::open(&ipc)?;
    let reporter =
        Reporter::start(format!("controller ready under {} with prefix {}", ipc.root().display(), ipc.prefix()));
    let notifier = Notifier::from_environment();
    notifier.ready();
    let mut controller = Controller {
        topics,
        gate: Gate::new(params.gate, SystemClock.now()),
        max_age_ns: params.gate.max_age_ns,
        arming: if arm { Arming::Waiting } else { Arming::Over },
        seen: Seen::default(),
        sequence: 0,
        tick_count: 0,
        sending_fails: false,
        reporter,
        notifier,
    };
    let mut next = Instant::now();
    let mut next_probe = next + PROBE_PAUSE;
    let mut ended = Ok(());
    while !stop.load(Ordering::Relaxed) && ended.is_ok() {
        controller.look();
        let now = Instant::now();
        if now >= next_probe {
            next_probe = now + PROBE_PAUSE;
            ended = controller.topics.check_intact();
        }
        if now < next {
            std::thread::sleep(LOOK_PAUSE.min(next - now));
            continue;
        }
        controller.tick();
        next += TICK;
        // After a pause of the whole process the lost ticks are not made up for.
        if next < now {
            next = now + TICK;
        }
    }
    controller.say_goodbye();
    ended
}

/// How far arming on request of the command line has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Arming {
    /// No live daemon was heard yet.
    Waiting,
    /// The gate is armed for this epoch; the daemon is asked until it moves.
    Asking(u64),
    /// Done, or not wanted, or given up for good after a latch.
    Over,
}

/// What was received, for those who watch.
#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    newest: Option<VelocityCommand>,
    received_at: Stamp,
    received_count: u64,
}

struct Controller {
    topics: ControllerTopics,
    gate: Gate,
    max_age_ns: u64,
    arming: Arming,
    seen: Seen,
    sequence: u64,
    tick_count: u64,
    sending_fails: bool,
    reporter: Reporter,
    notifier: Notifier,
}

impl Controller {
    /// Takes what waits on the topics, operators first.
    fn look(&mut self) {
        for _ in 0..LOOK_SAMPLES_MAX {
            let Some(request) = self.topics.next_operator() else { break };
            if let Some(event) = operator_event(&request) {
                self.step(GateEvent::Operator(event), SystemClock.now());
            }
        }
        for _ in 0..LOOK_SAMPLES_MAX {
            let Some((command, transport_id)) = self.topics.next_command() else { break };
            let now = SystemClock.now();
            self.seen = Seen {
                newest: Some(command),
                received_at: now,
                received_count: self.seen.received_count.wrapping_add(1),
            };
            self.step(GateEvent::Command(command_sample(&command, transport_id)), now);
            self.arm_if_wanted(&command, now);
        }
    }

    fn tick(&mut self) {
        let now = SystemClock.now();
        let output = self.step(GateEvent::Tick, now);
        self.publish(output.velocity, output.state, output.reason, now);
        self.tick_count += 1;
        if self.tick_count.is_multiple_of(TICKS_PER_WORD) && !self.sending_fails {
            self.notifier.processed();
        }
    }

    /// Lets the gate judge an event. A gate that stops says so to the platform at once, not at the next tick.
    fn step(&mut self, event: GateEvent, now: Stamp) -> GateOutput {
        let (gate, output) = self.gate.step(event, now);
        self.gate = gate;
        if let Some(transition) = output.transition {
            self.reporter.report(Report::Transition(transition));
            if transition.from == GateState::Track {
                self.publish(Velocity::ZERO, output.state, output.reason, now);
            }
            if transition.to == GateState::Latched {
                self.arming = Arming::Over;
            }
        }
        match (output.verdict, event) {
            (Verdict::Refused(reason), GateEvent::Operator(_)) => self.reporter.report(Report::RequestRefused(reason)),
            (Verdict::Refused(reason), GateEvent::Command(_)) => self.reporter.report(Report::CommandRefused(reason)),
            _ => {}
        }
        output
    }

    /// `--arm`: the gate is armed for the first live epoch, and the daemon of that epoch is asked until it moves.
    fn arm_if_wanted(&mut self, command: &VelocityCommand, now: Stamp) {
        if self.arming == Arming::Over || !is_sound(command) {
            return;
        }
        let age_ns = now.since_ns(Stamp { boottime_ns: command.t_monotonic_ns, wall_ns: 0 });
        if age_ns < 0 || age_ns > i64::try_from(self.max_age_ns).unwrap_or(i64::MAX) {
            return;
        }
        if self.arming == Arming::Waiting {
            let event = OperatorEvent::Arm { epoch: command.epoch, requested_at_ns: now.boottime_ns };
            if self.step(GateEvent::Operator(event), now).verdict != Verdict::Accepted {
                return;
            }
            self.arming = Arming::Asking(command.epoch);
        }
        match (self.arming, command.daemon_state()) {
            (Arming::Asking(epoch), Some(state)) if epoch == command.epoch && state.allows_motion() => {
                self.arming = Arming::Over;
            }
            (Arming::Asking(epoch), Some(DaemonState::Ready)) if epoch == command.epoch => {
                let request = OperatorRequest::new(Request::Arm, epoch, self.sequence, now);
                if self.topics.publish_operator(request).is_err() {
                    self.reporter.report(Report::SendingFails);
                }
            }
            _ => {}
        }
    }

    fn publish(&mut self, velocity: Velocity, state: GateState, reason: Reason, now: Stamp) {
        let (accepted_count, refused_count) = self.gate.counts();
        let newest = self.seen.newest;
        self.sequence += 1;
        let sample = PlatformVelocity {
            sequence: self.sequence,
            t_monotonic_ns: now.boottime_ns,
            t_wall_ns: now.wall_ns,
            linear_m_s: velocity.linear_m_s,
            angular_rad_s: velocity.angular_rad_s,
            epoch: self.gate.armed_epoch().unwrap_or(0),
            command_sequence: newest.map_or(0, |command| command.sequence),
            command_t_monotonic_ns: newest.map_or(0, |command| command.t_monotonic_ns),
            command_received_ns: self.seen.received_at.boottime_ns,
            received_count: self.seen.received_count,
            accepted_count,
            refused_count,
            state: state.number(),
            reason: reason.number(),
            daemon_state: newest.map_or(DaemonState::Boot.number(), |command| command.state),
            daemon_reason: newest.map_or(Reason::None.number(), |command| command.reason),
            ..PlatformVelocity::blank()
        };
        let failed = self.topics.publish_platform(sample).is_err();
        if failed && !self.sending_fails {
            self.reporter.report(Report::SendingFails);
        }
        self.sending_fails = failed;
    }

    /// Zero, three times, and what is in the log's queue.
    fn say_goodbye(mut self) {
        self.notifier.stopping();
        for _ in 0..LAST_ZEROS {
            self.publish(Velocity::ZERO, GateState::Latched, Reason::Terminated, SystemClock.now());
            std::thread::sleep(LOOK_PAUSE);
        }
        self.reporter.report(Report::Ended);
        self.reporter.finish();
    }
}

fn is_sound(command: &VelocityCommand) -> bool {
    command.schema_matches() && command.checksum_matches()
}

fn command_sample(command: &VelocityCommand, transport_id: u128) -> CommandSample {
    CommandSample {
        schema_matches: command.schema_matches(),
        checksum_matches: command.checksum_matches(),
        epoch: command.epoch,
        publisher: (command.publisher_id, transport_id),
        sequence: command.sequence,
        captured_at_ns: command.t_monotonic_ns,
        valid_until_ns: command.valid_until_ns,
        velocity: command.velocity(),
        daemon_state: command.daemon_state(),
    }
}

/// What a request on the wire means to a state machine; `None` for one that is spoilt or unknown.
#[must_use]
pub fn operator_event(request: &OperatorRequest) -> Option<OperatorEvent> {
    Some(match request.request()? {
        Request::Arm => OperatorEvent::Arm { epoch: request.epoch, requested_at_ns: request.t_monotonic_ns },
        Request::Stop => OperatorEvent::Stop,
        Request::Reset => OperatorEvent::Reset,
    })
}
