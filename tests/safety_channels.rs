//! Contract: every ping is held against the geometry: a sensor whose channels are exchanged, whose sample rate or array is not the
//! configured one never becomes READY and is a FAULT within 5 s; temperature, noise, jammers and walls are none.

mod checks;
mod perception_rig;

use checks::{figure, trials};
use nalgebra::Vector3;
use noctule::config::Config;
use noctule::geometry::Pose2;
use noctule::imaging::direct_path::{ChannelMap, DirectPath, HEARD_MIN, OUTLIER_MIN_M};
use noctule::safety::DaemonState;
use noctule::sensor::{Emission, SensorSetup};
use noctule::service::wiring;
use noctule::signal::{PingSet, Reason, SampleFormat, Velocity};
use noctule::sim::{Jammer, RobotParams, SimParams, Simulator, World};
use noctule::time::Stamp;
use perception_rig::{Random, Rig, config, hall, recorded, row};
use std::sync::Arc;

/// What is really built, where the configuration says something else.
#[derive(Clone, Copy, Debug)]
enum Built {
    AsConfigured,
    /// Samples a hundredth faster or slower.
    Rate(f64),
    /// Turned about the boresight by so many degrees.
    Turned(f64),
    /// Larger by this factor.
    Larger(f64),
    /// Channels in the opposite order.
    Reversed,
    /// Another emitter height, in metres.
    Emitter(f64),
    /// Warmer or colder air.
    SpeedOfSound(f64),
}

fn as_built(mut sensor: SensorSetup, built: Built) -> SensorSetup {
    let places = &mut sensor.array.positions_m;
    match built {
        Built::AsConfigured | Built::SpeedOfSound(_) => {}
        // The simulator makes every sound at the configured rate: slower air and a longer emission sound like a faster sampler.
        Built::Rate(rate) => {
            sensor.emission = Arc::new(Emission::hyperbolic(
                50e3 / rate,
                25e3 / rate,
                2.5e-3 * rate,
                0.1,
                sensor.emission.sample_rate_hz,
            ));
        }
        Built::Turned(degrees) => {
            let (sin, cos) = degrees.to_radians().sin_cos();
            places.iter_mut().for_each(|p| *p = Vector3::new(p.x, cos * p.y - sin * p.z, sin * p.y + cos * p.z));
        }
        Built::Larger(factor) => places.iter_mut().for_each(|p| *p *= factor),
        Built::Reversed => places.reverse(),
        Built::Emitter(height_m) => sensor.emitter_m.z = height_m,
    }
    sensor
}

/// Ping sets of a robot of which sensor `faulty` is built otherwise.
fn heard(
    config: &Config,
    world: World,
    params: SimParams,
    (faulty, built): (usize, Built),
    count: usize,
) -> Vec<PingSet> {
    let setup = wiring::sensing(config).expect("setup");
    let mut sensors = setup.sensors.clone();
    let mut speed_m_s = setup.speed_of_sound_m_s;
    if matches!(built, Built::Rate(_)) {
        // One emission for all that sound in the same air.
        sensors = sensors.into_iter().map(|sensor| as_built(sensor, built)).collect();
    } else {
        sensors[faulty] = as_built(sensors[faulty].clone(), built);
    }
    match built {
        Built::Rate(rate) => speed_m_s /= rate,
        Built::SpeedOfSound(factor) => speed_m_s *= factor,
        _ => {}
    }
    let robot = RobotParams::default();
    let mut simulator =
        Simulator::new(world, &sensors, &setup.recording, robot, speed_m_s, params, 5).expect("simulator");
    let mut set = simulator.empty_ping_set();
    let mut next = || {
        simulator.ping_set(Stamp::default(), &mut set);
        let mut copy = set.clone();
        copy.pings.iter_mut().for_each(|ping| ping.samples = Arc::new((*ping.samples).clone()));
        copy
    };
    (0..count).map(|_| next()).collect()
}

/// Verdicts of a fresh direct path on each of the sets.
fn verdicts(config: &Config, sets: &[PingSet], rounds: usize) -> Vec<[ChannelMap; 3]> {
    let setup = wiring::sensing(config).expect("setup");
    let mut path = DirectPath::new(&setup.plan, &setup.sensors, setup.speed_of_sound_m_s);
    let mut judge = |set: &PingSet| {
        let mut maps = [ChannelMap::Unknown; 3];
        set.iter_present().for_each(|ping| maps[ping.sensor_index] = path.listen(&setup.plan, ping).map);
        maps
    };
    (0..rounds).map(|round| judge(&sets[round % sets.len()])).collect()
}

const FORMATS: [SampleFormat; 3] = [SampleFormat::PcmF32, SampleFormat::PcmI16, SampleFormat::Pdm];

#[test]
fn a_sensor_that_is_not_built_as_configured_is_found_within_five_seconds_in_every_format() {
    let cases = [
        Built::Rate(1.01),
        Built::Rate(0.99),
        Built::Turned(180.0),
        Built::Turned(90.0),
        Built::Larger(1.3),
        Built::Reversed,
    ];
    let mut slowest = 0;
    for format in FORMATS {
        let mut config = config();
        config.recording.format = format;
        for (number, built) in cases.into_iter().enumerate() {
            let faulty = number % 3;
            let sets = heard(&config, hall(), SimParams::default(), (faulty, built), 3);
            let found = verdicts(&config, &sets, 50);
            let when = found.iter().position(|maps| maps[faulty] == ChannelMap::Wrong);
            assert!(found.iter().all(|maps| maps[faulty] != ChannelMap::Fits), "{format:?} {built:?}: {found:?}");
            slowest = slowest.max(when.unwrap_or_else(|| panic!("{format:?} {built:?}: {found:?}")) + 1);
        }
    }
    figure(29, "ping sets to a certain wrong array, channel order or sample rate", slowest, "<= 50", 18);
    assert!(slowest <= 50);
}

/// The negative control of the above: whoever asks only whether the emission is heard finds nothing wrong with any of them, and the
/// direct path itself finds nothing wrong where configuration and robot agree.
#[test]
fn presence_alone_would_accept_a_wrong_array_and_the_right_one_is_accepted() {
    let config = config();
    let setup = wiring::sensing(&config).expect("setup");
    for built in [Built::Rate(1.01), Built::Turned(90.0), Built::Larger(1.3)] {
        let sets = heard(&config, hall(), SimParams::default(), (0, built), 1);
        let mut path = DirectPath::new(&setup.plan, &setup.sensors, setup.speed_of_sound_m_s);
        assert!(path.listen(&setup.plan, &sets[0].pings[0]).correlation >= HEARD_MIN, "{built:?}");
    }
    for built in [Built::AsConfigured, Built::SpeedOfSound(1.03), Built::SpeedOfSound(0.97), Built::Emitter(0.061)] {
        for format in FORMATS {
            let mut config = config.clone();
            config.recording.format = format;
            let sets = heard(&config, hall(), SimParams::default(), (0, built), 2);
            let found = verdicts(&config, &sets, 20);
            assert!(found.iter().flatten().all(|map| *map == ChannelMap::Fits), "{built:?} {format:?}: {found:?}");
        }
    }
}

#[test]
fn two_channels_exchanged_are_found_unless_they_are_equally_far_from_the_emitter() {
    let config = config();
    let setup = wiring::sensing(&config).expect("setup");
    let sets = heard(&config, hall(), SimParams::default(), (0, Built::AsConfigured), 2);
    let fresh = DirectPath::new(&setup.plan, &setup.sensors[..1], setup.speed_of_sound_m_s);
    let sensor = &setup.sensors[0];
    let distance_m = |channel: usize| (sensor.array.positions_m[channel] - sensor.emitter_m).norm();
    let (mut found, mut alike, mut slowest) = (0, 0, 0);
    for first in 0..32 {
        for second in first + 1..32 {
            let exchanged = sets.iter().map(|set| {
                let mut set = set.clone();
                let kept = row(&mut set, 0, first).to_vec();
                let moved = row(&mut set, 0, second).to_vec();
                row(&mut set, 0, first).copy_from_slice(&moved);
                row(&mut set, 0, second).copy_from_slice(&kept);
                set
            });
            let exchanged: Vec<PingSet> = exchanged.collect();
            let mut path = fresh.clone();
            let wrong = (0..50)
                .position(|round| path.listen(&setup.plan, &exchanged[round % 2].pings[0]).map == ChannelMap::Wrong);
            let apart_m = (distance_m(first) - distance_m(second)).abs();
            match wrong {
                Some(round) => (found, slowest) = (found + 1, slowest.max(round + 1)),
                // 5 % for what noise and interpolation leave.
                None => assert!(apart_m < 1.05 * OUTLIER_MIN_M, "{first} and {second}, {apart_m} m apart"),
            }
            alike += usize::from(wrong.is_none());
        }
    }
    let told = format!("{found} of 496, {alike} within {OUTLIER_MIN_M} m of equally far, slowest {slowest} sets");
    figure(29, "pairs of exchanged channels found", told, "all farther apart, <= 50 sets", 496);
    assert!(found >= 440 && slowest <= 50);
}

/// The built-in robot with pings that end after 4.5 ms: all that the direct path needs, an eighth of the work.
fn short(format: SampleFormat) -> Config {
    let mut config = config();
    config.recording.format = format;
    config.recording.samples = Some(if format == SampleFormat::Pdm { 20_480 } else { 2_048 });
    config.imaging.range_max_m = 0.7;
    config
}

/// A scene that is hard on the direct path: walls down to 0.3 m from the sensors, jammers, noise, warm or cold air.
fn hard_scene(random: &mut Random) -> (World, SimParams, Pose2, f64) {
    let mut uniform = |from: f64, to: f64| from + (to - from) * 0.5 * (f64::from(random.uniform()) + 1.0);
    let mut text = "guidance = false\n[start]\ncorner = [-20.0, -20.0]\n".to_owned();
    for bearing_deg in [0.0, 120.0, -120.0_f64] {
        // From the centre; the sensors stand 0.1 to 0.2 m from it.
        let (away_m, askew) = (uniform(0.5, 1.5), uniform(-0.3, 0.3));
        let (sin, cos) = (bearing_deg.to_radians() + askew).sin_cos();
        let end = |along: f64| format!("[{}, {}]", away_m * cos - along * sin, away_m * sin + along * cos);
        text += &format!("[[wall]]\npoints = [{}, {}]\n", end(-2.0), end(2.0));
    }
    // Outside the robot.
    let (away_m, towards_rad) = (uniform(0.6, 3.0), uniform(-3.2, 3.2));
    let jammer = Jammer {
        frequency_hz: uniform(20e3, 60e3),
        amplitude_at_1_m: uniform(0.0, 0.3),
        position_m: [away_m * towards_rad.cos(), away_m * towards_rad.sin(), uniform(-0.5, 0.5)],
        bursts: None,
    };
    let noise_rms = 1e-4 * 100f64.powf(uniform(0.0, 1.0));
    let jammers = [Some(jammer), None, None, None];
    let params = SimParams { noise_rms, jammers, multipath: true, ..SimParams::default() };
    let pose = Pose2 { x_m: 0.0, y_m: 0.0, heading_rad: uniform(-0.2, 0.2) };
    (World::parse(std::path::Path::new("hard.toml"), &text).expect("world"), params, pose, uniform(0.97, 1.03))
}

#[test]
fn no_wall_jammer_noise_or_temperature_is_taken_for_a_wrong_array() {
    const SETS: usize = 20;
    let frames = trials(10_000, 300);
    let setups = FORMATS.map(|format| wiring::sensing(&short(format)).expect("setup"));
    let mut random = Random(29);
    let (mut wrong, mut doubted, mut unfit, mut some, mut unheard, mut done) = (0, 0, 0, 0, 0, 0);
    while done < frames {
        let (world, params, pose, warmth) = hard_scene(&mut random);
        let setup = &setups[done / SETS % 3];
        let mut path = DirectPath::new(&setup.plan, &setup.sensors, setup.speed_of_sound_m_s);
        let seed = done as u64;
        let speed_m_s = warmth * setup.speed_of_sound_m_s;
        let robot = RobotParams::default();
        let mut simulator =
            Simulator::new(world, &setup.sensors, &setup.recording, robot, speed_m_s, params, seed).expect("simulator");
        simulator.set_pose(pose);
        let mut set = simulator.empty_ping_set();
        for _ in 0..SETS {
            simulator.ping_set(Stamp::default(), &mut set);
            for ping in &set.pings {
                let found = path.listen(&setup.plan, ping);
                wrong += usize::from(found.map == ChannelMap::Wrong);
                doubted += usize::from(found.map == ChannelMap::Doubted);
                unheard += usize::from(!(found.correlation >= HEARD_MIN));
                let left_out = path.unfit(ping.sensor_index).iter();
                let left_out = left_out.filter(|finding| **finding != Default::default()).count();
                some += left_out;
                unfit += usize::from(left_out > 2);
            }
            done += 1;
        }
    }
    let told =
        format!("{wrong} wrong, {doubted} doubted, {unheard} unheard, {some} channels left out, 3 or more in {unfit}");
    figure(
        29,
        "false alarms near walls, jammed, noisy, at 0.97 to 1.03 times the speed of sound",
        told,
        "0 wrong",
        done,
    );
    assert_eq!((wrong, doubted), (0, 0));
    // A jammer's waves cancel at some microphones for the length of the quiet stretch, and the others look noisy: measured once in
    // 30,000 pings, and it slows the robot for half a second.
    assert!(unfit <= 1 + done / 1_000, "{unfit} in {done} sets");
}

#[test]
fn ready_is_refused_and_a_driving_robot_stands_within_five_seconds() {
    let config = config();
    let turned = heard(&config, hall(), SimParams::default(), (1, Built::Turned(180.0)), 3);
    let mut rig = Rig::new(&config);
    for index in 0..50 {
        let outcome = rig.step(&turned[index % 3], |_| {});
        assert_ne!(outcome.output.state, DaemonState::Ready);
    }
    let daemon = rig.pipeline.daemon();
    assert_eq!((daemon.state(), daemon.reason()), (DaemonState::Fault, Reason::ChannelMap));

    let right = recorded(&config, hall(), SimParams::default(), 4, &[]);
    let mut rig = Rig::new(&config);
    rig.drive(&right);
    let since_ns = rig.now_ns;
    let mut faulted = None;
    for index in 0..50 {
        let outcome = rig.step(&turned[index % 3], |_| {});
        if outcome.output.state == DaemonState::Fault {
            faulted.get_or_insert(index + 1);
        }
        assert_eq!(outcome.velocity, Velocity::ZERO, "an array in doubt does not drive");
    }
    let still_ms = rig.still_after_ms(since_ns + perception_rig::RECORDING_NS).expect("stands");
    let told = format!("FAULT at set {}, still after {still_ms} ms", faulted.expect("a fault"));
    figure(29, "array turned while driving", told, "<= 50 sets, <= 150 ms", 1);
    assert!(faulted.is_some_and(|sets| sets <= 50) && still_ms <= perception_rig::Z1_MS);
}

/// Least of many, since this machine has other work; the floor stands in the module's header.
#[test]
fn listening_to_every_channel_of_three_sensors_takes_a_fraction_of_a_millisecond() {
    for (format, most_ms) in FORMATS.into_iter().zip([0.4, 0.4, 1.0]) {
        let mut config = config();
        config.recording.format = format;
        let sets = heard(&config, hall(), SimParams::default(), (0, Built::AsConfigured), 2);
        let setup = wiring::sensing(&config).expect("setup");
        let mut path = DirectPath::new(&setup.plan, &setup.sensors, setup.speed_of_sound_m_s);
        let mut least_ms = f64::INFINITY;
        for round in 0..300 {
            let begin = std::time::Instant::now();
            for ping in &sets[round % 2].pings {
                path.listen(&setup.plan, ping);
            }
            least_ms = least_ms.min(begin.elapsed().as_secs_f64() * 1e3);
        }
        figure(
            29,
            &format!("judging the direct paths of three sensors, {format:?}, least, ms"),
            format!("{least_ms:.3}"),
            "floor 0.05",
            300,
        );
        // Five times what was measured: a search of all lags in every ping would take more.
        assert!(least_ms < most_ms, "{least_ms} ms");
    }
}

/// How near a wall may stand to a sensor before its echo and the direct path are one sound: told, and held to what robots do.
#[test]
fn a_wall_as_near_as_a_robot_can_come_to_it_is_no_wrong_array() {
    let config = short(SampleFormat::PcmF32);
    let setup = wiring::sensing(&config).expect("setup");
    let front_m = setup.sensors[0].mount.distance_m;
    let mut nearest_m = f64::INFINITY;
    for step in (2..=30).rev() {
        let away_m = 0.01 * f64::from(step);
        let wall_m = front_m + away_m;
        let text = format!(
            "guidance = false\n[[wall]]\npoints = [[{wall_m}, -2.0], [{wall_m}, 2.0]]\n[start]\ncorner = [-9.0, 0.0]\n"
        );
        let world = World::parse(std::path::Path::new("near.toml"), &text).expect("world");
        let (robot, params) = (RobotParams::default(), SimParams::default());
        let mut simulator =
            Simulator::new(world, &setup.sensors, &setup.recording, robot, 343.0, params, 1).expect("simulator");
        simulator.set_pose(Pose2::default());
        let mut set = simulator.empty_ping_set();
        let mut path = DirectPath::new(&setup.plan, &setup.sensors, setup.speed_of_sound_m_s);
        let fits = (0..8).all(|_| {
            simulator.ping_set(Stamp::default(), &mut set);
            path.listen(&setup.plan, &set.pings[0]).map == ChannelMap::Fits
        });
        if !fits {
            break;
        }
        nearest_m = away_m;
    }
    figure(
        29,
        "nearest wall before a sensor that leaves no doubt of its array, m",
        format!("{nearest_m:.2}"),
        "<= 0.15",
        29,
    );
    assert!(nearest_m <= 0.15);
}
