//! Contract: the running daemon publishes scan, obstacle, objects and ego-motion of the ping sets that it images, and records them as they were
//! published; told not to, it publishes none, and everything else as before.

mod ipc_rig;

use assert_cmd::cargo::CommandCargoExt as _;
use ipc_rig::Place;
use noctule::io::record::RunReader;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs::File;
use std::path::Path;
use std::process::{Child, Command, Stdio};

const TOPICS: [&str; 5] =
    ["noctule/scan", "noctule/obstacle", "noctule/objects", "noctule/ego_motion", "noctule/command"];

fn noctule(config: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::cargo_bin("noctule").expect("built");
    command.args(arguments).arg("--config").arg(config).stderr(Stdio::null());
    command
}

/// One listener a topic, of a daemon that drives the simulated robot for three seconds; what each heard.
fn heard(place: &Place, config: &Path, topics: &[&str], run_also: &[&str]) -> Vec<Vec<Value>> {
    // Into files: scans of three seconds are more than a pipe that nobody reads yet holds.
    let file = |topic: &str| place.directory.path().join(topic.replace('/', "_"));
    let listen = |topic: &&str| -> Child {
        let out = File::create(file(topic)).expect("made");
        noctule(config, &["echo", topic, "--json"]).stdout(out).spawn().expect("started")
    };
    let listeners: Vec<Child> = topics.iter().map(listen).collect();
    let mut run = vec!["run", "--source", "sim", "--backend", "cpu", "--duration", "3"];
    run.extend(run_also);
    let status = noctule(config, &run).stdout(Stdio::null()).status().expect("run");
    assert!(status.success(), "{status}");
    let lines = |(topic, mut child): (&str, Child)| {
        let process = rustix::process::Pid::from_child(&child);
        rustix::process::kill_process(process, rustix::process::Signal::TERM).expect("told to end");
        assert!(child.wait().expect("ended").success());
        let text = std::fs::read_to_string(file(topic)).expect("UTF-8");
        text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect()
    };
    topics.iter().copied().zip(listeners).map(lines).collect()
}

fn times(samples: &[Value]) -> BTreeSet<u64> {
    samples.iter().filter_map(|sample| sample["t_monotonic_ns"].as_u64()).collect()
}

fn array<'a>(sample: &'a Value, field: &str) -> &'a [Value] {
    sample[field].as_array().map_or(&[], Vec::as_slice)
}

#[test]
fn detections_of_every_ping_set_are_published_and_recorded() {
    let place = Place::new();
    let config = place.config_file();
    let recording = place.directory.path().join("run.mcap");
    let all = heard(&place, &config, &TOPICS, &["--record", recording.to_str().expect("UTF-8")]);
    let [scans, obstacles, objects, motions, commands] = all.as_slice() else { panic!("{}", all.len()) };
    // Three seconds are thirty ping sets; the first of them are taken by the self-test.
    for (topic, samples) in TOPICS.iter().zip(&all) {
        assert!(samples.len() >= 20, "{topic}: {}", samples.len());
    }
    let commanded = times(commands);
    let known = |samples: &[Value]| times(samples).iter().filter(|time| commanded.contains(time)).count();
    for samples in [scans, obstacles, objects, motions] {
        // A listener may miss what was published while it was being started.
        assert!(known(samples) + 3 >= samples.len(), "of emissions that were commanded from");
    }
    let scan = scans.last().expect("some");
    assert_eq!(array(scan, "range_m").len(), 360);
    let echoes = array(scan, "answer").iter().filter(|answer| *answer == "echo").count();
    let peaks = scan["peak_count"].as_u64().expect("number");
    assert!(echoes > 10 && peaks > 0 && scan["sensors_used"] == 7, "{echoes} echoes, {peaks} peaks");
    // Without a path there is no edge, and the detector says that it sees nothing rather than that nothing is there.
    let obstacle = obstacles.last().expect("some");
    assert_eq!(
        (&obstacle["follower"], &obstacle["detected"], &obstacle["edge_index"]),
        (&"IDLE".into(), &0.into(), &u32::MAX.into())
    );
    let map = objects.last().expect("some");
    assert_eq!((&map["frame"], array(map, "map").len()), (&"odometry".into(), 64 * 64));
    let known_cells = array(map, "map").iter().filter(|cell| cell.as_i64() != Some(-1)).count();
    assert!(known_cells > 50, "{known_cells}");
    // A robot that starts is heard to move as its wheels say.
    let both = |motion: &&Value| motion["linear_observed"] == 1 && motion["odometry_linear_m_s"].is_f64();
    let off_m_s = |motion: &Value| {
        motion["linear_m_s"].as_f64().expect("V") - motion["odometry_linear_m_s"].as_f64().expect("odometry")
    };
    let near = motions.iter().filter(both).filter(|motion| off_m_s(motion).abs() < 0.05).count();
    assert!(near * 10 >= motions.iter().filter(both).count() * 8 && near >= 15, "{near} of {}", motions.len());
    assert!(motions.iter().all(|motion| motion["slip"] == 0), "nothing slips");
    drop(RunReader::open(&recording).expect("a recording"));
    let bytes = std::fs::read(&recording).expect("read");
    for topic in [
        "/noctule/scan",
        "/noctule/laser_scan",
        "/noctule/obstacle",
        "/noctule/objects",
        "/noctule/map",
        "/noctule/ego_motion",
    ] {
        assert!(count_of(&bytes, topic.as_bytes()) > 0, "{topic} is in the recording");
    }
}

/// How often `wanted` stands in `bytes`: the names of channels are not compressed in the summary.
fn count_of(bytes: &[u8], wanted: &[u8]) -> usize {
    bytes.windows(wanted.len()).filter(|window| *window == wanted).count()
}

#[test]
fn a_robot_without_detectors_publishes_none_and_drives_as_before() {
    let place = Place::new();
    let config = place.config_file();
    let text = std::fs::read_to_string(&config).expect("read") + "[detect]\nenabled = false\n";
    std::fs::write(&config, text).expect("written");
    let all = heard(&place, &config, &TOPICS, &[]);
    assert_eq!(all[..4].iter().map(Vec::len).collect::<Vec<_>>(), [0, 0, 0, 0]);
    assert!(all[4].len() >= 20, "{}", all[4].len());
}

#[test]
fn a_robot_with_an_equal_area_grid_publishes_points_in_space_and_one_with_a_fan_does_not() {
    let place = Place::new();
    let config = place.config_file();
    let recording = place.directory.path().join("run.mcap");
    let topics = ["noctule/points", "noctule/scan"];
    let level = heard(&place, &config, &topics, &[]);
    assert!(level[0].is_empty() && level[1].len() >= 20, "{} {}", level[0].len(), level[1].len());
    let text = std::fs::read_to_string(&config).expect("read");
    let imaging = "[imaging]\ndirections = { equal_area = 200 }\n[platform]\nz_m = [-0.2, 0.3]\n";
    std::fs::write(&config, text + imaging).expect("written");
    let all = heard(&place, &config, &topics, &["--record", recording.to_str().expect("UTF-8")]);
    let (clouds, scans) = (&all[0], &all[1]);
    assert!(clouds.len() >= 20 && scans.len() >= 20, "{} {}", clouds.len(), scans.len());
    let cloud = clouds.last().expect("some");
    assert_eq!((array(cloud, "x_m").len(), array(cloud, "slice_m").len()), (192, 180));
    let count = cloud["point_count"].as_u64().expect("number") as usize;
    assert!(count > 0 && cloud["obstacle_count"].as_u64() <= cloud["point_count"].as_u64(), "{cloud}");
    assert!(array(cloud, "variance_z_m2")[..count].iter().all(|variance| variance.as_f64() > Some(0.0)));
    let bytes = std::fs::read(&recording).expect("read");
    for topic in ["/noctule/points", "/noctule/point_cloud"] {
        assert!(count_of(&bytes, topic.as_bytes()) > 0, "{topic} is in the recording");
    }
}
