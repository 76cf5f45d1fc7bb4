//! Contract: once it runs, the ring detector allocates nothing, whatever it hears: crowds, nothing, jumps of odometry, values
//! that are no numbers. It runs inside the daemon, beside the control path.

mod counting;

use counting::allocations_of;
use nalgebra::Vector2;
use noctule::detect::{RingDetector, RingParams};
use noctule::geometry::Pose2;
use noctule::signal::{PEAKS_MAX, Peak, Ray, Reading, RobotScan};

/// A scan full of reflectors, other ones every time.
fn crowd(turn: usize) -> RobotScan {
    let mut scan = RobotScan::unseen();
    scan.range_m = [0.2, 3.0];
    scan.emitted_at.boottime_ns = 1_000_000_000 + 100_000_000 * turn as u64;
    scan.rays.fill(Ray { reading: Reading::Clear, free_m: 3.0, ..Ray::default() });
    for index in 0..PEAKS_MAX {
        let (range_m, bearing_rad) = (0.3 + 0.025 * index as f64, 0.9 * index as f64 + 0.3 * turn as f64);
        let position_m = range_m * Vector2::new(bearing_rad.cos(), bearing_rad.sin());
        let (range_sigma_m, bearing_sigma_rad) = (0.003, if index % 7 == 0 { f64::NAN } else { 0.02 });
        let sensor_m = Vector2::zeros();
        scan.peaks.push(Peak {
            position_m,
            sensor_m,
            range_sigma_m,
            bearing_sigma_rad,
            energy: 0.1,
            sensor_index: index % 3,
        });
    }
    scan
}

#[test]
fn the_detector_allocates_nothing_after_it_was_made() {
    let params = RingParams { cone_deg: 90.0, ..RingParams::default() };
    let mut detector = RingDetector::new(&params);
    let scans: Vec<RobotScan> = (0..30).map(crowd).collect();
    let nothing = RobotScan::unseen();
    let mut most = 0;
    let ((), counted) = allocations_of(|| {
        for (turn, scan) in scans.iter().enumerate() {
            let pose = Pose2 { x_m: 0.05 * turn as f64, y_m: 0.0, heading_rad: 0.1 * turn as f64 };
            most = most.max(detector.update(scan, &pose).object_count);
            if turn % 9 == 8 {
                detector.update(&nothing, &Pose2 { x_m: 40.0, ..pose });
                detector.update(&nothing, &Pose2 { x_m: f64::NAN, ..pose });
            }
        }
    });
    assert_eq!(counted, 0, "allocations");
    assert_eq!(most, 32, "the crowd fills every place");
}

#[test]
fn the_counter_sees_an_allocation() {
    let (held, counted) = allocations_of(|| Vec::<u8>::with_capacity(100));
    assert!(counted == 1 && held.capacity() >= 100);
}
