//! Contract: a mask is +1 left, -1 right exactly where a cell is seen and its robot-frame point lies in the region, for the
//! default robot and every mount of Tables 1 and 2 of paper 000. The oracle has its own geometry; the golden file its own past.
//!
//! To renew `fixtures/golden/masks.txt` after a change that is meant: `NOCTULE_BLESS=1 cargo test --test masks_golden`.

use noctule::control::{ControlParams, PlatformLimits};
use noctule::flow::{MaskParams, MaskSet};
use noctule::geometry::flow_lines::FlowLinesRegion;
use noctule::geometry::shape::Shape;
use noctule::imaging::params::DirectionsParams;
use noctule::sensor::dead_zone::hidden_directions;
use noctule::sensor::{Emission, MicrophoneArray, Mount, SensorSetup};
use noctule::service::regions::mask_params;
use noctule::signal::{Direction, LayerName, MaskPurpose, PolarGrid, SENSORS_MAX};
use std::fmt::Write as _;
use std::sync::Arc;

/// (alpha deg, beta deg, l cm) of each sensor.
type Layout = (&'static str, f64, &'static [(f64, f64, f64)]);

const LAYOUTS: [Layout; 17] = [
    ("default", 0.20, &[(0.0, 0.0, 15.0), (120.0, 0.0, 15.0), (-120.0, 0.0, 15.0)]),
    ("sim-1", 0.10, &[(0.0, 0.0, 18.0)]),
    ("sim-2", 0.10, &[(0.0, -20.0, 14.0), (90.0, -10.0, 10.0), (-90.0, -5.0, 8.0)]),
    ("sim-3", 0.10, &[(90.0, -20.0, 10.0), (-90.0, 20.0, 10.0)]),
    ("sim-4", 0.10, &[(0.0, 0.0, 12.0), (90.0, 0.0, 12.0), (-90.0, 0.0, 12.0)]),
    ("sim-5", 0.10, &[(45.0, 0.0, 4.0), (-135.0, 0.0, 4.0)]),
    ("sim-6", 0.10, &[(0.0, 0.0, 10.0), (-180.0, 0.0, 10.0)]),
    ("sim-7", 0.10, &[(0.0, 20.0, 6.0), (90.0, 10.0, 0.0), (-90.0, 20.0, 14.0)]),
    ("sim-8", 0.10, &[(0.0, 0.0, 0.0), (120.0, -120.0, 14.0), (-120.0, 120.0, 14.0)]),
    ("sim-9", 0.10, &[(180.0, -180.0, 6.0)]),
    ("sim-10", 0.10, &[(45.0, -10.0, 6.0), (-45.0, 10.0, 6.0), (-180.0, 0.0, 0.0)]),
    ("real-1", 0.60, &[(0.0, 0.0, 41.0), (30.0, 60.0, 40.0), (-30.0, -60.0, 40.0)]),
    ("real-2", 0.60, &[(0.0, 0.0, 41.0), (180.0, 0.0, 27.0), (58.0, 32.0, 31.0)]),
    ("real-3", 0.60, &[(0.0, -12.0, 41.0), (180.0, 35.0, 27.0), (58.0, 2.0, 31.0)]),
    ("real-4", 0.60, &[(0.0, 0.0, 41.0)]),
    ("real-5", 0.60, &[(140.0, 80.0, 25.0), (-20.0, -30.0, 30.0), (30.0, -30.0, 39.0)]),
    ("real-6", 0.60, &[(140.0, 11.0, 25.0), (-20.0, 0.0, 30.0)]),
];

fn sensors(mounts: &[(f64, f64, f64)]) -> Vec<SensorSetup> {
    let emission = Arc::new(Emission { samples: vec![1.0], sample_rate_hz: 450e3, band_hz: (25e3, 50e3) });
    let sensor = |(index, (alpha, beta, l)): (usize, &(f64, f64, f64))| SensorSetup {
        name: format!("s{index}"),
        mount: Mount { distance_m: l / 100.0, bearing_rad: alpha.to_radians(), yaw_rad: beta.to_radians() },
        array: MicrophoneArray {
            positions_m: vec![nalgebra::Vector3::zeros()],
            enabled: vec![true],
            weights: vec![1.0],
        },
        emission: Arc::clone(&emission),
        emitter_m: nalgebra::Vector3::zeros(),
    };
    mounts.iter().enumerate().map(sensor).collect()
}

fn grid(range_step_m: f64) -> Arc<PolarGrid> {
    let directions = (0..180).map(|index| Direction::horizontal((f64::from(index) - 89.5).to_radians())).collect();
    Arc::new(PolarGrid::new(directions, 0.3, range_step_m, (4.7 / range_step_m).round() as usize + 1))
}

struct Setup {
    grid: Arc<PolarGrid>,
    sensors: Vec<SensorSetup>,
    hidden: Vec<Vec<bool>>,
    params: MaskParams,
    masks: MaskSet,
}

fn setup((_, radius_m, mounts): &Layout, range_step_m: f64) -> Setup {
    let platform = PlatformLimits { radius_m: *radius_m, ..PlatformLimits::default() };
    let (grid, sensors) = (grid(range_step_m), sensors(mounts));
    let hidden: Vec<Vec<bool>> =
        (0..sensors.len()).map(|index| hidden_directions(&sensors, index, &[], grid.directions()).hidden).collect();
    let params = mask_params(&ControlParams::for_platform(&platform), &platform, &DirectionsParams::default());
    let masks = MaskSet::build(&grid, &sensors, &hidden, &params).unwrap();
    Setup { grid, sensors, hidden, params, masks }
}

/// Place of a cell by complex numbers: e^{i alpha} (l + e^{i beta} r e^{i theta}).
fn place(mount: &Mount, range_m: f64, bearing_rad: f64) -> (f64, f64) {
    let times = |a: (f64, f64), b: (f64, f64)| (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
    let unit = |angle: f64| (angle.cos(), angle.sin());
    let turned = times(unit(mount.yaw_rad), (range_m * bearing_rad.cos(), range_m * bearing_rad.sin()));
    times(unit(mount.bearing_rad), (mount.distance_m + turned.0, turned.1))
}

/// How far inside a shape a point is, by signed slacks that are all positive inside; near zero on the edge.
fn slack(shape: &Shape, (x, y): (f64, f64)) -> f64 {
    match shape {
        Shape::Rectangle { x_m, y_m } => (x - x_m[0]).min(x_m[1] - x).min(y - y_m[0]).min(y_m[1] - y),
        Shape::Circle { centre_m, radius_m } => radius_m - (x - centre_m[0]).hypot(y - centre_m[1]),
        Shape::HalfCircle { centre_m, radius_m, heading_deg } => {
            let (dx, dy) = (x - centre_m[0], y - centre_m[1]);
            let ahead = dx * heading_deg.to_radians().cos() + dy * heading_deg.to_radians().sin();
            (radius_m - dx.hypot(dy)).min(ahead)
        }
        Shape::Sector { centre_m, radius_m, bearing_deg } => {
            let (dx, dy) = (x - centre_m[0], y - centre_m[1]);
            let d = dx.hypot(dy);
            let middle = (0.5 * (bearing_deg[0] + bearing_deg[1])).to_radians();
            let half = (0.5 * (bearing_deg[1] - bearing_deg[0])).to_radians();
            let off = (dx * middle.cos() + dy * middle.sin()).atan2(-dx * middle.sin() + dy * middle.cos());
            let off = (std::f64::consts::FRAC_PI_2 - off).sin().atan2((std::f64::consts::FRAC_PI_2 - off).cos()).abs();
            (d - radius_m[0]).min(radius_m[1] - d).min(d * (half - off))
        }
        Shape::Trapezoid { x_m, half_width_m } => {
            let share = (x - x_m[0]) / (x_m[1] - x_m[0]);
            let half = half_width_m[0] + share * (half_width_m[1] - half_width_m[0]);
            (x - x_m[0]).min(x_m[1] - x).min(half - y.abs())
        }
        Shape::Polygon { points_m } => {
            // Winding number: the turns that the corners make around the point.
            let mut turned = 0.0;
            let mut edge = f64::INFINITY;
            for (index, a) in points_m.iter().enumerate() {
                let b = points_m[(index + 1) % points_m.len()];
                let (ax, ay, bx, by) = (a[0] - x, a[1] - y, b[0] - x, b[1] - y);
                turned += (ax * by - ay * bx).atan2(ax * bx + ay * by);
                let length = (bx - ax).hypot(by - ay);
                let along = (-(ax * (bx - ax) + ay * (by - ay)) / (length * length)).clamp(0.0, 1.0);
                edge = edge.min((ax + along * (bx - ax)).hypot(ay + along * (by - ay)));
            }
            if turned.abs() > 3.0 { edge } else { -edge }
        }
    }
}

/// What a cell's mask should be; `None` so near to an edge that either is right.
fn expected(shapes: &[Shape], point: (f64, f64)) -> Option<i8> {
    let slack = shapes.iter().map(|shape| slack(shape, point)).fold(f64::NEG_INFINITY, f64::max);
    // An edge is inside, whatever rounding makes of it (1e-9 m); just beyond that nothing is promised.
    let slack = if slack.abs() < 1e-10 { 1.0 } else { slack };
    if slack.abs() < 1e-7 || point.1.abs() < 1e-12 {
        return None;
    }
    Some(if slack < 0.0 {
        0
    } else if point.1 > 0.0 {
        1
    } else {
        -1
    })
}

/// Cells of a mask that differ from the oracle, and cells that the oracle would not judge.
fn compare(setup: &Setup, layer: LayerName, shapes: &[Shape], mirror: bool) -> (usize, usize) {
    let (mut wrong, mut unjudged) = (0, 0);
    for mask in setup.masks.masks().filter(|mask| mask.layer == layer) {
        for (cell, value) in mask.values.iter().enumerate() {
            let (direction, range) = setup.grid.direction_and_range(cell);
            let bearing = setup.grid.directions()[direction].azimuth_rad * if mirror { -1.0 } else { 1.0 };
            let point = place(&setup.sensors[mask.sensor_index].mount, setup.grid.range_m(range), bearing);
            let seen = !setup.hidden[mask.sensor_index][direction];
            match if seen { expected(shapes, point) } else { Some(0) } {
                Some(expected) => wrong += usize::from(expected != *value),
                None => unjudged += 1,
            }
        }
    }
    (wrong, unjudged)
}

#[test]
fn every_mask_of_every_layout_agrees_with_the_oracle_in_every_cell() {
    for layout in &LAYOUTS {
        let setup = setup(layout, 0.005);
        for (layer, shapes) in [
            (LayerName::CollisionAvoidance, &setup.params.collision_avoidance),
            (LayerName::ObstacleAvoidance, &setup.params.obstacle_avoidance),
            (LayerName::CorridorFollowing, &setup.params.corridor_following),
        ] {
            let (wrong, unjudged) = compare(&setup, layer, shapes, false);
            assert_eq!(wrong, 0, "{} {}", layout.0, layer.as_str());
            assert!(unjudged < 20, "{} {}: {unjudged} cells on an edge", layout.0, layer.as_str());
        }
    }
}

// Negative control: the same comparison sees bearings that count the wrong way round, and a sensor put 2 cm off.
#[test]
fn the_oracle_sees_a_mirrored_bearing_and_a_displaced_sensor() {
    let layout = &LAYOUTS[2];
    let mut setup = setup(layout, 0.005);
    let shapes = setup.params.obstacle_avoidance.clone();
    assert!(compare(&setup, LayerName::ObstacleAvoidance, &shapes, true).0 > 100);
    setup.sensors[0].mount.distance_m += 0.02;
    assert!(compare(&setup, LayerName::ObstacleAvoidance, &shapes, false).0 > 50);
}

#[test]
fn every_shape_agrees_with_the_oracle_on_a_mount_askew() {
    let shapes = [
        Shape::Rectangle { x_m: [0.31, f64::INFINITY], y_m: [-0.77, 0.43] },
        Shape::Circle { centre_m: [0.9, -0.4], radius_m: 0.61 },
        Shape::HalfCircle { centre_m: [0.2, 0.1], radius_m: 1.7, heading_deg: 37.0 },
        Shape::Sector { centre_m: [0.1, 0.2], radius_m: [0.5, 1.9], bearing_deg: [-20.0, 75.0] },
        Shape::Sector { centre_m: [0.0, 0.0], radius_m: [0.0, 1.1], bearing_deg: [120.0, 290.0] },
        Shape::Trapezoid { x_m: [0.2, 2.1], half_width_m: [0.9, 0.3] },
        Shape::Polygon { points_m: vec![[0.3, 0.1], [1.8, 1.3], [0.9, 0.2], [1.7, -1.1], [0.2, -0.3]] },
    ];
    let mut setup = setup(&("askew", 0.2, &[(33.0, -71.0, 21.0), (-160.0, 24.0, 9.0)]), 0.01);
    setup.hidden[0][40..60].fill(true);
    for shape in shapes {
        let only = vec![shape.clone()];
        setup.params.obstacle_avoidance = only.clone();
        setup.masks = MaskSet::build(&setup.grid, &setup.sensors, &setup.hidden, &setup.params).unwrap();
        let (wrong, unjudged) = compare(&setup, LayerName::ObstacleAvoidance, &only, false);
        assert!(wrong == 0 && unjudged < 20, "{shape:?}: {wrong} wrong, {unjudged} on an edge");
    }
}

#[test]
fn each_cell_lies_on_one_flow_line_at_most_and_the_lines_fill_their_region() {
    for layout in &LAYOUTS {
        let setup = setup(layout, 0.005);
        let FlowLinesRegion { lateral_m, step_m, x_m } = setup.params.flow_lines[0];
        let table = setup.masks.table();
        let mut line_of = vec![vec![None; setup.grid.cell_count()]; setup.sensors.len()];
        for row in &table.rows {
            let MaskPurpose::FlowLine { index, lateral_m } = row.purpose else { continue };
            for entry in row.first..row.first + row.count {
                let line = &mut line_of[row.sensor_index][table.cells[entry] as usize];
                assert_eq!(*line, None, "{}: two lines in one cell", layout.0);
                *line = Some((index, lateral_m));
            }
        }
        for (sensor, lines) in line_of.iter().enumerate() {
            for (cell, line) in lines.iter().enumerate() {
                let (direction, range) = setup.grid.direction_and_range(cell);
                let bearing = setup.grid.directions()[direction].azimuth_rad;
                let (x, y) = place(&setup.sensors[sensor].mount, setup.grid.range_m(range), bearing);
                let inside = (x - x_m[0])
                    .min(x_m[1] - x)
                    .min(y - lateral_m[0] + 0.5 * step_m)
                    .min(lateral_m[1] + 0.5 * step_m - y);
                if let Some((_, line_m)) = line {
                    assert!(inside > -1e-9 && (y - line_m).abs() < 0.5 * step_m + 1e-9);
                } else if !setup.hidden[sensor][direction] {
                    assert!(inside < 1e-9, "{}: no line at ({x}, {y})", layout.0);
                }
            }
        }
    }
}

#[test]
fn distances_are_from_the_footprint_and_gains_and_floors_are_those_of_the_parameters() {
    let setup = setup(&LAYOUTS[0], 0.005);
    let table = setup.masks.table();
    for row in &table.rows {
        for entry in row.first..row.first + row.count {
            let (direction, range) = setup.grid.direction_and_range(table.cells[entry] as usize);
            let bearing = setup.grid.directions()[direction].azimuth_rad;
            let (x, y) = place(&setup.sensors[row.sensor_index].mount, setup.grid.range_m(range), bearing);
            assert!((f64::from(table.distances_m[entry]) - (x.hypot(y) - 0.2).max(0.0)).abs() < 1e-6);
            assert_eq!(table.sides[entry] > 0.0, y >= 0.0);
        }
    }
    for (index, range_m) in setup.grid.ranges_m().into_iter().enumerate() {
        let gain = f64::from(table.gains[2][index]);
        assert!((gain / (range_m * 10f64.powf(2.4 * (range_m - 1.0) / 20.0)) - 1.0).abs() < 1e-6);
        assert!(range_m < 0.6 || (f64::from(table.floors[1][index]) / gain / 10f64.powf(-3.5) - 1.0).abs() < 1e-6);
    }
}

#[test]
fn a_region_that_no_sensor_sees_is_refused_by_name() {
    let mut setup = setup(&LAYOUTS[1], 0.01);
    setup.params.corridor_following = vec![Shape::Circle { centre_m: [-2.0, 0.0], radius_m: 0.5 }];
    let error = MaskSet::build(&setup.grid, &setup.sensors, &setup.hidden, &setup.params).unwrap_err();
    assert_eq!(error.key, "corridor_following.regions");
    setup.params.corridor_following.clear();
    assert!(MaskSet::build(&setup.grid, &setup.sensors, &setup.hidden, &setup.params).is_ok(), "off is not empty");
}

#[test]
fn elevated_directions_stand_for_their_horizontal_projection() {
    let directions: Vec<Direction> = (0..180)
        .map(|index| Direction { azimuth_rad: (f64::from(index) - 89.5).to_radians(), elevation_rad: 1.0 })
        .collect();
    let grid = Arc::new(PolarGrid::new(directions, 0.3, 0.01, 471));
    let setup = setup(&LAYOUTS[0], 0.01);
    let masks = MaskSet::build(&grid, &setup.sensors, &setup.hidden, &setup.params).unwrap();
    let mask = masks.masks().find(|mask| mask.layer == LayerName::ObstacleAvoidance && mask.sensor_index == 0).unwrap();
    let reach =
        |mask: &[i8]| (0..471).rev().find(|range| mask[grid.cell(90, *range)] != 0).map(|range| grid.range_m(range));
    // The region ends 1.35 m ahead of the sensor; 1.35 / cos(1 rad) = 2.50 m along the slope.
    assert!((reach(&mask.values).unwrap() - 1.35 / 1.0f64.cos()).abs() < 0.011);
}

#[test]
fn the_way_is_covered_where_the_layout_looks() {
    let cover = |name: &str, used: [bool; SENSORS_MAX]| {
        let layout = LAYOUTS.iter().find(|layout| layout.0 == name).unwrap();
        let cue = setup(layout, 0.005).masks.coverage(used);
        (cue.ahead_m, cue.behind_m)
    };
    let all = [true; SENSORS_MAX];
    for (name, _, _) in &LAYOUTS {
        let (ahead_m, behind_m) = cover(name, all);
        println!("{name}: {ahead_m:.2} m ahead, {behind_m:.2} m behind");
        assert!(ahead_m >= 0.5, "{name} sees {ahead_m} m ahead");
        // Those whose fields of view hold the whole strip behind; sim-7's leave 11 degrees of it open.
        let looks_back = ["default", "sim-5", "sim-6", "sim-10", "real-2", "real-3", "real-5", "real-6"].contains(name);
        assert_eq!(behind_m > 0.0, looks_back, "{name} sees {behind_m} m behind");
    }
    assert_eq!(
        cover("default", [false, true, true]).0,
        0.0,
        "without its front sensor the default robot is blind ahead"
    );
    assert!(cover("default", [true, true, false]).0 > 1.0);
    assert_eq!(cover("default", [false; SENSORS_MAX]), (0.0, 0.0));
}

/// CRC-32 of a mask's bytes, by the table-free definition.
fn crc32(values: &[i8]) -> u32 {
    !values.iter().fold(u32::MAX, |crc, value| {
        (0..8).fold(
            crc ^ u32::from(*value as u8),
            |crc, _| if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 },
        )
    })
}

fn golden_text() -> String {
    let mut text = String::from(
        "# layout layer sensor: cells left and right, CRC-32 of the mask; then the default robot's masks, bearing down, range across\n",
    );
    for layout in &LAYOUTS {
        let setup = setup(layout, 0.01);
        for mask in setup.masks.masks() {
            let count = |side: i8| mask.values.iter().filter(|value| **value == side).count();
            let (left, right) = (count(1), count(-1));
            writeln!(
                text,
                "{} {} {}: {left} {right} {:08x}",
                layout.0,
                mask.layer.as_str(),
                mask.sensor_index,
                crc32(&mask.values)
            )
            .unwrap();
        }
    }
    let setup = setup(&LAYOUTS[0], 0.01);
    for mask in setup.masks.masks() {
        writeln!(text, "\n{} {}", mask.layer.as_str(), mask.sensor_index).unwrap();
        for direction in (3..180).step_by(6).rev() {
            let cells =
                (0..setup.grid.range_count()).step_by(6).map(|range| mask.values[setup.grid.cell(direction, range)]);
            let line: String = cells.map(|value| ['-', '.', '+'][(value + 1) as usize]).collect();
            writeln!(text, "{}", line.trim_end_matches('.')).unwrap();
        }
    }
    text
}

#[test]
fn masks_are_those_of_the_golden_file() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/golden/masks.txt");
    let text = golden_text();
    let (masks, empty) = (text.matches(": ").count(), text.matches(": 0 0 ").count());
    assert!(text.contains('+') && empty * 3 < masks, "{empty} of {masks} masks are empty");
    if std::env::var_os("NOCTULE_BLESS").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, &text).unwrap();
    }
    let golden = std::fs::read_to_string(&path).unwrap();
    for (found, golden) in text.lines().zip(golden.lines()) {
        assert_eq!(found, golden);
    }
    assert_eq!(text.len(), golden.len());
}
