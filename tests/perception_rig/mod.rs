//! The daemon's pipeline and the controller's gate behind a simulated robot, stepped by hand with a clock of their own; faults go into
//! the ping sets. The tests of what the sensors must not be believed share it.
#![allow(dead_code, reason = "every test file uses another part")]

use noctule::config::Config;
use noctule::imaging::backend::Backend;
use noctule::imaging::params::Prefer;
use noctule::imaging::{Imager, ImagerOptions};
use noctule::safety::{CommandSample, DaemonEvent, DaemonState, Gate, GateEvent, GateState, OperatorEvent};
use noctule::service::pipeline::{Outcome, Pipeline};
use noctule::service::simulator;
use noctule::service::wiring::{self, SensingSetup};
use noctule::signal::{PingSet, SampleFormat, Samples, Velocity};
use noctule::sim::{SimParams, World};
use noctule::time::Stamp;
use std::sync::Arc;

pub const MS: u64 = 1_000_000;
pub const EPOCH: u64 = 7;
/// From emission to the decision: 36 ms of recording, 20 ms of work.
pub const LATENCY_NS: u64 = 56 * MS;
/// From emission to the end of its recording: the arrival of the ping set.
pub const RECORDING_NS: u64 = 36 * MS;
pub const PERIOD_NS: u64 = 100 * MS;
pub const TICK_NS: u64 = 20 * MS;
/// Bars of the safe-state contract.
pub const Z1_MS: f64 = 150.0;
pub const Z2_MS: f64 = 350.0;

pub const WANTED: Velocity = Velocity { linear_m_s: 0.3, angular_rad_s: 0.0 };

pub fn stamp(boottime_ns: u64) -> Stamp {
    Stamp { boottime_ns, wall_ns: boottime_ns }
}

/// The built-in robot with PCM samples and few directions, so that many ping sets take little time.
pub fn config() -> Config {
    let mut config = Config::default();
    config.recording.format = SampleFormat::PcmF32;
    config
}

/// A hall with a wall three metres ahead and a pillar at one side: nothing to stop for.
pub fn hall() -> World {
    let text = "guidance = false\n[[wall]]\npoints = [[3.5, -4.0], [3.5, 4.0]]\n[[pillar]]\ncentre = [2.0, 1.5]\nradius_m = 0.1\n[start]\n";
    World::parse(std::path::Path::new("hall.toml"), text).expect("world")
}

/// Ping sets that differ in their noise only, as a robot that stands in `world` hears them.
pub fn recorded(config: &Config, world: World, params: SimParams, count: usize, silent: &[usize]) -> Vec<PingSet> {
    let setup = wiring::sensing(config).expect("setup");
    let mut simulator = simulator(config, &setup, world, params, 1).expect("simulator");
    silent.iter().for_each(|sensor| simulator.set_emitting(*sensor, false));
    let mut set = simulator.empty_ping_set();
    let mut next = || {
        simulator.ping_set(Stamp::default(), &mut set);
        // Buffers are shared; a clone of the samples must not be.
        let mut copy = set.clone();
        copy.pings.iter_mut().for_each(|ping| ping.samples = Arc::new((*ping.samples).clone()));
        copy
    };
    (0..count).map(|_| next()).collect()
}

/// Pipeline and gate with their clock, and what the platform was told.
pub struct Rig {
    pub pipeline: Pipeline,
    pub gate: Gate,
    pub now_ns: u64,
    pub sequence: u64,
    pub commands: u64,
    /// (time, what the gate put out) of every tick.
    pub told: Vec<(u64, Velocity)>,
    /// Emission of the newest set.
    pub emitted_ns: u64,
    /// The newest set as it was delivered.
    pub last: Option<PingSet>,
    waiting: Option<CommandSample>,
}

impl Rig {
    pub fn new(config: &Config) -> Self {
        Self::with_backend(config, |_, _| None)
    }

    /// With a backend made by the test in front of the CPU's.
    pub fn with_backend(
        config: &Config,
        make: impl FnOnce(&SensingSetup, &noctule::flow::MaskSet) -> Option<Box<dyn Backend>>,
    ) -> Self {
        let setup = wiring::sensing(config).expect("setup");
        let masks = wiring::masks(config, &setup).expect("masks");
        let backend = make(&setup, &masks);
        let (plan, table) = (Arc::clone(&setup.plan), Arc::clone(masks.table()));
        let options = ImagerOptions { threads: Some(1), ..ImagerOptions::default() };
        let imager = match backend {
            None => Imager::open(plan, table, Prefer::Cpu, options),
            Some(backend) => Imager::with_backends(plan, table, Some(backend), Some(1), "test"),
        };
        let now_ns = 1_000_000 * MS;
        let mut pipeline = Pipeline::new(config, setup, masks, imager.expect("imager"), EPOCH, stamp(now_ns));
        pipeline.tell(DaemonEvent::Started, stamp(now_ns));
        let gate = Gate::new(config.gate_params(), stamp(now_ns));
        Self {
            pipeline,
            gate,
            now_ns,
            sequence: 0,
            commands: 0,
            told: Vec::new(),
            emitted_ns: 0,
            last: None,
            waiting: None,
        }
    }

    /// One period: the set is emitted now, decided on 56 ms later, and the gate ticks all the time.
    pub fn step(&mut self, set: &PingSet, change: impl FnOnce(&mut PingSet)) -> Outcome {
        let mut set = set.clone();
        self.emitted_ns = self.now_ns;
        set.sequence = self.sequence;
        set.emitted_at = stamp(self.emitted_ns);
        for ping in &mut set.pings {
            ping.sequence = self.sequence;
            ping.emitted_at = set.emitted_at;
            // No two sets are the same, however often a recorded one is taken.
            let mark = self.sequence % 1_000;
            match ping.samples_mut() {
                Samples::PcmF32(values) => {
                    values.iter_mut().rev().take(1).for_each(|value| *value = mark as f32 * 1e-7)
                }
                Samples::PcmI16(values) => values.iter_mut().rev().take(1).for_each(|value| *value = mark as i16),
                Samples::Pdm(words) => words.iter_mut().rev().take(1).for_each(|word| *word = mark as u32),
            }
        }
        change(&mut set);
        self.last = Some(set.clone());
        self.sequence += 1;
        let decided_ns = self.emitted_ns + LATENCY_NS;
        let outcome = self.pipeline.process(stamp(decided_ns), &mut set, WANTED, None).expect("imaged");
        let command = self.command(&outcome, set.emitted_at.boottime_ns);
        self.run_to(decided_ns);
        self.waiting = Some(command);
        self.run_to(self.emitted_ns + PERIOD_NS);
        outcome
    }

    fn command(&mut self, outcome: &Outcome, captured_at_ns: u64) -> CommandSample {
        self.commands += 1;
        CommandSample {
            schema_matches: true,
            checksum_matches: true,
            epoch: EPOCH,
            publisher: (1, 1),
            sequence: self.commands,
            captured_at_ns,
            valid_until_ns: u64::MAX,
            velocity: outcome.velocity,
            daemon_state: Some(outcome.output.state),
        }
    }

    /// Lets the gate tick up to a moment.
    pub fn run_to(&mut self, until_ns: u64) {
        if let Some(command) = self.waiting.take() {
            self.gate = self.gate.step(GateEvent::Command(command), stamp(self.now_ns)).0;
        }
        while self.now_ns + TICK_NS <= until_ns {
            self.now_ns += TICK_NS;
            let (gate, output) = self.gate.step(GateEvent::Tick, stamp(self.now_ns));
            self.gate = gate;
            self.told.push((self.now_ns, output.velocity));
        }
    }

    /// Steps until the robot drives.
    pub fn drive(&mut self, sets: &[PingSet]) {
        for index in 0..40 {
            let outcome = self.step(&sets[index % sets.len()], |_| {});
            let waits = self.gate.armed_epoch().is_none();
            if outcome.output.state == DaemonState::Ready || (waits && outcome.output.state == DaemonState::Active) {
                self.arm();
            }
            let moves = self.told.last().is_some_and(|(_, velocity)| velocity.linear_m_s > 0.25);
            if self.gate.state() == GateState::Track && outcome.output.state == DaemonState::Active && moves {
                self.told.clear();
                return;
            }
        }
        panic!("does not drive: {} {}", self.pipeline.daemon().state(), self.pipeline.daemon().reason());
    }

    pub fn arm(&mut self) {
        let arm = OperatorEvent::Arm { epoch: EPOCH, requested_at_ns: self.now_ns };
        self.pipeline.tell(DaemonEvent::Operator(arm), stamp(self.now_ns));
        self.gate = self.gate.step(GateEvent::Operator(arm), stamp(self.now_ns)).0;
    }

    /// What an operator does after a fault: reset, self-test, arm, drive.
    pub fn drive_again(&mut self, sets: &[PingSet]) {
        self.now_ns += MS;
        self.pipeline.tell(DaemonEvent::Operator(OperatorEvent::Reset), stamp(self.now_ns));
        self.pipeline.tell(DaemonEvent::Operator(OperatorEvent::Stop), stamp(self.now_ns));
        self.gate = self.gate.step(GateEvent::Operator(OperatorEvent::Stop), stamp(self.now_ns)).0;
        self.now_ns += MS;
        self.drive(sets);
    }

    /// Time from `since_ns` to the first tick from which on nothing moves any more; `None` if it moves at the end.
    pub fn still_after_ms(&self, since_ns: u64) -> Option<f64> {
        let moving = |velocity: &Velocity| *velocity != Velocity::ZERO;
        if self.told.last().is_none_or(|(_, velocity)| moving(velocity)) {
            return None;
        }
        let last_ns = self.told.iter().rfind(|(_, velocity)| moving(velocity)).map_or(0, |(at_ns, _)| at_ns + TICK_NS);
        Some(last_ns.saturating_sub(since_ns) as f64 * 1e-6)
    }
}

/// The row of one channel.
pub fn row(set: &mut PingSet, sensor: usize, channel: usize) -> &mut [f32] {
    let Samples::PcmF32(values) = set.pings[sensor].samples_mut() else { panic!("PCM f32") };
    let count = values.len() / 32;
    &mut values[channel * count..][..count]
}

/// Pseudo-random numbers of the tests, apart from the simulator's: uniform in [-1, 1).
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0 >> 33
    }

    pub fn below(&mut self, count: usize) -> usize {
        self.next() as usize % count
    }

    pub fn uniform(&mut self) -> f32 {
        self.next() as f32 / (1_u64 << 30) as f32 - 1.0
    }

    /// Half the sum of twelve uniform numbers: mean 0, standard deviation 1.
    pub fn gaussian(&mut self) -> f32 {
        (0..12).map(|_| self.uniform()).sum::<f32>() / 2.0
    }
}
