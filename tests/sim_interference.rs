//! Contract: clocks that disagree move what sensors hear of each other by their difference and nothing else; jammers are
//! tones of closed-form amplitude and phase on every microphone. The closed forms are written here, from geometry alone.

mod sim_support;

use nalgebra::Vector3;
use noctule::geometry::Pose2;
use noctule::sensor::SensorSetup;
use noctule::signal::PingSet;
use noctule::sim::{Bursts, Jammer, Pillar, RobotParams, SimParams, Simulator, World};
use sim_support::*;
use std::f64::consts::{PI, TAU};

/// As in the tests of the echoes: interpolation and f32.
const SHAPE_TOLERANCE: f64 = 5e-5;
/// A whole number of periods a ping, so that a discrete Fourier sum is exact.
const BIN_HZ: f64 = RATE_HZ / SAMPLES as f64;
const HUM_HZ: f64 = 1456.0 * BIN_HZ;

fn pair() -> [SensorSetup; 2] {
    [sensor(0.15, 90.0, -90.0), sensor(0.15, -90.0, 90.0)]
}

fn heard(world: World, sensors: &[SensorSetup], params: SimParams, silent: &[usize]) -> PingSet {
    let mut simulator = simulator(world, sensors, params);
    silent.iter().for_each(|sensor| simulator.set_emitting(*sensor, false));
    simulator.set_pose(Pose2::default());
    ping(&mut simulator)
}

/// Discrete Fourier sum at one frequency: amplitude and phase of a tone of whole periods.
fn tone_in(samples: &[f32], frequency_hz: f64) -> (f64, f64) {
    let (mut re, mut im) = (0.0, 0.0);
    for (index, value) in samples.iter().enumerate() {
        let (sin, cos) = (TAU * frequency_hz * index as f64 / RATE_HZ).sin_cos();
        re += f64::from(*value) * cos;
        im -= f64::from(*value) * sin;
    }
    (2.0 * re.hypot(im) / samples.len() as f64, im.atan2(re))
}

fn wrapped(angle_rad: f64) -> f64 {
    (angle_rad + PI).rem_euclid(TAU) - PI
}

#[test]
fn clocks_apart_move_what_comes_from_others_by_their_difference_and_own_echoes_not_at_all() {
    let sensors = pair();
    let (from, to) = ([1.2, -40.0], [1.2, 40.0]);
    let world = || walls(&[&[from, to]]);
    let place = Pose2::default();
    let emitter = in_world(&place, &sensors[1], &sensors[1].emitter_m);
    for offsets in [[3.1e-6, -5.3e-6, 0.0], [-40e-6, 17e-6, 0.0]] {
        let params = SimParams { sync_offsets_s: offsets, ..bare() };
        let set = heard(world(), &sensors, params, &[0]);
        let late_s = offsets[1] - offsets[0];
        for microphone in [0, 7, 31] {
            let ear = in_world(&place, &sensors[0], &sensors[0].array.positions_m[microphone]);
            let row = row(&set, 0, microphone);
            // The direct way is over after 3.4 ms; the echo begins at 7 ms.
            let late: Vec<f32> = row.iter().enumerate().map(|(i, v)| if i < 2000 { 0.0 } else { *v }).collect();
            let early: Vec<f32> = row.iter().enumerate().map(|(i, v)| if i < 2000 { *v } else { 0.0 }).collect();
            let path_m = (mirrored(&emitter, from, to) - ear).norm();
            let amplitude = 0.2 / path_m;
            assert!(misfit(&late, path_m / SPEED_M_S + late_s, amplitude) / amplitude < SHAPE_TOLERANCE);
            assert!(misfit(&late, path_m / SPEED_M_S, amplitude) / amplitude > 0.1, "control: equal clocks");
            let direct_m = (emitter - ear).norm();
            let found = peak_near(&early, direct_m / SPEED_M_S + late_s, 0.0);
            // Emitter and microphones each see the other at a right angle, where the housing leaves a half.
            assert!((found * direct_m / (0.2 * 0.25) - 1.0).abs() < 0.05, "direct way: {found}");
            let (fit, unfit) = (direct_m / SPEED_M_S + late_s, direct_m / SPEED_M_S);
            assert!(misfit(&early, fit, found) < 0.01 * found && misfit(&early, unfit, found) > 0.1 * found);
        }
        let own = |params| heard(world(), &sensors, params, &[1]).pings[0].samples.clone();
        assert!(own(params) == own(bare()), "its own echoes");
    }
}

#[test]
fn a_sensor_that_starts_late_hears_the_end_of_what_the_others_would_have_missed() {
    let sensors = pair();
    let (from, to) = ([6.5, -40.0], [6.5, 40.0]);
    let params = SimParams { sync_offsets_s: [4e-3, 0.0, 0.0], ..bare() };
    let set = heard(walls(&[&[from, to]]), &sensors, params, &[0]);
    let place = Pose2::default();
    let image = mirrored(&in_world(&place, &sensors[1], &sensors[1].emitter_m), from, to);
    let path_m = (image - in_world(&place, &sensors[0], &sensors[0].array.positions_m[3])).norm();
    assert!(path_m / SPEED_M_S > SAMPLES as f64 / RATE_HZ, "the echo comes after an ordinary ping's end");
    // The direct way ended before this sensor's first sample, so the echo stands alone.
    let error = misfit(row(&set, 0, 3), path_m / SPEED_M_S - 4e-3, 0.2 / path_m) * path_m / 0.2;
    assert!(error < SHAPE_TOLERANCE, "{error}");
}

/// One microphone a sensor and a tone for an emission: its phase is the delay.
fn clock_differences_s(jitter_s: f64, seed: u64, count: usize) -> Vec<f64> {
    let mut sensors = pair();
    for sensor in &mut sensors {
        sensor.emission = tone(40e3);
        sensor.array.positions_m.truncate(1);
        sensor.array.enabled.truncate(1);
        sensor.array.weights.truncate(1);
    }
    let mut world = walls(&[&[[1.2, -40.0], [1.2, 40.0]]]);
    world.start.corner = [0.0, 0.0];
    let params = SimParams { sync_jitter_s: jitter_s, ..bare() };
    let mut simulator =
        Simulator::new(world, &sensors, &pcm(), RobotParams::default(), SPEED_M_S, params, seed).unwrap();
    simulator.set_pose(Pose2::default());
    simulator.set_emitting(0, false);
    let late = |set: &PingSet| tone_in(&row(set, 0, 0)[2000..], 40e3).1;
    let phases: Vec<f64> = (0..count).map(|_| late(&ping(&mut simulator))).collect();
    simulator.set_emitting(1, false);
    simulator.set_emitting(0, true);
    let own: Vec<_> = (0..3).map(|_| ping(&mut simulator).pings[0].samples.clone()).collect();
    assert!(own.windows(2).all(|pair| pair[0] == pair[1]), "own echoes do not jitter");
    phases.iter().map(|phase| -wrapped(phase - phases[0]) / (TAU * 40e3)).collect()
}

#[test]
fn jitter_is_gaussian_white_from_ping_to_ping_and_belongs_to_the_seed() {
    let count = 400;
    let delays = clock_differences_s(1e-6, 5, count);
    let mean = delays.iter().sum::<f64>() / count as f64;
    let moment = |lag: usize, power: i32| {
        let products = delays.iter().zip(&delays[lag..]).map(|(a, b)| ((a - mean) * (b - mean)).powi(power));
        products.sum::<f64>() / (count - lag) as f64
    };
    // Two independent clocks: the difference has twice the variance. One standard error of it is 7 %.
    assert!((moment(0, 1) / 2e-12 - 1.0).abs() < 0.25, "{}", moment(0, 1));
    // One standard error of a correlation is 5 %, of the kurtosis 0.25.
    assert!((moment(1, 1) / moment(0, 1)).abs() < 0.2 && (moment(2, 1) / moment(0, 1)).abs() < 0.2);
    assert!((moment(0, 2) / moment(0, 1).powi(2) - 3.0).abs() < 0.9);
    assert_eq!(delays[..5], clock_differences_s(1e-6, 5, 5), "the same seed");
    assert!(delays[..5] != clock_differences_s(1e-6, 6, 5), "another seed");
    assert!(clock_differences_s(0.0, 5, 5).iter().all(|delay| *delay == 0.0), "control: no jitter");
}

fn hum(frequency_hz: f64, position_m: [f64; 3]) -> Jammer {
    Jammer { frequency_hz, amplitude_at_1_m: 0.05, position_m, bursts: None }
}

fn with(jammer: Jammer) -> SimParams {
    SimParams { jammers: [Some(jammer), None, None, None], ..bare() }
}

#[test]
fn a_jammer_is_a_line_of_closed_form_amplitude_and_phase_on_every_microphone() {
    let sensor = sensor(0.1, 20.0, 10.0);
    let place = Pose2::default();
    let jammer = hum(HUM_HZ, [1.7, 0.9, 0.4]);
    let set = heard(World::default(), std::slice::from_ref(&sensor), with(jammer), &[0]);
    let distance_m = |index: usize| {
        (in_world(&place, &sensor, &sensor.array.positions_m[index]) - Vector3::new(1.7, 0.9, 0.4)).norm()
    };
    let first = tone_in(row(&set, 0, 0), HUM_HZ);
    for index in 0..32 {
        let (amplitude, phase_rad) = tone_in(row(&set, 0, index), HUM_HZ);
        let expected = 0.05 / distance_m(index);
        assert!((amplitude / expected - 1.0).abs() < 1e-5, "microphone {index}: {amplitude} {expected}");
        let expected_rad = -TAU * HUM_HZ * (distance_m(index) - distance_m(0)) / SPEED_M_S;
        let error_rad = wrapped(phase_rad - first.1 - expected_rad);
        assert!(error_rad.abs() < 1e-5, "microphone {index}: {error_rad} rad");
        for beside in [-700, -20, -2, -1, 1, 2, 20, 700] {
            let (leak, _) = tone_in(row(&set, 0, index), HUM_HZ + f64::from(beside) * BIN_HZ);
            assert!(leak < 1e-6 * expected, "silence elsewhere: {leak} at {beside} bins");
        }
    }
    let spread_rad = TAU * HUM_HZ * (distance_m(31) - distance_m(0)).abs() / SPEED_M_S;
    assert!(spread_rad > 1.0, "control: the phases tell the microphones apart, {spread_rad}");
    // The air takes 1.32 dB a metre at 40 kHz.
    let params = SimParams { air: SimParams::default().air, ..with(jammer) };
    let in_air = heard(World::default(), std::slice::from_ref(&sensor), params, &[0]);
    let loss_db = -20.0 * (tone_in(row(&in_air, 0, 0), HUM_HZ).0 / first.0).log10();
    assert!((loss_db / distance_m(0) - 1.32).abs() < 0.03, "{loss_db}");
}

#[test]
fn a_jammers_phase_is_new_every_ping_the_same_for_all_sensors_and_the_seeds() {
    let sensors = pair();
    let jammer = hum(HUM_HZ, [2.0, 0.3, 0.0]);
    let offsets = [2e-6, 0.0, 0.0];
    let run = |seed: u64| -> Vec<PingSet> {
        let params = SimParams { sync_offsets_s: offsets, ..with(jammer) };
        let mut simulator =
            Simulator::new(World::default(), &sensors, &pcm(), RobotParams::default(), SPEED_M_S, params, seed)
                .unwrap();
        (0..2).for_each(|sensor| simulator.set_emitting(sensor, false));
        simulator.set_pose(Pose2::default());
        (0..24).map(|_| ping(&mut simulator)).collect()
    };
    let pings = run(3);
    let phases: Vec<f64> = pings.iter().map(|set| tone_in(row(set, 0, 5), HUM_HZ).1).collect();
    let (cos, sin) = phases.iter().fold((0.0, 0.0), |(c, s), phase| (c + phase.cos(), s + phase.sin()));
    // 24 uniform phases add up to sqrt(24), typically.
    assert!(f64::hypot(cos, sin) < 12.0, "{phases:?}");
    let distance_m = |sensor: usize| {
        let place = in_world(&Pose2::default(), &sensors[sensor], &sensors[sensor].array.positions_m[5]);
        (place - Vector3::new(2.0, 0.3, 0.0)).norm()
    };
    // A sensor that starts later is further on in the tone.
    let expected_rad = TAU * HUM_HZ * (offsets[0] - offsets[1] - (distance_m(0) - distance_m(1)) / SPEED_M_S);
    for set in &pings {
        let found_rad = tone_in(row(set, 0, 5), HUM_HZ).1 - tone_in(row(set, 1, 5), HUM_HZ).1;
        assert!(wrapped(found_rad - expected_rad).abs() < 1e-5, "{found_rad} {expected_rad}");
    }
    assert!(pings == run(3) && pings != run(4));
}

#[test]
fn a_jammer_behind_an_object_or_behind_the_sensor_is_not_heard() {
    let sensor = [sensor(0.0, 0.0, 0.0)];
    let loudness =
        |world: World, position_m| largest(row(&heard(world, &sensor, with(hum(40e3, position_m)), &[0]), 0, 9));
    let pillar = || World { pillars: vec![Pillar { centre: [1.0, 0.0], radius_m: 0.2 }], ..World::default() };
    assert!((loudness(World::default(), [2.0, 0.0, 0.0]) - 0.025).abs() < 1e-3);
    assert_eq!(loudness(pillar(), [2.0, 0.0, 0.0]), 0.0);
    assert!(loudness(pillar(), [2.0, 1.5, 0.0]) > 0.01, "control: beside the pillar");
    assert_eq!(loudness(World::default(), [-2.0, 0.0, 0.0]), 0.0);
    let on_the_wall = walls(&[&[[2.0, -4.0], [2.0, 4.0]]]);
    assert!(loudness(on_the_wall, [2.0, 0.0, 0.0]) > 0.02, "a wall does not hide what hangs on it");
}

#[test]
fn bursts_come_with_their_period_and_length() {
    let sensor = [sensor(0.0, 0.0, 0.0)];
    let jammer = Jammer { bursts: Some(Bursts { period_s: 5e-3, duration_s: 1e-3 }), ..hum(40e3, [1.0, 0.0, 0.0]) };
    let set = heard(World::default(), &sensor, with(jammer), &[0]);
    let samples = row(&set, 0, 19);
    // Middles of the bursts: the centre of gravity of each run of sound.
    let mut middles_s = Vec::new();
    let (mut weight, mut moment) = (0.0, 0.0);
    let mut silence = 0;
    for (index, value) in samples.iter().enumerate() {
        silence = if *value == 0.0 { silence + 1 } else { 0 };
        weight += f64::from(*value).powi(2);
        moment += f64::from(*value).powi(2) * index as f64 / RATE_HZ;
        if silence == 100 && weight > 0.0 {
            middles_s.push(moment / weight);
            (weight, moment) = (0.0, 0.0);
        }
    }
    assert!((6..=8).contains(&middles_s.len()), "{middles_s:?}");
    for gap in middles_s[1..].windows(2) {
        assert!((gap[1] - gap[0] - 5e-3).abs() < 2e-5, "{middles_s:?}");
    }
    let sounding = samples.iter().filter(|value| **value != 0.0).count() as f64 / SAMPLES as f64;
    assert!((sounding - 0.2).abs() < 0.03, "a fifth of the time: {sounding}");
    assert!((largest(samples) / 0.05 - 1.0).abs() < 0.01);
}

#[test]
fn a_jammer_beside_the_band_is_gone_after_a_matched_filter_and_one_inside_is_not() {
    let sensor = [sensor(0.0, 0.0, 0.0)];
    let after_filter = |frequency_hz: f64| {
        let set = heard(World::default(), &sensor, with(hum(frequency_hz, [1.0, 0.0, 0.0])), &[0]);
        (0..40).map(|step| reading(row(&set, 0, 19), 4e-3 + f64::from(step) * 7.3e-4)).fold(0.0, f64::max)
    };
    let (inside, outside) = (after_filter(40e3), after_filter(70e3));
    // A tone of amplitude A in the band reads about A times sqrt(2 / time-bandwidth product), 0.05 * sqrt(2 / 62) = 0.009.
    assert!(inside > 0.004 && inside < 0.02, "{inside}");
    assert!(outside < 0.01 * inside, "{outside}, {inside}");
}

#[test]
fn clocks_and_jammers_that_make_no_sense_are_refused_by_name() {
    let refuse = |params: SimParams| {
        let sensors = [sensor(0.0, 0.0, 0.0)];
        Simulator::new(World::default(), &sensors, &pcm(), RobotParams::default(), SPEED_M_S, params, 1)
            .unwrap_err()
            .to_string()
    };
    let good = hum(40e3, [1.0, 0.0, 0.0]);
    for (params, key) in [
        (SimParams { sync_jitter_s: -1e-6, ..bare() }, "sync_jitter_s"),
        (SimParams { sync_offsets_s: [0.0, f64::NAN, 0.0], ..bare() }, "sync_offsets_s[1]"),
        (with(Jammer { frequency_hz: 0.0, ..good }), "jammers[0].frequency_hz"),
        (with(Jammer { frequency_hz: 200e3, ..good }), "jammers[0].frequency_hz"),
        (with(Jammer { amplitude_at_1_m: -1.0, ..good }), "jammers[0].amplitude_at_1_m"),
        (with(Jammer { position_m: [0.0, f64::INFINITY, 0.0], ..good }), "jammers[0].position_m[1]"),
        (with(Jammer { bursts: Some(Bursts { period_s: 0.0, duration_s: 1.0 }), ..good }), "bursts.period_s"),
        (with(Jammer { bursts: Some(Bursts { period_s: 1.0, duration_s: 2.0 }), ..good }), "bursts.duration_s"),
    ] {
        let error = refuse(params);
        assert!(error.contains(key), "{error}, expected {key}");
    }
}
