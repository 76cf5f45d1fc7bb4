//! Contract: what the program believes of the hardware is what was measured of it: the array, the emitted call, where a
//! sensor stands and how it moves, what stands in its way. Oracles: the given data files, finite differences, plain angles.

use nalgebra::{Rotation2, Vector2, Vector3};
use noctule::geometry::shape::Shape;
use noctule::sensor::{Emission, EmissionParams, EmissionShape, MicrophoneArray, Mount, RecordingParams, SensorSetup};
use noctule::sensor::{air, hidden_directions};
use noctule::signal::{Direction, SampleFormat, Velocity};
use proptest::prelude::*;
use std::f64::consts::PI;
use std::path::Path;
use std::sync::Arc;

const CHIRP: &str = include_str!("../fixtures/emissions/ertis_chirp_80_25khz_450khz.csv");
const RATE_HZ: f64 = 450e3;

fn chirp() -> Vec<f64> {
    CHIRP.lines().map(|line| line.split_once(',').unwrap().1.parse().unwrap()).collect()
}

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn the_hyperbolic_sweep_reproduces_the_call_of_the_real_sensor() {
    let emission = Emission::hyperbolic(80e3, 25e3, 2.5e-3, 0.1, RATE_HZ);
    assert_eq!(emission.samples.len(), 1126);
    assert_eq!(emission.band_hz, (25e3, 80e3));
    assert!((emission.duration_s() - 2.5e-3).abs() < 1e-15);
    // The specification's bound; measured: 8.9e-13, the fifteen digits of the file.
    let difference = largest_difference(&emission.samples, &chirp());
    assert!(difference <= 2e-12, "{difference:e}");
}

#[test]
fn a_taper_shifted_by_one_sample_or_a_sweep_one_hertz_off_would_be_noticed() {
    let off = Emission::hyperbolic(80e3, 25_001.0, 2.5e-3, 0.1, RATE_HZ);
    assert!(largest_difference(&off.samples, &chirp()) > 1e-5);
    let plain = Emission::hyperbolic(80e3, 25e3, 2.5e-3, 0.0, RATE_HZ).samples;
    let (faded, width) = (chirp(), 225);
    let hann = |k: usize| 0.5 - 0.5 * (2.0 * PI * k as f64 / (width + 1) as f64).cos();
    let fade_in = |first: usize| (0..113).map(|i| (plain[i] * hann(i + first) - faded[i]).abs()).fold(0.0, f64::max);
    assert!(fade_in(1) <= 2e-12 && fade_in(0) > 1e-3, "{:e} {:e}", fade_in(1), fade_in(0));
}

#[test]
fn instantaneous_frequency_runs_from_start_to_end() {
    // Between upward zero crossings, interpolated; oracle: f = 1 / (1/f0 + t (1/f1 - 1/f0) / T), and the straight line.
    let (start, end, duration) = (50e3, 25e3, 2.5e-3);
    let crossings = |samples: &[f64]| -> Vec<f64> {
        let upward = samples.windows(2).enumerate().filter(|(_, pair)| pair[0] < 0.0 && pair[1] >= 0.0);
        upward.map(|(i, pair)| (i as f64 - pair[0] / (pair[1] - pair[0])) / 4.5e6).collect()
    };
    type Law = fn(f64) -> f64;
    let hyperbolic: Law = |share| 1.0 / (1.0 / 50e3 + share * (1.0 / 25e3 - 1.0 / 50e3));
    let linear: Law = |share| 50e3 - 25e3 * share;
    let pairs = [
        (Emission::hyperbolic(start, end, duration, 0.0, 4.5e6), hyperbolic),
        (Emission::linear(start, end, duration, 0.0, 4.5e6), linear),
    ];
    for (emission, law) in pairs {
        let times = crossings(&emission.samples);
        assert!(times.len() > 80);
        for pair in times.windows(2) {
            let expected = law(0.5 * (pair[0] + pair[1]) / duration);
            // The sampling at 4.5 MHz bends a zero crossing by at most 0.05 % of a period here.
            assert!((1.0 / (pair[1] - pair[0]) / expected - 1.0).abs() < 1e-3);
        }
    }
}

#[test]
fn an_emission_from_a_file_is_its_samples_and_bad_rows_are_named() {
    let read = Emission::from_csv(CHIRP, RATE_HZ, (25e3, 80e3)).unwrap();
    assert_eq!(read.samples, chirp());
    let alone = Emission::from_csv("sample\n0.5\n-0.25\n", RATE_HZ, (25e3, 80e3)).unwrap();
    assert_eq!(alone.samples, [0.5, -0.25]);
    for (text, found) in [
        ("0,0\n1,x\n", "line 2: \"x\""),
        ("0,0\n1,NaN\n", "line 2: \"NaN\""),
        ("inf\n1\n", "line 1: \"inf\""),
        ("0,0\n2,1\n", "line 2: index 2"),
        ("0,0,0\n", "line 1: 3 numbers"),
        ("0\n0\n", "silence"),
        ("", "0 samples"),
        ("1\n1e9\n", "line 2: a sample beyond"),
    ] {
        let error = Emission::from_csv(text, RATE_HZ, (25e3, 80e3)).unwrap_err();
        assert!(error.found.contains(found), "{text:?}: {error}");
    }
}

#[test]
fn emission_parameters_pick_the_shape_and_find_the_file_beside_the_configuration() {
    let base = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/emissions"));
    let csv = EmissionParams {
        shape: EmissionShape::Csv,
        file: Some("ertis_chirp_80_25khz_450khz.csv".into()),
        start_hz: 80e3,
        ..EmissionParams::default()
    };
    assert_eq!(Emission::new(&csv, RATE_HZ, base).unwrap().samples, chirp());
    let missing = EmissionParams { file: Some("none.csv".into()), ..csv.clone() };
    let error = Emission::new(&missing, RATE_HZ, base).unwrap_err();
    assert!(error.key == "file" && error.found.contains("none.csv: no such file"), "{error}");
    let linear = EmissionParams { shape: EmissionShape::Linear, ..EmissionParams::default() };
    assert_eq!(Emission::new(&linear, RATE_HZ, base).unwrap(), Emission::linear(50e3, 25e3, 2.5e-3, 0.1, RATE_HZ));
    let refused = |params: EmissionParams| Emission::new(&params, RATE_HZ, base).unwrap_err().key;
    assert_eq!(refused(EmissionParams { file: None, ..csv.clone() }), "file");
    assert_eq!(refused(EmissionParams { shape: EmissionShape::Linear, ..csv }), "file");
    assert_eq!(refused(EmissionParams { end_hz: 50e3, ..EmissionParams::default() }), "end_hz");
    assert_eq!(refused(EmissionParams { taper: 0.6, ..EmissionParams::default() }), "taper");
    assert_eq!(refused(EmissionParams { duration_s: f64::NAN, ..EmissionParams::default() }), "duration_s");
    assert_eq!(refused(EmissionParams { duration_s: 1e-9, ..EmissionParams::default() }), "duration_s");
}

#[test]
fn the_built_in_array_is_32_microphones_on_a_plane_a_few_centimetres_wide() {
    let array = MicrophoneArray::ertis_v3d1();
    assert_eq!(array.channel_count(), 32);
    assert_eq!(array.positions_m[0], Vector3::new(0.0, 0.022055606, -0.014225825));
    assert!(array.positions_m.iter().all(|p| p.x == 0.0 && p.norm() < 0.06));
    let mean = array.positions_m.iter().sum::<Vector3<f64>>() / 32.0;
    assert!(mean.norm() < 2e-3, "the origin is the array's centre, not {mean:?}");
    assert!(array.enabled.iter().all(|on| *on) && array.weights.iter().all(|w| *w == 1.0));
}

#[test]
fn an_array_file_is_judged_row_by_row() {
    let good = MicrophoneArray::from_csv("mic,x_m,y_m,z_m,weight\n0,0,0.1,0,0.5\n1,0,-0.1,0.02,1\n").unwrap();
    assert_eq!((good.channel_count(), good.weights.as_slice()), (2, [0.5, 1.0].as_slice()));
    for (text, found) in [
        ("", "the header \"\""),
        ("mic,x,y,z\n0,0,0,0\n", "the header \"mic,x,y,z\""),
        ("mic,x_m,y_m,z_m\n", "0 rows"),
        ("mic,x_m,y_m,z_m\n0,0,0\n", "line 2: 3 numbers"),
        ("mic,x_m,y_m,z_m\n0,0,0,0,1\n", "line 2: 5 numbers"),
        ("mic,x_m,y_m,z_m\n0,0,0,0\n2,0,0,0\n", "line 3: microphone 2"),
        ("mic,x_m,y_m,z_m\n0,0,inf,0\n", "line 2: \"inf\""),
        ("mic,x_m,y_m,z_m\n0,0,22.05,0\n", "line 2: a position of [0, 22.05, 0]"),
        ("mic,x_m,y_m,z_m,weight\n0,0,0,0,-1\n", "line 2: a weight of -1"),
        ("mic,x_m,y_m,z_m,weight\n0,0,0,0,0\n", "no microphone in use"),
    ] {
        let error = MicrophoneArray::from_csv(text).unwrap_err();
        assert!(error.found.contains(found), "{text:?}: {error}");
    }
}

#[test]
fn disabled_microphones_exist_are_named_once_and_leave_some() {
    let mut array = MicrophoneArray::ertis_v3d1();
    array.disable(&[3, 31]).unwrap();
    assert_eq!(array.enabled.iter().filter(|on| !**on).count(), 2);
    assert!(!array.enabled[3] && !array.enabled[31]);
    let refused = |mics: &[usize]| MicrophoneArray::ertis_v3d1().disable(mics).unwrap_err().key;
    assert_eq!(refused(&[0, 32]), "disabled_mics[1]");
    assert_eq!(refused(&[5, 6, 5]), "disabled_mics[2]");
    assert_eq!(refused(&(0..32).collect::<Vec<_>>()), "disabled_mics");
}

#[test]
fn sound_is_343_2_m_s_at_20_degrees_and_331_3_at_the_freezing_point() {
    // ISO 9613-1, annex: 343.2 m/s at 20 degrees Celsius.
    assert!((air::speed_of_sound_m_s(20.0) - 343.2).abs() < 0.05);
    assert_eq!(air::speed_of_sound_m_s(0.0), 331.3);
}

#[test]
fn a_recording_takes_what_is_left_out_from_its_format() {
    let pdm = RecordingParams::default().resolve().unwrap();
    assert_eq!((pdm.samples, pdm.decimation, pdm.demodulated_samples()), (163_840, 10, 16_384));
    assert_eq!(pdm.demodulated_rate_hz(), 450e3);
    let pcm = RecordingParams { format: SampleFormat::PcmI16, ..RecordingParams::default() };
    let resolved = pcm.resolve().unwrap();
    assert_eq!((resolved.samples, resolved.decimation, resolved.sample_rate_hz), (16_384, 1, 450e3));
    let refused = |params: RecordingParams| params.resolve().unwrap_err().key;
    assert_eq!(refused(RecordingParams { decimation: Some(10), ..pcm }), "decimation");
    assert_eq!(refused(RecordingParams { decimation: Some(0), ..RecordingParams::default() }), "decimation");
    assert_eq!(refused(RecordingParams { samples: Some(3), ..RecordingParams::default() }), "samples");
    assert_eq!(refused(RecordingParams { sample_rate_hz: Some(f64::NAN), ..pcm }), "sample_rate_hz");
}

proptest! {
    #[test]
    fn the_sensor_velocity_is_the_finite_difference_of_its_true_path(
        distance in 0.0f64..0.8, bearing in -PI..PI, yaw in -PI..PI, linear in -0.5f64..0.5, angular in -1.5f64..1.5,
    ) {
        let mount = Mount { distance_m: distance, bearing_rad: bearing, yaw_rad: yaw };
        let told = mount.sensor_velocity_m_s(Velocity { linear_m_s: linear, angular_rad_s: angular });
        // The robot's centre after a short time, both ways, by the arc's own geometry to second order.
        let place = |t: f64| {
            let turn = angular * t;
            let centre = Vector2::new(linear * t, 0.5 * linear * angular * t * t);
            centre + Rotation2::new(turn) * Vector2::new(distance * bearing.cos(), distance * bearing.sin())
        };
        let step = 1e-5;
        let in_robot_frame = (place(step) - place(-step)) / (2.0 * step);
        let truth = Rotation2::new(-(bearing + yaw)) * in_robot_frame;
        prop_assert!((told - truth).norm() < 1e-8, "{told:?} is not {truth:?}");
    }
}

#[test]
fn a_sensor_that_looks_left_moves_to_its_own_right_where_the_paper_prints_left() {
    let mount = Mount { distance_m: 0.0, bearing_rad: PI / 2.0, yaw_rad: 0.0 };
    let velocity = mount.sensor_velocity_m_s(Velocity::forward_m_s(1.0));
    assert!((velocity - Vector2::new(0.0, -1.0)).norm() < 1e-12);
}

fn sensor(name: &str, distance_m: f64, bearing_deg: f64, yaw_deg: f64) -> SensorSetup {
    SensorSetup {
        name: name.to_owned(),
        mount: Mount { distance_m, bearing_rad: bearing_deg.to_radians(), yaw_rad: yaw_deg.to_radians() },
        array: MicrophoneArray::ertis_v3d1(),
        emission: Arc::new(Emission::hyperbolic(50e3, 25e3, 2.5e-3, 0.1, RATE_HZ)),
        emitter_m: Vector3::new(0.0, 0.0, 0.06),
    }
}

fn fan() -> Vec<Direction> {
    (0..180).map(|i| Direction::horizontal((f64::from(i) - 89.5).to_radians())).collect()
}

fn hidden_deg(sensors: &[SensorSetup], index: usize, obstructions: &[Shape]) -> Vec<f64> {
    let (zone, fan) = (hidden_directions(sensors, index, obstructions, &fan()), fan());
    zone.hidden.iter().zip(fan).filter(|(hidden, _)| **hidden).map(|(_, d)| d.azimuth_rad.to_degrees()).collect()
}

#[test]
fn a_housing_ahead_hides_the_angle_that_its_corners_span() {
    // Sensor `a` at the origin looks forward; `b` stands 0.4 m ahead and looks forward too: its back, 0.116 m wide, is
    // 0.35 m away, so it hides atan(0.058 / 0.35) = 9.41 degrees to either side.
    let sensors = [sensor("a", 0.0, 0.0, 0.0), sensor("b", 0.4, 0.0, 0.0)];
    let hidden = hidden_deg(&sensors, 0, &[]);
    assert_eq!(hidden.len(), 18);
    assert!((hidden[0] + 8.5).abs() < 1e-9 && (hidden[17] - 8.5).abs() < 1e-9);
    assert!(hidden_deg(&sensors, 1, &[]).is_empty(), "what stands behind hides nothing");
    // Turned to face `a`, the front is 0.4 m away: atan(0.058 / 0.4) = 8.25 degrees.
    let facing = [sensor("a", 0.0, 0.0, 0.0), sensor("b", 0.4, 0.0, 180.0)];
    let hidden = hidden_deg(&facing, 0, &[]);
    assert_eq!(hidden.len(), 16, "{hidden:?}");
}

#[test]
fn hidden_bearings_turn_with_the_sensor() {
    let sensors = [sensor("a", 0.0, 0.0, 50.0), sensor("b", 0.4, 0.0, 0.0)];
    let hidden = hidden_deg(&sensors, 0, &[]);
    // The same 9.41 degrees about a bearing of -50.
    assert!((hidden[0] + 58.5).abs() < 1e-9 && (hidden[hidden.len() - 1] + 41.5).abs() < 1e-9, "{hidden:?}");
}

#[test]
fn the_built_in_robot_sees_everything() {
    let sensors = [sensor("f", 0.15, 0.0, 0.0), sensor("l", 0.15, 120.0, 0.0), sensor("r", 0.15, -120.0, 0.0)];
    for index in 0..3 {
        let zone = hidden_directions(&sensors, index, &[], &fan());
        assert_eq!((zone.hidden_count(), zone.listed.len(), zone.warnings.len()), (0, 0, 0));
    }
}

#[test]
fn a_housing_around_the_origin_is_ignored_with_a_warning() {
    // Setup 8 of table 1 has a sensor in the centre of the robot; two in one place hide nothing from each other.
    let sensors = [sensor("a", 0.0, 0.0, 0.0), sensor("b", 0.02, 0.0, 0.0)];
    let zone = hidden_directions(&sensors, 0, &[], &fan());
    assert_eq!(zone.hidden_count(), 0);
    assert!(zone.warnings.len() == 1 && zone.warnings[0].contains("`b`") && zone.warnings[0].contains("`a`"));
}

#[test]
fn an_obstruction_hides_its_angle_and_names_itself() {
    let sensors = [sensor("a", 0.2, 90.0, -90.0)];
    let pillar = Shape::Circle { centre_m: [0.5, 0.2], radius_m: 0.1 };
    // asin(0.1 / 0.5) = 11.54 degrees.
    assert_eq!(hidden_deg(&sensors, 0, std::slice::from_ref(&pillar)).len(), 24);
    let zone = hidden_directions(&sensors, 0, &[pillar], &fan());
    assert_eq!(zone.listed, ["obstruction[0] hides 24 of 180 directions from sensor `a`, bearings -11.5 to 11.5 deg"]);
    let around = Shape::Circle { centre_m: [0.0, 0.0], radius_m: 0.5 };
    let zone = hidden_directions(&sensors, 0, &[around], &fan());
    assert_eq!((zone.hidden_count(), zone.warnings.len()), (180, 1), "a blind sensor is blind, not free");
}
