//! A short simulated drive with a clock of its own, recorded as the daemon's deciding thread records: pipeline, simulator, tape.
#![allow(dead_code, reason = "every test file uses another part")]

use noctule::config::Config;
use noctule::imaging::params::Prefer;
use noctule::imaging::{Imager, ImagerOptions};
use noctule::io::record::{Note, RecordError, RecordOptions, RecordSubject, Recording, Tally};
use noctule::io::wire::message::{
    EnergyscapeHeader, Odometry, OperatorRequest, Request, VelocityCommand, VelocityInput,
};
use noctule::io::wire::telemetry::{CueThresholds, Cues, Health, PlatformVelocity};
use noctule::safety::{DaemonEvent, OperatorEvent};
use noctule::service::pipeline::Pipeline;
use noctule::service::simulator;
use noctule::service::tape::{self, Tape};
use noctule::service::wiring::{self, SensingSetup};
use noctule::signal::{DaemonState, PingSet, SENSORS_MAX, SampleFormat, Velocity};
use noctule::sim::{SimParams, Simulator, World};
use noctule::time::Stamp;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

pub const EPOCH: u64 = 77;
const START: Stamp = Stamp { boottime_ns: 1_000_000_000_000, wall_ns: 1_700_000_000_000_000_000 };
const PERIOD_NS: u64 = 100_000_000;
/// From emission to "now" of the pipeline.
const DECIDED_NS: u64 = 45_000_000;
/// Longest wait for the end of a file.
const FINISH: Duration = Duration::from_secs(120);

/// The default robot with short pings, so that a drive is some megabytes.
pub fn config() -> Config {
    let mut config = Config::default();
    config.recording.format = SampleFormat::PcmI16;
    config.recording.samples = Some(8192);
    config.imaging.range_max_m = 2.5;
    config.validate().expect("valid");
    config
}

/// Options for a recording that loses nothing, since simulated time waits.
pub fn patient(path: &Path) -> RecordOptions {
    RecordOptions { patient: true, reserve_bytes: 0, slot_count: 4, ..RecordOptions::new(path) }
}

/// A robot under way.
pub struct Drive {
    pub setup: SensingSetup,
    pub pipeline: Pipeline,
    pub simulator: Simulator,
    pub pings: PingSet,
    pub commands: Vec<VelocityCommand>,
    now: Stamp,
    set_count: u64,
    velocity: Velocity,
}

pub fn subject(config: &Config) -> RecordSubject {
    tape::subject(config, &wiring::sensing(config).expect("setup"))
}

impl Drive {
    pub fn new(config: &Config) -> Self {
        let setup = wiring::sensing(config).expect("setup");
        let masks = wiring::masks(config, &setup).expect("masks");
        let options = ImagerOptions { threads: Some(1), gpu_deadline_ms: 1000 };
        let imager = Imager::open(Arc::clone(&setup.plan), Arc::clone(masks.table()), Prefer::Cpu, options);
        let world = World::default_world().expect("world");
        let simulator = simulator(config, &setup, world, SimParams::default(), 3).expect("simulator");
        let pipeline = Pipeline::new(config, setup.clone(), masks, imager.expect("CPU"), EPOCH, START);
        let pings = simulator.empty_ping_set();
        Self {
            setup,
            pipeline,
            simulator,
            pings,
            commands: Vec::new(),
            now: START,
            set_count: 0,
            velocity: Velocity::ZERO,
        }
    }

    pub fn begun(&self) -> Stamp {
        START
    }

    /// Tells the pipeline, as the deciding thread does.
    pub fn tell(&mut self, tape: &mut Tape, event: DaemonEvent) {
        tape.told(&event, self.now);
        let output = self.pipeline.tell(event, self.now);
        if output.transition.is_some_and(|transition| !transition.to.allows_motion()) {
            let command = VelocityCommand::standstill(self.pings.emitted_at, output.state, output.reason);
            self.send(tape, command);
        }
    }

    fn send(&mut self, tape: &mut Tape, command: VelocityCommand) {
        let sequence = self.commands.len() as u64 + 1;
        let command = VelocityCommand { epoch: EPOCH, sequence, t_published_ns: self.now.boottime_ns, ..command };
        self.commands.push(command);
        tape.command(self.now, command);
    }

    /// One ping set; gives how long the tape took with it.
    pub fn ping_set(&mut self, tape: &mut Tape) -> Duration {
        self.set_count += 1;
        let emitted_at = START.plus_ns(self.set_count * PERIOD_NS);
        for _ in 0..5 {
            self.simulator.step(self.velocity, 0.02);
        }
        self.simulator.ping_set(emitted_at, &mut self.pings);
        if self.set_count == 9 {
            // A sensor that is late once.
            self.pings.present[1] = false;
        }
        self.now = emitted_at.plus_ns(DECIDED_NS);
        self.hear(tape);
        let wanted = Velocity { linear_m_s: 0.2, angular_rad_s: 0.01 * self.set_count as f64 };
        let pose = self.set_count.is_multiple_of(2).then(|| self.simulator.odometry().pose);
        tape.before(self.now, &self.pings, wanted, pose);
        let outcome = self.pipeline.process(self.now, &mut self.pings, wanted, pose).expect("imaged");
        self.velocity = outcome.velocity;
        let (state, reason) = (outcome.output.state, outcome.output.reason);
        self.send(tape, VelocityCommand::from_decision(&outcome.decision, outcome.velocity, state, reason));
        let mut headers = [None; SENSORS_MAX];
        let image = self.pipeline.image();
        for (index, energyscape) in image.energyscapes.iter().enumerate().filter(|(index, _)| image.imaged[*index]) {
            headers[index] = Some(EnergyscapeHeader {
                sequence: energyscape.sequence,
                t_monotonic_ns: energyscape.emitted_at.boottime_ns,
                t_wall_ns: energyscape.emitted_at.wall_ns,
                ..EnergyscapeHeader::for_grid(&self.setup.plan.grid, index, self.setup.speed_of_sound_m_s)
            });
        }
        tape.note(self.now, Note::Cues(Cues::new(&outcome.cues, &CueThresholds::default())));
        let begun = Instant::now();
        tape.after(self.now, &self.pings, &self.pipeline.image().energyscapes, &headers);
        begun.elapsed()
    }

    /// What else arrives.
    fn hear(&mut self, tape: &mut Tape) {
        let (now, sequence) = (self.now, self.set_count);
        let odometry = self.simulator.odometry();
        tape.note(now, Note::Odometry(Odometry::new(sequence, now, odometry.pose, self.velocity)));
        tape.note(now, Note::Input(VelocityInput::new(sequence, now, Velocity::forward_m_s(0.2))));
        let (t_monotonic_ns, t_wall_ns) = (now.boottime_ns, now.wall_ns);
        let velocity = self.velocity;
        tape.note(
            now,
            Note::Platform(PlatformVelocity {
                sequence,
                t_monotonic_ns,
                t_wall_ns,
                linear_m_s: velocity.linear_m_s,
                angular_rad_s: velocity.angular_rad_s,
                ..PlatformVelocity::blank()
            }),
        );
        let state = self.pipeline.daemon().state().number();
        tape.note(
            now,
            Note::Health(Health { t_monotonic_ns, t_wall_ns, state, ..Health::blank().with_adapter("test") }),
        );
        if self.pipeline.daemon().state() == DaemonState::Ready {
            tape.note(now, Note::Operator(OperatorRequest::new(Request::Arm, EPOCH, sequence, now)));
            let arm = OperatorEvent::Arm { epoch: EPOCH, requested_at_ns: now.boottime_ns };
            self.tell(tape, DaemonEvent::Operator(arm));
        }
    }

    /// The whole drive: start, arm, drive, a stop and another arm on the way.
    pub fn run(&mut self, tape: &mut Tape, sets: usize, mut each: impl FnMut(&Self)) {
        self.tell(tape, DaemonEvent::Started);
        for set in 0..sets {
            if set == sets * 2 / 3 {
                self.tell(tape, DaemonEvent::Operator(OperatorEvent::Stop));
            }
            self.ping_set(tape);
            self.tell(tape, DaemonEvent::Tick);
            each(self);
        }
    }
}

/// Records a drive; gives the commands and the tally.
pub fn record(
    config: &Config,
    options: &RecordOptions,
    sets: usize,
) -> Result<(Vec<VelocityCommand>, Tally), RecordError> {
    record_watched(config, options, sets, |_| {})
}

/// As [`record`], and `each` looks at the drive after every set.
pub fn record_watched(
    config: &Config,
    options: &RecordOptions,
    sets: usize,
    each: impl FnMut(&Drive),
) -> Result<(Vec<VelocityCommand>, Tally), RecordError> {
    let mut drive = Drive::new(config);
    let Recording { tap, recorder } = Recording::start(options, subject(config))?;
    let mut tape = Tape::new(tap, EPOCH, drive.begun());
    drive.run(&mut tape, sets, each);
    drop(tape);
    Ok((drive.commands, recorder.finish(FINISH)?))
}
