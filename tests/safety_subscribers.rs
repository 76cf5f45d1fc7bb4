//! Contract (check 26): subscribers that are slow, stopped, or killed while they hold samples cost the daemon neither time nor
//! memory, and a healthy one beside them gets every sample.

mod checks;
mod crash_rig;
mod ipc_rig;
mod namespace;

use crash_rig::{Killed, appears, this_program, wait_at_most};
use iceoryx2::prelude::BackpressureStrategy;
use ipc_rig::{Place, foreign_node, shared_memory_files};
use namespace::isolated;
use noctule::io::wire::message::{EnergyscapeHeader, VelocityCommand};
use noctule::io::wire::telemetry::{Cues, Health};
use noctule::io::{DaemonTopics, Echo, Ipc, IpcParams};
use noctule::signal::{DaemonState, Reason, SampleFormat};
use noctule::time::{Clock, SystemClock};
use rustix::process::Signal;
use std::fs;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::PathBuf;
use std::process::{ChildStdout, Stdio};
use std::time::{Duration, Instant};

/// Longest publishing of a ping set's topics, but for one in a thousand.
const PUBLISH_LIMIT: Duration = Duration::from_millis(1);
const SOON: Duration = Duration::from_secs(5);
/// Places that a topic of the daemon has.
const STOPPED: usize = 7;
/// Subscribers that an energyscape's topic has room for, with the healthy one's.
const STOPPED_ON_IMAGES: usize = 5;
/// Resident memory that may come and go without being growth.
const SLACK_KIB: u64 = 512;

fn sensors() -> Vec<String> {
    vec!["front".to_owned()]
}

fn place_of_a_child() -> Option<(PathBuf, IpcParams)> {
    let root = PathBuf::from(std::env::var_os("NOCTULE_TEST_ROOT")?);
    let prefix = std::env::var("NOCTULE_TEST_PREFIX").ok()?;
    Some((root.clone(), IpcParams { root: Some(root), prefix }))
}

fn tell_ready(root: &std::path::Path) {
    let name = std::env::var("NOCTULE_TEST_NAME").expect("a name");
    fs::write(root.with_extension(name), "").expect("told");
}

/// An ear on each of the daemon's topics; on its energyscapes if asked to.
fn ears(params: &IpcParams) -> Vec<Echo> {
    let ipc = Ipc::open(params).expect("opened");
    let mut topics = vec!["noctule/command", "noctule/cues", "noctule/health"];
    if std::env::var_os("NOCTULE_TEST_IMAGES").is_some() {
        topics.push("noctule/sonar/front/energyscape");
    }
    let open = |topic: &&str| Echo::open(&ipc, topic, true, &sensors(), SampleFormat::Pdm).expect("an ear");
    topics.iter().map(open).collect()
}

/// Not a test of its own: tells the number of every command that it hears, one a line, and whether the rest was there before it.
#[test]
fn healthy_subscriber() {
    let Some((root, params)) = place_of_a_child() else { return };
    let ears = ears(&params);
    tell_ready(&root);
    let mut out = std::io::stdout().lock();
    loop {
        if let Some(line) = ears[0].next_line() {
            let command: serde_json::Value = serde_json::from_str(&line).expect("JSON");
            let complete = ears[1].next_line().is_some() && ears[2].next_line().is_some();
            writeln!(out, "heard {} {complete}", command["sequence"]).expect("told");
            out.flush().expect("told");
        }
        std::thread::sleep(Duration::from_micros(50));
    }
}

/// Not a test of its own: opens everything and is then stopped by whoever started it.
#[test]
fn stopped_subscriber() {
    let Some((root, params)) = place_of_a_child() else { return };
    let _ears = ears(&params);
    tell_ready(&root);
    std::thread::sleep(Duration::from_secs(600));
}

/// Not a test of its own: holds as many samples of health as it may, and is then killed.
#[test]
fn holding_subscriber() {
    let Some((root, params)) = place_of_a_child() else { return };
    let node = foreign_node(&root, &params.prefix);
    let builder = node.service_builder(&"noctule/health".try_into().expect("name"));
    let service = builder.publish_subscribe::<Health>().open().expect("opened");
    let subscriber = service.subscriber_builder().create().expect("subscriber");
    let mut held = Vec::new();
    while held.len() < 2 {
        held.extend(subscriber.receive().expect("received"));
        std::thread::sleep(Duration::from_micros(200));
    }
    tell_ready(&root);
    std::thread::sleep(Duration::from_secs(600));
}

/// Not a test of its own: what the transport does with its own defaults and without overflow.
#[test]
fn blocking_publisher() {
    let Some((root, params)) = place_of_a_child() else { return };
    let node = foreign_node(&root, &params.prefix);
    let builder = node.service_builder(&"bare".try_into().expect("name"));
    let builder = builder.publish_subscribe::<u64>().enable_safe_overflow(false).subscriber_max_buffer_size(1);
    let service = builder.create().expect("made");
    let idle = service.subscriber_builder().create().expect("subscriber");
    let publisher = service
        .publisher_builder()
        .backpressure_strategy(BackpressureStrategy::RetryUntilDelivered)
        .create()
        .expect("publisher");
    // It takes part, and is slow from then on.
    assert!(idle.receive().expect("received").is_none());
    for value in 0..10 {
        publisher.send_copy(value).expect("sent");
        fs::write(root.with_extension("sent"), value.to_string()).expect("told");
    }
}

fn start(place: &Place, test: &str, name: &str, images: bool) -> Killed {
    let mut command = this_program(place, test);
    command.env("NOCTULE_TEST_NAME", name).stdout(Stdio::piped());
    if images {
        command.env("NOCTULE_TEST_IMAGES", "1");
    }
    let child = Killed(command.spawn().expect("started"));
    assert!(appears(&place.root().with_extension(name), SOON), "{test} does not start");
    child
}

/// Publishes everything of a ping set; how long that took.
fn publish(daemon: &mut DaemonTopics, values: &[f32]) -> (u64, Duration) {
    let now = SystemClock.now();
    let command = VelocityCommand::standstill(now, DaemonState::Ready, Reason::NotArmed);
    let begun = Instant::now();
    daemon.publish_cues(Cues::blank()).expect("published");
    daemon.publish_health(Health::blank()).expect("published");
    daemon.publish_energyscape(0, &EnergyscapeHeader::blank(), values).expect("published");
    let sequence = daemon.publish_command(command, now).expect("published");
    (sequence, begun.elapsed())
}

/// Resident memory, open descriptors and shared-memory files.
fn footprint(place: &Place) -> (u64, usize, usize) {
    let status = fs::read_to_string("/proc/self/status").expect("status");
    let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("resident");
    let resident_kib = resident.trim().trim_end_matches("kB").trim().parse().expect("a number");
    let descriptors = fs::read_dir("/proc/self/fd").expect("descriptors").count();
    (resident_kib, descriptors, shared_memory_files(&place.params.prefix).len())
}

fn heard(lines: &mut std::io::Lines<BufReader<ChildStdout>>) -> String {
    loop {
        let line = lines.next().expect("a line").expect("readable");
        if let Some((_, told)) = line.split_once("heard ") {
            return told.to_owned();
        }
    }
}

#[test]
fn seven_stopped_subscribers_cost_the_publisher_nothing_and_the_healthy_one_no_sample() {
    // A process of its own, whose descriptors and memory no other test changes.
    isolated("seven_stopped_subscribers_cost_the_publisher_nothing_and_the_healthy_one_no_sample", "64m", || {
        let place = Place::new();
        let mut daemon = DaemonTopics::open(&place.ipc, &sensors(), &[35]).expect("daemon");
        let stopped: Vec<Killed> = (0..STOPPED)
            .map(|index| start(&place, "stopped_subscriber", &format!("stopped{index}"), index < STOPPED_ON_IMAGES))
            .collect();
        for child in &stopped {
            rustix::process::kill_process(rustix::process::Pid::from_child(&child.0), Signal::STOP).expect("stopped");
        }
        let mut healthy = start(&place, "healthy_subscriber", "healthy", false);
        let mut lines = BufReader::new(healthy.0.stdout.take().expect("piped")).lines();
        let values = vec![1.0; 35];
        let sets = checks::trials(10_000, 3_000);
        let mut times = Vec::with_capacity(sets);
        let mut received = 0;
        // The first one makes the connections.
        publish(&mut daemon, &values);
        heard(&mut lines);
        let before = footprint(&place);
        for _ in 0..sets {
            let (sequence, took) = publish(&mut daemon, &values);
            times.push(took);
            // One after the other: whether it gets every one is a question to the transport, not to the scheduler.
            received += usize::from(heard(&mut lines) == format!("{sequence} true"));
        }
        let after = footprint(&place);
        times.sort();
        let rank = |share: f64| times[((sets as f64 * share).ceil() as usize).clamp(1, sets) - 1];
        let found = format!("p50 {:?}, p99.9 {:?}, max {:?}", rank(0.5), rank(0.999), rank(1.0));
        checks::figure(26, "publishing beside 7 stopped subscribers", found, "p99.9 <= 1 ms", sets);
        checks::figure(26, "samples that the healthy one got", format!("{received} of {sets}"), "100 %", sets);
        checks::figure(
            26,
            "KiB, descriptors, files before and after",
            format!("{before:?} {after:?}"),
            "no growth",
            sets,
        );
        assert_eq!(received, sets);
        assert!(rank(0.999) <= PUBLISH_LIMIT, "{:?}", rank(0.999));
        assert_eq!((before.1, before.2), (after.1, after.2));
        assert!(after.0 <= before.0 + SLACK_KIB, "{before:?} {after:?}");
    });
}

#[test]
fn subscribers_killed_while_they_hold_samples_leave_no_error_and_no_growth() {
    // A process of its own, whose descriptors and memory no other test changes.
    isolated("subscribers_killed_while_they_hold_samples_leave_no_error_and_no_growth", "64m", || {
        let place = Place::new();
        let mut daemon = DaemonTopics::open(&place.ipc, &sensors(), &[35]).expect("daemon");
        let values = vec![1.0; 35];
        let killed = checks::trials(60, 20);
        let mut slowest = Duration::ZERO;
        let mut first = None;
        for number in 0..killed {
            let mut command = this_program(&place, "holding_subscriber");
            let name = format!("holding{number}");
            let mut child = Killed(command.env("NOCTULE_TEST_NAME", &name).spawn().expect("started"));
            let deadline = Instant::now() + SOON;
            while !place.root().with_extension(&name).exists() {
                assert!(Instant::now() < deadline, "subscriber {number} gets nothing");
                slowest = slowest.max(publish(&mut daemon, &values).1);
                std::thread::sleep(Duration::from_millis(1));
            }
            child.0.kill().expect("killed");
            child.0.wait().expect("gone");
            for _ in 0..20 {
                slowest = slowest.max(publish(&mut daemon, &values).1);
            }
            // The first few fill caches and places that stay.
            if number == 9 {
                first = Some(footprint(&place));
            }
        }
        let (first, last) = (first.expect("ten at least"), footprint(&place));
        let found = format!("{first:?} after 10, {last:?} after {killed}");
        checks::figure(26, "killed while holding: KiB, descriptors, files", found, "no growth", killed);
        checks::figure(26, "slowest publishing between kills", format!("{slowest:?}"), "no error", killed);
        assert!(last.1 <= first.1 && last.2 <= first.2, "{first:?} {last:?}");
        assert!(last.0 <= first.0 + SLACK_KIB, "{first:?} {last:?}");
    });
}

/// Negative control: what the transport does with its own defaults and without overflow.
#[test]
fn with_back_pressure_and_without_overflow_one_idle_subscriber_blocks_the_publisher() {
    let place = Place::new();
    let mut child = Killed(this_program(&place, "blocking_publisher").spawn().expect("started"));
    assert!(appears(&place.root().with_extension("sent"), SOON), "the first is sent");
    let ended = wait_at_most(&mut child, Duration::from_millis(1_500));
    let sent = fs::read_to_string(place.root().with_extension("sent")).expect("told");
    let found = format!("blocked for 1.5 s after sample {sent}");
    checks::figure(26, "negative control: back-pressure, no overflow", found, "blocks", 1);
    assert!(ended.is_none(), "{ended:?}");
}
