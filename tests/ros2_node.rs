//! Contract: the ROS 2 node passes images, commands and what the platform is told on as they were published, and cmd_vel to the daemon.
//! With the real wheel of the transport and a stand-in for rclpy; `NOCTULE_REQUIRE_PYTHON=1` makes the wheel's absence a failure.

mod client_rig;
mod ipc_rig;

use client_rig::{DIRECTIONS, Publisher, RANGES, python_is_missing, run, stdout};
use noctule::io::wire::WireType;
use noctule::io::wire::message::VelocityCommand;
use noctule::io::wire::telemetry::{Health, PlatformVelocity};
use noctule::io::{ControllerTopics, DaemonTopics};
use noctule::signal::{DaemonState, Reason};
use noctule::time::{Clock, SystemClock};
use serde_json::Value;
use std::process::Command;

/// A command, health and what the controller makes of it: numbers that no two messages share.
fn say(topics: &mut DaemonTopics, controller: &ControllerTopics) {
    let now = SystemClock.now();
    let mut command = VelocityCommand::standstill(now, DaemonState::Degraded, Reason::SensorLost);
    (command.linear_m_s, command.angular_rad_s) = (0.25, -0.75);
    topics.publish_command(command, now).expect("published");
    let schema_hash = Health::SCHEMA_HASH;
    topics.publish_health(Health { schema_hash, dropped_count: 17, ..Health::default() }).expect("published");
    let told = PlatformVelocity {
        schema_hash: PlatformVelocity::SCHEMA_HASH,
        t_wall_ns: now.wall_ns,
        linear_m_s: 0.125,
        angular_rad_s: 0.5,
        ..PlatformVelocity::default()
    };
    controller.publish_platform(told).expect("published");
}

#[test]
fn the_node_passes_on_what_was_published_and_what_was_wanted() {
    if python_is_missing() {
        return;
    }
    let mut publisher = Publisher::new();
    let controller = ControllerTopics::open(&publisher.place.ipc).expect("opened");
    let config = publisher.place.config_file();
    let mut node = Command::new("python3");
    node.args(["-B", concat!(env!("CARGO_MANIFEST_DIR"), "/examples/ros2_node.py"), "--config"]).arg(config);
    node.args(["--noctule", env!("CARGO_BIN_EXE_noctule")]);
    node.env("PYTHONPATH", concat!(env!("CARGO_MANIFEST_DIR"), "/tests/python/ros_stand_in"));
    let mut wanted = None;
    let output = run(&mut node, || {
        publisher.publish_next();
        say(&mut publisher.topics, &controller);
        wanted = publisher.topics.poll_input().or(wanted);
    });

    let said = stdout(&output);
    let of = |topic: &str| -> Vec<Value> {
        let lines = said.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
        lines.filter(|line| line["topic"] == topic).map(|mut line| line["message"].take()).collect()
    };
    let images = of("sonar_left/energyscape");
    assert!(images.len() >= 3, "{said}");
    for image in &images {
        let stamp_ns = |wall_ns: u64| (wall_ns / 1_000_000_000, wall_ns % 1_000_000_000);
        let header = &image["header"];
        assert_eq!((&image["encoding"], &header["frame_id"]), (&"32FC1".into(), &"sonar_left".into()));
        assert_eq!([&image["height"], &image["width"], &image["step"]], [DIRECTIONS, RANGES, 4 * RANGES]);
        // The strongest cell lies where some published ping has it.
        let at = image["data"]["at"].as_u64().expect("a place") as usize;
        let found = publisher.published.values().any(|ping| {
            let same = |a: f64, b: f64| (a - b).abs() < 1e-6;
            same(ping.range_m, 0.4 + 0.0125 * (at % RANGES) as f64)
                && same(ping.bearing_deg, -88.0 + 4.0 * (at / RANGES) as f64)
                && same(f64::from(ping.value), image["data"]["max"].as_f64().expect("a value"))
        });
        assert!(found, "{image}");
        let now_s = stamp_ns(SystemClock.now().wall_ns).0;
        assert!(header["stamp"]["sec"].as_u64().is_some_and(|sec| now_s - sec < 120), "{header}");
    }
    for (topic, linear, angular) in [("noctule/command", 0.25, -0.75), ("noctule/platform", 0.125, 0.5)] {
        let twists = of(topic);
        assert!(twists.len() >= 3, "{said}");
        assert!(twists.iter().all(|message| message["twist"]["linear"]["x"] == linear), "{topic}");
        assert!(twists.iter().all(|message| message["twist"]["angular"]["z"] == angular), "{topic}");
    }
    // The first diagnostics may come before anything was heard.
    let status = of("/diagnostics").pop().expect("diagnostics")["status"][0].take();
    let stale = status["message"] == "no command for 300 ms";
    assert!(stale || status["message"] == "DEGRADED: sensor_lost", "{status}");
    let wanted = wanted.expect("cmd_vel reached the daemon");
    assert_eq!((wanted.linear_m_s, wanted.angular_rad_s), (0.125, -0.5));
    assert!(wanted.schema_matches());
}
