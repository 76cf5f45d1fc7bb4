//! Contract: the scan of the whole robot says where reflectors are, as surely as it claims, and never calls free what no sensor sees.
//! Places come from plane geometry: the nearest point of a cylinder, the foot of the perpendicular on a wall.

use nalgebra::Vector2;
use noctule::config::Config;
use noctule::geometry::{Pose2, polar_from_cartesian, wrap_angle_rad};
use noctule::imaging::params::Prefer;
use noctule::service::scanning::{Scanning, fuser};
use noctule::service::simulator;
use noctule::service::trial::TrialRig;
use noctule::signal::{Peak, Reading, RobotScan, SampleFormat};
use noctule::sim::{Pillar, SimParams, Simulator, Wall, World};
use noctule::time::Stamp;

fn rig() -> TrialRig {
    let mut config = Config::default();
    config.recording.format = SampleFormat::PcmF32;
    TrialRig::new(config).expect("the default robot")
}

fn world(pillars: Vec<Pillar>, walls: Vec<Wall>) -> World {
    World { pillars, walls, guidance: false, ..World::default() }
}

fn put(rig: &TrialRig, world: World, seed: u64) -> Simulator {
    // What a neighbour's emission brings has no truth here: its echoes seem nearer or farther than what they come from.
    let acoustics = SimParams { cross_talk: false, ..SimParams::default() };
    let mut simulator = simulator(rig.config(), rig.setup(), world, acoustics, seed).expect("an empty start zone");
    simulator.set_pose(Pose2::default());
    simulator
}

fn look(scanning: &mut Scanning, simulator: &mut Simulator) -> RobotScan {
    let mut pings = simulator.empty_ping_set();
    simulator.ping_set(Stamp { boottime_ns: 5_000_000_000, wall_ns: 5_000_000_000 }, &mut pings);
    scanning.look(&pings).expect("imaged").clone()
}

/// Where the peak is off, along and across its own line of sight, in its own standard deviations; and in metres and radians.
fn error_of(peak: &Peak, truth_m: Vector2<f64>) -> [f64; 4] {
    let (found_m, found_rad) = polar_from_cartesian(peak.position_m - peak.sensor_m);
    let (true_m, true_rad) = polar_from_cartesian(truth_m - peak.sensor_m);
    let (range_m, bearing_rad) = (found_m - true_m, wrap_angle_rad(found_rad - true_rad));
    [range_m / peak.range_sigma_m, bearing_rad / peak.bearing_sigma_rad, range_m, bearing_rad]
}

/// A number in 0..1 that any language gives for `index`: the golden ratio's multiples fill the interval evenly.
fn spread(index: usize, which: f64) -> f64 {
    (0.5 + index as f64 * 0.618_033_988_749_895 * which).fract()
}

#[test]
fn a_pillar_is_where_it_is_within_what_the_scan_claims() {
    let rig = rig();
    let mut scanning = Scanning::open(&rig, Prefer::Cpu).expect("CPU");
    let mut errors = Vec::new();
    let count = 60;
    for index in 0..count {
        let (range_m, bearing_rad) = (0.8 + 3.0 * spread(index, 1.0), std::f64::consts::TAU * spread(index, 1.3));
        let radius_m = 0.03 + 0.1 * spread(index, 0.7);
        let centre_m = range_m * Vector2::new(bearing_rad.cos(), bearing_rad.sin());
        let pillar = Pillar { centre: centre_m.into(), radius_m };
        let scan = look(&mut scanning, &mut put(&rig, world(vec![pillar], Vec::new()), index as u64));
        for peak in &scan.peaks {
            // The cylinder's point nearest to the sensor, which is where the sound turns round.
            let towards_m = (peak.sensor_m - centre_m).normalize() * radius_m;
            let error = error_of(peak, centre_m + towards_m);
            errors.push(error);
        }
    }
    let share = |which: usize, sigmas: f64| {
        errors.iter().filter(|error| error[which].abs() <= sigmas).count() as f64 / errors.len() as f64
    };
    let rms = |which: usize| {
        (errors.iter().map(|error| error[which] * error[which]).sum::<f64>() / errors.len() as f64).sqrt()
    };
    println!(
        "{} peaks of {count} pillars; range: {:.1} mm rms, {:.2} and {:.2} within 1 and 2 sigma; bearing: {:.2} deg rms, {:.2} and {:.2}",
        errors.len(),
        rms(2) * 1e3,
        share(0, 1.0),
        share(0, 2.0),
        rms(3).to_degrees(),
        share(1, 1.0),
        share(1, 2.0)
    );
    // Every pillar is heard by one sensor at least, and by no more than see it: side lobes and flat tops are no reflectors.
    assert!((count..2 * count).contains(&errors.len()), "{} peaks of {count} pillars", errors.len());
    assert!(share(0, 2.0) >= 0.95 && share(1, 2.0) >= 0.95, "claims too much");
    // And not so little that nothing follows from it: half of what is claimed is used.
    assert!(rms(0) > 0.2 && rms(1) > 0.2, "claims too little: {} {}", rms(0), rms(1));
}

#[test]
fn a_walls_foot_of_the_perpendicular_is_a_peak_and_the_ray_to_it_an_echo_of_that_range() {
    let rig = rig();
    let mut scanning = Scanning::open(&rig, Prefer::Cpu).expect("CPU");
    let wall = Wall { points: vec![[-8.0, 1.5], [8.0, 1.5]], closed: false };
    let scan = look(&mut scanning, &mut put(&rig, world(Vec::new(), vec![wall]), 3));
    let left = scan.peaks.iter().find(|peak| (peak.position_m.y - 1.5).abs() < 0.02).expect("the wall");
    // Within what it claims: a wall's foot lies where the sight is square to it.
    let off_m = (left.position_m.x - left.sensor_m.x).abs();
    assert!(off_m < 3.0 * left.bearing_sigma_rad * 1.4 + 0.01, "at the foot: {left:?}");
    let bearing_rad = left.position_m.y.atan2(left.position_m.x);
    let ray = scan.rays[RobotScan::ray_at(bearing_rad)];
    let Reading::Echo { range_m, .. } = ray.reading else { panic!("{ray:?}") };
    assert!((range_m - left.position_m.norm()).abs() < 0.02, "{range_m}");
    assert!(ray.free_m <= range_m && ray.free_m > 1.2, "free up to the wall: {ray:?}");
}

#[test]
fn what_only_a_lost_sensor_saw_is_unseen_and_with_it_is_clear() {
    let rig = rig();
    let mut scanning = Scanning::open(&rig, Prefer::Cpu).expect("CPU");
    let mut simulator = put(&rig, world(Vec::new(), Vec::new()), 1);
    let mut pings = simulator.empty_ping_set();
    simulator.ping_set(Stamp { boottime_ns: 1, wall_ns: 1 }, &mut pings);
    let count = |scan: &RobotScan, wanted: Reading| scan.rays.iter().filter(|ray| ray.reading == wanted).count();
    let all = scanning.look(&pings).expect("imaged").clone();
    let clear = count(&all, Reading::Clear);
    assert!(clear > 300, "an empty room is clear around: {clear}");
    pings.present[0] = false;
    pings.sequence += 1;
    let lost = scanning.look(&pings).expect("imaged").clone();
    assert_eq!((all.sensors_used, lost.sensors_used), (0b111, 0b110));
    let gone = count(&lost, Reading::Unseen) - count(&all, Reading::Unseen);
    assert!(gone > 20, "only the first sensor saw these: {gone}");
    for (before, after) in all.rays.iter().zip(lost.rays.iter()) {
        assert!(after.free_m <= before.free_m + 1e-9, "nothing becomes free by losing a sensor");
    }
    pings.present = [false; noctule::signal::SENSORS_MAX];
    pings.sequence += 1;
    let blind = scanning.look(&pings).expect("imaged");
    assert_eq!(count(blind, Reading::Unseen), noctule::signal::RAYS);
    assert!(blind.rays.iter().all(|ray| ray.free_m == 0.0) && blind.peaks.is_empty());
}

#[test]
fn a_sensor_that_is_no_witness_lends_its_time_and_not_its_silence() {
    let rig = rig();
    let mut fuser = fuser(rig.config(), rig.setup());
    let silence = vec![0.0; rig.setup().plan.grid.cell_count()];
    let at = Stamp { boottime_ns: 77, wall_ns: 78 };
    let mut scan = RobotScan::unseen();
    for sensor in 0..3 {
        fuser.pass(40 + sensor, at);
    }
    fuser.fuse(&mut scan);
    assert_eq!((scan.sequence, scan.emitted_at, scan.sensors_used), (42, at, 0));
    assert!(scan.rays.iter().all(|ray| ray.reading == Reading::Unseen && ray.free_m == 0.0));
    // Control: the same silence of a witness is free space.
    (0..3).for_each(|sensor| fuser.hear(sensor, 43, at, &silence));
    fuser.fuse(&mut scan);
    assert!(scan.rays.iter().filter(|ray| ray.reading == Reading::Clear).count() > 300);
}
