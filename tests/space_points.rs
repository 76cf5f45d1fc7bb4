//! Contract: on a grid with elevations a region is where the robot's body passes: what is below or above it is in no mask, and a level
//! fan is not changed by it. Points in space are what there is, as sure as they say, and cost no allocation.

mod counting;

use assert_cmd::cargo::CommandCargoExt as _;
use counting::allocations_of;
use noctule::config::Config;
use noctule::detect::SpaceDetector;
use noctule::flow::MaskSet;
use noctule::geometry::Pose2;
use noctule::imaging::params::Prefer;
use noctule::imaging::{Imager, ImagerOptions};
use noctule::sensor::{RecordingParams, SensorSetup};
use noctule::service::space_trials::{Looker, SpaceScore, room};
use noctule::service::wiring::{self, SensingSetup};
use noctule::service::{scanning, simulator};
use noctule::signal::{Cues, PointCloud, SampleFormat, SpaceClass};
use noctule::sim::{Ball, Bar, Pillar, SimParams, World};
use noctule::time::Stamp;
use std::process::Command;
use std::sync::Arc;

/// The floor is 0.4 m below: seen along the array's own plane its lobe reaches up to half of that.
const BAND_M: [f64; 2] = [-0.20, 0.30];
const FLOOR_M: f64 = -0.40;

fn config(directions: Option<usize>, z_m: Option<[f64; 2]>) -> Config {
    let mut config = Config::default();
    config.sensor.truncate(1);
    config.imaging.directions.equal_area = directions;
    config.imaging.range_max_m = 2.6;
    config.platform.z_m = z_m;
    config.recording = RecordingParams { format: SampleFormat::PcmF32, ..RecordingParams::default() };
    config.validate().expect("valid");
    config
}

fn rig(directions: Option<usize>, z_m: Option<[f64; 2]>) -> (Config, SensingSetup, MaskSet) {
    let config = config(directions, z_m);
    let setup = wiring::sensing(&config).expect("sensors");
    let masks = wiring::masks(&config, &setup).expect("masks");
    (config, setup, masks)
}

/// Height of a cell above the sensors' origins, and whether it may be in a mask.
fn height_m(setup: &SensingSetup, cell: usize) -> f64 {
    let grid = &setup.plan.grid;
    let (row, bin) = (cell / grid.range_count(), cell % grid.range_count());
    (grid.range_first_m() + bin as f64 * grid.range_step_m()) * grid.directions()[row].elevation_rad.sin()
}

#[test]
fn a_mask_ends_at_the_height_of_the_robot_and_nowhere_else() {
    let (_, setup, whole) = rig(Some(500), None);
    let (_, _, cut) = rig(Some(500), Some(BAND_M));
    let (mut kept, mut dropped) = (0, 0);
    for (whole, cut) in whole.masks().zip(cut.masks()) {
        assert_eq!((whole.layer, whole.sensor_index), (cut.layer, cut.sensor_index));
        for (cell, (before, after)) in whole.values.iter().zip(&cut.values).enumerate() {
            let inside = (BAND_M[0]..=BAND_M[1]).contains(&height_m(&setup, cell));
            assert_eq!(*after, if inside { *before } else { 0 }, "cell {cell}");
            kept += usize::from(*after != 0);
            dropped += usize::from(*before != *after);
        }
    }
    assert!(kept > 10_000 && dropped > 10_000, "{kept} {dropped}");
}

#[test]
fn a_level_fan_has_the_masks_that_it_had() {
    let (_, _, before) = rig(None, None);
    let (_, _, after) = rig(None, Some(BAND_M));
    assert_eq!(before.masks().collect::<Vec<_>>(), after.masks().collect::<Vec<_>>());
    assert_eq!(before.table(), after.table());
}

/// What the layers are told of a world in front of a robot in its origin.
fn cues((config, setup, masks): &(Config, SensingSetup, MaskSet), world: World) -> Cues {
    let plan = Arc::clone(&setup.plan);
    let options = ImagerOptions { threads: Some(1), ..ImagerOptions::default() };
    let mut imager = Imager::open(plan, Arc::clone(masks.table()), Prefer::Cpu, options).expect("CPU");
    let mut simulator = simulator(config, setup, world, SimParams::default(), 3).expect("simulator");
    simulator.set_pose(Pose2::default());
    let mut pings = simulator.empty_ping_set();
    simulator.ping_set(Stamp { boottime_ns: 1, wall_ns: 0 }, &mut pings);
    let image = imager.image(&pings).expect("imaged");
    masks.fuse(&image.sums, image.imaged, image.emitted_at, image.sequence)
}

/// A bar across the way, at a height and a distance from the sensor in the plane.
fn bar(z_m: f64) -> World {
    let bar = Bar { from: [0.58, -0.8, z_m], to: [0.58, 0.8, z_m], radius_m: 0.02 };
    World { bars: vec![bar], ..World::default() }
}

#[test]
fn a_bar_at_the_robots_height_stops_it_and_neither_one_overhead_nor_the_floor_does() {
    let threshold = Config::default().control.collision_avoidance.threshold as f32;
    let floor = World { floor_m: Some(FLOOR_M), ..World::default() };
    let energy = |rig: &(Config, SensingSetup, MaskSet), world: World| cues(rig, world).collision.energy;
    for directions in [500, 1000, 2000, 4000] {
        let with = rig(Some(directions), Some(BAND_M));
        let (in_way, overhead, below) =
            (energy(&with, bar(0.1)), energy(&with, bar(0.45)), energy(&with, floor.clone()));
        println!("{directions}: energies of {threshold}: in the way {in_way}, overhead {overhead}, floor {below}");
        assert!(in_way > 2.0 * threshold, "{directions}: {in_way} of {threshold}");
        assert!(overhead < 0.5 * threshold, "{directions}: {overhead} of {threshold}");
        assert!(below < 0.5 * threshold, "{directions}: {below} of {threshold}");
    }
    // Control: a robot that does not know its height takes the bar overhead for one in its way.
    let without = rig(Some(1000), None);
    assert!(energy(&without, bar(0.45)) > 2.0 * threshold, "{}", energy(&without, bar(0.45)));
}

#[test]
fn coverage_of_the_way_is_that_of_a_fan() {
    let (_, _, fan) = rig(None, Some(BAND_M));
    for directions in [500, 1000, 2000, 4000] {
        let config = config(Some(directions), Some(BAND_M));
        let setup = wiring::sensing(&config).expect("sensors");
        // Masks of thousands of directions take seconds: the view alone is asked.
        let mounts: Vec<_> = setup.sensors.iter().map(|sensor: &SensorSetup| sensor.mount).collect();
        let hidden = setup.hidden_directions();
        let view = noctule::flow::View::new(&setup.plan.grid, &mounts, &hidden);
        for step in -80..=80 {
            assert!(view.sees_bearing(0, f64::from(step).to_radians()), "{directions}: {step} degrees");
        }
    }
    assert!(fan.coverage([true, false, false]).ahead_m > 1.0);
}

#[test]
fn points_in_random_rooms_are_what_there_is_and_as_sure_as_they_say() {
    let looker = Looker::new(config(Some(2000), None)).expect("robot");
    let sensor_m = looker.sensor_m();
    let rooms: Vec<_> = (1..=12).map(|seed| room(seed, sensor_m)).collect();
    let looks = looker.look(&rooms, Prefer::Cpu, &mut || {}).expect("looked");
    let mut score = SpaceScore::default();
    rooms.iter().zip(&looks).for_each(|(room, look)| score.add(room, look, sensor_m, false));
    let share = |class: SpaceClass| score.found[class as usize] as f64 / score.there[class as usize] as f64;
    // Measured: all found but 3 of 36 on the floor, all told right, no ghost, 0.8 mm, 0.06 and 0.13 degrees.
    assert!(share(SpaceClass::Obstacle) > 0.95 && share(SpaceClass::Overhang) > 0.9, "{score:?}");
    assert!(share(SpaceClass::Floor) > 0.8 && share(SpaceClass::Ceiling) > 0.9, "{score:?}");
    let wrong: usize = (0..4).map(|class| score.found[class] - score.confusion[class][class]).sum();
    assert!(wrong <= 1 && score.false_obstacles <= 1 && score.ghosts <= 3, "{score:?}");
    let [range_m, azimuth_rad, elevation_rad] = score.rms().expect("found");
    assert!(range_m < 2e-3 && azimuth_rad.to_degrees() < 0.2 && elevation_rad.to_degrees() < 0.3, "{score:?}");
    // Three numbers each: 3 if honest. Not above that by more than chance, and not so cautious as to say nothing.
    let nees = score.mean_nees().expect("found");
    assert!((0.7..4.0).contains(&nees), "{nees}");
    // Control: points turned by two degrees are caught.
    let mut turned = SpaceScore::default();
    for (room, look) in rooms.iter().zip(&looks) {
        let mut look = look.clone();
        let turn = nalgebra::Rotation3::from_axis_angle(&nalgebra::Vector3::z_axis(), 0.035);
        look.cloud.points.iter_mut().for_each(|point| point.position_m = turn * point.position_m);
        turned.add(room, &look, sensor_m, false);
    }
    assert!(turned.mean_nees().expect("found") > 8.0, "{turned:?}");
}

#[test]
fn the_detector_of_points_allocates_nothing_after_it_was_made() {
    let config = config(Some(500), Some(BAND_M));
    let setup = wiring::sensing(&config).expect("sensors");
    let mut detector: SpaceDetector = scanning::space(&config, &setup).expect("a grid with elevations");
    let mut cloud = PointCloud::empty();
    let world = World {
        balls: vec![Ball { centre: [1.2, 0.3, 0.4], radius_m: 0.1 }],
        floor_m: Some(FLOOR_M),
        ceiling_m: Some(1.8),
        ..bar(0.1)
    };
    let mut imager = Imager::open(
        Arc::clone(&setup.plan),
        Arc::new(noctule::signal::MaskTable::default()),
        Prefer::Cpu,
        ImagerOptions { threads: Some(1), ..ImagerOptions::default() },
    )
    .expect("CPU");
    let mut simulator = simulator(&config, &setup, world, SimParams::default(), 3).expect("simulator");
    simulator.set_pose(Pose2::default());
    let mut pings = simulator.empty_ping_set();
    simulator.ping_set(Stamp { boottime_ns: 1, wall_ns: 0 }, &mut pings);
    let cells = imager.image(&pings).expect("imaged").energyscapes[0].values.clone();
    // A crowd: every third cell is a top.
    let noisy: Vec<f32> = (0..cells.len()).map(|cell| ((cell * 7919) % 1013) as f32 * 1e-3).collect();
    let mut most = 0;
    let ((), counted) = allocations_of(|| {
        for sequence in 1..40 {
            let seen = if sequence % 3 == 0 { &noisy } else { &cells };
            detector.hear(0, sequence, Stamp { boottime_ns: sequence, wall_ns: 0 }, seen);
            detector.hear(7, sequence, Stamp::default(), seen);
            detector.update(&mut cloud);
            most = most.max(cloud.points.len());
        }
    });
    assert_eq!(counted, 0, "allocations");
    assert!(most >= 20, "{most}");
}

#[test]
fn the_command_tells_what_it_found_as_a_table_as_json_and_as_a_picture() {
    let directory = tempfile::tempdir().expect("directory");
    let (table, picture) = (directory.path().join("table.json"), directory.path().join("space.png"));
    let run = |directions: &str| {
        let mut command = Command::cargo_bin("noctule").expect("built");
        command.args(["--quiet", "detect", "space", "--runs", "1", "--directions", directions]);
        command.arg("--json").arg(&table).arg("--plot").arg(&picture).output().expect("run")
    };
    let output = run("600");
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8(output.stdout).expect("UTF-8");
    assert!(text.contains("fan 180") && text.contains("equal-area 600"), "{text}");
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(&table).expect("read")).expect("JSON");
    assert_eq!((json[1]["rooms"].as_u64(), json[1]["there"].as_array().map(Vec::len)), (Some(1), Some(4)));
    assert!(json[0]["range_rms_m"].is_null() && json[1]["range_rms_m"].as_f64() < Some(0.01), "{json}");
    assert!(std::fs::read(&picture).expect("read").starts_with(b"\x89PNG"));
    let refused = run("7");
    assert_eq!(refused.status.code(), Some(2), "{refused:?}");
    assert!(String::from_utf8_lossy(&refused.stderr).contains("32 to 16384"), "{refused:?}");
}

/// The thresholds are made for the fan of 1 degree. Measured: each grid within 3 % of the mean of all grids, the mean within 25 % of the
/// fan where the thing stands level with the sensors.
#[test]
fn what_a_region_reads_hardly_depends_on_the_grid() {
    let pillar = |x_m: f64, y_m: f64, radius_m: f64| World {
        pillars: vec![Pillar { centre: [x_m, y_m], radius_m }],
        ..World::default()
    };
    let ball = Ball { centre: [0.6, 0.0, 0.0], radius_m: 0.05 };
    let ball = World { balls: vec![ball], ..World::default() };
    let worlds = [bar(0.0), pillar(0.7, 0.0, 0.05), pillar(0.6, 0.1, 0.02), pillar(0.9, 0.0, 0.1), ball];
    let read = |directions: Option<usize>| -> Vec<f32> {
        let rig = rig(directions, directions.map(|_| BAND_M));
        worlds.iter().map(|world| cues(&rig, world.clone()).obstacle.energy).collect()
    };
    let fan = read(None);
    let grids = [500, 1000, 2000, 4000].map(|directions| read(Some(directions)));
    for (index, fan) in fan.iter().enumerate() {
        let mean = grids.iter().map(|grid| grid[index]).sum::<f32>() / grids.len() as f32;
        println!("world {index}: fan {fan}, grids {:?}", grids.each_ref().map(|grid| grid[index]));
        assert!((0.75..1.30).contains(&(mean / fan)), "world {index}: {mean}, the fan {fan}");
        for grid in &grids {
            assert!((grid[index] / mean - 1.0).abs() < 0.06, "world {index}: {} of {mean}", grid[index]);
        }
    }

    // Control: cells counted alike, as they are on fans, read eight times as much on the finest grid as on the coarsest.
    let weight = |directions| config(Some(directions), None).imaging.directions.cell_weight();
    for (coarse, fine) in grids[0].iter().zip(&grids[3]) {
        let times = (fine / weight(4000)) / (coarse / weight(500));
        assert!((7.0..9.0).contains(&times), "{times}");
    }
}

/// Floor, ceiling, pipes, a cable, a lamp; a barrier and a leaning beam at the robot's height.
#[test]
fn a_cellar_is_driven_through_in_three_dimensions_where_a_fan_stays_where_it_is() {
    let drive = |extra: &[&str]| {
        let folder = tempfile::tempdir().expect("directory");
        let json = folder.path().join("runs.json");
        let mut command = Command::cargo_bin("noctule").expect("built");
        command.args(["simulate", "fixtures/worlds/cellar.toml", "--runs", "2", "--json"]).arg(&json).args(extra);
        let output = command.output().expect("run");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let record = std::fs::read(&json).expect("written");
        let record: serde_json::Value = serde_json::from_slice(&record).expect("JSON");
        record["runs"].as_array().expect("runs").clone()
    };
    let grid = ["--config", "fixtures/config/cellar.toml"];
    for run in drive(&grid) {
        assert_eq!((&run["reached_goal"], &run["collided"]), (&true.into(), &false.into()), "{run}");
    }
    // The control: to a fan the floor is a thing ahead.
    for run in drive(&["--layout", "sim-1"]) {
        assert_eq!((&run["reached_goal"], &run["collided"]), (&false.into(), &false.into()), "{run}");
        assert!(run["path_length_m"].as_f64().expect("a number") < 0.5, "{run}");
    }
}
