//! Time of a ping set of the simulator: three sensors in the built-in office world, on one core.

#[path = "../tests/sim_support/mod.rs"]
mod sim_support;

use criterion::{Criterion, criterion_group, criterion_main};
use noctule::sensor::RecordingFormat;
use noctule::signal::SampleFormat;
use noctule::sim::{RobotParams, SimParams, Simulator, World};
use noctule::time::Stamp;
use std::hint::black_box;

fn ping_set(criterion: &mut Criterion) {
    let i16_recording = RecordingFormat { format: SampleFormat::PcmI16, ..sim_support::pcm() };
    for (name, recording, multipath) in [
        ("pcm_f32", sim_support::pcm(), false),
        ("pcm_f32_multipath", sim_support::pcm(), true),
        ("pcm_i16", i16_recording, false),
        ("pdm", sim_support::pdm(), false),
    ] {
        let world = World::default_world().expect("the built-in world is valid");
        let sensors = sim_support::three_sensors();
        let params = SimParams { multipath, ..SimParams::default() };
        let robot = RobotParams::default();
        let mut simulator = Simulator::new(world, &sensors, &recording, robot, sim_support::SPEED_M_S, params, 1)
            .expect("the built-in world has room");
        let mut set = simulator.empty_ping_set();
        criterion.bench_function(&format!("simulator/three_sensors/{name}"), |bencher| {
            bencher.iter(|| {
                // Driving on keeps the scene from being a single lucky pose.
                let wanted = simulator.wanted_velocity();
                simulator.step(wanted, 0.1);
                simulator.ping_set(Stamp::default(), &mut set);
                black_box(&set);
            });
        });
    }
}

criterion_group! { name = simulator; config = Criterion::default().sample_size(30); targets = ping_set }
criterion_main!(simulator);
