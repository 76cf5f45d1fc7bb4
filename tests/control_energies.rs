//! Contract: whatever stands in the CA or OA zone, left, right, both or right at the sensor, fires the layer and is never
//! cancelled by its mirror image. Synthetic energyscapes go through masks, sums, fusion and controller; the sums are the test's own.

use noctule::control::{ControlParams, Controller, PlatformLimits};
use noctule::flow::MaskSet;
use noctule::imaging::params::DirectionsParams;
use noctule::sensor::{Emission, MicrophoneArray, Mount, SensorSetup};
use noctule::service::regions::mask_params;
use noctule::signal::{
    Cues, Decision, Direction, Energyscape, LayerName, MaskPurpose, MaskRow, MaskTable, PolarGrid, RowSums,
    SENSORS_MAX, Velocity,
};
use noctule::time::Stamp;
use std::sync::Arc;

const FORWARD: Velocity = Velocity { linear_m_s: 0.3, angular_rad_s: 0.0 };
const ALL: [bool; SENSORS_MAX] = [true; SENSORS_MAX];

struct Robot {
    grid: Arc<PolarGrid>,
    mounts: Vec<Mount>,
    masks: MaskSet,
    params: ControlParams,
}

/// The default robot: sensors at 0, 120 and -120 deg, 0.15 m out, looking outward.
fn robot(range_first_m: f64) -> Robot {
    let directions = (0..180).map(|index| Direction::horizontal((f64::from(index) - 89.5).to_radians())).collect();
    let grid = Arc::new(PolarGrid::new(directions, range_first_m, 0.005, ((5.0 - range_first_m) / 0.005) as usize));
    let emission = Arc::new(Emission { samples: vec![1.0], sample_rate_hz: 450e3, band_hz: (25e3, 50e3) });
    let mount = |bearing_deg: f64| Mount { distance_m: 0.15, bearing_rad: bearing_deg.to_radians(), yaw_rad: 0.0 };
    let mounts = vec![mount(0.0), mount(120.0), mount(-120.0)];
    let sensors: Vec<SensorSetup> = mounts
        .iter()
        .map(|mount| SensorSetup {
            name: String::from("s"),
            mount: *mount,
            array: MicrophoneArray {
                positions_m: vec![nalgebra::Vector3::zeros()],
                enabled: vec![true],
                weights: vec![1.0],
            },
            emission: Arc::clone(&emission),
            emitter_m: nalgebra::Vector3::zeros(),
        })
        .collect();
    let (params, platform) = (ControlParams::default(), PlatformLimits::default());
    let hidden = vec![vec![false; 180]; 3];
    let masks =
        MaskSet::build(&grid, &sensors, &hidden, &mask_params(&params, &platform, &DirectionsParams::default()))
            .unwrap();
    Robot { grid, mounts, masks, params }
}

/// Images of small reflectors at robot-frame points, `amplitude` at 1 m and spreading as 1/r, in every sensor that sees them.
fn images(robot: &Robot, reflectors: &[(f64, f64)], amplitude: f64) -> Vec<Energyscape> {
    let mut images: Vec<Energyscape> =
        (0..robot.mounts.len()).map(|index| Energyscape::zeros(Arc::clone(&robot.grid), index)).collect();
    for (image, mount) in images.iter_mut().zip(&robot.mounts) {
        for &(x, y) in reflectors {
            let (dx, dy) =
                (x - mount.distance_m * mount.bearing_rad.cos(), y - mount.distance_m * mount.bearing_rad.sin());
            let (range_m, bearing) = (dx.hypot(dy), dy.atan2(dx) - mount.bearing_rad - mount.yaw_rad);
            let bearing = bearing.sin().atan2(bearing.cos());
            for (direction, at) in robot.grid.directions().iter().enumerate() {
                for range in 0..robot.grid.range_count() {
                    let beam = (-((at.azimuth_rad - bearing) / 0.07).powi(2)).exp();
                    let pulse = (-((robot.grid.range_m(range) - range_m) / 0.005).powi(2)).exp();
                    if beam * pulse > 1e-3 {
                        image.values[robot.grid.cell(direction, range)] +=
                            (amplitude / range_m.max(0.05) * beam * pulse) as f32;
                    }
                }
            }
        }
    }
    images
}

/// Sums over one row as their documentation says, one cell after the other.
fn row_sums(table: &MaskTable, row: &MaskRow, image: &Energyscape, signed: bool) -> RowSums {
    let mut sums = RowSums::SILENT;
    let entries = || (row.first..row.first + row.count).map(|entry| (entry, table.cells[entry] as usize));
    let energy = |cell: usize| {
        let (_, range) = image.grid.direction_and_range(cell);
        let gained = image.values[cell] * table.gains[row.sensor_index][range];
        if !gained.is_finite() {
            f32::INFINITY
        } else if gained < table.floors[row.sensor_index][range] {
            0.0
        } else {
            gained
        }
    };
    for (entry, cell) in entries() {
        let e = energy(cell);
        let r = image.grid.range_m(image.grid.direction_and_range(cell).1) as f32;
        sums.energy += if signed { e * table.sides[entry] } else { e };
        sums.turn += e * table.sides[entry] / (r * r);
        sums.flow += e * r.sqrt();
        sums.active_count += u32::from(e > 0.0);
        if e > sums.peak {
            (sums.peak, sums.peak_entry) = (e, (entry - row.first) as u32);
        }
    }
    for (entry, cell) in entries().filter(|_| sums.peak > 0.0) {
        if energy(cell) >= sums.peak / 2.0 && table.distances_m[entry] < sums.nearest_distance_m {
            (sums.nearest_distance_m, sums.nearest_entry) = (table.distances_m[entry], (entry - row.first) as u32);
        }
    }
    sums
}

fn sums(robot: &Robot, images: &[Energyscape], signed: bool) -> Vec<RowSums> {
    let table = robot.masks.table();
    table.rows.iter().map(|row| row_sums(table, row, &images[row.sensor_index], signed)).collect()
}

fn cues(robot: &Robot, reflectors: &[(f64, f64)], amplitude: f64) -> Cues {
    robot.masks.fuse(&sums(robot, &images(robot, reflectors, amplitude), false), ALL, Stamp::default(), 0)
}

/// The decision after `count` ping sets of the same cues.
fn decide(robot: &Robot, cues: &Cues, count: u64) -> Decision {
    let mut controller = Controller::new(&robot.params, &PlatformLimits::default());
    let mut cues = *cues;
    let mut last = None;
    for index in 1..=count {
        cues.emitted_at = Stamp { boottime_ns: index * 100_000_000, wall_ns: 0 };
        last = Some(controller.step(cues.emitted_at, &cues, FORWARD));
    }
    last.unwrap()
}

/// A pole's echo: 0.04 of full scale at 1 m.
const POLE: f64 = 0.04;

/// GIVEN poles in the CA zone on the left, on the right, and on both sides, WHEN imaged, THEN CA fires each time.
#[test]
fn collision_avoidance_fires_for_left_right_and_symmetric_obstacles() {
    let robot = robot(0.3);
    for (x, y) in [(0.50, 0.10), (0.50, 0.25), (0.56, 0.02), (0.32, 0.30)] {
        for (reflectors, turn) in [(vec![(x, y)], -1.0), (vec![(x, -y)], 1.0), (vec![(x, y), (x, -y)], 0.0)] {
            let decision = decide(&robot, &cues(&robot, &reflectors, POLE), 3);
            assert_eq!(decision.layer, LayerName::CollisionAvoidance, "{reflectors:?}");
            assert_eq!(decision.velocity.linear_m_s, 0.0);
            assert!(
                decision.velocity.angular_rad_s * turn >= 0.0 && decision.velocity.angular_rad_s != 0.0,
                "{reflectors:?}"
            );
        }
    }
}

/// GIVEN a symmetric pair, WHEN fused, THEN neither side is nearer; moved by a centimetre, the nearer one is.
#[test]
fn a_mirrored_pair_is_a_tie_and_the_nearer_of_an_uneven_pair_wins() {
    let robot = robot(0.3);
    assert_eq!(cues(&robot, &[(0.5, 0.2), (0.5, -0.2)], POLE).collision.nearest.unwrap().side, 0);
    assert_eq!(cues(&robot, &[(0.49, 0.2), (0.5, -0.2)], POLE).collision.nearest.unwrap().side, 1);
    assert_eq!(cues(&robot, &[(0.5, 0.2), (0.49, -0.2)], POLE).collision.nearest.unwrap().side, -1);
}

/// GIVEN the same scenes, WHEN the energy is summed with its sign as the paper prints eq. 11, THEN the right-hand and the symmetric
/// obstacle go unnoticed: the negative control.
#[test]
fn a_signed_sum_misses_what_is_on_the_right_and_what_is_symmetric() {
    let robot = robot(0.3);
    let table = robot.masks.table();
    let signed = |reflectors: &[(f64, f64)]| -> f32 {
        let sums = sums(&robot, &images(&robot, reflectors, POLE), true);
        let collision = MaskPurpose::Region(LayerName::CollisionAvoidance);
        table.rows.iter().zip(sums).filter(|(row, _)| row.purpose == collision).map(|(_, sums)| sums.energy).sum()
    };
    let threshold = robot.params.collision_avoidance.threshold as f32;
    assert!(signed(&[(0.5, 0.2)]) > threshold, "the left it does see");
    assert!(!(signed(&[(0.5, -0.2)]) > threshold));
    assert!(!(signed(&[(0.5, 0.2), (0.5, -0.2)]) > threshold));
}

/// GIVEN a loud echo beside the way and its side lobe in it, 10 dB down at the same range, WHEN fused, THEN OA does not steer by the
/// lobe; an obstacle at that place at another range, or 5 dB down, counts. In the CA region the way counts as seen up to the lobe only.
#[test]
fn a_side_lobe_of_a_loud_echo_is_no_obstacle_but_ends_the_way_that_is_seen() {
    let robot = robot(0.3);
    let heard = |beside_x: f64, ahead: f64| {
        let mut all = images(&robot, &[(0.15 + beside_x * 0.42, beside_x * 0.91)], 0.1);
        let lobe = images(&robot, &[(0.15 + 0.8 * 0.99, 0.8 * 0.12)], ahead);
        all.iter_mut()
            .zip(&lobe)
            .for_each(|(image, lobe)| image.values.iter_mut().zip(&lobe.values).for_each(|(a, b)| *a += b));
        robot.masks.fuse(&sums(&robot, &all, false), ALL, Stamp::default(), 0).obstacle.peak
    };
    assert_eq!(heard(0.8, 0.03), 0.0);
    assert!(heard(1.0, 0.03) > 0.02, "another range");
    assert!(heard(0.8, 0.056) > 0.04, "too loud for a lobe");
    let mut near = images(&robot, &[(0.15 + 0.42 * 0.42, 0.42 * 0.91)], 0.1);
    let lobe = images(&robot, &[(0.15 + 0.42, 0.01)], 0.035);
    near.iter_mut()
        .zip(&lobe)
        .for_each(|(image, lobe)| image.values.iter_mut().zip(&lobe.values).for_each(|(a, b)| *a += b));
    let cues = robot.masks.fuse(&sums(&robot, &near, false), ALL, Stamp::default(), 0);
    assert_eq!(cues.collision.energy, 0.0, "else a robot beside a wall would hold CA whichever way it turned");
    // The lobe is 0.37 m ahead of the footprint; its ring and the ones beside it begin 0.08 m nearer.
    let seen_m = cues.coverage.ahead_m;
    assert!((0.25..=0.37).contains(&seen_m), "something may hide under the lobe: {seen_m} m");
}

/// GIVEN obstacles in the OA zone, WHEN imaged, THEN OA fires, slows down, and steers away from the one side that has any.
#[test]
fn obstacle_avoidance_fires_slows_and_steers_for_every_side() {
    let robot = robot(0.3);
    for (x, y) in [(0.8, 0.15), (1.1, 0.05), (1.4, 0.25)] {
        for (reflectors, turn) in [(vec![(x, y)], -1.0), (vec![(x, -y)], 1.0), (vec![(x, y), (x, -y)], 0.0)] {
            let decision = decide(&robot, &cues(&robot, &reflectors, 0.05), 6);
            assert_eq!(decision.layer, LayerName::ObstacleAvoidance, "{reflectors:?}");
            let Velocity { linear_m_s, angular_rad_s } = decision.velocity;
            assert!(linear_m_s > 0.0 && linear_m_s < 0.3, "{linear_m_s}");
            if turn == 0.0 {
                assert!(angular_rad_s.abs() < 0.02, "{angular_rad_s}");
            } else {
                assert!(angular_rad_s * turn > 0.1, "{reflectors:?} {angular_rad_s}");
            }
        }
    }
}

/// GIVEN an obstacle coming ever nearer to the sensor, down to its first range bin, WHEN imaged, THEN CA fires and nothing diverges.
#[test]
fn an_obstacle_at_the_sensor_itself_stops_the_robot() {
    let robot = robot(0.005);
    for range_m in [0.3, 0.1, 0.05, 0.02, 0.01, 0.005] {
        for (reflectors, name) in [
            (vec![(0.15 + range_m, 0.0005)], "ahead"),
            (vec![(0.15, range_m)], "left"),
            (vec![(0.15, -range_m)], "right"),
            (vec![(0.15, range_m), (0.15, -range_m)], "both"),
        ] {
            let cues = cues(&robot, &reflectors, 0.1);
            let decision = decide(&robot, &cues, 3);
            assert_eq!(decision.layer, LayerName::CollisionAvoidance, "{name} at {range_m} m");
            assert!(decision.velocity.is_finite() && decision.velocity.linear_m_s == 0.0);
            assert!(cues.obstacle.energy > 0.0 && cues.obstacle.energy.is_finite());
        }
    }
}

/// GIVEN a cell that is no number anywhere in a mask, WHEN fused, THEN every region is an obstacle and the way is unseen.
#[test]
fn a_cell_that_is_no_number_is_an_obstacle_wherever_it_lies() {
    let robot = robot(0.3);
    for (x, y) in [(0.5, 0.1), (1.2, -0.1), (0.5, 1.2), (1.3, 1.5), (-0.6, 0.1)] {
        for bad in [f32::NAN, f32::INFINITY] {
            let mut images = images(&robot, &[(x, y)], POLE);
            let mut spoiled = 0;
            for value in images.iter_mut().flat_map(|image| &mut image.values).filter(|value| **value > 0.001) {
                (*value, spoiled) = (bad, spoiled + 1);
            }
            assert!(spoiled > 0);
            let cues = robot.masks.fuse(&sums(&robot, &images, false), ALL, Stamp::default(), 0);
            assert_eq!((cues.collision.energy, cues.coverage.ahead_m), (f32::INFINITY, 0.0));
            assert_eq!(decide(&robot, &cues, 2).velocity.linear_m_s, 0.0);
        }
    }
    let short = robot.masks.fuse(&[], ALL, Stamp::default(), 0);
    assert_eq!(short.collision.energy, f32::INFINITY, "sums that do not fit the table are no free space");
}

/// GIVEN walls of reflectors along both sides, WHEN imaged, THEN they are found at their lateral distances, strongest first.
#[test]
fn walls_are_found_where_they_stand() {
    let robot = robot(0.3);
    for (left_m, right_m) in [(1.0, 0.8), (0.62, 1.31), (1.5, 1.5)] {
        // A specular wall is heard where each sensor looks at it squarely.
        let feet: Vec<(f64, f64)> = [0.15, -0.075].into_iter().flat_map(|x| [(x, left_m), (x, -right_m)]).collect();
        let cues = cues(&robot, &feet, 0.3);
        let found = cues.walls.as_slice();
        let nearest_to = |at: f64| found.iter().map(|wall| (wall.lateral_m - at).abs()).fold(f64::INFINITY, f64::min);
        assert!(nearest_to(left_m) < 0.02 && nearest_to(-right_m) < 0.02, "{left_m} {right_m}: {found:?}");
        assert!(found.windows(2).all(|pair| pair[0].strength >= pair[1].strength));
        assert_eq!(decide(&robot, &cues, 3).layer, LayerName::FlowFollowing);
    }
}

/// GIVEN something in the strip behind, WHEN fused, THEN the way back is not free although it is seen.
#[test]
fn an_obstacle_behind_forbids_reversing() {
    let robot = robot(0.3);
    assert_eq!(cues(&robot, &[], POLE).coverage.behind_m, 3.0);
    assert_eq!(cues(&robot, &[(-0.55, 0.1)], POLE).coverage.behind_m, 0.0);
    assert_eq!(cues(&robot, &[(-1.5, 0.1)], POLE).coverage.behind_m, 3.0);
    let blocked = cues(&robot, &[(-0.55, 0.1), (0.5, 0.1)], POLE);
    assert_eq!(decide(&robot, &blocked, 10).velocity.linear_m_s, 0.0);
    assert!(decide(&robot, &cues(&robot, &[(0.5, 0.1)], POLE), 10).velocity.linear_m_s < 0.0);
}

/// GIVEN a sensor that did not deliver, WHEN fused, THEN what it would have heard is left out and its view is not covered.
#[test]
fn a_missing_sensor_takes_its_view_along() {
    let robot = robot(0.3);
    let sums = sums(&robot, &images(&robot, &[(0.5, 0.1)], POLE), false);
    let without_front = robot.masks.fuse(&sums, [false, true, true], Stamp::default(), 7);
    assert_eq!((without_front.coverage.ahead_m, without_front.sequence), (0.0, 7));
    assert_eq!(without_front.sensors_used, [false, true, true]);
    assert_eq!(without_front.collision.sensors[0].energy, 0.0);
    assert_eq!(decide(&robot, &without_front, 5).velocity.linear_m_s, 0.0);
}

/// GIVEN a mirrored scene, WHEN it goes all the way, THEN V is the same and omega changes its sign.
#[test]
fn mirrored_scenes_give_mirrored_commands() {
    let robot = robot(0.3);
    let scenes: [&[(f64, f64)]; 5] = [
        &[(0.9, 0.2)],
        &[(0.55, 0.13), (1.2, -0.2)],
        &[(0.15, 1.0), (0.15, -0.7), (-0.1, 1.0), (-0.1, -0.7)],
        &[(0.5, 0.9), (0.7, -0.5), (0.2, 0.6)],
        &[(-0.6, 0.3), (0.5, -0.3)],
    ];
    for scene in scenes {
        let mirror: Vec<(f64, f64)> = scene.iter().map(|(x, y)| (*x, -*y)).collect();
        let (a, b) = (decide(&robot, &cues(&robot, scene, 0.03), 6), decide(&robot, &cues(&robot, &mirror, 0.03), 6));
        assert_eq!(a.layer, b.layer, "{scene:?}");
        // Sums over mirrored cells are added in another order: f32 rounding of some thousand terms.
        assert!((a.velocity.linear_m_s - b.velocity.linear_m_s).abs() < 1e-5, "{a:?} {b:?}");
        assert!((a.velocity.angular_rad_s + b.velocity.angular_rad_s).abs() < 1e-4, "{a:?} {b:?}");
    }
}
