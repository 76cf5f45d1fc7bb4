//! Contract: what is recorded is read without ROS by the Python packages mcap-ros2-support and rosbags: every topic decodes, scans,
//! images, commands and mounts are those that were recorded. `NOCTULE_REQUIRE_MCAP_READERS=1` makes their absence a failure.

mod record_rig;

use noctule::detect::RangeScanner;
use noctule::flow::NoiseFloor;
use noctule::signal::{RangeScan, Reading};
use record_rig::{config, patient, record_watched};
use serde_json::{Map, Value, json};
use std::io::Write as _;
use std::process::Command;
use std::sync::Arc;

const SETS: usize = 12;

/// Whether the packages are here. Without them the test ends early, and says so past the test runner's capture.
fn readers_are_missing() -> bool {
    let imports = "import numpy, mcap_ros2.decoder, rosbags.highlevel";
    let why = match Command::new("python3").args(["-c", imports]).output() {
        Err(error) => format!("python3: {error}"),
        Ok(output) if output.status.success() => return false,
        Ok(output) => String::from_utf8_lossy(&output.stderr).trim().lines().last().unwrap_or("").to_owned(),
    };
    let help = "pip install numpy mcap-ros2-support rosbags";
    let required = std::env::var_os("NOCTULE_REQUIRE_MCAP_READERS").is_some_and(|value| value == "1");
    assert!(!required, "{why}; {help}");
    let _ = writeln!(std::io::stderr(), "SKIPPED, foreign readers of recordings are NOT tested: {why}; {help}");
    true
}

/// A range as ROS writes it, as the hexadecimal digits of its four bytes: NaN and infinities survive JSON so.
fn digits(reading: Reading) -> String {
    let range_m = match reading {
        Reading::Unseen => f32::NAN,
        Reading::Clear => f32::INFINITY,
        Reading::Echo { range_m, .. } => range_m as f32,
    };
    range_m.to_le_bytes().iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn two_foreign_readers_find_every_topic_and_every_value() {
    if readers_are_missing() {
        return;
    }
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("run.mcap");
    let config = config();
    let floor = NoiseFloor::configured(config.control.energy.noise_floor_dbfs.clone());
    let share = 10f64.powf(-config.control.energy.side_lobe_db / 20.0);
    let (mut scans, mut mounts) = (Map::new(), Map::new());
    let (mut images, mut echoes) = (0, 0);
    let watched = record_watched(&config, &patient(&path), SETS, |drive| {
        let image = drive.pipeline.image();
        for (index, energyscape) in image.energyscapes.iter().enumerate().filter(|(index, _)| image.imaged[*index]) {
            let sensor = &drive.setup.sensors[index];
            let wall_ns = energyscape.emitted_at.wall_ns;
            let key = format!("{}_{}_{}", sensor.name, wall_ns / 1_000_000_000, wall_ns % 1_000_000_000);
            let bytes: Vec<u8> = energyscape.values.iter().flat_map(|value| value.to_le_bytes()).collect();
            std::fs::write(folder.path().join(format!("{key}.f32")), bytes).expect("written");
            let hidden = &drive.setup.plan.sensors[index].hidden;
            let mut scanner = RangeScanner::new(&energyscape.grid, hidden, |range_m| floor.at(range_m), share);
            let mut scan = RangeScan::unseen(Arc::clone(&energyscape.grid), index);
            scanner.scan(energyscape, &mut scan);
            echoes += scan.readings.iter().filter(|reading| matches!(reading, Reading::Echo { .. })).count();
            scans.insert(key, scan.readings.iter().map(|reading| json!(digits(*reading))).collect());
            let (mount, frame) = (sensor.mount, format!("sonar_{}", sensor.name));
            let (sin, cos) = mount.bearing_rad.sin_cos();
            let yaw_rad = mount.bearing_rad + mount.yaw_rad;
            mounts.insert(frame, json!([mount.distance_m * cos, mount.distance_m * sin, yaw_rad]));
            images += 1;
        }
    });
    let (commands, _) = watched.expect("recorded");
    assert!(echoes > 10 * images, "a room that echoes: {echoes} in {images} scans");
    let told: Vec<_> = commands.iter().map(|command| [command.linear_m_s, command.angular_rad_s]).collect();
    let expected = json!({ "scans": scans, "mounts": mounts, "commands": told });
    std::fs::write(folder.path().join("expected.json"), expected.to_string()).expect("written");

    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/record_readers.py");
    let run = || Command::new("python3").arg(script).arg(&path).arg(folder.path()).output().expect("runs");
    let output = run();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    for reader in ["mcap_ros2", "rosbags"] {
        let found = &found[reader];
        assert_eq!(found["scans"], json!(images), "{reader}");
        assert_eq!(found["images"], json!(images), "{reader}");
        assert_eq!(found["commands"], json!(commands.len()), "{reader}");
        let topics = found["topics"].as_object().expect("topics");
        for topic in
            ["pipeline", "command", "cues", "input", "operator", "odometry", "platform", "platform_vel", "health"]
        {
            assert!(topics.contains_key(&format!("/noctule/{topic}")), "{reader} has no {topic}: {topics:?}");
        }
        for topic in
            ["/tf", "/tf_static", "/diagnostics", "/noctule/sonar/front/raw", "/noctule/sonar/left/energyscape_info"]
        {
            assert!(topics.contains_key(topic), "{reader} has no {topic}: {topics:?}");
        }
    }
    // Negative control: one value that is another is found by the same judge.
    let spoilt = std::fs::read_to_string(folder.path().join("expected.json")).expect("read");
    let at = spoilt.find("\"0000807f\"").expect("a direction with nothing in range");
    let spoilt = format!("{}\"00000040\"{}", &spoilt[..at], &spoilt[at + 10..]);
    std::fs::write(folder.path().join("expected.json"), spoilt).expect("written");
    assert!(!run().status.success(), "a wrong range was believed");
}
