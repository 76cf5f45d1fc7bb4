//! Daemon and gate driven by hand, each with its own clock; the tests of the state machines share it.
#![allow(dead_code, reason = "every test file uses another part")]

use noctule::safety::{
    CommandSample, Daemon, DaemonEvent, DaemonOutput, DaemonState, Gate, GateEvent, GateOutput, GateParams, GateState,
    GroupFindings, MotionLimits, OperatorEvent, SafetyParams, SensorFindings,
};
use noctule::signal::Velocity;
use noctule::time::Stamp;

pub const MS: u64 = 1_000_000;
pub const SECOND: u64 = 1_000 * MS;
pub const START_NS: u64 = 1_000 * SECOND;
pub const EPOCH: u64 = 0x5eed;
pub const SENSOR_COUNT: usize = 3;

pub fn at(boottime_ns: u64) -> Stamp {
    Stamp { boottime_ns, wall_ns: 0 }
}

/// A daemon driven by hand, with its clock.
#[derive(Clone)]
pub struct DaemonRig {
    pub daemon: Daemon,
    pub now_ns: u64,
}

impl DaemonRig {
    pub fn new() -> Self {
        Self { daemon: Daemon::new(SENSOR_COUNT, 300 * MS, EPOCH, at(START_NS)), now_ns: START_NS }
    }

    pub fn send(&mut self, event: DaemonEvent) -> DaemonOutput {
        let (daemon, output) = self.daemon.step(event, at(self.now_ns));
        self.daemon = daemon;
        output
    }

    /// 100 ms later a set captured 40 ms ago arrives.
    pub fn group(&mut self, change: impl FnOnce(&mut GroupFindings)) -> DaemonOutput {
        self.now_ns += 100 * MS;
        let mut group = good_group(self.now_ns - 40 * MS);
        change(&mut group);
        self.send(DaemonEvent::Group(group))
    }

    pub fn arm(&mut self) -> DaemonOutput {
        self.now_ns += MS;
        self.send(DaemonEvent::Operator(OperatorEvent::Arm { epoch: EPOCH, requested_at_ns: self.now_ns }))
    }

    /// Drives a new daemon into `state` by the shortest way that the contract allows.
    pub fn in_state(state: DaemonState) -> Self {
        let mut rig = Self::new();
        if state == DaemonState::Boot {
            return rig;
        }
        rig.send(DaemonEvent::Started);
        rig.send(DaemonEvent::BackendVerified);
        if state == DaemonState::SelfTest {
            return rig;
        }
        for _ in 0..5 {
            rig.group(|_| {});
        }
        match state {
            DaemonState::Ready => {}
            DaemonState::Fault => drop(rig.send(DaemonEvent::InternalError)),
            DaemonState::Shutdown => drop(rig.send(DaemonEvent::Terminate)),
            _ => {
                rig.arm();
                match state {
                    DaemonState::Degraded => drop(rig.group(|group| group.sensors[1] = SensorFindings::ABSENT)),
                    DaemonState::Stopped => drop(rig.group(|group| group.view_missing = true)),
                    _ => {}
                }
            }
        }
        assert_eq!(rig.daemon.state(), state, "the way into the state");
        rig
    }
}

pub fn good_group(captured_at_ns: u64) -> GroupFindings {
    GroupFindings {
        captured_at_ns,
        sensors: [SensorFindings::GOOD; SENSOR_COUNT],
        desync_ns: 0,
        backend_fallback: false,
        view_missing: false,
    }
}

pub const LIMITS: MotionLimits =
    MotionLimits { linear_m_s: 0.5, angular_rad_s: 1.0, linear_m_s2: 1.0, angular_rad_s2: 3.0 };

pub fn gate_params() -> GateParams {
    GateParams::new(&SafetyParams::default(), LIMITS)
}

pub fn command(sequence: u64, captured_at_ns: u64) -> CommandSample {
    CommandSample {
        schema_matches: true,
        checksum_matches: true,
        epoch: EPOCH,
        publisher: (7, 70),
        sequence,
        captured_at_ns,
        valid_until_ns: captured_at_ns + 300 * MS,
        velocity: Velocity { linear_m_s: 0.3, angular_rad_s: -0.2 },
        daemon_state: Some(DaemonState::Active),
    }
}

/// A gate driven by hand at 50 Hz with a command every fifth tick.
#[derive(Clone)]
pub struct GateRig {
    pub gate: Gate,
    pub now_ns: u64,
    pub sequence: u64,
}

impl GateRig {
    pub fn new() -> Self {
        Self { gate: Gate::new(gate_params(), at(START_NS)), now_ns: START_NS, sequence: 100 }
    }

    pub fn send(&mut self, event: GateEvent) -> GateOutput {
        let (gate, output) = self.gate.step(event, at(self.now_ns));
        self.gate = gate;
        output
    }

    pub fn arm(&mut self) -> GateOutput {
        self.now_ns += MS;
        self.send(GateEvent::Operator(OperatorEvent::Arm { epoch: EPOCH, requested_at_ns: self.now_ns }))
    }

    pub fn tick(&mut self) -> GateOutput {
        self.now_ns += 20 * MS;
        self.send(GateEvent::Tick)
    }

    /// The next command, captured 40 ms ago.
    pub fn next(&mut self) -> CommandSample {
        self.sequence += 1;
        command(self.sequence, self.now_ns - 40 * MS)
    }

    /// Five ticks, then a command with `change`.
    pub fn command(&mut self, change: impl FnOnce(&mut CommandSample)) -> GateOutput {
        for _ in 0..5 {
            self.tick();
        }
        let mut sample = self.next();
        change(&mut sample);
        self.send(GateEvent::Command(sample))
    }

    pub fn in_state(state: GateState) -> Self {
        let mut rig = Self::new();
        rig.arm();
        if state != GateState::Wait {
            for _ in 0..5 {
                rig.command(|_| {});
            }
            match state {
                GateState::Hold => drop(rig.command(|sample| sample.daemon_state = Some(DaemonState::Stopped))),
                GateState::Latched => drop(rig.command(|sample| sample.checksum_matches = false)),
                _ => {}
            }
        }
        assert_eq!(rig.gate.state(), state);
        rig
    }
}
