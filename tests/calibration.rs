//! Contract: the direct path is timed to micrometres; what it tells of air, emitter, microphones and gains is right within the standard
//! deviations told, which are honest; what it cannot tell is said; drift is an alarm, and hours without drift are none.

mod calibration_rig;
mod checks;
mod counting;
mod sim_support;

use calibration_rig::*;
use checks::trials;
use nalgebra::{DMatrix, Vector3};
use noctule::calibration::Observer;
use noctule::calibration::arrival::Sweep;
use noctule::calibration::solve::{Heard, Known, Way, solve};
use noctule::geometry::Pose2;
use noctule::sensor::{SensorSetup, air};
use noctule::signal::{SampleFormat, Velocity};
use noctule::sim::{Jammer, SimParams};
use sim_support::*;

#[test]
fn the_direct_path_is_timed_to_micrometres_and_clipping_takes_the_amplitude_only() {
    let template = Sweep::new(&emission());
    let mut random = Random(1);
    let um = SPEED_M_S / RATE_HZ * 1e6;
    // Amplitude, noise, bars: rms error of the phase in micrometres, of the envelope, of the amplitude (share).
    // Measured, and a half more.
    let cases = [
        (0.5, 0.0, 0.02, 50.0, 1e-3),
        (0.5, 1e-3, 0.22, 50.0, 1e-3),
        (0.5, 1e-2, 2.2, 50.0, 1e-2),
        (0.5, 0.1, 21.0, 150.0, 0.05),
        (0.5, 0.4, 85.0, 470.0, 0.2),
        (2.0, 1e-3, 2.3, 50.0, 0.3),
        (5.0, 1e-3, 6.0, 100.0, 0.3),
        (20.0, 1e-3, 17.0, 150.0, 0.35),
    ];
    for (amplitude, noise, phase_um, envelope_um, share) in cases {
        let (mut sum, mut squares, mut envelope, mut loudness, mut likeness) = (0.0, 0.0, 0.0, 0.0, 0.0);
        let count = 200;
        for step in 0..count {
            let delay_s = (40.37 + 80.0 * f64::from(step) / f64::from(count)) / RATE_HZ;
            let row = channel(delay_s, amplitude, noise, 1400, &mut random);
            let found = template.find(&row, delay_s * RATE_HZ + 5.0).expect("found");
            let error = (found.phase_lag(&template, 0.0) - delay_s * RATE_HZ) * um;
            sum += error / f64::from(count);
            squares += error * error / f64::from(count);
            envelope += ((found.envelope_lag - delay_s * RATE_HZ) * um).powi(2) / f64::from(count);
            loudness += found.amplitude / f64::from(count);
            likeness += found.coefficient / f64::from(count);
        }
        let (rms, envelope) = (squares.sqrt(), envelope.sqrt());
        println!(
            "amplitude {amplitude}, noise {noise}: phase mean {sum:+.3} um, rms {rms:.3} um; envelope rms {envelope:.1} um; amplitude \
             {loudness:.4}, coefficient {likeness:.3}"
        );
        assert!(rms < phase_um && envelope < envelope_um, "{amplitude} {noise}: {rms} {envelope}");
        assert!((loudness / amplitude.min(1.0) - 1.0).abs() < share, "{loudness}");
    }
    // Controls: a hundredth of a sample is seen; silence, noise and NaN are no arrival that anybody would believe.
    let row = channel(80.01 / RATE_HZ, 0.5, 0.0, 1400, &mut random);
    let error = template.find(&row, 80.0).expect("found").phase_lag(&template, 0.0) - 80.0;
    assert!((error - 0.01).abs() < 1e-4, "{error}");
    assert_eq!(template.find(&[0.0; 1400], 80.0), None);
    assert_eq!(template.find(&[f32::NAN; 1400], 80.0), None);
    assert_eq!(template.find(&row[..900], 80.0), None);
    let hiss: Vec<f32> = (0..1400).map(|_| 0.3 * random.gaussian() as f32).collect();
    assert!(template.find(&hiss, 80.0).is_none_or(|found| found.coefficient < 0.3));
}

/// Ways of the array in closed form.
fn ways_of(sensor: &SensorSetup, emitter_m: Vector3<f64>, speed_m_s: f64, late_s: f64) -> Vec<Heard> {
    let way = |place_m: &Vector3<f64>| Heard {
        place_m: *place_m,
        way_m: SPEED_M_S * ((place_m - emitter_m).norm() / speed_m_s + late_s),
        sd_m: 1e-9,
        unheard: false,
    };
    sensor.array.positions_m.iter().map(way).collect()
}

fn known(sensor: &SensorSetup, speed: f64, late: f64, emitter: f64, place: f64) -> Known {
    Known {
        speed_of_sound_m_s: SPEED_M_S,
        speed_sd_m_s: speed,
        late_sd_s: late,
        emitter_m: sensor.emitter_m,
        emitter_sd_m: emitter,
        place_sd_m: place,
    }
}

#[test]
fn ways_in_closed_form_give_back_what_made_them_and_another_sign_does_not() {
    let sensor = nominal();
    // As good as nothing known beforehand, and a perfect array.
    let free = known(&sensor, 300.0, 1e-3, 0.3, 1e-7);
    let mut ways = Vec::new();
    for (speed_m_s, late_s, shift_m) in [
        (325.2, 0.0, Vector3::zeros()),
        (360.4, 2e-6, Vector3::new(0.0, 1.5e-3, -2e-3)),
        (343.0, -5e-6, Vector3::new(0.0, -3e-3, 1e-3)),
    ] {
        let heard = ways_of(&sensor, sensor.emitter_m + shift_m, speed_m_s, late_s);
        let found = solve(&heard, &free, &mut ways).expect("solved");
        assert!((found.speed_of_sound_m_s - speed_m_s).abs() < 0.02, "{found:?}");
        assert!((found.late_s - late_s).abs() < 2e-8, "{found:?}");
        assert!((found.emitter_m - sensor.emitter_m - shift_m).norm() < 1e-5, "{found:?}");
        if shift_m != Vector3::zeros() {
            let turned = solve(&ways_of(&sensor, sensor.emitter_m - shift_m, speed_m_s, late_s), &free, &mut ways);
            assert!((turned.expect("solved").emitter_m - sensor.emitter_m - shift_m).norm() > 1e-3, "control");
        }
    }
    assert!(solve(&ways_of(&sensor, sensor.emitter_m, 343.0, 0.0)[..5], &free, &mut ways).is_none());
}

/// Singular values of the Jacobian of the times by scale, lateness and emitter, made by differences.
fn singular_values(sensor: &SensorSetup) -> Vec<f64> {
    let base = |values: [f64; 5], place_m: &Vector3<f64>| {
        let emitter_m = sensor.emitter_m + Vector3::new(values[2], values[3], values[4]);
        (1.0 + values[0]) * (place_m - emitter_m).norm() + values[1]
    };
    let step = 1e-6;
    let rows = sensor.array.positions_m.len();
    let jacobian = DMatrix::from_fn(rows, 5, |row, column| {
        let at = |sign: f64| {
            let mut values = [0.0; 5];
            values[column] = sign * step;
            base(values, &sensor.array.positions_m[row])
        };
        (at(1.0) - at(-1.0)) / (2.0 * step)
    });
    jacobian.singular_values().iter().copied().collect()
}

#[test]
fn a_planar_array_with_the_emitter_in_its_plane_tells_four_of_five_and_says_so() {
    let sensor = nominal();
    let flat = singular_values(&sensor);
    println!("singular values, emitter in the plane: {flat:.6?}");
    assert!(flat[4] < 1e-9 * flat[0] && flat[3] > 1e-4 * flat[0], "{flat:?}");
    let mut raised = sensor.clone();
    raised.emitter_m.x = 0.02;
    let five = singular_values(&raised);
    println!("emitter 20 mm before it: {five:.6?}");
    assert!(five[4] > 1e-5 * five[0], "{five:?}");
    let mut ways = Vec::new();
    let heard = ways_of(&sensor, sensor.emitter_m, SPEED_M_S, 0.0);
    for (speed, late, emitter, place) in [
        (10.0, 3e-6, 2e-3, 0.5e-3),
        (10.0, 3e-6, 1e-3, 0.3e-3),
        (0.3, 3e-6, 2e-3, 0.5e-3),
        (10.0, 0.2e-6, 0.3e-3, 0.02e-3),
    ] {
        let found = solve(&heard, &known(&sensor, speed, late, emitter, place), &mut ways).expect("solved");
        // The emitter is a millimetre elsewhere and held where it was: what it does to the speed of sound.
        let held = known(&sensor, speed, late, 1e-7, place);
        let moved = |axis: usize| {
            let mut emitter_m = sensor.emitter_m;
            emitter_m[axis] += 1e-3;
            let found = solve(&ways_of(&sensor, emitter_m, SPEED_M_S, 0.0), &held, &mut Vec::new());
            found.expect("solved").speed_of_sound_m_s - SPEED_M_S
        };
        println!(
            "known: c {speed} m/s, late {:.1} us, emitter {:.1} mm, places {:.2} mm; told {}: c {:.2} m/s, late {:.2} us, emitter {:.2?} \
             mm; 1 mm of y is {:+.2} m/s, of z {:+.2}",
            1e6 * late,
            1e3 * emitter,
            1e3 * place,
            found.told,
            found.speed_sd_m_s,
            1e6 * found.late_sd_s,
            (1e3 * found.emitter_sd_m).as_slice(),
            moved(1),
            moved(2)
        );
        assert!((found.emitter_sd_m.x / emitter - 1.0).abs() < 1e-6, "x stays as it was known: {found:?}");
        assert!(found.emitter_sd_m.y < 0.5 * emitter && found.told < 5, "{found:?}");
    }
}

/// Mean of the normalized squared error of the five shared unknowns, and of a microphone's way, over worlds drawn from `truth` and
/// solved by who believes `belief`.
fn normalized_errors(truth: &Known, belief: &Known, noise_m: f64, worlds: usize) -> (f64, f64) {
    let sensor = nominal();
    let mut random = Random(5);
    let mut ways: Vec<Way> = Vec::new();
    let (mut shared, mut own) = (0.0, 0.0);
    for _ in 0..worlds {
        let scale = random.gaussian() * truth.speed_sd_m_s / SPEED_M_S;
        let late_m = random.gaussian() * truth.late_sd_s * SPEED_M_S;
        let shift_m = Vector3::from_fn(|_, _| random.gaussian() * truth.emitter_sd_m);
        let mut longer_m = Vec::new();
        let heard: Vec<Heard> = sensor
            .array
            .positions_m
            .iter()
            .map(|place_m| {
                longer_m.push(random.gaussian() * truth.place_sd_m);
                let way_m = (1.0 + scale) * (place_m - sensor.emitter_m - shift_m).norm() + late_m;
                let way_m = way_m + longer_m[longer_m.len() - 1] + noise_m * random.gaussian();
                Heard { place_m: *place_m, way_m, sd_m: noise_m, unheard: false }
            })
            .collect();
        let found = solve(&heard, belief, &mut ways).expect("solved");
        let moved_m = found.emitter_m - sensor.emitter_m - shift_m;
        let error = nalgebra::SVector::<f64, 5>::from_column_slice(&[
            SPEED_M_S / found.speed_of_sound_m_s - 1.0 - scale,
            found.late_s * SPEED_M_S - late_m,
            moved_m.x,
            moved_m.y,
            moved_m.z,
        ]);
        let inverse = found.covariance.try_inverse().expect("positive");
        shared += (error.transpose() * inverse * error)[0] / worlds as f64;
        let squares: f64 =
            ways.iter().zip(&longer_m).map(|(way, longer_m)| ((way.longer_m - longer_m) / way.sd_m).powi(2)).sum();
        own += squares / (worlds * ways.len()) as f64;
    }
    (shared, own)
}

#[test]
fn the_standard_deviations_told_are_those_that_the_errors_have() {
    let sensor = nominal();
    let worlds = trials(6000, 400);
    for believed in [known(&sensor, 10.0, 3e-6, 2e-3, 0.5e-3), known(&sensor, 0.3, 3e-6, 2e-3, 0.5e-3)] {
        let (shared, own) = normalized_errors(&believed, &believed, 0.1e-3, worlds);
        println!("{worlds} worlds: mean normalized squared error {shared:.2} of 5, a microphone {own:.3} of 1");
        // One standard error of a mean of 400 chi-squares with 5 degrees of freedom is 0.16; curvature adds a little.
        assert!((shared - 5.0).abs() < 0.65, "{shared}");
        assert!((own - 1.0).abs() < 0.1, "{own}");
    }
    // Control: who trusts the array five times too much is wrong by more than he says.
    let truth = known(&sensor, 10.0, 3e-6, 2e-3, 0.5e-3);
    let (shared, _) = normalized_errors(&truth, &known(&sensor, 10.0, 3e-6, 2e-3, 0.1e-3), 0.1e-3, 100);
    assert!(shared > 20.0, "{shared}");
}

#[test]
fn air_emitter_microphones_and_gains_of_a_crooked_sensor_are_found_within_what_is_told() {
    let mut sums = [0.0; 4];
    let mut count = 0.0;
    for (index, temperature_c) in [-10.0, 5.0, 20.0, 35.0, 50.0].into_iter().enumerate() {
        for (format, pings) in [(SampleFormat::PcmF32, 48), (SampleFormat::PcmI16, 20), (SampleFormat::Pdm, 8)] {
            let seed = 10 + index as u64;
            let mut truth = crooked(temperature_c, seed);
            if format == SampleFormat::Pdm {
                truth.gains = vec![1.0; 32];
            }
            let observer = observe(&truth, format, pings, seed);
            let blind = measured(&observer, &truth, false);
            let found = measured(&observer, &truth, true);
            let emitter_m = Vector3::from(found.emitter_m) - truth.sensor.emitter_m;
            let own: f64 = found
                .path_m
                .iter()
                .zip(&longer_m(&truth))
                .zip(&found.path_sd_m)
                .map(|((found, truth), sd)| ((found - truth) / sd).powi(2))
                .sum::<f64>()
                / 32.0;
            let mut sorted = truth.gains.clone();
            sorted.sort_by(f64::total_cmp);
            let gain_db = |(found, gain): (&f64, &f64)| found - 20.0 * (gain / sorted[16]).log10();
            let worst_db =
                found.gain_db.iter().zip(&truth.gains).map(gain_db).fold(0.0_f64, |most, x| most.max(x.abs()));
            println!(
                "{temperature_c} C, {}: blind {:.1} +- {:.1} C; with a thermometer emitter y {:+.2} +- {:.2} mm, z {:+.2} +- {:.2} mm, ways \
                 {own:.2} of 1, worst gain {worst_db:.3} dB",
                format.as_str(),
                blind.air_temperature_c,
                blind.air_temperature_sd_c,
                1e3 * emitter_m.y,
                1e3 * found.emitter_sd_m[1],
                1e3 * emitter_m.z,
                1e3 * found.emitter_sd_m[2]
            );
            assert!(((blind.air_temperature_c - temperature_c) / blind.air_temperature_sd_c).abs() < 3.5);
            assert!(
                (emitter_m.y / found.emitter_sd_m[1]).abs() < 3.5 && (emitter_m.z / found.emitter_sd_m[2]).abs() < 3.5
            );
            // Measured: see the table; what is left is the distance, known to a tenth of a millimetre of 30.
            assert!(worst_db < 0.1, "{worst_db}");
            assert_eq!(blind.not_observable, ["lateness", "emitter x"]);
            let sigmas = [
                (blind.air_temperature_c - temperature_c) / blind.air_temperature_sd_c,
                emitter_m.y / found.emitter_sd_m[1],
                emitter_m.z / found.emitter_sd_m[2],
                own.sqrt(),
            ];
            sums.iter_mut().zip(sigmas).for_each(|(sum, sigma)| *sum += sigma * sigma);
            count += 1.0;
        }
    }
    println!("mean squares in standard deviations: {:.2?}", sums.map(|sum| sum / count));
}

#[test]
fn noise_clipping_and_jamming_are_borne_and_told() {
    let truth_ways = |truth: &Truth, observer: &Observer| {
        let mut heard = Vec::new();
        observer.heard(&mut heard);
        let errors: Vec<f64> = heard
            .iter()
            .zip(&truth.sensor.array.positions_m)
            .filter(|(one, _)| !one.unheard)
            .map(|(one, p)| one.way_m - SPEED_M_S / truth.speed_m_s * (p - truth.sensor.emitter_m).norm())
            .collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let rms = (errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>() / errors.len() as f64).sqrt();
        let told = heard.iter().map(|one| one.sd_m).sum::<f64>() / heard.len() as f64;
        (1e6 * rms, 1e6 * told, 1e6 * mean, errors.len())
    };
    let jammer = Jammer { frequency_hz: 40e3, amplitude_at_1_m: 0.2, position_m: [1.5, 0.5, 0.0], bursts: None };
    let with = |params: SimParams| Truth { params, ..Truth::as_configured() };
    let plain = SimParams::default();
    for (name, params, bar_um) in [
        ("noise 1e-3", plain, 5.0),
        ("noise 1e-2", SimParams { noise_rms: 1e-2, ..plain }, 6.0),
        ("noise 1e-1", SimParams { noise_rms: 1e-1, ..plain }, 6.0),
        ("clipped 3 times", SimParams { direct_amplitude: 3.0, ..plain }, 6.0),
        ("clipped 10 times", SimParams { direct_amplitude: 10.0, ..plain }, 8.0),
        ("a wall 0.15 m before it", plain, 13.0),
        ("jammed at 40 kHz", SimParams { jammers: [Some(jammer), None, None, None], ..plain }, 13.0),
    ] {
        let mut truth = with(params);
        if name.starts_with("a wall") {
            // The robot stands, its sensor 0.15 m before the middle, and what comes back is always the same.
            (truth.pose, truth.velocity) = (Pose2::default(), Velocity::ZERO);
            truth.world = walls(&[&[[0.30, -3.0], [0.30, 3.0]]]);
        }
        let observer = observe(&truth, SampleFormat::PcmF32, 40, 3);
        let (rms_um, told_um, mean_um, heard) = truth_ways(&truth, &observer);
        let found = measured(&observer, &truth, false);
        println!(
            "{name}: ways to {rms_um:.1} um rms (told {told_um:.1}), {mean_um:+.1} um in common, {heard} heard, {} clipped, {:.1} +- {:.1} C",
            found.clipped.len(),
            found.air_temperature_c,
            found.air_temperature_sd_c
        );
        // Beside a wall, whose echo is as loud as the direct path, eight microphones are not believed.
        assert!(heard >= 24 && rms_um < bar_um, "{name}: {rms_um}");
        assert!((found.speed_of_sound_m_s - SPEED_M_S).abs() < 1.5, "{name}: {found:?}");
        assert_eq!(found.clipped.is_empty(), params.direct_amplitude < 1.0 && !name.starts_with("a wall"), "{name}");
    }
}

#[test]
fn the_temperature_of_the_air_is_the_inverse_of_its_speed_of_sound() {
    for tenth in -400..850 {
        let temperature_c = f64::from(tenth) * 0.1;
        let speed = speed_m_s(temperature_c);
        assert!((air::air_temperature_c(speed) - temperature_c).abs() < 1e-9);
        let slope = (air::air_temperature_c(speed + 1e-4) - air::air_temperature_c(speed - 1e-4)) / 2e-4;
        assert!((air::kelvins_per_m_s(speed) - slope).abs() < 1e-5);
    }
}
