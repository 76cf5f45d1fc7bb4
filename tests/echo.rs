//! Contract: what passes on any topic can be read as one JSON object a line, its fields named as `noctule topics` lists
//! them; an unknown topic is refused with those there are.

mod ipc_rig;

use ipc_rig::Place;
use noctule::io::topics::topics_json;
use noctule::io::wire::message::{EnergyscapeHeader, OperatorRequest, Request, VelocityCommand};
use noctule::io::wire::telemetry::PlatformVelocity;
use noctule::io::{ControllerTopics, DaemonTopics, Echo, EchoLimit, IpcError, RawPublisher, RawShape};
use noctule::signal::{DaemonState, Direction, GateState, PolarGrid, RawPing, Reason, SampleFormat, Samples};
use noctule::time::{Clock, SystemClock};
use serde_json::Value;
use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

fn sensors() -> Vec<String> {
    vec!["front".to_owned()]
}

fn open(place: &Place, topic: &str, json: bool) -> Echo {
    Echo::open(&place.ipc, topic, json, &sensors(), SampleFormat::PcmI16).expect("opened")
}

fn next(echo: &Echo) -> Value {
    serde_json::from_str(&echo.next_line().expect("a line")).expect("JSON")
}

/// Names of the fields of a topic, as `topics --json` lists them.
fn listed(place: &Place, topic: &str) -> BTreeSet<String> {
    let json = topics_json(&place.params, &sensors(), SampleFormat::PcmI16);
    let services = json["services"].as_array().expect("services");
    let service = services.iter().find(|service| service["name"] == topic).expect("listed");
    let part = if service["header"].is_null() { &service["payload"] } else { &service["header"] };
    let fields = part["fields"].as_array().expect("fields");
    fields.iter().map(|field| field["name"].as_str().expect("name").to_owned()).collect()
}

fn names(value: &Value) -> BTreeSet<String> {
    value.as_object().expect("object").keys().cloned().collect()
}

#[test]
fn the_platforms_velocity_is_read_with_its_state_and_reason_by_name() {
    let place = Place::new();
    let controller = ControllerTopics::open(&place.ipc).expect("controller");
    let echo = open(&place, "noctule/platform", true);
    assert!(echo.next_line().is_none());
    let sent = PlatformVelocity {
        t_monotonic_ns: 12_345_678_901_234,
        linear_m_s: 0.25,
        angular_rad_s: -0.5,
        state: GateState::Track.number(),
        reason: Reason::Armed.number(),
        ..PlatformVelocity::blank()
    };
    controller.publish_platform(sent).expect("sent");
    let value = next(&echo);
    assert_eq!(names(&value), listed(&place, "noctule/platform"));
    assert_eq!(value["t_monotonic_ns"], 12_345_678_901_234_u64);
    assert_eq!((value["linear_m_s"].as_f64(), value["angular_rad_s"].as_f64()), (Some(0.25), Some(-0.5)));
    assert_eq!((&value["state"], &value["reason"]), (&Value::from("TRACK"), &Value::from("armed")));
}

#[test]
fn commands_requests_and_images_are_read_with_the_fields_that_topics_lists() {
    let place = Place::new();
    let mut daemon = DaemonTopics::open(&place.ipc, &sensors(), &[6]).expect("daemon");
    let controller = ControllerTopics::open(&place.ipc).expect("controller");
    let now = SystemClock.now();

    let echo = open(&place, "noctule/command", true);
    daemon
        .publish_command(VelocityCommand::standstill(now, DaemonState::Fault, Reason::FrozenPing), now)
        .expect("sent");
    let value = next(&echo);
    assert_eq!(names(&value), listed(&place, "noctule/command"));
    assert_eq!((&value["state"], &value["reason"]), (&Value::from("FAULT"), &Value::from("frozen_ping")));
    assert_eq!(value["epoch"], daemon.epoch());

    let echo = open(&place, "noctule/operator", true);
    controller.publish_operator(OperatorRequest::new(Request::Stop, 0, 1, now)).expect("sent");
    assert_eq!(next(&echo)["request"], "stop");

    let grid = PolarGrid::new(vec![Direction::horizontal(-0.1), Direction::horizontal(0.1)], 0.3, 0.005, 3);
    let header = EnergyscapeHeader { sequence: 4, ..EnergyscapeHeader::for_grid(&grid, 0, 343.0) };
    daemon.publish_energyscape(0, &header, &[0.0, 0.5, 0.25, 0.0, 2.5, 0.0]).expect("sent");
    let echo = open(&place, "noctule/sonar/front/energyscape", true);
    daemon.connect_latecomers().expect("connected");
    let value = next(&echo);
    let mut expected = listed(&place, "noctule/sonar/front/energyscape");
    expected.extend(["len".to_owned(), "max".to_owned()]);
    assert_eq!(names(&value), expected);
    assert_eq!((&value["len"], &value["max"], &value["sequence"]), (&6.into(), &2.5.into(), &4.into()));
    daemon.publish_energyscape(0, &header, &[0.0, f32::NAN, 0.25, 0.0, 2.5, 0.0]).expect("sent");
    assert_eq!(next(&echo)["max"], Value::Null, "a NaN is shown, not hidden behind a larger number");
}

#[test]
fn raw_pings_are_read_and_people_get_names_and_values() {
    let place = Place::new();
    let shape = RawShape { format: SampleFormat::PcmI16, sample_rate_hz: 450e3, channel_count: 2, sample_count: 2 };
    let driver = RawPublisher::open(&place.ipc, "front", shape).expect("driver");
    let echo = open(&place, "noctule/sonar/front/pcm", false);
    let samples = Samples::PcmI16(vec![-5, 7, 3, 1]);
    driver
        .publish(&RawPing { sensor_index: 0, sequence: 8, emitted_at: SystemClock.now(), samples: samples.into() })
        .expect("sent");
    let line = echo.next_line().expect("a line");
    for part in ["sequence=8", "format=pcm-i16", "len=4", "max=7.0000"] {
        assert!(line.contains(part), "{line}");
    }
}

#[test]
fn every_listed_topic_can_be_opened_and_an_unknown_one_is_refused_with_2() {
    let place = Place::new();
    for format in [SampleFormat::Pdm, SampleFormat::PcmI16, SampleFormat::PcmF32] {
        let json = topics_json(&place.params, &sensors(), format);
        for service in json["services"].as_array().expect("services") {
            let name = service["name"].as_str().expect("name");
            Echo::open(&place.ipc, name, true, &sensors(), format).unwrap_or_else(|error| panic!("{name}: {error}"));
        }
    }
    match Echo::open(&place.ipc, "noctule/comand", true, &sensors(), SampleFormat::Pdm).map(drop) {
        Err(error @ IpcError::UnknownTopic { .. }) => {
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains("noctule/command"), "{error}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_echo_ends_at_its_count_at_its_time_and_when_asked() {
    let place = Place::new();
    let controller = ControllerTopics::open(&place.ipc).expect("controller");
    let echo = open(&place, "noctule/platform", true);
    for _ in 0..3 {
        controller.publish_platform(PlatformVelocity::blank()).expect("sent");
    }
    let go = AtomicBool::new(false);
    let mut lines = 0;
    let count = EchoLimit { count: Some(2), duration: None };
    assert_eq!(
        echo.run(count, &go, |_| {
            lines += 1;
            true
        }),
        2
    );
    assert_eq!(lines, 2);
    let time = EchoLimit { count: None, duration: Some(Duration::from_millis(30)) };
    assert_eq!(echo.run(time, &go, |_| true), 1);
    assert_eq!(echo.run(EchoLimit::default(), &AtomicBool::new(true), |_| true), 0);
    controller.publish_platform(PlatformVelocity::blank()).expect("sent");
    assert_eq!(echo.run(EchoLimit::default(), &go, |_| false), 0, "the reader went away");
}
