//! Contract: every echo of the simulator is the emission, delayed by its exact path and scaled by a closed form.
//! The closed forms are computed here from geometry; the simulator's own code is never called for an expected value.

mod sim_support;

use nalgebra::{Vector2, Vector3};
use noctule::geometry::Pose2;
use noctule::sim::{Mover, PathLoop, Pillar, RobotParams, SimParams, Simulator, World};
use sim_support::*;

/// Measured: 6e-6 of the amplitude (interpolation and f32); a delay wrong by a thousandth of a sample is 7e-4.
const SHAPE_TOLERANCE: f64 = 5e-5;

fn pose(x_m: f64, y_m: f64, heading_deg: f64) -> Pose2 {
    Pose2 { x_m, y_m, heading_rad: heading_deg.to_radians() }
}

fn distance(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    (a - b).norm()
}

#[test]
fn a_planes_echo_is_the_sweep_at_its_image_sources_delay_and_amplitude_on_every_microphone() {
    let (from, to) = ([2.0, -40.0], [4.0, 40.0]);
    for (distance_m, bearing_deg, yaw_deg, place) in
        [(0.0, 0.0, 0.0, pose(0.0, 0.0, 0.0)), (0.15, 50.0, -70.0, pose(0.7, -0.4, 11.0))]
    {
        let sensor = sensor(distance_m, bearing_deg, yaw_deg);
        let mut simulator = simulator(walls(&[&[from, to]]), std::slice::from_ref(&sensor), bare());
        simulator.set_pose(place);
        let set = ping(&mut simulator);
        let image = mirrored(&in_world(&place, &sensor, &sensor.emitter_m), from, to);
        for (index, microphone) in sensor.array.positions_m.iter().enumerate() {
            let path_m = distance(&image, &in_world(&place, &sensor, microphone));
            let amplitude = 0.2 / path_m;
            let error = misfit(row(&set, 0, index), path_m / SPEED_M_S, amplitude) / amplitude;
            assert!(error < SHAPE_TOLERANCE, "microphone {index}: {error}");
            // Controls: the measure notices a hundredth of a sample, 1 % of amplitude, and the emitter at the wrong height.
            assert!(misfit(row(&set, 0, index), path_m / SPEED_M_S + 0.01 / RATE_HZ, amplitude) / amplitude > 3e-3);
            assert!(misfit(row(&set, 0, index), path_m / SPEED_M_S, 1.01 * amplitude) / amplitude > 5e-3);
            let flat = Vector3::new(image.x, image.y, 0.0);
            let flat_m = distance(&flat, &in_world(&place, &sensor, microphone));
            assert!(misfit(row(&set, 0, index), flat_m / SPEED_M_S, amplitude) / amplitude > 1e-2);
        }
    }
}

#[test]
fn a_plane_at_1_m_reads_a_tenth_with_absorption_and_directivity() {
    let sensor = sensor(0.0, 0.0, 0.0);
    let params = SimParams { noise_rms: 0.0, direct_amplitude: 0.0, ..SimParams::default() };
    let mut simulator = simulator(walls(&[&[[1.0, -40.0], [1.0, 40.0]]]), &[sensor], params);
    simulator.set_pose(pose(0.0, 0.0, 0.0));
    let set = ping(&mut simulator);
    let found = peak_near(row(&set, 0, 19), 2.0 / SPEED_M_S, 8.0 / RATE_HZ);
    assert!((found / 0.1 - 1.0).abs() < 0.01, "{found}");
}

fn lone_echo(world: World, place: Pose2, params: SimParams, expected_m: f64) -> f64 {
    let mut simulator = simulator(world, &[sensor(0.0, 0.0, 0.0)], params);
    simulator.set_pose(place);
    let set = ping(&mut simulator);
    peak_near(row(&set, 0, 19), expected_m / SPEED_M_S, 30.0 / RATE_HZ)
}

fn slope(near: f64, far: f64, ratio: f64) -> f64 {
    (far / near).ln() / ratio.ln()
}

#[test]
fn planes_spread_with_the_first_power_cylinders_and_edges_with_one_and_a_half() {
    let plane = |range_m: f64| {
        lone_echo(walls(&[&[[range_m, -40.0], [range_m, 40.0]]]), pose(0.0, 0.0, 0.0), bare(), 2.0 * range_m)
    };
    let found = slope(plane(1.0), plane(2.0), 2.0);
    assert!((found + 1.0).abs() < 0.01, "plane {found}");
    let pillar = |range_m: f64| {
        let pillars = vec![Pillar { centre: [range_m, 0.0], radius_m: 0.01 }];
        let world = World { pillars, ..World::default() };
        lone_echo(world, pose(0.0, 0.0, 0.0), bare(), 2.0 * range_m - 0.02)
    };
    let found = slope(pillar(1.0), pillar(2.0), 2.0);
    assert!((found + 1.5).abs() < 0.02, "cylinder {found}");
    // A wall end seen along the wall's line, far from any mirror image.
    let edge = |range_m: f64| {
        lone_echo(walls(&[&[[range_m, 0.0], [range_m + 9.0, 6.0]]]), pose(0.0, 0.0, 0.0), bare(), 2.0 * range_m)
    };
    let found = slope(edge(1.0), edge(2.0), 2.0);
    assert!((found + 1.5).abs() < 0.03, "edge {found}");
}

#[test]
fn a_cylinder_echoes_from_fermats_point_with_geometrical_amplitude() {
    let (centre, radius_m) = (Vector2::new(1.3, 0.4), 0.2);
    let sensor = sensor(0.1, 30.0, 0.0);
    let world = World { pillars: vec![Pillar { centre: centre.into(), radius_m }], ..World::default() };
    let mut simulator = simulator(world, std::slice::from_ref(&sensor), bare());
    let place = pose(0.0, 0.0, -10.0);
    simulator.set_pose(place);
    let set = ping(&mut simulator);
    let emitter = in_world(&place, &sensor, &sensor.emitter_m);
    for (index, local) in sensor.array.positions_m.iter().enumerate() {
        let microphone = in_world(&place, &sensor, local);
        // Shortest way over the surface by trying; the way unfolds to a straight line in height.
        let plane_m = |step: i32| {
            let angle = std::f64::consts::PI + f64::from(step) * 2e-5;
            let point = centre + Vector2::new(angle.cos(), angle.sin()) * radius_m;
            (emitter.xy() - point).norm() + (microphone.xy() - point).norm()
        };
        let shortest_m = (-80_000..80_000).map(plane_m).fold(f64::INFINITY, f64::min);
        let path_m = shortest_m.hypot(emitter.z - microphone.z);
        let range_m = 0.5 * shortest_m;
        let amplitude = 0.2 / (2.0 * range_m) * (radius_m / (radius_m + range_m)).sqrt();
        // Emitter and microphone are 3 cm apart, so the monostatic amplitude holds to a thousandth.
        let error = misfit(row(&set, 0, index), path_m / SPEED_M_S, amplitude) / amplitude;
        assert!(error < 2e-3, "microphone {index}: {error}");
        let centre_m = 2.0 * (range_m + radius_m);
        assert!(misfit(row(&set, 0, index), centre_m / SPEED_M_S, amplitude) / amplitude > 0.5, "control");
    }
}

#[test]
fn a_right_angled_corner_sends_the_sound_back_as_a_point_mirror() {
    let sensor = sensor(0.0, 0.0, 0.0);
    let corner = Vector2::new(1.5, 0.2);
    let world = walls(&[&[[1.5, -30.0], [1.5, 0.2], [-30.0, 0.2]]]);
    let mut simulator = simulator(world, std::slice::from_ref(&sensor), bare());
    let place = pose(0.0, -1.0, 38.66);
    simulator.set_pose(place);
    let set = ping(&mut simulator);
    let emitter = in_world(&place, &sensor, &sensor.emitter_m);
    let image = Vector3::new(2.0 * corner.x - emitter.x, 2.0 * corner.y - emitter.y, emitter.z);
    let path_m = distance(&image, &in_world(&place, &sensor, &sensor.array.positions_m[19]));
    let found = reading(row(&set, 0, 19), path_m / SPEED_M_S);
    assert!((found / (0.2 / path_m) - 1.0).abs() < 0.02, "{found}");
    // Off the right angle the two orders part: below it both images show, above it neither, and 0.1 degree is little.
    let bent = |bend: f64| {
        lone_echo(walls(&[&[[1.5 + bend, -30.0], [1.5, 0.2], [-30.0, 0.2]]]), place, bare(), path_m) / found
    };
    assert!((bent(-0.05) - 1.0).abs() < 0.1 && (bent(0.05) - 1.0).abs() < 0.1, "{} {}", bent(-0.05), bent(0.05));
    assert!(bent(-0.5) > 1.2 && bent(0.5) < 0.8, "{} {}", bent(-0.5), bent(0.5));
    // Control: without the second wall nothing comes back from there but the edge.
    let alone = lone_echo(walls(&[&[[1.5, -30.0], [1.5, 0.2]]]), place, bare(), path_m);
    assert!(alone < 0.1 * found, "{alone}");
}

#[test]
fn past_the_end_of_a_wall_the_echo_fades_smoothly_through_one_half() {
    let plane = 0.1;
    let world = || walls(&[&[[1.0, -30.0], [1.0, 0.0]]]);
    let echo = |y_m: f64| lone_echo(world(), pose(0.0, y_m, 0.0), bare(), 2.0);
    let at_the_end = echo(0.0);
    assert!((at_the_end / plane - 0.5).abs() < 0.06, "{at_the_end}");
    assert!((echo(-0.6) / plane - 1.0).abs() < 0.15);
    assert!(echo(0.6) < 0.08 * plane, "{}", echo(0.6));
    let steps: Vec<f64> = (-20..=20).map(|step| echo(f64::from(step) * 0.01)).collect();
    let jump = steps.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
    // A Fresnel zone is 5 cm here, so 13 % a centimetre is right; an echo switched on and off would jump by all of it.
    assert!(jump < 0.16 * plane, "{jump}");
}

#[test]
fn the_emitter_sends_less_the_farther_off_its_axis_and_nothing_behind() {
    let params = SimParams { air: None, noise_rms: 0.0, direct_amplitude: 0.0, ..SimParams::default() };
    let readings: Vec<f64> = (0..=12)
        .map(|step| {
            let heading_deg = 10.0 * f64::from(step);
            lone_echo(walls(&[&[[1.0, -40.0], [1.0, 40.0]]]), pose(0.0, 0.0, heading_deg), params, 2.0)
        })
        .collect();
    for pair in readings.windows(2).take(9) {
        assert!(pair[1] < pair[0], "{readings:?}");
    }
    assert!(readings[6] > 0.5 * readings[0], "60 degrees off the axis is still heard well: {readings:?}");
    assert!(readings[9] > 0.05 * readings[0] && readings[9] < 0.5 * readings[0], "a right angle: {readings:?}");
    assert!(readings[11] < 1e-9 && readings[12] < 1e-9, "behind: {readings:?}");
}

#[test]
fn what_stands_in_front_hides_what_is_behind_unless_occlusion_is_off() {
    let scene = || World {
        pillars: vec![Pillar { centre: [1.0, 0.0], radius_m: 0.15 }],
        ..walls(&[&[[2.0, -40.0], [2.0, 40.0]]])
    };
    let hidden = lone_echo(scene(), pose(0.0, 0.0, 0.0), bare(), 4.0);
    let shown = lone_echo(scene(), pose(0.0, 0.0, 0.0), SimParams { occlusion: false, ..bare() }, 4.0);
    assert!(hidden < 1e-3 && (shown - 0.05).abs() < 2e-3, "{hidden} {shown}");
}

#[test]
fn another_sensors_housing_hides_what_is_behind_it() {
    // The second sensor stands 0.1 m in front of the first and looks the same way.
    let pair = [sensor(0.0, 0.0, 0.0), sensor(0.1, 0.0, 0.0)];
    let alone = [sensor(0.0, 0.0, 0.0), sensor(0.1, 180.0, 180.0)];
    let params = SimParams { cross_talk: false, ..bare() };
    let heard = |sensors: &[_]| {
        let mut simulator = simulator(walls(&[&[[1.0, -40.0], [1.0, 40.0]]]), sensors, params);
        simulator.set_pose(pose(0.0, 0.0, 0.0));
        largest(row(&ping(&mut simulator), 0, 0))
    };
    assert!(heard(&pair) < 1e-6, "{}", heard(&pair));
    assert!(heard(&alone) > 0.09, "{}", heard(&alone));
}

#[test]
fn sensors_hear_each_others_echoes_at_the_others_path_length_unless_switched_off() {
    let sensors = [sensor(0.15, 90.0, -90.0), sensor(0.15, -90.0, 90.0)];
    let place = pose(0.0, 0.0, 0.0);
    let (from, to) = ([1.2, -40.0], [1.2, 40.0]);
    let image = mirrored(&in_world(&place, &sensors[1], &sensors[1].emitter_m), from, to);
    let path_m = distance(&image, &in_world(&place, &sensors[0], &sensors[0].array.positions_m[7]));
    let heard = |cross_talk: bool, delay_m: f64| {
        let mut simulator = simulator(walls(&[&[from, to]]), &sensors, SimParams { cross_talk, ..bare() });
        simulator.set_emitting(0, false);
        simulator.set_pose(place);
        let set = ping(&mut simulator);
        // The direct way between the two is over after 3.4 ms; the echo begins at 7 ms.
        let late: Vec<f32> = row(&set, 0, 7).iter().enumerate().map(|(i, v)| if i < 2000 { 0.0 } else { *v }).collect();
        misfit(&late, (path_m + delay_m) / SPEED_M_S, 0.2 / path_m) / (0.2 / path_m)
    };
    assert!(heard(true, 0.0) < SHAPE_TOLERANCE, "{}", heard(true, 0.0));
    assert!(heard(true, 0.001) > 0.5 && heard(false, 0.0) > 0.9, "controls");
}

#[test]
fn the_direct_path_has_its_delay_and_spreading_on_every_microphone() {
    let sensor = sensor(0.15, 0.0, 0.0);
    let params = SimParams { direct_amplitude: 0.7, ..bare() };
    let mut simulator = simulator(World::default(), std::slice::from_ref(&sensor), params);
    let set = ping(&mut simulator);
    let path_m = |index: usize| distance(&sensor.emitter_m, &sensor.array.positions_m[index]);
    let nearest_m = (0..32).map(path_m).fold(f64::INFINITY, f64::min);
    for index in 0..32 {
        let amplitude = 0.7 * nearest_m / path_m(index);
        let error = misfit(row(&set, 0, index), path_m(index) / SPEED_M_S, amplitude) / amplitude;
        assert!(error < SHAPE_TOLERANCE, "microphone {index}: {error}");
    }
}

/// ISO 9613-1 at 40 kHz, 20 degrees, 50 % humidity: 1.32 dB/m (value of the standard's formula in the literature).
#[test]
fn air_takes_1_32_db_a_metre_at_40_khz() {
    let echo = |range_m: f64, air| {
        let mut sensor = sensor(0.0, 0.0, 0.0);
        sensor.emission = tone(40e3);
        let params = SimParams { air, ..bare() };
        let mut simulator = simulator(walls(&[&[[range_m, -40.0], [range_m, 40.0]]]), &[sensor], params);
        simulator.set_pose(pose(0.0, 0.0, 0.0));
        largest(row(&ping(&mut simulator), 0, 0))
    };
    let air = SimParams::default().air;
    let extra_db = 20.0 * ((echo(1.0, air) / echo(2.0, air)) / (echo(1.0, None) / echo(2.0, None))).log10();
    assert!((extra_db / 2.0 - 1.32).abs() < 0.03, "{} dB/m", extra_db / 2.0);
}

#[test]
fn an_emission_switched_off_leaves_noise_of_the_configured_rms_alone() {
    let mut simulator = simulator(
        World::default_world().unwrap(),
        &three_sensors(),
        SimParams { noise_rms: 2e-3, ..SimParams::default() },
    );
    (0..3).for_each(|sensor| simulator.set_emitting(sensor, false));
    let set = ping(&mut simulator);
    for sensor in 0..3 {
        for microphone in 0..32 {
            let found = rms(row(&set, sensor, microphone));
            // One standard error is 2e-3 / sqrt(2 * 16384) = 0.55 %.
            assert!((found / 2e-3 - 1.0).abs() < 0.03, "{found}");
        }
    }
}

#[test]
fn a_mover_is_where_its_path_and_the_time_put_it_and_echoes_from_there() {
    let mover = |repeat| Mover {
        radius_m: 0.1,
        path: vec![[2.0, 0.0], [3.0, 0.0], [3.0, 2.0]],
        speed_m_s: 0.5,
        repeat,
        start_s: 1.0,
    };
    let at = |repeat, time_s| -> [f64; 2] { mover(repeat).position_m(time_s).into() };
    assert_eq!(at(PathLoop::Once, 0.5), [2.0, 0.0]);
    assert_eq!(at(PathLoop::Once, 2.0), [2.5, 0.0]);
    assert_eq!(at(PathLoop::Once, 5.0), [3.0, 1.0]);
    assert_eq!(at(PathLoop::Once, 90.0), [3.0, 2.0]);
    assert_eq!(at(PathLoop::PingPong, 9.0), [3.0, 1.0]);
    assert_eq!(at(PathLoop::PingPong, 12.0), [2.5, 0.0]);
    let [x, y] = at(PathLoop::Cycle, 1.0 + (3.0 + 0.5 * 5f64.sqrt()) / 0.5);
    assert!((x - 2.5).abs() < 1e-12 && (y - 1.0).abs() < 1e-12, "{x} {y}");

    let world = World { movers: vec![mover(PathLoop::Once)], ..World::default() };
    let mut simulator = simulator(world, &[sensor(0.0, 0.0, 0.0)], bare());
    simulator.set_pose(pose(0.0, 0.0, 0.0));
    for _ in 0..20 {
        simulator.step(noctule::signal::Velocity::ZERO, 0.1);
    }
    let set = ping(&mut simulator);
    let range_m: f64 = 2.5 - 0.1;
    let amplitude = 0.2 / (2.0 * range_m) * (0.1 / (0.1 + range_m)).sqrt();
    let found = peak_near(row(&set, 0, 19), 2.0 * range_m / SPEED_M_S, 10.0 / RATE_HZ);
    assert!((found / amplitude - 1.0).abs() < 0.02, "{found} {amplitude}");
}

#[test]
fn pdm_words_decode_to_the_pcm_within_their_quantisation_noise() {
    let make = |recording| {
        let world = walls(&[&[[1.0, -40.0], [1.0, 40.0]]]);
        let sensors = [sensor(0.0, 0.0, 0.0)];
        let params = SimParams { noise_rms: 0.0, ..SimParams::default() };
        let mut simulator =
            Simulator::new(world, &sensors, &recording, RobotParams::default(), SPEED_M_S, params, 5).unwrap();
        simulator.set_pose(pose(0.0, 0.0, 0.0));
        ping(&mut simulator)
    };
    let (words, pcm) = (make(pdm()), make(pcm()));
    let noctule::signal::Samples::Pdm(words) = &*words.pings[0].samples else { panic!("not PDM") };
    assert_eq!(words.len(), 163_840);
    for microphone in [0, 17, 31] {
        let bit = |index: i64| match words.get(usize::try_from(index).unwrap_or(usize::MAX)) {
            Some(word) => f64::from(word >> microphone & 1) * 2.0 - 1.0,
            None => 0.0,
        };
        // Low-pass at 70 kHz: the sweep ends at 50 kHz, the shaped noise below that is 3e-4 rms in theory.
        let decoded = low_pass(bit, 40_000, 70e3 / 4.5e6, 1201, 10);
        let source = row(&pcm, 0, microphone);
        let error = |shift: i64| {
            let inside = 200..3800usize;
            let sum: f64 = inside
                .clone()
                .map(|index| (decoded[index] - f64::from(source[(index as i64 + shift) as usize])).powi(2))
                .sum();
            (sum / inside.len() as f64).sqrt()
        };
        // Measured 4e-4; a shift of one sample of 2.2 us makes it a hundred times as much.
        assert!(error(0) < 1e-3, "microphone {microphone}: {}", error(0));
        assert!(error(1) > 20.0 * error(0) && error(-1) > 20.0 * error(0), "control");
    }
}

#[test]
fn sixteen_bit_samples_are_the_float_ones_rounded() {
    let mut recording = pcm();
    recording.format = noctule::signal::SampleFormat::PcmI16;
    let make = |recording| {
        let world = World::default_world().unwrap();
        let mut simulator = Simulator::new(
            world,
            &three_sensors(),
            &recording,
            RobotParams::default(),
            SPEED_M_S,
            SimParams::default(),
            9,
        )
        .unwrap();
        ping(&mut simulator)
    };
    let (short, float) = (make(recording), make(pcm()));
    let noctule::signal::Samples::PcmI16(values) = &*short.pings[1].samples else { panic!("not i16") };
    for (index, value) in values.iter().enumerate().take(SAMPLES) {
        let exact = f64::from(row(&float, 1, 0)[index]) * 32768.0;
        assert!((f64::from(*value) - exact).abs() <= 0.5, "{index}");
    }
}

fn some_run(seed: u64) -> Vec<noctule::signal::PingSet> {
    let world = World::default_world().unwrap();
    let params = SimParams { odometry_drift: 0.01, ..SimParams::default() };
    let mut simulator =
        Simulator::new(world, &three_sensors(), &pcm(), RobotParams::default(), SPEED_M_S, params, seed).unwrap();
    (0..3)
        .map(|_| {
            let wanted = simulator.wanted_velocity();
            simulator.step(wanted, 0.1);
            ping(&mut simulator)
        })
        .collect()
}

#[test]
fn the_same_seed_gives_the_same_bits_on_any_thread_and_another_seed_gives_others() {
    let here = some_run(42);
    let elsewhere: Vec<_> = (0..3).map(|_| std::thread::spawn(|| some_run(42))).collect();
    for run in elsewhere {
        assert!(run.join().unwrap() == here);
    }
    assert!(some_run(43) != here);
    assert!(here[0].pings[0].samples != here[1].pings[0].samples, "noise differs from ping to ping");
}
