//! Contract: sensors that hear each other know the air better than one alone; sensors that look away say nothing of it.

use super::*;
use noctule::calibration::CrossCalibration;
use noctule::calibration::cross::{HEARD_MIN, hearing, measure_cross, with_pairs};

fn at(name: &str, distance_m: f64, bearing_deg: f64, yaw_deg: f64) -> SensorSetup {
    let mount = Mount { distance_m, bearing_rad: bearing_deg.to_radians(), yaw_rad: yaw_deg.to_radians() };
    SensorSetup { name: name.into(), mount, ..nominal() }
}

/// What the first of two sensors hears of the second in air of `temperature_c`; the second really stands `off_m` farther out.
/// One estimate for each way of knowing the mounts.
fn pair(
    sensors: &[SensorSetup; 2],
    off_m: f64,
    temperature_c: f64,
    mount_sds_m: [f64; 2],
) -> [Option<CrossCalibration>; 2] {
    let plan = plan_of(&sensors[0], SampleFormat::PcmF32, SHORT);
    let template = Arc::new(Sweep::new(&sensors[0].emission));
    let virtual_sensor = hearing(&sensors[0], &sensors[1]);
    let observer = Observer::new(&plan, &virtual_sensor, &template, SPEED_M_S, (32, f64::INFINITY), None);
    let mut observer = observer.clear_from(HEARD_MIN);
    let mut true_sensors = sensors.clone();
    true_sensors[1].mount.distance_m += off_m;
    let world = Truth::as_configured().world;
    let (robot, speed) = (RobotParams::default(), speed_m_s(temperature_c));
    let simulator = Simulator::new(
        world,
        &true_sensors,
        &recording_of(SampleFormat::PcmF32, SHORT),
        robot,
        speed,
        SimParams::default(),
        1,
    );
    let mut simulator = simulator.expect("world");
    simulator.set_pose(Pose2 { x_m: 0.2, y_m: -0.1, heading_rad: 0.3 });
    let mut set = simulator.empty_ping_set();
    for _ in 0..40 {
        simulator.step(Velocity { linear_m_s: 0.25, angular_rad_s: 0.4 }, 0.1);
        simulator.ping_set(Stamp::default(), &mut set);
        observer.listen(&plan, &set.pings[0].samples);
    }
    let known = Tolerances::default();
    mount_sds_m.map(|sd_m| measure_cross(&observer, (&sensors[0], &sensors[1]), SPEED_M_S, (&known, sd_m)))
}

#[test]
fn sensors_that_hear_each_other_know_the_air_and_those_that_look_away_say_nothing() {
    let beside = [at("left", 0.15, 90.0, -90.0), at("right", 0.15, -90.0, 90.0)];
    for (temperature_c, off_m) in [(0.0, 0.0), (20.0, 0.0), (40.0, 0.0), (20.0, 1e-3)] {
        let truth_m_s = speed_m_s(temperature_c);
        let mount_sds_m = [2e-3, 0.5e-3];
        for (mount_sd_m, found) in mount_sds_m.into_iter().zip(pair(&beside, off_m, temperature_c, mount_sds_m)) {
            let found = found.expect("heard");
            let error_m_s = found.speed_of_sound_m_s - truth_m_s;
            println!(
                "{temperature_c} C, mounts to {:.1} mm, {:.0} mm off: {error_m_s:+.2} +- {:.2} m/s, {} microphones to {:.3} mm",
                1e3 * mount_sd_m,
                1e3 * off_m,
                found.speed_of_sound_sd_m_s,
                found.microphones,
                1e3 * found.residual_m
            );
            // Who believes mounts to half a millimetre that are a whole one off may be off by three of his deviations.
            assert!(error_m_s.abs() < 3.0 * found.speed_of_sound_sd_m_s, "{found:?}");
            assert!(off_m > 0.0 || error_m_s.abs() < 0.6, "{found:?}");
            let (_, together) = with_pairs((SPEED_M_S, 10.0), &[found.clone(), found]);
            assert!(together < 2.9, "{together}");
        }
    }
    // The built-in robot's sensors look away from each other.
    assert_eq!(pair(&[at("front", 0.15, 0.0, 0.0), at("left", 0.15, 120.0, 0.0)], 0.0, 20.0, [2e-3; 2]), [None, None]);
    assert_eq!(with_pairs((343.0, 10.0), &[]), (343.0, 10.0));
}
