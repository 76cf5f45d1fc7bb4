//! Contract: drift is an alarm of its own kind and no other; hours without drift are none.

use super::*;
use crate::checks::{is_full, trials};
use crate::counting::allocations_of;
use noctule::calibration::{Alarms, Calibration, CalibrationParams, Drift, DriftMonitor};
use noctule::io::encode_png;
use noctule::io::plot::{CurvePanel, CurvePoint, curves};

fn watch_params(measured: Option<SensorCalibration>) -> CalibrationParams {
    let file = |sensor| Calibration {
        calibration_version: 1,
        recorded: String::new(),
        sensor: vec![sensor],
        cross: Vec::new(),
    };
    CalibrationParams { measured: measured.map(|sensor| Arc::new(file(sensor))), ..CalibrationParams::default() }
}

/// Alarms of a monitor that hears `before` and then `after`; and how many looks it took.
fn watch(params: &CalibrationParams, used_m_s: f64, worlds: &[(&Truth, usize)], seed: u64) -> (Alarms, Drift) {
    let sensor = nominal();
    let plan = plan_of(&sensor, SampleFormat::PcmF32, SHORT);
    let mut monitor = DriftMonitor::new(&plan, std::slice::from_ref(&sensor), params, used_m_s);
    let mut seen = 0;
    for (truth, count) in worlds {
        truth.pings(*count, SampleFormat::PcmF32, seed, |set| {
            let ((), allocated) = allocations_of(|| monitor.listen(&plan, set));
            assert_eq!(allocated, 0, "it runs inside the daemon");
            seen |= monitor.drift(0).alarms.bits();
        });
    }
    (Alarms::from_bits(seen), monitor.drift(0))
}

/// A look comes after eight pings a value and 16 values a block; an alarm needs two looks.
const FRESH: usize = 8 * 16 * 4;
/// Pings after which a mean has followed a change.
const FOLLOWED: usize = 8 * 16 * 9;

#[test]
fn a_drifted_world_is_an_alarm_of_its_own_kind_and_no_other() {
    let base = crooked(20.0, 3);
    let observer = observe(&base, SampleFormat::PcmF32, 80, 3);
    let calibrated = watch_params(Some(measured(&observer, &base, true)));
    let changed = |change: &dyn Fn(&mut Truth)| {
        let mut truth = base.clone();
        change(&mut truth);
        truth
    };
    let used_m_s = base.speed_m_s;
    // The calibration was made with 343 m/s configured; the world has 343.2.
    let cases: [(&str, Truth, Alarms); 6] = [
        ("nothing", base.clone(), Alarms::default()),
        ("12 K warmer", changed(&|truth| truth.speed_m_s = speed_m_s(32.0)), Alarms::SPEED),
        (
            "microphone 9 is 1.5 mm farther",
            changed(&|truth| {
                let apart_m = truth.sensor.array.positions_m[9] - truth.sensor.emitter_m;
                truth.sensor.array.positions_m[9] += apart_m.normalize() * 1.5e-3;
            }),
            Alarms::PATH,
        ),
        ("microphone 5 is 6 dB weaker", changed(&|truth| truth.gains[5] *= 0.5), Alarms::GAIN),
        ("the emitter is 1.5 mm to the left", changed(&|truth| truth.sensor.emitter_m.y += 1.5e-3), Alarms::EMITTER),
        ("the emitter is 6 dB weaker", changed(&|truth| truth.params.direct_amplitude *= 0.5), Alarms::LEVEL),
    ];
    for (name, truth, expected) in &cases {
        let (alarms, drift) = watch(&calibrated, used_m_s, &[(truth, FRESH)], 4);
        println!(
            "{name}: {alarms}; {drift}; {} looks, speed off {:+.2} +- {:.2} m/s",
            drift.looks, drift.speed_off_m_s, drift.speed_sd_m_s
        );
        assert_eq!(alarms, *expected, "{name}: {drift}");
    }
    let warmer = &cases[1].1;
    // What was measured is the truth's temperature.
    let (_, drift) = watch(&calibrated, used_m_s, &[(warmer, FRESH)], 4);
    assert!((drift.air_temperature_c() - 32.0).abs() < 1.0, "{drift}");
    // A configuration that has followed the air is no drift; without a file a change since the start shows too.
    let (alarms, _) = watch(&calibrated, warmer.speed_m_s, &[(warmer, FRESH)], 4);
    assert!(alarms.is_empty(), "{alarms}");
    let (alarms, drift) = watch(&watch_params(None), used_m_s, &[(&base, FRESH), (warmer, FOLLOWED)], 4);
    assert_eq!(alarms, Alarms::SPEED, "{drift}");
    // Controls: who tolerates ten times as much, and who does not watch, says nothing.
    let deaf = CalibrationParams { speed_tolerance: 0.1, ..calibrated.clone() };
    assert!(watch(&deaf, used_m_s, &[(warmer, FRESH)], 4).0.is_empty());
    let off = CalibrationParams { watch: false, ..calibrated };
    assert_eq!(watch(&off, used_m_s, &[(warmer, 600)], 4).1.looks, 0);
}

#[test]
fn hours_without_drift_are_no_alarm() {
    // A small room, whose walls come to half a metre; fifty times the noise that the simulator's microphones have.
    let mut base = crooked(20.0, 8);
    base.world = walls(&[&[[-1.3, -1.3], [1.3, -1.3], [1.3, 1.3], [-1.3, 1.3], [-1.3, -1.3]]]);
    base.params.noise_rms = 5e-2;
    base.velocity = Velocity { linear_m_s: 0.15, angular_rad_s: 0.5 };
    // Calibrated in the open, in quiet.
    let observer = observe(&crooked(20.0, 8), SampleFormat::PcmF32, 80, 8);
    let params = watch_params(Some(measured(&observer, &base, true)));
    let sensor = nominal();
    let plan = plan_of(&sensor, SampleFormat::PcmF32, SHORT);
    let mut monitor = DriftMonitor::new(&plan, std::slice::from_ref(&sensor), &params, base.speed_m_s);
    // Full: two hours at ten a second. What alarms need is told as a share of the tolerance: the room that is left.
    let count = trials(72_000, 2_400);
    let (mut worst, mut looks, mut alarms, mut took_s) = ([0.0_f64; 4], 0, 0, 0.0);
    let (mut sum, mut squares) = (0.0, 0.0);
    base.pings(count, SampleFormat::PcmF32, 9, |set| {
        let begun = std::time::Instant::now();
        monitor.listen(&plan, set);
        took_s += begun.elapsed().as_secs_f64();
        let now = monitor.drift(0);
        if now.looks > looks {
            looks = now.looks;
            alarms += u64::from(!now.alarms.is_empty());
            sum += now.speed_off_m_s;
            squares += now.speed_off_m_s.powi(2);
            let shares = [now.speed_off_m_s / 3.43, now.path.1 / 1e-3, now.gain.1 / 3.0, now.level_db / 3.0];
            worst.iter_mut().zip(shares).for_each(|(worst, share)| *worst = worst.max(share.abs()));
        }
    });
    let sd = (squares / looks as f64 - (sum / looks as f64).powi(2)).sqrt();
    println!(
        "{count} pings, {looks} looks: {alarms} alarms; largest shares of the tolerances: speed, way, gain, level {worst:.3?}; speed {:+.3} +- \
         {sd:.3} m/s; {:.1} us a ping",
        sum / looks as f64,
        1e6 * took_s / count as f64
    );
    assert_eq!(alarms, 0);
    assert!(looks > 10 && worst.iter().all(|share| *share < 0.5), "{worst:?}");
}

#[test]
fn the_temperature_told_follows_that_of_a_day() {
    // Colder by night, warmest at three in the afternoon; calibrated at noon of the day before, with a thermometer.
    let temperature_c = |hour: f64| 16.0 - 9.0 * (std::f64::consts::TAU * (hour - 3.0) / 24.0).cos();
    let mut truth = crooked(temperature_c(12.0), 12);
    let observer = observe(&truth, SampleFormat::PcmF32, 40, 12);
    let params = watch_params(Some(measured(&observer, &truth, true)));
    let sensor = nominal();
    let plan = plan_of(&sensor, SampleFormat::PcmF32, SHORT);
    let mut monitor = DriftMonitor::new(&plan, std::slice::from_ref(&sensor), &params, truth.speed_m_s);
    let (step, pings) = if is_full() { (1, FOLLOWED) } else { (6, FRESH) };
    let (mut points, mut worst) = (Vec::new(), 0.0_f64);
    for hour in (0..24).step_by(step).map(f64::from) {
        truth.speed_m_s = speed_m_s(temperature_c(hour));
        truth.pings(pings, SampleFormat::PcmF32, hour as u64, |set| monitor.listen(&plan, set));
        let told_c = monitor.drift(0).air_temperature_c();
        println!("{hour:2}:00 {:.2} C, told {told_c:.2} C", temperature_c(hour));
        points.push(CurvePoint { x: hour + 1.0, measured: told_c, expected: temperature_c(hour) });
        worst = worst.max((told_c - temperature_c(hour)).abs());
    }
    // The mean remembers four blocks, so that a minute after a step of 9 K a quarter of it is left in a plain run.
    assert!(worst < if is_full() { 0.6 } else { 4.5 }, "{worst}");
    if let Some(path) = std::env::var_os("NOCTULE_PICTURE_DAY") {
        let panels = [CurvePanel { x_title: "hour of the day, from 1".to_owned(), points }];
        let titles = [
            "Temperature of the air, as the direct path tells it",
            "one calibration with a thermometer, the day before",
        ];
        let picture = curves(&panels, titles, "degrees Celsius", ["told", "true"]);
        encode_png(std::fs::File::create(path).expect("file"), &picture).expect("picture");
    }
}
