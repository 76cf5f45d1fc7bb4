//! Contract: the whole way from microphone signals to motion stops a simulated robot when its ears fail. Simulator, imaging, layers and the daemon's state machine, stepped by hand; no processes, no clocks.

use noctule::config::Config;
use noctule::imaging::params::Prefer;
use noctule::imaging::{Imager, ImagerOptions};
use noctule::safety::{DaemonEvent, DaemonState, OperatorEvent};
use noctule::service::pipeline::{Outcome, Pipeline};
use noctule::service::{simulator, wiring};
use noctule::signal::{PingSet, Reason, SampleFormat, Velocity};
use noctule::sim::{SimParams, Simulator, World};
use noctule::time::Stamp;
use std::sync::Arc;

const EPOCH: u64 = 7;

struct Drive {
    simulator: Simulator,
    pipeline: Pipeline,
    pings: PingSet,
    now: Stamp,
}

impl Drive {
    fn new(config: &Config, world: World, params: SimParams, seed: u64) -> Self {
        let mut config = config.clone();
        config.recording.format = SampleFormat::PcmF32;
        let setup = wiring::sensing(&config).expect("setup");
        let masks = wiring::masks(&config, &setup).expect("masks");
        let simulator = simulator(&config, &setup, world, params, seed).expect("simulator");
        let options = ImagerOptions { threads: Some(1), ..ImagerOptions::default() };
        let imager =
            Imager::open(Arc::clone(&setup.plan), Arc::clone(masks.table()), Prefer::Cpu, options).expect("imager");
        let now = Stamp { boottime_ns: 1_000_000_000, wall_ns: 0 };
        let mut pipeline = Pipeline::new(&config, setup, masks, imager, EPOCH, now);
        pipeline.tell(DaemonEvent::Started, now);
        let pings = simulator.empty_ping_set();
        Self { simulator, pipeline, pings, now }
    }

    /// One tenth of a second: a ping set 40 ms old is decided on, then the robot moves.
    fn step(&mut self, prepare: impl FnOnce(&mut PingSet)) -> Outcome {
        self.simulator.ping_set(self.now, &mut self.pings);
        prepare(&mut self.pings);
        self.now = self.now.plus_ns(40_000_000);
        let (wanted, pose) = (self.simulator.wanted_velocity(), self.simulator.pose());
        let outcome = self.pipeline.process(self.now, &mut self.pings, wanted, Some(pose)).expect("imaged");
        self.simulator.step(outcome.velocity, 0.1);
        self.now = self.now.plus_ns(60_000_000);
        outcome
    }

    /// Steps until the daemon is READY, then arms it.
    fn arm(&mut self) {
        for _ in 0..10 {
            let outcome = self.step(|_| {});
            assert_eq!(outcome.velocity, Velocity::ZERO, "no motion before anybody armed");
            if outcome.output.state == DaemonState::Ready {
                let request = OperatorEvent::Arm { epoch: EPOCH, requested_at_ns: self.now.boottime_ns };
                let output = self.pipeline.tell(DaemonEvent::Operator(request), self.now);
                assert_eq!(output.state, DaemonState::Active);
                return;
            }
        }
        panic!("not READY after ten ping sets: {}", self.pipeline.daemon().reason());
    }
}

#[test]
fn a_dead_emitter_is_a_fault_and_never_a_free_way() {
    let mut drive = Drive::new(&Config::default(), World::default_world().expect("world"), SimParams::default(), 1);
    drive.arm();
    for _ in 0..20 {
        drive.step(|_| {});
    }
    (0..3).for_each(|sensor| drive.simulator.set_emitting(sensor, false));
    let outcome = drive.step(|_| {});
    assert_eq!((outcome.output.state, outcome.output.reason), (DaemonState::Fault, Reason::NoDirectPath));
    for _ in 0..20 {
        assert_eq!(drive.step(|_| {}).velocity, Velocity::ZERO, "a silent world is never a free one");
    }
    // It stays so when the emitters come back: only an operator ends a fault.
    (0..3).for_each(|sensor| drive.simulator.set_emitting(sensor, true));
    for _ in 0..20 {
        assert_eq!(drive.step(|_| {}).velocity, Velocity::ZERO);
    }
}

#[test]
fn one_dead_emitter_of_three_is_a_fault_too_although_its_neighbours_are_heard() {
    let world = World::default_world().expect("world");
    let mut drive = Drive::new(&Config::default(), world, SimParams::default(), 1);
    drive.arm();
    for _ in 0..20 {
        drive.step(|_| {});
    }
    assert!(drive.simulator.velocity().linear_m_s > 0.25, "it drives at first");
    drive.simulator.set_emitting(0, false);
    for _ in 0..20 {
        let outcome = drive.step(|_| {});
        assert_eq!((outcome.output.state, outcome.output.reason), (DaemonState::Fault, Reason::NoDirectPath));
        assert_eq!(outcome.velocity, Velocity::ZERO);
        assert_eq!((outcome.cues.sensors_used[0], outcome.cues.coverage.ahead_m), (false, 0.0), "its way is unseen");
    }
    assert_eq!(drive.simulator.velocity().linear_m_s, 0.0);
}

#[test]
fn frozen_pings_are_a_fault_at_the_second_copy() {
    let mut drive = Drive::new(&Config::default(), World::default_world().expect("world"), SimParams::default(), 1);
    drive.arm();
    for _ in 0..10 {
        drive.step(|_| {});
    }
    let frozen = drive.pings.clone();
    let outcome = drive.step(|pings| {
        for (ping, old) in pings.pings.iter_mut().zip(&frozen.pings) {
            *ping.samples_mut() = (*old.samples).clone();
        }
    });
    assert_eq!((outcome.output.state, outcome.output.reason), (DaemonState::Fault, Reason::FrozenPing));
    assert_eq!(outcome.velocity, Velocity::ZERO);
}

#[test]
fn the_lost_front_sensor_stops_the_robot_and_a_lost_rear_one_slows_it() {
    for (lost, moves) in [(0, false), (1, true)] {
        let mut drive = Drive::new(&Config::default(), World::default_world().expect("world"), SimParams::default(), 1);
        drive.arm();
        for _ in 0..20 {
            drive.step(|_| {});
        }
        let mut fastest_m_s = 0.0_f64;
        for index in 0..10 {
            let outcome = drive.step(|pings| pings.present[lost] = false);
            if index > 0 {
                fastest_m_s = fastest_m_s.max(outcome.velocity.linear_m_s);
            }
            let state = outcome.output.state;
            let expected = if moves { DaemonState::Degraded } else { DaemonState::Stopped };
            assert_eq!(state, expected, "sensor {lost} lost: {}", outcome.output.reason);
        }
        assert!(fastest_m_s <= 0.1 + 1e-12, "at most 0.1 m/s with a sensor lost, not {fastest_m_s}");
    }
}
