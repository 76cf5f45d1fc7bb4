//! A simulated robot under way: the daemon's pipeline, the controller's gate and the simulator, stepped with a clock of their own.
//!
//! The code that decides is the daemon's own ([`super::pipeline`], [`crate::safety::Gate`]); only shared memory and threads are left out,
//! and a fixed latency stands for them. Who drives ([`super::trial`], [`super::soak`]) says what happens in which order: hear, decide,
//! tick. Reads no clock and scores nothing.

use super::pipeline::{Outcome, Pipeline};
use super::trial::TrialRig;
use super::{ServiceError, simulator};
use crate::imaging::Imager;
use crate::imaging::backend::BackendError;
use crate::safety::{CommandSample, DaemonEvent, DaemonOutput, Gate, GateEvent, GateOutput, OperatorEvent};
use crate::signal::{PingSet, Velocity};
use crate::sim::{SimParams, Simulator, World};
use crate::time::Stamp;
use std::collections::VecDeque;
use std::time::Duration;

/// The controller's tick.
pub(super) const TICK_NS: u64 = 20_000_000;
/// Start of the simulated clock: not zero, which would make every age of a missing stamp look small.
pub(super) const CLOCK_START_NS: u64 = 1_000_000_000_000;
/// From the last sample of a ping to the command at the controller: what `demo` measures at its slowest, rounded up.
const PROCESSING_NS: u64 = 20_000_000;
const EPOCH: u64 = 1;

/// Robot, daemon and controller.
pub(super) struct Drive {
    pub simulator: Simulator,
    /// What was heard last.
    pub pings: PingSet,
    pub pipeline: Pipeline,
    pub gate: Gate,
    pub now_ns: u64,
    /// From one ping set to the next, a multiple of the tick.
    pub period_ns: u64,
    /// From the first emission of a set to its last sample.
    recording_ns: u64,
    sequence: u64,
    heard_ns: u64,
    /// Commands on their way to the gate, and when they arrive.
    under_way: VecDeque<(u64, CommandSample)>,
}

impl Drive {
    /// Puts the robot into the world; the daemon has started and tests itself, nobody is armed.
    ///
    /// # Errors
    /// When the robot does not fit into the start zone.
    pub fn new(
        rig: &TrialRig,
        world: World,
        acoustics: SimParams,
        seed: u64,
        imager: Imager,
    ) -> Result<Self, ServiceError> {
        let (config, setup) = (rig.config(), rig.setup());
        let simulator = simulator(config, setup, world, acoustics, seed)?;
        let start = stamp(CLOCK_START_NS);
        // A tick is 20 ms; so is every moment of the drive a multiple of it.
        let period_ns = (1e9 / config.control.rate_hz / TICK_NS as f64).round().max(1.0) as u64 * TICK_NS;
        let mut pipeline = Pipeline::new(config, setup.clone(), rig.masks().clone(), imager, EPOCH, start);
        pipeline.tell(DaemonEvent::Started, start);
        Ok(Self {
            pings: simulator.empty_ping_set(),
            pipeline,
            gate: Gate::new(config.gate_params(), start),
            now_ns: CLOCK_START_NS,
            period_ns,
            recording_ns: Duration::from_secs_f64(config.set_duration_s(&setup.recording)).as_nanos() as u64,
            sequence: 0,
            heard_ns: CLOCK_START_NS,
            under_way: VecDeque::new(),
            simulator,
        })
    }

    /// The present moment.
    pub fn now(&self) -> Stamp {
        stamp(self.now_ns)
    }

    /// Lets the sensors ping now.
    pub fn hear(&mut self) {
        self.heard_ns = self.now_ns;
        self.simulator.ping_set(self.now(), &mut self.pings);
    }

    /// Has the daemon decide on what was heard last; its command reaches the gate when a real one would.
    ///
    /// # Errors
    /// When the ping set cannot be imaged.
    pub fn decide(&mut self, wanted: Velocity) -> Result<Outcome, BackendError> {
        let captured_at_ns = self.pings.emitted_at.boottime_ns;
        let pose = self.simulator.odometry().pose;
        let decided_at = stamp(self.heard_ns + self.recording_ns + PROCESSING_NS);
        let outcome = self.pipeline.process(decided_at, &mut self.pings, wanted, Some(pose))?;
        self.send(captured_at_ns, outcome.velocity, &outcome.output);
        if let Some(output) = self.pipeline.after_command(&self.pings, decided_at) {
            self.send(captured_at_ns, Velocity::ZERO, &output);
        }
        Ok(outcome)
    }

    /// Tells the daemon that time passes without a ping set; it speaks when it therefore stops.
    pub fn wait(&mut self) {
        let output = self.pipeline.tell(DaemonEvent::Tick, self.now());
        if output.transition.is_some_and(|transition| !transition.to.allows_motion()) {
            self.send(self.pings.emitted_at.boottime_ns, Velocity::ZERO, &output);
        }
    }

    fn send(&mut self, captured_at_ns: u64, velocity: Velocity, output: &DaemonOutput) {
        self.sequence += 1;
        let command = CommandSample {
            schema_matches: true,
            checksum_matches: true,
            epoch: EPOCH,
            publisher: (1, 1),
            sequence: self.sequence,
            captured_at_ns,
            valid_until_ns: u64::MAX,
            velocity,
            daemon_state: Some(output.state),
        };
        let latency_ns = (self.recording_ns + PROCESSING_NS).div_ceil(TICK_NS) * TICK_NS;
        self.under_way.push_back(((self.heard_ns + latency_ns).max(self.now_ns), command));
    }

    /// An operator asks daemon and controller.
    pub fn ask(&mut self, request: OperatorEvent) {
        self.pipeline.tell(DaemonEvent::Operator(request), self.now());
        self.gate = self.gate.step(GateEvent::Operator(request), self.now()).0;
    }

    /// An operator arms daemon and controller.
    pub fn arm(&mut self) {
        self.ask(OperatorEvent::Arm { epoch: EPOCH, requested_at_ns: self.now_ns });
    }

    /// One tick of the controller; the world stands still unless it `moves`.
    pub fn tick(&mut self, moves: bool) -> GateOutput {
        while let Some((_, command)) = self.under_way.front().copied().filter(|(at_ns, _)| *at_ns <= self.now_ns) {
            self.under_way.pop_front();
            self.gate = self.gate.step(GateEvent::Command(command), self.now()).0;
        }
        let (gate, output) = self.gate.step(GateEvent::Tick, self.now());
        self.gate = gate;
        self.now_ns += TICK_NS;
        if moves {
            self.simulator.step(output.velocity, TICK_NS as f64 * 1e-9);
        }
        output
    }

    /// Ticks from one ping set to the next.
    pub fn ticks(&self) -> u64 {
        self.period_ns / TICK_NS
    }
}

fn stamp(boottime_ns: u64) -> Stamp {
    Stamp { boottime_ns, wall_ns: boottime_ns }
}
