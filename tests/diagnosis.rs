//! Contract: `noctule status` tells a running system's state, why the robot moves or stands and what is not well; `noctule doctor`
//! finds what was planted, with a remedy, and changes nothing. Both end whatever they meet.

mod ipc_rig;

use iceoryx2::prelude::AttributeSpecifier;
use ipc_rig::{Place, files_below, foreign_node, shared_memory_files, wait_for};
use serde_json::Value;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// The place's configuration, written once: a process may just be reading it.
fn config_of(place: &Place) -> PathBuf {
    let path = place.directory.path().join("robot.toml");
    if path.exists() { path } else { place.config_file() }
}

const PROGRAM: &str = env!("CARGO_BIN_EXE_noctule");

fn run(place: &Place, arguments: &[&str]) -> Output {
    let begun = Instant::now();
    let output = Command::new(PROGRAM).args(arguments).arg("--config").arg(config_of(place)).output().expect("runs");
    assert!(begun.elapsed() < Duration::from_secs(20), "{arguments:?} took {:?}", begun.elapsed());
    output
}

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| {
        panic!("{error}: {} {}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
    })
}

/// Lines of the doctor about something, as (level, found, remedy).
fn about(report: &Value, what: &str) -> Vec<(String, String, String)> {
    let text = |line: &Value, key: &str| line[key].as_str().unwrap_or_default().to_owned();
    let lines = report["lines"].as_array().expect("lines").iter().filter(|line| line["about"] == what);
    lines.map(|line| (text(line, "level"), text(line, "found"), text(line, "remedy"))).collect()
}

fn problem(report: &Value, what: &str, found: &str) {
    let lines = about(report, what);
    let there = |(level, told, remedy): &(String, String, String)| {
        level == "problem" && told.contains(found) && !remedy.is_empty()
    };
    assert!(lines.iter().any(there), "no problem {what:?} with {found:?} in {lines:?}");
}

struct Process(Child);

impl Process {
    fn start(place: &Place, arguments: &[&str]) -> Self {
        let mut command = Command::new(PROGRAM);
        command.arg("--quiet").args(arguments).arg("--config").arg(config_of(place));
        Self(command.stdout(Stdio::null()).spawn().expect("started"))
    }

    fn end(mut self) {
        rustix::process::kill_process(rustix::process::Pid::from_child(&self.0), rustix::process::Signal::TERM)
            .expect("signal");
        wait_for(&mut self.0, Duration::from_secs(5));
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn where_nobody_lives_status_says_so_with_69_and_makes_nothing() {
    let place = Place::new();
    std::fs::remove_dir_all(place.root()).expect("removed");
    let output = run(&place, &["status"]);
    assert_eq!(output.status.code(), Some(69));
    let talk = String::from_utf8_lossy(&output.stderr);
    assert!(
        talk.contains("nobody runs under") && talk.contains("noctule run") && talk.contains("noctule doctor"),
        "{talk}"
    );
    let report = json(&run(&place, &["doctor", "--json"]));
    assert!(about(&report, "ipc root")[0].1.contains("not there yet"), "{report}");
    assert!(!place.root().exists() && shared_memory_files(&place.params.prefix).is_empty(), "something was made");
}

#[test]
fn a_driving_robot_is_well_and_a_stopped_one_is_told_with_its_reason() {
    let place = Place::new();
    let daemon = Process::start(&place, &["run"]);
    let controller = Process::start(&place, &["controller", "--arm"]);
    let deadline = Instant::now() + Duration::from_secs(20);
    let report = loop {
        let output = run(&place, &["status", "--json"]);
        if output.status.code() == Some(0) && json(&output)["controller"]["state"] == "TRACK" {
            break json(&output);
        }
        let talk = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text));
        assert!(Instant::now() < deadline, "{talk:?}");
    };
    assert_eq!((&report["daemon"]["state"], &report["backend"]), (&"ACTIVE".into(), &"cpu".into()));
    assert_eq!(report["daemon"]["process"], daemon.0.id());
    assert_eq!(report["controller"]["armed_epoch"], report["daemon"]["epoch"]);
    assert!(report["controller"]["age_s"].as_f64().is_some_and(|age_s| (0.0..0.2).contains(&age_s)), "{report}");
    assert!(report["ping_rate_hz"].as_f64().is_some_and(|rate_hz| (8.0..12.0).contains(&rate_hz)), "{report}");
    assert!(
        report["sensors"].as_array().is_some_and(|all| all.len() == 3 && all.iter().all(|one| one["delivers"] == true))
    );
    let who = &report["services"]["noctule/command"];
    assert!(who.as_array().is_some_and(|all| all.iter().any(|one| one["process"] == daemon.0.id())), "{who}");
    let publishers = &report["publishers"];
    assert_eq!(publishers["noctule/command"], serde_json::json!([daemon.0.id()]), "{publishers}");
    assert_eq!(publishers["noctule/platform"], serde_json::json!([controller.0.id()]), "{publishers}");
    // Topics go by their short names, too.
    let rate = json(&run(&place, &["echo", "command", "--rate", "--count", "1", "--json"]));
    assert!(rate["rate_hz"].as_f64().is_some_and(|rate_hz| (7.0..13.0).contains(&rate_hz)), "{rate}");
    assert!(rate["age_ms"].as_f64().is_some_and(|age_ms| (0.0..1_000.0).contains(&age_ms)), "{rate}");
    // The doctor looks at the same time, and nothing changes.
    let checked = json(&run(&place, &["doctor", "--json"]));
    assert!(about(&checked, "processes")[0].1.contains(&format!("daemon: process {}", daemon.0.id())), "{checked}");
    for what in ["ipc root", "left-overs", "versions", "shared memory"] {
        assert!(about(&checked, what).iter().all(|(level, ..)| level == "ok"), "{what}: {:?}", about(&checked, what));
    }
    run(&place, &["stop"]);
    let output = run(&place, &["status"]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(
        text.contains("LATCHED (operator_stop)") && text.contains("stands:") && text.contains("-> `noctule arm`"),
        "{text}"
    );
    controller.end();
    let output = run(&place, &["status", "--json"]);
    let found = json(&output)["findings"].to_string();
    assert!(output.status.code() == Some(1) && found.contains("no controller runs"), "{found}");
    daemon.end();
    assert_eq!(run(&place, &["status"]).status.code(), Some(69));
}

#[test]
fn the_doctor_finds_what_was_planted_and_leaves_it() {
    let place = Place::new();
    let prefix = &place.params.prefix;
    let name = |ending: &str| Path::new("/dev/shm").join(format!("{prefix}{}_1{ending}", "0".repeat(40)));
    std::fs::write(name(".connection"), "").expect("half made");
    std::fs::write(name(".dynamic"), (9_u64 << 16 | 2).to_ne_bytes()).expect("another version");
    std::fs::set_permissions(place.root(), std::fs::Permissions::from_mode(0o777)).expect("opened");
    std::thread::sleep(Duration::from_millis(1_100));
    let seen = || {
        let mut files = shared_memory_files(prefix);
        files_below(&place.root(), &mut files);
        files.sort();
        files
    };
    let before = seen();
    let output = run(&place, &["doctor", "--json"]);
    assert_eq!(output.status.code(), Some(1));
    let report = json(&output);
    problem(&report, "left-overs", "1 half-made files");
    problem(&report, "versions", "iceoryx2 0.9.2");
    problem(&report, "ipc root", "mode 0777");
    assert_eq!(
        report["problems"].as_u64(),
        Some(report["lines"].as_array().expect("lines").iter().filter(|line| line["level"] == "problem").count() as u64)
    );
    assert_eq!(seen(), before, "the doctor changed something");
    let mode = std::fs::metadata(place.root()).expect("there").permissions().mode() & 0o777;
    assert_eq!(mode, 0o777);
}

#[test]
fn the_doctor_names_who_uses_another_builds_type() {
    let place = Place::new();
    let node = foreign_node(&place.root(), &place.params.prefix);
    let key = "noctule.schema".try_into().expect("key");
    let attributes =
        AttributeSpecifier::new().define(&key, &"0123456789abcdef".try_into().expect("value")).expect("defined");
    let _service = node
        .service_builder(&"noctule/command".try_into().expect("name"))
        .publish_subscribe::<u64>()
        .create_with_attributes(&attributes)
        .expect("service");
    let report = json(&run(&place, &["doctor", "--json"]));
    problem(&report, "versions", "noctule/command has schema 0123456789abcdef");
    problem(&report, "versions", &std::process::id().to_string());
}

#[test]
fn a_refused_configuration_is_a_problem_and_the_rest_is_looked_at() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("robot.toml");
    std::fs::write(&path, "[safety]\nmax_age_ms = 0\n").expect("written");
    let output = Command::new(PROGRAM).args(["doctor", "--json", "--config"]).arg(&path).output().expect("runs");
    assert_eq!(output.status.code(), Some(1));
    let report = json(&output);
    problem(&report, "configuration", "max_age_ms");
    assert!(about(&report, "shared memory").len() == 1 && !about(&report, "gpu").is_empty(), "{report}");
}
